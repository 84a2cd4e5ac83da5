"""What a record must show before it can identify a clearance: a contact after a flight, not one that always touches.

A clearance acts through where and when a contact begins: a body that separated and touches again has crossed it, be it
back to the same side or to the other. While it only presses, or only flies, the gap could be any.
"""

from __future__ import annotations

import numpy as np

from calibration.diagnostics.fit_tests import Test
from calibration.forward.model import Model
from calibration.forward.runs import Contact

# Parameters that mean a gap without being called so, with the contact that closes it.
_GAPS = {"drop_height": "contact"}
_PREFIX = "clearance_"


def gap_of(name: str) -> str | None:
    """The contact whose gap a parameter is; None for one that is no clearance."""
    return name.removeprefix(_PREFIX) if name.startswith(_PREFIX) else _GAPS.get(name)


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
    """Whether the data hold a contact from its start past its peak, for scenes whose records are of impacts.

    Those are scenes that nothing turns: their bodies fly, touch and part.

    Args:
        peaks_inside: whether the contact turns before the end of some record.
    """
    if model.scene.traits.turning or not model.channels:
        return []
    touched = any(c.touching.any() for c in seen)
    reason = (
        "the record ends before the force has reached its peak: the data are shorter than a contact"
        if touched
        else "no contact begins within the records"
    )
    return [Test("a contact in the record", float(peaks_inside), 1.0, touched and peaks_inside, reason)]
