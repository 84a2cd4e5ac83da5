"""Forces in the axes of bodies: columns by name, and the period that hangs on who looks (physics sheet 9, A1)."""

from __future__ import annotations

import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.analysis.histories import settled_period
from bcfj_jax.analysis.simulation.results import framed
from bcfj_jax.core.errors import InputError


def test_every_contact_is_named_in_every_frame():
    scene = bj.scenes.slider_crank()
    names = [one.name for one in framed(scene, ("rod", "world"))]
    assert names == [f"journal.force.{k}{frame}" for frame in (" in rod", "") for k in "xyz"]
    with pytest.raises(InputError, match=r"--frames.*no body 'rood'.*rod"):
        framed(scene, ("rood",))


@pytest.mark.slow
def test_who_turns_with_the_cage_sees_one_period_a_turn():
    scene = bj.scenes.joint(cage=bj.scenes.JointCage(window_ends=True))
    times = np.linspace(0.0, 1.8, 1801)
    read = [f"seat_cage.force.{k} in {body}" for body in ("cage", "seat", "head") for k in "xy"]
    run = bj.simulate(scene, scene.parameters(), times, read=read)
    # One turn at 100 1/min; six equal balls follow each other.
    assert settled_period(times, run.force["seat_cage"][:, 0]) == pytest.approx(0.1, rel=1e-3)
    for name in read:
        assert settled_period(times, run.readings[name]) == pytest.approx(0.6, rel=1e-3)
