"""A measured attitude: channels of a unit quaternion, compared as one rotation.

With q the quaternion that was measured and p the model's, the error is the rotation vector [rad], in the world's axes, of
p q*: its direction is the axis and its length the angle, at most pi. q and -q are the same attitude, of which the one with
q0 >= 0 is kept. A quaternion can be wrong in three numbers: the error's x, y, z stand in the places of q1, q2, q3, and
what they say of q0 is enough.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.bodies import QUATERNION
from bcfj_jax.mechanism.channels import ATTITUDE

# Square of half an angle below which its series is as good.
_SMALL = 1e-8
# A spin is in the body's axes where it misses the attitude's rate by so many times less there, and by this share in the world's.
_APART, _SHARE = 3.0, 0.1


def attitudes(channels: Iterable[str]) -> dict[str, dict[str, str]]:
    """Of each attitude its channels' names by component, by what they are named without the component."""
    found: dict[str, dict[str, str]] = {}
    for name in channels:
        text, _, frame = name.partition(" in ")
        part, _, component = text.rpartition(".")
        if part.endswith(f".{ATTITUDE}"):
            found.setdefault(f"{part} in {frame}" if frame else part, {})[component] = name
    return found


def scalar(name: str) -> str:
    """Name of the scalar part of the attitude that a channel is of."""
    return re.sub(r"\.q[1-3]", ".q0", name)


def reduced(times: np.ndarray, channels: Mapping[str, np.ndarray], where: str) -> dict[str, np.ndarray]:
    """Readings of attitudes that are kept, by channel: q1, q2, q3 of length at most 1, q0 being what is left of 1.

    Args:
        times, channels: (T,) [s]; (T,) by name, all four of an attitude, or q1 to q3 where q0 is not negative.
        where: for the message.

    Raises:
        InputError: naming what is missing, how far from 1 the length is, or in which axes the spin beside it seems to be.
    """
    found: dict[str, np.ndarray] = {}
    for name, parts in attitudes(channels).items():
        missing = [q for q in QUATERNION if q not in parts]
        if missing and missing != ["q0"]:
            said = f"'{name}' without {', '.join(missing)}"
            raise InputError(f"{where}: observe", said, "observe q0 to q3, scalar first: an attitude is all four")
        rest = [channels[parts[q]] for q in QUATERNION[1:]]
        left = 1.0 - np.sum(np.square(rest), axis=0)
        q = np.stack([np.sqrt(np.maximum(left, 0.0)) if missing else channels[parts["q0"]], *rest])
        length = np.sqrt(np.sum(np.square(q), axis=0))
        off = np.abs(length - 1.0)
        if np.any(off > 0.1):
            worst = int(np.nanargmax(off))
            said = f"q0 to q3 of row {worst + 1} have a length of {length[worst]:.3g}"
            raise InputError(f"{where}: observe '{name}'", said, "give columns of a unit quaternion, scalar first")
        q = q / length * np.where(q[0] < 0.0, -1.0, 1.0)
        body = name.rpartition(".")[0]
        spin = [channels[x] for k in "xyz" if (x := f"{body}.spin.{k}") in channels]
        if len(spin) == 3 and " in " not in name:
            _check_spin(times, q, np.stack(spin), body, where)
        found |= {parts[key]: x for key, x in zip(QUATERNION[1:], q[1:], strict=True)}
    return found


def _check_spin(times: np.ndarray, q: np.ndarray, spin: np.ndarray, body: str, where: str) -> None:
    """Refuse angular velocities (3, T) that fit the rate of an attitude (4, T) in the body's axes and not in the world's."""
    after, before, inverse = q[:, 1:], q[:, :-1], np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    # The same turn seen from the body: of the inverse attitudes, backwards.
    pairs = (after, before), (before * inverse, after * inverse)
    mean, steps = 0.5 * (spin[:, 1:] + spin[:, :-1]), np.diff(times)
    misses = [mean - np.asarray(rotation(*map(jnp.asarray, pair))) / steps for pair in pairs]
    seen = np.isfinite(misses).all(axis=(0, 1))
    if not seen.any():
        # Without two readings in a row nothing is known of a rate.
        return
    world, own, size = (float(np.sqrt(np.mean(np.square(x[:, seen])))) for x in (*misses, mean))
    if world > _APART * own and world > _SHARE * size:
        said = f"misses the attitude's rate by {world:.2g} rad/s in the world's axes, by {own:.2g} rad/s in the body's"
        raise InputError(f"{where}: observe '{body}.spin.x'", said, f"write '{body}.spin.x in {body}', y and z alike")


def compared(read: Mapping[str, Array], measured: Mapping[str, Array]) -> dict[str, Array]:
    """Readings (T,) by channel, of attitudes the scalar part, too; of these what was measured, with the error added."""
    found = dict(read)
    for parts in attitudes(measured).values():
        names = [parts[q] for q in QUATERNION[1:]]
        vector = jnp.stack([measured[n] for n in names])
        square = 1.0 - jnp.sum(vector * vector, 0)
        whole = jnp.concatenate([jnp.sqrt(jnp.maximum(square, 0.0))[None], vector])
        model = jnp.stack([read[scalar(names[0])], *(read[n] for n in names)])
        found |= dict(zip(names, vector + rotation(model, whole), strict=True))
    return found


def rotation(p: Array, q: Array) -> Array:
    """Rotation vector (3, T) [rad] that takes the attitudes q to p, (4, T) each, of any length; 0 where one is 0."""
    w = jnp.sum(p * q, 0)
    v = q[0] * p[1:] - p[0] * q[1:] - jnp.cross(p[1:], q[1:], axis=0)
    v, w = jnp.where(w < 0.0, -v, v), jnp.abs(w)
    square = jnp.sum(v * v, 0)
    small = square <= _SMALL * jnp.square(w)
    size = jnp.sqrt(jnp.where(small, 1.0, square))
    # atan(s/w)/s, of small s by its series.
    safe = jnp.where(w > 0.0, w, 1.0)
    half = jnp.where(small, (1.0 - square / (3.0 * safe**2)) / safe, jnp.arctan2(size, w) / size)
    return 2.0 * half * v
