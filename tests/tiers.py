"""Which cases of a costly family CI's tier takes; all of them run in the slow tier."""

from __future__ import annotations

import pytest


def ci(cases, *kept):
    """Cases for ``pytest.mark.parametrize``; those that ``kept`` does not name are slow."""
    cases = list(cases)
    assert all(case in cases for case in kept), f"one of {kept} is none of the cases {cases}"
    return [case if case in kept else slow(case) for case in cases]


def slow(case):
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
