"""Records of motion alone, of places or velocities, that hold no contact to be fitted: each is refused with the way."""

from __future__ import annotations

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.io.units import format_si
from calibration.impacts.events import even_pull, turning
from calibration.impacts.proposal import Run, Understood
from calibration.noise.scatter import scatter

# A place leaves its line in a contact by more than so many times its noise; a contact that throws a body back by less than that
# share of its speed is a shorter share of a record.
_SEEN, _LONG, _BACK = 6.0, 0.5, 0.1
_RESULTS = "docs/howto/problem_file.md#results"


def refuse(found: Understood) -> None:
    """Refuse places or velocities of one body, that does not fall, which hold no contact to be fitted; with the way."""
    header = next(iter(found.columns.values())).removeprefix("-")
    if found.falls or not found.columns.keys() <= {"m", "m/s"}:
        return
    for run in found.records:
        where = f"{found.path} {run.name}"
        if (pull := even_pull(run.clock, run.readings)[0]) or _lasts(run):
            how = f"evenly by {format_si(abs(pull), 'm/s^2', 3)}" if pull else "over most of the record"
            said = f"'{header}' changes its speed {how}, as friction or a slope does, and a contact is short"
            way = "write a scene of a body that slides to rest: docs/howto/force_displacement.md#a-body-that-slides-to-rest"
            raise InputError(where, said, f"{way}; or to take it as an impact all the same give --scene impact")
        if "m" in found.columns and "m/s" not in found.columns:
            _resolved(run, where, header)


def _lasts(run: Run) -> bool:
    """Whether what would be the contact is most of the record, and does not throw the body back."""
    values = run.readings["m/s"] if "m/s" in run.readings else np.gradient(run.readings["m"], run.clock)
    few = max(values.size // 20, 1)
    back = np.nanmean(values[-few:]) / np.nanmean(values[:few]) < -_BACK
    return run.events[0].last - run.events[0].first > _LONG * run.clock.size and not back


def _resolved(run: Run, where: str, header: str) -> None:
    """Refuse places that turn between two samples: they tell a restitution, and no law."""
    seen = np.isfinite(run.readings["m"])
    clock, places = run.clock[seen], run.readings["m"][seen]
    turn = turning(clock, places)
    if turn < 4 or turn > clock.size - 5:
        return
    (before, level), (after, _) = (np.polyfit(clock[k], places[k], 1) for k in (slice(turn), slice(turn + 1, None)))
    if np.abs(places[:turn] - level - before * clock[:turn]).max() < _SEEN * scatter(places) and before * after < 0.0:
        raise InputError(
            where,
            f"'{header}' turns between two samples: they show the speeds {format_si(abs(before), 'm/s', 3)} before and "
            f"{format_si(abs(after), 'm/s', 3)} after, but no contact",
            f"sample faster; or fit the loss to the restitution {abs(after / before):.3g}, as a result: {_RESULTS}",
        )
