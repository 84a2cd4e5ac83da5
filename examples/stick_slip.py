"""A measured bit torque drives a drill string: python stick_slip.py FOLDER.

The record stands for a rig's: 60 s at 1 kHz of bit torque, top torque and bit speed while the bit sticks and slips. It is
made by SciPy from equations of its own: four lumps on springs, a top that turns evenly, and at the bit Coulomb's friction
that falls with speed, as a switch between sticking and sliding (Karnopp 1985). The scene has the same string and no law of
friction: the recorded torque acts on the bit as a table of 60 001 rows. Top torque and bit speed are compared.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj

LUMPS, INERTIA, BIT, STIFFNESS, DAMPING = 4, 40.0, 120.0, 1900.0, 12.0
TOP_SPEED, STATIC, SLIDING, FALL = 8.0, 2600.0, 1400.0, 2.0
END, RATE, NOISE = 60.0, 1000, 15.0
INERTIAS = np.array([INERTIA] * (LUMPS - 1) + [BIT])


def record():
    """Times (T,), torque of the rock on the bit, torque at the top, speed of the bit; sticking and sliding by events."""

    def torques(t, y):
        """Of the springs, from the top down [N m]."""
        angles, speeds = np.concatenate([[TOP_SPEED * t], y[:LUMPS]]), np.concatenate([[TOP_SPEED], y[LUMPS:]])
        return -STIFFNESS * np.diff(angles) - DAMPING * np.diff(speeds)

    def friction(speed):
        return -(SLIDING + (STATIC - SLIDING) * np.exp(-abs(speed) / FALL))

    def field(stuck):
        def rates(t, y):
            twisting = torques(t, y)
            net = twisting - np.append(twisting[1:], 0.0)
            net[-1] = 0.0 if stuck else net[-1] + friction(y[-1])
            return np.concatenate([y[LUMPS:], net / INERTIAS])

        return rates

    def slips(t, y):
        return torques(t, y)[-1] - STATIC

    def stops(t, y):
        return y[-1]

    slips.terminal = stops.terminal = True
    slips.direction, stops.direction = 1, -1
    times, found, y, begin, stuck = np.arange(round(END * RATE) + 1) / RATE, [], np.zeros(2 * LUMPS), 0.0, True
    while begin < END:
        part = solve_ivp(
            field(stuck), (begin, END), y, "DOP853", dense_output=True, events=slips if stuck else stops,
            rtol=1e-10, atol=1e-10,
        )  # fmt: skip
        last = part.t[-1] if part.t[-1] < END else np.inf
        for t in times[(times >= begin) & (times < last)]:
            state = part.sol(t)
            pull = torques(t, state)
            found.append((-pull[-1] if stuck else friction(state[-1]), pull[0], state[-1]))
        begin, y, stuck = part.t[-1], part.y[:, -1], not stuck
        # Off the switch, so that an event is not found again.
        y[-1] = 0.0 if stuck else 1e-9
    return times, *np.array(found).T


def string(times, torque):
    """The same string under a table of the bit's torque."""
    names = [*(f"lump_{k}" for k in range(1, LUMPS)), "bit"]
    top = bj.Body("top", "hinge", mass=1.0, inertia=1.0, axis="x", drive=bj.Drive("constant", speed=TOP_SPEED))
    bodies, loads = [top], [bj.loads.Torque("rock", "bit", "x", table=(times, torque))]
    for name, parent, inertia in zip(names, ["top", *names], INERTIAS, strict=False):
        # A hinge's angle is from its parent, at whose speed it turns; all are at rest when the top begins to.
        start = {"speed": -TOP_SPEED} if parent == "top" else {}
        bodies.append(bj.Body(name, "hinge", parent=parent, mass=1.0, inertia=float(inertia), axis="x", start=start))
        loads.append(bj.loads.JointSpring(f"twist_{name}", name, stiffness=STIFFNESS, damping=DAMPING))
    return bj.Mechanism("string", bodies, loads=loads, end=END)


def compared(end=END):
    """The run, what it is compared with, and by name the largest and the rms difference as shares of the range."""
    times, bit, top, speed = (x[: round(end * RATE) + 1] for x in record())
    measured = bit + NOISE * np.random.default_rng(1).standard_normal(times.size)
    scene = string(times, measured)
    right = {"top.torque": top, "bit.spin.x": speed}
    run = bj.simulate(scene, scene.parameters(), times, read=list(right))
    off = {name: np.abs(run.readings[name] - x) / np.ptp(x) for name, x in right.items()}
    return run, right, {name: (float(x.max()), float(np.sqrt(np.mean(x**2)))) for name, x in off.items()}


def main():
    """Compare, draw, print."""
    import matplotlib.pyplot as plt

    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    run, right, found = compared()
    figure, axes = plt.subplots(2, sharex=True, layout="constrained")
    for axis, name, label, unit in zip(
        axes, right, ("top torque [kN m]", "bit speed [rad/s]"), (1e3, 1.0), strict=True
    ):
        axis.plot(run.times, right[name] / unit, label="record")
        axis.plot(run.times, run.readings[name] / unit, "--", label="simulated")
        axis.set_ylabel(label)
    axes[0].legend(loc="upper right")
    axes[1].set_xlabel("time [s]")
    figure.savefig(folder / "stick_slip.png", dpi=120)
    for name, (largest, rms) in found.items():
        print(f"{name}: largest difference {largest:.2%} of the range, rms {rms:.2%}")


if __name__ == "__main__":
    main()
