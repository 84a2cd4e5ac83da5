"""A study as an accelerator runs it, on a CPU: large blocks, all places at once, one process; and blocks of another device."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tiers

from bcfj_jax.analysis.studies import api
from bcfj_jax.analysis.studies.block import Blocks
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.core.errors import InputError
from bcfj_jax.xla import backend, programs

IMPACT = {
    "scene": "impact",
    "vary": {"approach_speed": {"lower": 0.5, "upper": 2.0, "steps": 5}, "stiffness": {"values": [1e7, 2e7]}},
    "results": {"features": ["contact.peak", "contact.impulse"]},
}
# Of features, between devices and sizes of a batch: rounding, through the steps.
SAME = 1e-9


@pytest.fixture
def accelerator(monkeypatch):
    """A CPU that is taken for an accelerator with 80 GiB."""
    programs.forget()
    monkeypatch.setattr(backend, "on_cpu", lambda: False)
    monkeypatch.setattr(backend, "memory", lambda: 80 << 30)
    yield monkeypatch
    programs.forget()


def test_blocks_follow_from_the_device(accelerator):
    joints = {"scene": "joint", "vary": {"clearance_seat_cage": {"lower": 1e-5, "upper": 1e-4, "steps": 65536}}}
    large = Blocks(from_table(joints | {"results": {"features": ["seat_cage.peak"]}})).size
    tangents = Blocks(
        from_table(joints | {"results": {"features": ["seat_cage.peak"], "derivatives": ["stiffness", "load_ramp"]}})
    )
    one_by_one = Blocks(from_table(joints | {"results": {"features": ["seat_cage.peak"], "steady": True}})).size
    accelerator.setattr(backend, "memory", lambda: 8 << 30)
    little = Blocks(from_table(joints | {"results": {"features": ["seat_cage.peak"]}})).size
    accelerator.setattr(backend, "on_cpu", lambda: True)
    assert Blocks(from_table(joints | {"results": {"features": ["seat_cage.peak"]}})).size <= 64
    assert little < large and one_by_one <= 64
    assert 64 < tangents.size <= large <= 16_384


@pytest.mark.slow
@pytest.mark.parametrize("derivatives", tiers.ci([[], ["stiffness"]], []))
def test_one_large_block_gives_what_small_ones_give(tmp_path: Path, accelerator, derivatives: list[str]):
    table = {**IMPACT, "results": {**IMPACT["results"], "derivatives": derivatives}}
    large = api.study(table, tmp_path / "large", workers=2)
    accelerator.setattr(backend, "on_cpu", lambda: True)
    programs.forget()
    small = api.study(table, tmp_path / "small")
    assert large.state["blocks"] == 1 and small.state["blocks"] > 1 and large.failed == 0
    for name in large.study.columns:
        # A derivative is compared to what the whole feature over the parameter is: the impulse hardly depends on stiffness.
        feature = name.removeprefix("d(").partition(")")[0]
        natural = np.abs(small.column(feature)) / small.column("stiffness")
        atol = SAME * natural if name.startswith("d(") else 0.0
        assert np.all(np.abs(large.column(name) - small.column(name)) <= SAME * np.abs(small.column(name)) + atol)
    said = json.loads((tmp_path / "large" / "environment.json").read_text())
    assert said["block_size"] == 10 and said["device"]["devices"]


@pytest.mark.slow
def test_a_study_goes_on_in_blocks_of_the_size_it_was_begun_with(tmp_path: Path, accelerator):
    begun = api.prepare(from_table(IMPACT), tmp_path / "out")
    accelerator.setattr(backend, "on_cpu", lambda: True)
    assert Blocks(begun.study).size != begun.blocks.size
    found = api.study(IMPACT, tmp_path / "out")
    assert found.state["blocks"] == len(begun.blocks) == 1 and found.state["left"] == 0
    # An older folder says nothing of it.
    old = tmp_path / "old"
    api.prepare(from_table(IMPACT), old)
    said = json.loads((old / "environment.json").read_text())
    del said["block_size"]
    (old / "environment.json").write_text(json.dumps(said))
    accelerator.setattr(backend, "on_cpu", lambda: False)
    assert api.prepare(from_table(IMPACT), old).blocks.size < 10
    (old / "environment.json").write_text(json.dumps(said | {"block_size": -1}))
    with pytest.raises(InputError):
        api.prepare(from_table(IMPACT), old)
