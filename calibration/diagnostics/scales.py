"""Which scales the channels cannot tell: masses and speeds that may be wrong without any reading showing it.

With m -> c m, v -> v/c, K -> K c^n and a -> a c every force of an impact stays the same; of accelerations only K/m acts. With
A the derivatives of the residuals by the logarithms of all that is free, and of masses and speeds that are fixed, what no
reading shows is a direction in which A is 0: so far scales move, and so far the estimates move along.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from bcfj_jax.core.quantities import rounded
from bcfj_jax.mechanism.channels import quantity_of, unit_of
from calibration.forward.model import Model, evaluation
from calibration.problem import NUISANCES
from calibration.solver_budget import budget

# Units of the scales, and other lengths that set a speed. A transition speed of friction is none.
_UNITS, _LENGTHS, _NONE = ("kg", "kg m^2", "m/s"), ("drop_height",), ("friction_speed",)
# What is left of a derivative, as a share, where the data cannot tell; step of the differences. Exact scalings leave
# 1e-5 or less, combinations that data determine to a percent 5e-3 or more.
_UNSEEN, _STEP = 1e-3, 1e-3
# A finite move along such a direction, and what may be left of what it would do.
_FINITE, _LEFT = 0.05, 5e-3
# A move of an estimate that is named, for 1 % of a scale [%].
_NAMED = 0.05
# Moves of scales below this share of the largest are none; relations of two are recognised to it.
_EQUAL = 0.05


class _Axes(NamedTuple):
    """What moves: names (M,), of estimates as results have them, how many are free, which are scales, and the derivatives (N, M)
    of the residuals by their logarithms; of a nuisance by its range.
    """

    names: list[str]
    labels: list[str]
    free: int
    scales: np.ndarray
    columns: np.ndarray


def untold(model: Model, labels: tuple[str, ...], point: np.ndarray) -> list[dict[str, Any]]:
    """Every scale, or combination of scales, that the channels do not show, in words.

    Returns:
        parameters: the scales; moves: by scale, what 1 % of it moves each free parameter by [%]; text and remedy.
    """
    if budget(model).rough or not model.scene.traits.history or not model.channels:
        return []
    point = np.asarray(point, dtype=float)
    axes = _axes(model, labels, point)
    sizes = np.linalg.norm(axes.columns, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    _, singular, directions = np.linalg.svd(axes.columns / sizes, full_matrices=False)
    unseen = singular < _UNSEEN * np.linalg.norm(directions[:, axes.scales], axis=1)
    ways = [way / np.abs(way[axes.scales]).max() for way in directions[unseen] / sizes]
    ways = [way for way in ways if _exact(model, point, way, axes, sizes)]
    return [_told(model, way, axes) for way in _apart(np.reshape(ways, (-1, sizes.size)), axes)]


def _axes(model: Model, labels: tuple[str, ...], point: np.ndarray) -> _Axes:
    at, free = evaluation(model)(point[None]), [axis.name for axis in model.coordinates]
    jacobian = np.where(np.isfinite(at.jacobians[0]), at.jacobians[0], 0.0)
    columns, fixed = [jacobian @ _steps(model, point)], []
    units = {name: q.unit for name, q in model.scene.quantities.items()}
    scales = [n for n, unit in units.items() if (unit in _UNITS or n in _LENGTHS) and n not in _NONE]
    for name in (n for n in scales if n not in free and np.any(model.data.fixed.get(n, 0.0))):
        sides = [evaluation(_scaled(model, {name: sign * _STEP}))(point[None]).residuals[0] for sign in (1.0, -1.0)]
        column = (sides[0] - sides[1]) / (2.0 * _STEP)
        if np.isfinite(column).all() and np.any(column):
            columns.append(column[:, None])
            fixed.append(name)
    names = [*free, *fixed]
    return _Axes(names, [*labels, *fixed], len(free), np.isin(names, scales), np.hstack(columns))


def _scaled(model: Model, logs: dict[str, float]) -> Model:
    """The model with the logarithms of fixed values moved."""
    moved = {name: np.asarray(model.data.fixed[name], dtype=float) * np.exp(log) for name, log in logs.items()}
    return eqx.tree_at(lambda m: m.data.fixed, model, {**model.data.fixed, **moved})


def _steps(model: Model, point: np.ndarray) -> np.ndarray:
    """Moves of the unit box (P, P) for the logarithm of each parameter; of a nuisance, for its whole range."""
    values, steps = model.values(point), np.eye(len(model.coordinates))
    for k, axis in enumerate(model.coordinates):
        if axis.name not in NUISANCES and values[k] > 0:
            steps[:, k] = (model.point(values * (1.0 + 1e-6 * (np.arange(values.size) == k))) - point) / 1e-6
    return steps


def _exact(model: Model, point: np.ndarray, way: np.ndarray, axes: _Axes, sizes: np.ndarray) -> bool:
    """Whether a finite move leaves every reading as it is: few samples have directions that only to first order do."""
    own, nuisance = way[: axes.free], np.array([axis.name in NUISANCES for axis in model.coordinates])
    # What the data hardly show moves without a bound; so far away nothing is exact.
    logs = np.where(nuisance, 0.0, np.clip(_FINITE * own, -50.0, 50.0))
    other = np.where(nuisance, point + _FINITE * own, model.point(model.values(point) * np.exp(logs)))
    fixed = {name: _FINITE * float(x) for name, x in zip(axes.names[axes.free :], way[axes.free :], strict=True)}
    change = evaluation(_scaled(model, fixed))(other[None]).residuals[0] - evaluation(model)(point[None]).residuals[0]
    return bool(np.linalg.norm(change) < _LEFT * _FINITE * np.max((np.abs(way) * sizes)[axes.scales]))


def _apart(ways: np.ndarray, axes: _Axes) -> np.ndarray:
    """Directions (R, M) of which each has a scale of its own, fixed ones first, and as few others as may be."""
    count = 0
    for k in sorted(np.flatnonzero(axes.scales), key=lambda k: k < axes.free):
        left = np.abs(ways[count:, axes.scales])
        if not left.size or np.abs(ways[count:, k]).max() <= _EQUAL * left.max():
            continue
        first = count + int(np.argmax(np.abs(ways[count:, k])))
        ways[[count, first]] = ways[[first, count]]
        ways[count] /= ways[count, k]
        ways -= np.outer(np.where(np.arange(len(ways)) == count, 0.0, ways[:, k]), ways[count])
        count += 1
    return ways[:count]


def _told(model: Model, way: np.ndarray, axes: _Axes) -> dict[str, Any]:
    """One direction in words: of fixed scales by what they are given, of free ones by what is determined of them."""
    moving = np.flatnonzero(np.abs(way) > _EQUAL)
    fixed = [int(k) for k in moving if k >= axes.free]
    mine = fixed or [int(k) for k in moving if axes.scales[k]]
    lead, names = max(mine, key=lambda k: abs(way[k])), list(dict.fromkeys(axes.names[k] for k in mine))
    way = way / way[lead]
    kept = [k for k in range(axes.free) if axes.names[k] not in NUISANCES and k != lead]
    beside = _moves([(axes.names[k], way[k]) for k in fixed if k != lead]) if len(fixed) > 1 else ""
    with_it = f"{axes.labels[lead]} by +1 % together with {{}} gives the same readings"
    if fixed:
        alone = {axes.names[k]: _alone(axes, k) if beside else way for k in fixed}
        said = [f"{with_it.format(beside)} and moves {_moves(_shared(axes, way, kept))}"] if beside else []
        one = " alone" if beside else ""
        said += [f"1 % of {n}{one} moves {_moves(_shared(axes, x, kept))}" for n, x in alone.items()]
        what, known = ", ".join(dict.fromkeys(axes.names[k] for k in kept)), " and ".join(f"the {n}" for n in names)
        text = f"{_channels(model)} alone determine {what} only for {known} given: {'; '.join(said)}"
    else:
        alone = {axes.names[lead]: way}
        relations = [way[k] for k in mine if axes.names[k] != axes.names[lead]]
        near = {x: abs(relations[0] - x) < _EQUAL for x in (-1.0, 1.0)} if relations else {}
        kind = "product" if near.get(-1.0) else "ratio" if near.get(1.0) else "combination"
        only = f"only the {kind} of {' and '.join(names)} is" if relations else f"{names[0]} is not"
        same = with_it.format(_moves([(axes.labels[k], way[k]) for k in kept]))
        text = f"{_channels(model)} alone leave a scale open, and {only} determined: {same}"
    moves = {name: {axes.labels[k]: float(x[k]) for k in kept} for name, x in alone.items()}
    return {"parameters": names, "moves": moves, "text": text, "remedy": _remedy(names, model, not fixed)}


def _alone(axes: _Axes, k: int) -> np.ndarray:
    """Moves (P,) of the estimates by least squares for a scale that alone is wrong, whatever residuals that leaves."""
    inner = axes.columns[:, : axes.free]
    sizes = np.where(np.any(inner, axis=0), np.linalg.norm(inner, axis=0), 1.0)
    return -np.linalg.lstsq(inner / sizes, axes.columns[:, k], rcond=1e-6)[0] / sizes


def _shared(axes: _Axes, moves: np.ndarray, kept: list[int]) -> list[tuple[str, float]]:
    """Moves by the parameter's name: where every record has its own, that of the first stands for all."""
    return list({axes.names[k]: (axes.names[k], float(moves[k])) for k in reversed(kept)}.values())[::-1]


def _moves(moves: list[tuple[str, float]]) -> str:
    named = [f"{name} by {rounded(share, 2, '+')} %" for name, share in moves if abs(share) > _NAMED]
    return ", ".join(named) or "no estimate by 0.05 %"


def _channels(model: Model) -> str:
    """The kinds of readings in words: "forces", "accelerations"."""
    kinds = dict.fromkeys("position" if quantity_of(c)[0] == "place" else quantity_of(c)[0] for c in model.channels)
    plural = [f"{k[:-1]}ies" if k.endswith("y") else f"{k}s" for k in kinds]
    return " and ".join(plural)


def _remedy(names: list[str], model: Model, one: bool) -> str:
    """What to measure: every one that is fixed; of free ones ``one``."""
    known = {
        **{n: "weigh the mass" for n in names if "mass" in n},
        **{n: f"measure {n}" for n in names if "inertia" in n},
    }
    speed = "measure the speed (light gate, high-speed camera)"
    known |= {n: "measure the height" if n in _LENGTHS else speed for n in names if n not in known}
    wanted = list(dict.fromkeys(known[n] for n in names))
    forces = [unit_of(c) in ("N", "N m") for c in model.channels]
    more = "" if any(forces) else "read a force as well"
    more = "read a position, velocity or acceleration as well" if all(forces) else more
    first = (" or " if one else " and ").join(wanted)
    return f"{first}; or {more}" if more else first
