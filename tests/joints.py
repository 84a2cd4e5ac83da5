"""Joints that tests share, their states and places of their balls, and runs of them from any start."""

from __future__ import annotations

import functools
from typing import NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

import bcfj_jax as bj
from bcfj_jax.models.joint import energy, system
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.constants import constants as make_constants
from bcfj_jax.models.joint.contacts import ContactForce
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scales import scales
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.rodas import Rodas

SEEDS = st.integers(0, 2**31 - 1)


def plain_joint(**options):
    """A joint of particles in windows without ends, whose pilots are full spheres; other options as they are given.

    It costs half of the default's program and has closed forms, and kept data are of it. Tests of the default say so.
    """
    return bj.scenes.make("joint", **PLAIN | options)


JOINT = plain_joint()
# The same in a scene file.
PLAIN_LINES = "".join(f"{name} = {str(value).lower()}\n" for name, value in PLAIN.items())
# What runs once, or a few hundred times, is compiled without care.
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
# An operation at a time, each of these compiles a hundred little programs.
constants, view, start = (jax.jit(f, static_argnums=0) for f in (make_constants, system.view, nominal))
GROOVES = ("seat_ball", "head_ball")
# The smallest joint that runs, so that it compiles quickly; what is tested with it does not depend on its options.
LITTLE = {"friction": False, "cage": "fixed", "contacts": GROOVES, "head": "fixed", "balls": 3}
MANY = 60


class Touches(NamedTuple):
    """All contacts: grooves (balls, 2 races), windows and their ends (balls,), pilots (k,), as far as there are any."""

    grooves: ContactForce
    windows: ContactForce | None
    pilots: ContactForce | None
    ends: ContactForce | None


def stacked(touches: list[ContactForce], axis: int) -> ContactForce:
    """Several touches as one; of what they read, what all of them read."""
    missing = [k for k in ContactForce._fields if any(getattr(one, k) is None for one in touches)]
    alike = [one._replace(**dict.fromkeys(missing)) for one in touches]
    return jax.tree.map(lambda *x: jnp.stack(x, axis), *alike)


def touches(scene, c, state):
    """What the contacts of one state do."""
    found = system.by_name(scene, system.contact_forces(scene, c, state))
    pilots = [found[name] for name in scene.pilots]
    grooves = stacked([found[name] for name in GROOVES], 1)
    return Touches(
        grooves, found.get("cage_ball"), stacked(pilots, 0) if pilots else None, found.get("cage_window_end")
    )


@functools.cache
def made(**options):
    """A joint of hashable options, its parameters and its constants."""
    scene = plain_joint(**options)
    params = scene.parameters()
    return scene, params, constants(scene, params)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Random directions, (*shape, 3)."""
    v = rng.normal(size=(*shape, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def in_grooves(rng: np.random.Generator, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Ball centres within some 50 um of the track circle, from its centre; normals of the track's plane."""
    across = unit(rng, MANY, 2)
    radial = np.cross(across, unit(rng, MANY, 2))
    radial /= np.linalg.norm(radial, axis=-1, keepdims=True)
    return radius * radial + 5e-5 * rng.normal(size=(MANY, 2, 3)), across


def noisy(scene, params, seed, places=3e-5, speeds=0.3):
    """A state in contact: the nominal one at some angle, with noise [m] and [m/s]; angles by each body's radius."""
    draw = np.random.default_rng(seed)
    p, n, b = params, scene.balls, scene.coupling
    radius = float(p["pitch_radius"])
    turns = [
        name.endswith("turn") for name, piece in scene.slices.items() if piece for _ in range(piece.stop - piece.start)
    ]
    lever = np.where(turns, 1.0 / radius, 1.0)
    twist = np.ones((n, scene.twist))
    twist[:, 3:] = 1.0 / float(p["ball_radius"])
    size = np.concatenate([np.full(3 * n, places), places * lever, speeds * twist.ravel(), speeds * lever])
    begin = start(scene, params, jnp.asarray(draw.uniform(0.0, 2 * np.pi)))
    y = np.array(begin)
    y[: size.size] += size * draw.normal(size=size.size)
    tilt = scene.slices["cage_turn"]
    if tilt is not None:
        axis = y[3 * n : 3 * n + b][tilt]
        axis /= np.linalg.norm(axis)
    if scene.drive == "prescribed":
        y[scene.moving - 1] = float(p["drive_speed"])
    return y


def flows(scene, params):
    """Power, store and the store's rate at (t, y), compiled."""
    c = constants(scene, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def read(t, y):
        flow = energy.power(scene, c, t, y)
        drift = system.field(t, y, (scene, c))
        store, rate = jax.jvp(lambda t, y: energy.stored(scene, c, t, y), (t, y), (jnp.ones(()), drift))
        return flow, store, rate

    return read


def _solved(scene, params, start, times, tolerance):
    """States at the times from any start."""
    c = make_constants(scene, params)
    control = dfx.PIDController(rtol=0.0, atol=tolerance * scales(scene, params), pcoeff=0.2, icoeff=0.5)
    solution = dfx.diffeqsolve(
        dfx.ODETerm(system.field), Rodas(Arrowhead()), 0.0, times[-1], 1e-7, start, (scene, c),
        saveat=dfx.SaveAt(ts=times), stepsize_controller=control, adjoint=dfx.ForwardMode(), max_steps=100_000,
    )  # fmt: skip
    return solution.ys


solved = jax.jit(_solved, static_argnums=0, compiler_options=QUICK)
