"""Three questions to a fit, three answers, and the one word that follows from them.

*search*: did it converge, on the whole record, without rivals that no data exclude? *data*: which coefficients do they
determine? *law*: is the miss of the contact law the noise (``consistent``), a few percent of the peak (``adequate``),
or more (``inadequate``)?

A clearance acts through where and when a contact begins: a body that separated and touches again has crossed it, be it
back to the same side or to the other. While it only presses, or only flies, the gap could be any.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcfj_jax.core.quantities import percent, rounded
from calibration.diagnostics.fit_tests import Test
from calibration.diagnostics.records import Record
from calibration.diagnostics.residual_tests import Series
from calibration.forward.model import Model
from calibration.forward.runs import Contact, gap_of, of_contacts
from calibration.noise.scatter import scatter

# Held-out runs may be missed by so much more: they differ from the fitted ones, too.
_HELD_OUT = 2.0
# Fewer samples before contact show no noise, and residuals of less than so many times it are no news.
_RESTING, _LOUDER = 8, 1.5
# A reading of so much of the peak where so little is predicted is a contact that the model does not have there.
# Below so many deviations a reading may be noise.
_HIGH, _LOW, _MOST_UNMET, _NOISY = 0.2, 0.02, 0.1, 3.5


# What misses in a fit of contacts, and where the whole record counts.
LAW, MODEL = "in contact the law", "the model"


class Answer(NamedTuple):
    """One word, and the sentences behind it."""

    answer: str
    because: list[str]


def search(tests: Sequence[Test]) -> Answer:
    """``converged`` or ``not_converged``."""
    failed = [t.reason for t in tests if not t.passed]
    return Answer("not_converged" if failed else "converged", failed)


def data(tests: Sequence[Test], determined: Mapping[str, bool]) -> Answer:
    """``determined`` where the data tell every coefficient, ``partly`` where some, ``not_determined`` where none."""
    failed = [t.reason for t in tests if not t.passed]
    if not failed:
        return Answer("determined", [])
    known = [name for name, known in determined.items() if known]
    return Answer("partly" if known else "not_determined", failed)


def law(
    tests: Sequence[Test],
    miss: float,
    held_out: Mapping[str, Mapping[str, float]] | None,
    threshold: float,
    loud: float = 0.0,
    what: str = LAW,
) -> Answer:
    """``consistent``, ``adequate`` or ``inadequate``: by ``miss`` of the worst channel (``missed``) against the ``threshold``
    up to which a law is adequate, shares of the peak; ``loud``: residuals in contact over the noise before it
    (``louder``); ``what`` misses.
    """
    failed = [t.reason for t in tests if not t.passed]
    if not failed:
        return Answer("consistent", [])
    predicted = max((e["rms_error_of_peak"] for e in (held_out or {}).values()), default=0.0)
    good = miss <= threshold and predicted <= _HELD_OUT * threshold
    size = f"{what} misses by {percent(miss, 2)} of the peak (rms)"
    size += f", and held-out records by {percent(predicted, 2)}" if held_out else ""
    limit = f"; up to {percent(threshold, 2)} is called adequate"
    heard = f"residuals in contact are {rounded(loud)} times what the sensor scatters before contact"
    return Answer("adequate" if good else "inadequate", [size + limit, *([heard] if loud > _LOUDER else []), *failed])


def missed(series: Sequence[Series], residuals: np.ndarray) -> float:
    """What the worst channel misses in contact, rms, as a share of the record's peak.

    Less what changes from sample to sample, by the median, which is noise.
    """
    worst = 0.0
    for s in series:
        inside = residuals[s.rows[s.touching]]
        if inside.size < 2:
            continue
        noise = (1.4826 * float(np.median(np.abs(np.diff(inside))))) ** 2 / 2.0
        worst = max(worst, s.share * float(np.sqrt(max(np.mean(inside**2) - noise, 0.0))))
    return worst


def louder(series: Sequence[Series], residuals: np.ndarray) -> float:
    """Residuals in contact over the scatter of what is read before the first contact, of the worst channel; 0 of none.

    Both by deviations; a record with fewer than ``_RESTING`` samples before contact says nothing.
    """
    worst = 0.0
    for s in series:
        first = int(np.argmax(s.touching)) if s.touching.any() else 0
        if first < _RESTING:
            continue
        rest = float(np.std(s.values[:first] * s.weights[:first]))
        inside = residuals[s.rows[s.touching]]
        if rest > 0.0 and inside.size:
            worst = max(worst, float(np.sqrt(np.mean(inside**2))) / rest)
    return worst


def contacts_met(records: Sequence[Record]) -> Test:
    """Whether the model touches where the data do: where it does not, the search ended beside the contacts."""
    worst = 0.0
    for record in records:
        for name, values in record.data.items():
            if not name.endswith(".normal"):
                continue
            seen = np.isfinite(values)
            peak = float(np.max(values[seen], initial=0.0))
            high = seen & (values > max(_HIGH * peak, _NOISY * scatter(values[seen])))
            if peak > 0.0 and high.any():
                worst = max(worst, float(np.mean(np.abs(record.prediction[name][high]) < _LOW * peak)))
    reason = f"{worst:.0%} of the samples that read a contact are predicted apart: the search ended beside the contacts"
    reason += "; give more starts, narrower bounds, or a start"
    return Test("contacts met", worst, _MOST_UNMET, worst <= _MOST_UNMET, reason)


def clearance_tests(model: Model, seen: list[Contact]) -> list[Test]:
    """A test for each clearance that is searched: whether a record shows it being crossed, at the fitted values."""
    tests = []
    for name, experiment in dict.fromkeys((s.name, s.experiment) for s in model.coordinates):
        contact = gap_of(name)
        if contact is None:
            continue
        members = model.scene.members.get(contact, 0)
        own = [f"{contact}_{k + 1}" for k in range(members)] or [contact]
        mine = [c for c in seen if c.name in own and experiment in (None, c.experiment)]
        crossings = sum(int(np.count_nonzero(np.diff(c.touching.astype(int)) > 0)) for c in mine)
        tests.append(Test(f"{name} crossed", crossings, 1, crossings > 0, _missing(name, contact, mine)))
    return tests


def _missing(name: str, contact: str, mine: list[Contact]) -> str:
    if not any(c.touching.any() for c in mine):
        return f"{name}: '{contact}' never touches in the record, so the gap may be any that is large enough"
    if all(c.touching.all() for c in mine):
        what = f"'{contact}' touches all the time"
    else:
        what = f"'{contact}' only lets go and does not touch again"
    return f"{name}: {what}, and no flight is seen: only a contact after a flight, on either side, shows a clearance"


def whole_contact_test(model: Model, seen: list[Contact], peaks_inside: bool) -> list[Test]:
    """Whether the data hold a contact from its start past its peak (``peaks_inside``), for fits of contacts (``of_contacts``)
    whose records are of impacts: those that nothing turns.
    """
    if model.scene.traits.turning or not model.channels or not of_contacts(model):
        return []
    touched = any(c.touching.any() for c in seen)
    short = "the record ends before the force has reached its peak: the data are shorter than a contact"
    reason = short if touched else "no contact begins within the records"
    return [Test("a contact in the record", float(peaks_inside), 1.0, touched and peaks_inside, reason)]


def verdict(of_search: Answer, of_data: Answer, of_law: Answer) -> str:
    """A search that failed says nothing of the law, and an inadequate law nothing of its coefficients."""
    if of_search.answer != "converged":
        return "not_converged"
    if of_law.answer == "inadequate":
        return "misfit"
    if of_data.answer != "determined":
        return "not_identified"
    return "adequate" if of_law.answer == "adequate" else "identified"
