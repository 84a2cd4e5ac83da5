"""Damaged records of every reader (``benchmarks/robustness/damaged.py``), and that the suite finds what it looks for."""

from __future__ import annotations

import numpy as np
import pytest
import tiers

from bcfj_jax.data.readers import READERS
from benchmarks.robustness import damaged

for library in ("nptdms", "h5py", "pyuff", "ezc3d", "asammdf", "openpyxl", "pyarrow"):
    pytest.importorskip(library, reason="the extra io is not installed")


def faults(reader, count, folder):
    # A worker that holds other tests' programs may have more than a reader ever may: what it adds is bounded.
    before = damaged.largest()
    ends = damaged.cases(reader, count, folder, 3)
    found = [
        f"{name} case {k}: {c.outcome}: {c.detail}" for name, k, c in ends if c.outcome not in ("accepted", "refused")
    ]
    assert damaged.largest() - before <= damaged.LARGEST
    return found


@pytest.mark.full
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("count", tiers.ci([4, 15], 4))
@pytest.mark.parametrize("reader", tiers.ci(damaged.FILES, *(set(damaged.FILES) - {"mdf", "wav", "parquet"})))
def test_a_damaged_record_is_refused_in_words_or_read_as_it_stands(reader, count, tmp_path):
    assert not faults(reader, count, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("reader", damaged.FILES)
def test_five_hundred_damaged_records_of_a_reader(reader, tmp_path):
    assert not faults(reader, 500, tmp_path)


def test_every_reader_is_among_them():
    assert {r.__name__.rpartition(".")[2] for r in READERS} | {"text"} == set(damaged.FILES)


def test_numbers_that_are_none_of_the_files_are_found():
    good = damaged.Source("a", b"", lambda path: (np.zeros(0), ""), np.arange(9.0), "", "utf-8")
    read = np.arange(9.0)
    read[[2, 5, 7]] = 100.0, np.nan, 200.0
    for rows, said, outcome in ((2, "", ""), (1, "", "2 of 8"), (1, "the file is cut off", ""), (None, "", "")):
        assert damaged.wrong(good, damaged.Damaged(b"", rows), (read, said))[:6] == outcome


def test_damages_are_made_again_from_their_seed_and_change_a_file():
    text = "\n".join(["time [s],force [N]", *(f"{k / 1e4:.4f},{k % 7}.25" for k in range(99))]).encode()
    for damage in (damaged.of_lines, damaged.of_blocks):
        made = [damage(np.random.default_rng(k), text, "utf-8") for k in range(60)]
        assert made == [damage(np.random.default_rng(k), text, "utf-8") for k in range(60)]
        assert len({m.content for m in made}) > 50 and {m.rows for m in made} > {None}
