"""The Python API under attack (``attacks``): what is bad is refused in words, and what is good passes."""

from __future__ import annotations

import attacks
import pytest

pytestmark = pytest.mark.full
EVERY = attacks.table()


def test_there_are_many_attacks():
    assert len(EVERY) > 1000
    assert len({attack.verb for attack in EVERY}) > 15


@pytest.mark.parametrize("verb", sorted({attack.verb for attack in EVERY}))
def test_what_is_bad_is_refused_with_place_value_and_remedy(verb):
    wrong = []
    for attack in EVERY:
        if attack.verb == verb:
            found = attacks.outcome(attack)
            wrong += [] if found.right else [(attack.name, found.kind, found.text)]
    assert not wrong


@pytest.mark.slow
@pytest.mark.parametrize("name", attacks.controls())
def test_what_the_attacks_leave_alone_is_good(name):
    assert attacks.controls()[name]() is not None
