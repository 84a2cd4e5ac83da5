"""Which scales the channels cannot tell: masses and speeds that may be wrong without any reading showing it.

With m -> c m, v -> v/c, K -> K c^n and a -> a c every force of an impact stays the same; of accelerations only K/m acts. With
B the derivatives of the residuals by the logarithms of what is free, and A those by the logarithms of fixed masses and
speeds, what no reading shows is a direction in which A - B B^+ A is 0. The estimates move along by -B^+ A.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np

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
# Relations of two scales that a direction leaves open are recognised to this share.
_EQUAL = 0.05


def untold(model: Model, labels: tuple[str, ...], point: np.ndarray) -> list[dict[str, Any]]:
    """Every scale, or combination of scales, that the channels do not show, in words.

    Returns:
        parameters: the scales; moves: by scale, what 1 % of it moves each free parameter by [%]; text and remedy.
    """
    if budget(model).rough or not model.scene.traits.history or not model.channels:
        return []
    quantities = {name: q.unit for name, q in model.scene.quantities.items()}
    scales = [n for n, unit in quantities.items() if (unit in _UNITS or n in _LENGTHS) and n not in _NONE]
    at = evaluation(model)(np.asarray(point)[None])
    jacobian = np.where(np.isfinite(at.jacobians[0]), at.jacobians[0], 0.0)
    inner = jacobian @ _steps(model, point)
    free = [axis.name for axis in model.coordinates]
    found = _searched(model, labels, point, inner, [n for n in scales if n in free])
    if found:
        return found
    return _fixed(model, labels, point, inner, [n for n in scales if n not in free])


def _steps(model: Model, point: np.ndarray) -> np.ndarray:
    """Moves of the unit box (P, P) for the logarithm of each parameter; of a nuisance, for its whole range."""
    values, steps = model.values(np.asarray(point)), np.eye(len(model.coordinates))
    for k, axis in enumerate(model.coordinates):
        if axis.name not in NUISANCES and values[k] > 0:
            moved = values * (1.0 + 1e-6 * (np.arange(values.size) == k))
            steps[:, k] = (model.point(moved) - np.asarray(point)) / 1e-6
    return steps


def _searched(
    model: Model, labels: tuple[str, ...], point: np.ndarray, inner: np.ndarray, scales: list[str]
) -> list[dict[str, Any]]:
    """Free scales of which the data determine a combination only."""
    mine = [k for k, axis in enumerate(model.coordinates) if axis.name in scales]
    if not mine:
        return []
    sizes = np.linalg.norm(inner, axis=0)
    normal = inner / np.where(sizes > 0, sizes, 1.0)
    _, singular, directions = np.linalg.svd(normal, full_matrices=False)
    way = directions[-1] / np.where(sizes > 0, sizes, 1.0)  # of the logarithms
    if singular[-1] > _UNSEEN or np.max(np.abs(directions[-1][mine])) < _EQUAL:
        return []
    lead = mine[int(np.argmax(np.abs(way[mine])))]
    way = way / way[lead]
    if not _exact(model, point, way, {}, sizes[lead]):
        return []
    together = [k for k in mine if abs(way[k]) > _EQUAL]
    names = list(dict.fromkeys(model.coordinates[k].name for k in together))
    share = {labels[k]: float(way[k]) for k in range(len(labels)) if abs(way[k]) > _NAMED}
    if len(names) == 1:
        only = f"{names[0]} is not determined"
    else:
        other = next(k for k in together if model.coordinates[k].name != model.coordinates[lead].name)
        kind = "product" if abs(way[other] + 1) < _EQUAL else "ratio" if abs(way[other] - 1) < _EQUAL else "combination"
        only = f"only the {kind} of {' and '.join(names)} is determined"
    more = {
        labels[k]: float(way[k]) for k in range(len(labels)) if k != lead and model.coordinates[k].name not in NUISANCES
    }
    same = f"{labels[lead]} by +1 % together with {_moves(more)} gives the same readings"
    text = f"{_channels(model)} alone leave a scale open, and {only}: {same}"
    return [{"parameters": names, "moves": {names[0]: share}, "text": text, "remedy": _remedy(names, model, True)}]


def _fixed(
    model: Model, labels: tuple[str, ...], point: np.ndarray, inner: np.ndarray, scales: list[str]
) -> list[dict[str, Any]]:
    """Fixed scales, or combinations of them, that may be wrong without any reading showing it."""
    columns, names = [], []
    for name in scales:
        own = np.asarray(model.data.fixed.get(name, 0.0), dtype=float)
        if not np.any(own):
            continue
        sides = []
        for sign in (1.0, -1.0):
            moved = eqx.tree_at(lambda m, name=name: m.data.fixed[name], model, own * (1.0 + sign * _STEP))
            sides.append(evaluation(moved)(np.asarray(point)[None]).residuals[0])
        column = (sides[0] - sides[1]) / (2.0 * _STEP)
        if np.isfinite(column).all() and np.linalg.norm(column) > 0.0:
            columns.append(column)
            names.append(name)
    if not names:
        return []
    outer = np.stack(columns, axis=1)
    sizes, outer_sizes = np.linalg.norm(inner, axis=0), np.linalg.norm(outer, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    along = -np.linalg.lstsq(inner / sizes, outer, rcond=1e-6)[0] / sizes[:, None]
    left = (outer + inner @ along) / outer_sizes
    _, singular, directions = np.linalg.svd(left, full_matrices=False)
    weak = directions[singular < _UNSEEN]
    ways = [(way / outer_sizes) / np.max(np.abs(way / outer_sizes)) for way in weak]
    weak = np.array([
        w * outer_sizes for w in ways
        if _exact(model, point, along @ w, dict(zip(names, w, strict=True)), float(np.max(np.abs(w) * outer_sizes)))
    ])  # fmt: skip
    involved = [k for k in range(len(names)) if weak.size and np.max(np.abs(weak[:, k] / outer_sizes[k])) > _EQUAL]
    if not involved:
        return []
    own = [names[k] for k in involved]
    kept = [i for i, axis in enumerate(model.coordinates) if axis.name not in NUISANCES]
    moves = {names[k]: {labels[i]: float(along[i, k]) for i in kept} for k in involved}
    given = " and ".join(f"the {name}" for name in own)
    alone = " alone" if len(own) > 1 else ""
    said = [f"1 % of {name}{alone} moves {_moves(_shared(model, labels, moves[name]))}" for name in own]
    if alone:
        way = weak[0] / weak[0][involved[0]]
        beside = {names[k]: float(way[k] * outer_sizes[involved[0]] / outer_sizes[k]) for k in involved[1:]}
        together = (along / outer_sizes) @ way * outer_sizes[involved[0]]
        same = _moves(_shared(model, labels, {labels[i]: float(together[i]) for i in kept}))
        said.insert(0, f"{own[0]} by +1 % together with {_moves(beside)} gives the same readings and moves {same}")
    what = ", ".join(dict.fromkeys(model.coordinates[i].name for i in kept))
    text = f"{_channels(model)} alone determine {what} only for {given} given: {'; '.join(said)}"
    return [{"parameters": own, "moves": moves, "text": text, "remedy": _remedy(own, model, False)}]


def _exact(model: Model, point: np.ndarray, way: np.ndarray, fixed: dict[str, float], size: float) -> bool:
    """Whether a finite move leaves every reading as it is: few samples have directions that only to first order do.

    ``way``, ``fixed``: logarithms by which what is free, and what is fixed, move; ``size``: what the largest of them alone
    does.
    """
    point = np.asarray(point, dtype=float)
    values, moved = model.values(point), model
    nuisance = np.array([axis.name in NUISANCES for axis in model.coordinates])
    # What the data hardly show moves without a bound; so far away nothing is exact.
    other = model.point(values * np.exp(np.where(nuisance, 0.0, np.clip(_FINITE * way, -50.0, 50.0))))
    other = np.where(nuisance, point + _FINITE * way, other)
    for name, log in fixed.items():
        own = np.asarray(model.data.fixed[name], dtype=float) * np.exp(_FINITE * log)
        moved = eqx.tree_at(lambda m, name=name: m.data.fixed[name], moved, own)
    change = evaluation(moved)(other[None]).residuals[0] - evaluation(model)(point[None]).residuals[0]
    return bool(np.linalg.norm(change) < _LEFT * _FINITE * size)


def _shared(model: Model, labels: tuple[str, ...], moves: dict[str, float]) -> dict[str, float]:
    """Moves by the parameter's name: where every record has its own, that of the first stands for all."""
    found: dict[str, float] = {}
    for axis, label in zip(model.coordinates, labels, strict=True):
        if label in moves:
            found.setdefault(axis.name, moves[label])
    return found


def _moves(moves: dict[str, float]) -> str:
    named = [f"{name} by {share:+.2g} %" for name, share in moves.items() if abs(share) > _NAMED]
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
    forces = all(unit_of(c) in ("N", "N m") for c in model.channels)
    motions = not any(unit_of(c) in ("N", "N m") for c in model.channels)
    more = "read a position, velocity or acceleration as well" if forces else "read a force as well" if motions else ""
    first = (" or " if one else " and ").join(wanted)
    return f"{first}; or {more}" if more else first
