"""A measured bit torque drives the end of a drill string: python stick_slip.py FOLDER.

The record stands for a rig's: 60 s at 1 kHz of bit torque, top torque and bit speed while the bit sticks and slips. It is
made by SciPy from equations of its own: three lumps on springs below a flexible top that turns evenly, and at the bit
Coulomb's friction that falls with speed, as a switch between sticking and sliding (Karnopp 1985). The scene ``string`` in
motion has the same string and no law of friction: the recorded torque acts on its bit as a table, thinned from 60 001 rows
with a stated error. Top torque and bit speed are compared. The record has the scene's stiffness of a joint, which follows
from its contacts, and nothing else of it.
"""

import sys
from pathlib import Path

import jax
import numpy as np
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from bcfj_jax.models.string_motion import joint_stiffness

JOINTS, END, RATE, NOISE = 3, 60.0, 1000, 15.0
# Of the record's table: what straight lines may be off [N m], twice the noise.
ERROR = 30.0
STATIC, SLIDING, FALL = 2600.0, 1400.0, 2.0
GIVEN = {
    "drive_speed": 8.0, "drive_stiffness": 600.0, "drive_damping": 20.0, "bit_inertia": 60.0, "wall_friction": 0.0,
    "weight_on_bit": 10e3,
}  # fmt: skip


def string(times, torque):
    """The scene under a table of the bit's torque [N m], and its parameters."""
    rock = bj.scenes.JointLoads(load_profile="table", load_table=[times, torque])
    drive = bj.scenes.JointDrive(drive="flexible")
    scene = bj.scenes.string(n=JOINTS, motion="torsional", fidelity="kinematic", drive=drive, loads=rock)
    return scene, scene.parameters(GIVEN)


def lumps():
    """Inertias of the lumps, stiffness and damping of the springs above them, from the drive down."""
    scene, params = string([0.0, 1.0], [SLIDING, SLIDING])
    p = {name: float(value) for name, value in params.items()}
    polar = 0.5 * np.pi * (p["segment_radius"] ** 4 - p["segment_bore"] ** 4)
    inertia = np.full(JOINTS, p["segment_density"] * polar * p["segment_length"] + p["head_inertia"])
    inertia[-1] += p["bit_inertia"]
    joints = np.asarray(jax.jit(lambda p: joint_stiffness(scene, p))(params))
    stiffness = 1.0 / (1.0 / joints + 2.58 * p["segment_length"] / (p["segment_modulus"] * polar))
    damping = p["twist_relaxation"] * stiffness
    stiffness[0] = 1.0 / (1.0 / stiffness[0] + 1.0 / p["drive_stiffness"])
    damping[0] = p["drive_damping"]
    return inertia, stiffness, damping


def record(end=END):
    """Times (T,), torque of the bit on the rock, torque at the top, speed of the bit; sticking and sliding by events."""
    inertia, stiffness, damping = lumps()
    top = GIVEN["drive_speed"]

    def torques(t, y):
        """Of the springs, from the top down [N m]."""
        angles, speeds = np.concatenate([[top * t], y[:JOINTS]]), np.concatenate([[top], y[JOINTS:]])
        return -stiffness * np.diff(angles) - damping * np.diff(speeds)

    def friction(speed):
        return SLIDING + (STATIC - SLIDING) * np.exp(-abs(speed) / FALL)

    def field(stuck):
        def rates(t, y):
            twisting = torques(t, y)
            net = twisting - np.append(twisting[1:], 0.0)
            net[-1] = 0.0 if stuck else net[-1] - friction(y[-1])
            return np.concatenate([y[JOINTS:], net / inertia])

        return rates

    def slips(t, y):
        return torques(t, y)[-1] - STATIC

    def stops(t, y):
        return y[-1]

    slips.terminal = stops.terminal = True
    slips.direction, stops.direction = 1, -1
    times, found, begin, stuck = np.arange(round(end * RATE) + 1) / RATE, [], 0.0, False
    y = np.concatenate([np.zeros(JOINTS), np.full(JOINTS, top)])
    while begin < end:
        part = solve_ivp(
            field(stuck), (begin, end), y, "DOP853", dense_output=True, events=slips if stuck else stops,
            rtol=1e-9, atol=1e-10,
        )  # fmt: skip
        last = part.t[-1] if part.t[-1] < end else np.inf
        for t in times[(times >= begin) & (times < last)]:
            state = part.sol(t)
            pull = torques(t, state)
            found.append((pull[-1] if stuck else friction(state[-1]), pull[0], state[-1]))
        begin, y, stuck = part.t[-1], part.y[:, -1], not stuck
        # Off the switch, so that an event is not found again.
        y[-1] = 0.0 if stuck else 1e-9
    return times, *np.array(found).T


def compared(end=END):
    """The run, what it is compared with, and by name the largest and the rms difference as shares of the range."""
    times, bit, top, speed = record(end)
    rock = bj.thinned(times, bit + NOISE * np.random.default_rng(1).standard_normal(times.size), ERROR)
    print(
        f"{times.size} rows are {rock.times.size}, {rock.error:.3g} N m off at most; filtered out {rock.filtered:.3g} N m (rms)"
    )
    scene, params = string(rock.times, rock.values)
    right = {"top.torque": top, f"lump_{JOINTS}.speed": speed}
    run = bj.simulate(scene, params, times, read=list(right))
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
    print(f"greatest force of a ball on its seat: {np.nanmax(np.abs(run.force['seat_ball'])) / 1e3:.1f} kN")


if __name__ == "__main__":
    main()
