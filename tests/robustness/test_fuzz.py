"""A small part of the fuzz suite (``benchmarks/robustness/fuzz.py``), and that the suite finds what it looks for."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import tiers
from oracles import impact, within

from bcfj_jax import InputError
from benchmarks.robustness import fuzz
from benchmarks.robustness.mutations import of_bytes, of_toml

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# Of each kind; the benchmark runs two thousand.
COUNT = 12


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    for path in EXAMPLES.iterdir():
        shutil.copy(path, folder)
    return folder, fuzz.targets(4 * COUNT, folder)


WHOLE = ("scene values", "calibration values", "study values", "design values")
NAMES = ("scene", "calibration", "study", *WHOLE, *fuzz.records.FORMATS, *fuzz.kept.KINDS)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore")
# Records of other formats: test_damaged.py in CI's tier.
@pytest.mark.parametrize("name", tiers.ci(NAMES, "scene", "calibration", "study", *WHOLE[1:], ".csv", *fuzz.kept.KINDS))
def test_damaged_files_are_refused_in_words_or_read(name, every):
    folder, targets = every
    how = targets[name]._replace(count=40 * COUNT if name in WHOLE else COUNT)
    faults = [
        f"case {k}: {c.outcome}: {c.detail}" for k, c in fuzz.cases(name, how, folder, 11) if c.outcome not in GOOD
    ]
    assert not faults, "\n".join(faults)


GOOD = ("accepted", "refused")


def test_the_suite_finds_faults(tmp_path):
    file = tmp_path / "a.toml"

    def case(read, then=fuzz.nothing, content=b"x"):
        return fuzz.run_case(read, then, file, content).outcome

    def refuse(where, found="no", remedy="yes"):
        def read(path):
            raise InputError(where, found, remedy)

        return read

    def endless(path):
        while True:
            pass

    assert case(lambda path: {}["key"]) == "traceback"
    assert case(refuse("here")) == "bad message"
    assert case(refuse("a.toml")) == "refused"
    assert case(refuse("a.toml", "x" * 300), content=b"x" * 5000) == "bad message"
    assert case(lambda path: 1, lambda found: "wrong") == "wrong force"
    assert case(lambda path: 1) == "accepted"
    before, fuzz.HANG = fuzz.HANG, 0.05
    try:
        assert case(endless) == "hang"
    finally:
        fuzz.HANG = before


def test_mutations_are_made_again_from_their_seed():
    good = b"[scene]\nkind = 'impact'\n[parameters]\nmass = 0.1\n"
    for mutate in (of_bytes, of_toml):
        made = [mutate(np.random.default_rng(k), good) for k in range(60)]
        assert made == [mutate(np.random.default_rng(k), good) for k in range(60)]
        assert sum(content != good for content in made) > 40


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.6])
def test_the_closed_form_of_the_peak(damping):
    expected = impact(lambda d, rate: 1e9 * d**1.5 * (1.0 + damping * rate) if d > 0 else 0.0, 0.2, 2.0)
    assert fuzz.closed_peak(0.2, 2.0, 1e9, 1.5, damping) == within(expected.peak, 1e-6)
