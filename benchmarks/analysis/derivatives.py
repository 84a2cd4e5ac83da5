"""Derivatives of the joint's forces by a solver that shares no code with the package: CVODES' forward sensitivities.

    python -m benchmarks.analysis.derivatives    solves, and writes tests/data/joint_derivatives.npz (needs the extra ``bench``)

``joint_sensitive`` integrates state and sensitivities together, both in its error control. Forces are read from both by
``joint.observe``. The file holds, as float32 at 1 ms, the derivatives of all normal forces by the logarithms of
``MOVED``, and settings as JSON, with how well they converged and what central differences say.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import ROOT, keep_arrays, kept_arrays

if TYPE_CHECKING:
    from benchmarks.references.joint_sensitive import Sensitive

PATH = ROOT / "tests" / "data" / "joint_derivatives.npz"
END_S, STEP_S, WINDOW = 0.6, 1e-3, 5
# What is moved, each by its logarithm; a groove's clearance is that of both races.
MOVED = {
    "stiffness": ("stiffness",),
    "exponent": ("exponent",),
    "friction_static": ("friction_static",),
    "friction_dynamic": ("friction_dynamic",),
    "damping": ("damping",),
    "groove clearance": ("clearance_seat_ball", "clearance_head_ball"),
    "cage clearance": ("clearance_cage_ball",),
    "contact_angle": ("contact_angle",),
}
CONTACTS = {"seat_cage": 1, "head_cage": 1, "cage_ball": 6, "seat_ball": 6, "head_ball": 6}
TOLERANCE, LOOSER, DIFFERENCE_TOLERANCE, DIFFERENCE_STEPS = 1e-8, 1e-6, 1e-10, (1e-4, 3e-4)


class Reference(NamedTuple):
    """A kept Jacobian: times (T,) [s], forces (T, 20) and derivatives (T, 20, 8) by the logarithms of ``MOVED`` [N]."""

    times: np.ndarray
    force: np.ndarray
    slope: np.ndarray
    settings: dict[str, Any]


def load(path: Path = PATH) -> Reference:
    """The kept file."""
    kept, settings = kept_arrays(path)
    return Reference(kept["times"], kept["force"], kept["slope"], settings)


def moved(params: Mapping[str, Any], logs: Any) -> dict[str, Any]:
    """The parameters, those of ``MOVED`` times the exponentials of ``logs`` (8,)."""
    import jax.numpy as jnp

    changed = dict(params)
    for i, names in enumerate(MOVED.values()):
        changed |= {name: params[name] * jnp.exp(logs[i]) for name in names}
    return changed


def normals(force: Mapping[str, Any]) -> Any:
    """All normal forces side by side, (..., T, 20), in the order of ``CONTACTS``."""
    import jax.numpy as jnp

    parts = [force[name][..., 0] for name in CONTACTS]
    return jnp.concatenate([part if size > 1 else part[..., None] for part, size in zip(parts, CONTACTS.values())], -1)  # noqa: B905


def averaged(histories: np.ndarray, width: int = WINDOW) -> np.ndarray:
    """Moving average of ``width`` samples along the first axis."""
    total = np.cumsum(np.concatenate([np.zeros_like(histories[:1]), histories]), axis=0)
    return (total[width:] - total[:-width]) / width


def errors(found: np.ndarray, exact: np.ndarray, width: int = WINDOW) -> np.ndarray:
    """Relative L2 error (8,) of the averages of derivatives (T, 20, 8), over all histories; ``width`` 1: pointwise."""
    a, b = averaged(found, width), averaged(exact, width)
    return np.sqrt(np.sum((a - b) ** 2, axis=(0, 1)) / np.sum(b**2, axis=(0, 1)))


def influence(exact: np.ndarray, width: int = WINDOW) -> np.ndarray:
    """L2 norm (8,) of each parameter's averaged derivatives, over the largest."""
    size = np.sqrt(np.sum(averaged(exact, width) ** 2, axis=(0, 1)))
    return size / size.max()


def reader(scene: Any, params: Mapping[str, Any]) -> Any:
    """(states (T, n), slopes (T, n, 8)) -> normal forces (T, 20) and their derivatives (T, 20, 8)."""
    import jax
    import jax.numpy as jnp

    from bcfj_jax.models.joint.constants import constants
    from bcfj_jax.models.joint.observe import observe

    def one(y, logs):
        found = observe(scene, constants(scene, moved(params, logs)), y)
        return normals({name: reading.force[None] for name, reading in found.items()})[0]

    def both(y, slope):
        logs, eye = jnp.zeros(len(MOVED)), jnp.eye(len(MOVED))
        ahead = jax.vmap(lambda dy, dp: jax.jvp(one, (y, logs), (dy, dp))[1], (1, 0), 1)
        return one(y, logs), ahead(slope, eye)

    compiled = jax.jit(jax.vmap(both))
    return lambda states, slopes: tuple(np.asarray(x) for x in compiled(jnp.asarray(states), jnp.asarray(slopes)))


def force_reader(scene: Any, params: Mapping[str, Any]) -> Any:
    """(states (T, n), logs (8,)) -> normal forces (T, 20)."""
    import jax

    from bcfj_jax.models.joint.constants import constants
    from bcfj_jax.models.joint.observe import observe

    @jax.jit
    def read(states, logs):
        made = constants(scene, moved(params, logs))
        return normals(jax.vmap(lambda y: {k: r.force for k, r in observe(scene, made, y).items()})(states))

    return lambda states, logs: np.asarray(read(states, logs))


def differences(made: Sensitive, times: np.ndarray, tol: float, step: float, central: bool = True) -> tuple[Any, float]:
    """Derivatives (T, 20, 8) by differences of runs of CVODES, and their CPU time [s]."""
    read, eye, total = force_reader(made.scene, made.params), np.eye(len(MOVED)), 0.0

    def run(logs):
        nonlocal total
        states, seconds, _ = made.states(times, tol, logs)
        total += seconds
        return read(states, logs)

    if central:
        columns = [(run(step * e) - run(-step * e)) / (2.0 * step) for e in eye]
    else:
        base = run(np.zeros(len(MOVED)))
        columns = [(run(step * e) - base) / step for e in eye]
    return np.stack(columns, -1), total


def grid() -> np.ndarray:
    """The times of all of this."""
    return np.linspace(0.0, END_S, round(END_S / STEP_S) + 1)


def make() -> None:
    """Solve, measure the convergence, and write the file."""
    import bcfj_jax as bj
    from benchmarks.references.joint_casadi import default_scales
    from benchmarks.references.joint_sensitive import Sensitive

    scene = bj.scenes.joint_of_keys(**PLAIN)
    params, times = scene.parameters(), grid()
    made = Sensitive(scene, params, default_scales(scene), MOVED)
    print(f"built in {made.compile_s:.1f} s", flush=True)
    read = reader(scene, params)
    kept, convergence = {}, {}
    for tol in (TOLERANCE, LOOSER):
        states, slopes, seconds = made.sensitivities(times, tol)
        kept[tol] = read(states, slopes)
        print(f"sensitivities at {tol:g}: {seconds:.1f} s", flush=True)
    force, slope = kept[TOLERANCE]

    def against(found):
        named = zip(MOVED, errors(found, slope).tolist(), errors(found, slope, 1).tolist(), strict=True)
        return {name: {"5 ms": average, "pointwise": point} for name, average, point in named}

    convergence[f"sensitivities at {LOOSER:g}"] = against(kept[LOOSER][1])
    for step in DIFFERENCE_STEPS:
        found, seconds = differences(made, times, DIFFERENCE_TOLERANCE, step)
        name = f"central differences, step {step:g}, on CVODES at {DIFFERENCE_TOLERANCE:g}"
        convergence[name] = against(found)
        print(f"{name}: {seconds:.1f} s", flush=True)
    settings = {
        "solver": "CVODES (CasADi, BDF), state and forward sensitivities together in the error control",
        "tolerance": TOLERANCE,
        "unit_of_the_tolerance": "a place of 50 um, a speed of 0.1 m/s, a turn or spin of these over 35.5 mm",
        "versions": {name: version(name) for name in ("casadi", "numpy")},
        "derivative": "of normal forces [N] by the logarithm of each parameter",
        "parameters": {name: list(names) for name, names in MOVED.items()},
        "histories": dict(CONTACTS),
        "influence": dict(zip(MOVED, influence(slope).tolist(), strict=True)),
        "largest": dict(zip(MOVED, np.abs(slope).max((0, 1)).tolist(), strict=True)),
        "convergence": {"what": "relative L2 difference from this file", **convergence},
        "scene": "joint, every option at its default",
        "values": {name: float(value) for name, value in params.items()},
    }
    keep_arrays(PATH, settings, times, {"force": force, "slope": slope})
    print(json.dumps({key: settings[key] for key in ("influence", "largest", "convergence")}, indent=1))


if __name__ == "__main__":
    make()
