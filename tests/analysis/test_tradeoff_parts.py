"""The parts of the trade study: its advice, its errors, its settings, solvers by name."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from joints import PLAIN, plain_joint

import bcfj_jax as bj
from bcfj_jax.analysis.tradeoff import advice, command, reference, study
from bcfj_jax.analysis.tradeoff.measures import (
    Measured,
    compared,
    derivative_error,
    errors,
    measured,
    peak_change,
    worst,
)
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.analysis.tradeoff.trial import loaded, singles, trial
from bcfj_jax.io.scenefile import from_table, load
from bcfj_jax.solve.plan import plan


def advised(todo, errors):
    """What is recommended of settings with these errors, the tighter the dearer."""
    rows = [
        dict.fromkeys(advice.MAIN, error) | {"setting": s.name, "status": "ok", "wall_s": 1.0 / s.error}
        for s, error in zip(todo, errors, strict=True)
    ]
    truth = reference.Reference(SimpleNamespace(), None, {"errors": dict.fromkeys(advice.MAIN, 1e-9)})
    return advice.recommended(study.Study(todo, rows, truth, False))


def test_advice_takes_no_lucky_level():
    """One level right by luck between two wrong ones; a solver that was lost on another level."""
    todo = [s for s in settings(load("bounce")) if s.ladder in ("tsit5", "dopri8") and s.group == "tolerance"]
    lucky = {("tsit5", 0.1): 1e-6, ("dopri8", 1e-3): 30.0}
    usual = {"tsit5": 1.0, "dopri8": 0.0}
    found = advised(todo, [lucky.get((s.ladder, s.error), max(usual[s.ladder] * s.error, 1e-6)) for s in todo])
    # Twice the error of the next looser level has to fit, and of every tighter one: not 10 %, with its 1e-6.
    assert found["10 %"]["setting"] == "tsit5 at 5 %"
    assert found["1 %"]["setting"] == "tsit5 at 0.2 %"
    assert not any("dopri8" in one["setting"] for one in found.values())


def test_advice_asks_for_no_less_than_its_budget():
    """However right a loose level is on the scene itself."""
    todo = [s for s in settings(load("bounce")) if s.ladder == "tsit5" and s.group == "tolerance"]
    found = advised(todo, [1e-9] * len(todo))
    by_budget = {budget: next(s.error for s in todo if s.name == one["setting"]) for budget, one in found.items()}
    assert by_budget == {"10 %": 0.1, "5 %": 0.05, "2 %": 0.02, "1 %": 0.01, "0.5 %": 5e-3, "0.1 %": 1e-3}


def test_errors_of_known_histories():
    """Two members of one contact and one of another, off by constants."""
    times = np.linspace(0.0, 2.0, 5)
    force = np.zeros((5, 3, 3))
    force[:, 0, 0], force[:, 1, 0], force[:, 2, 0] = 10.0, 4.0, -2.0
    owner, period = np.array([0, 0, 1]), np.array([0.5, np.nan, 0.25])
    truth = Measured(force, owner, period, np.array([3.0, 1.0, 1.0]), np.array([3.0, 1.0, 1.0]))
    assert errors(truth, truth, times) == pytest.approx(dict.fromkeys(errors(truth, truth, times), 0.0))
    moved = force.copy()
    moved[:, 1, 0] += 1.0
    moved[:, 2, 2] = 0.5
    found = Measured(moved, owner, np.array([0.55, 0.1, 0.25]), np.array([3.0, 1.5, 1.0]), truth.moved)
    assert errors(found, truth, times) == pytest.approx(
        # The friction's 0.5 N of 2 N; 1 N of 10 N; the same over 2 s; 10 %; half a joule of five.
        {"force_rms_error": 0.25, "peak_error": 0.1, "impulse_error": 0.1, "period_error": 0.1, "dissipated_error": 0.1}
    )
    lost = found._replace(period=np.array([np.nan, 0.1, 0.25]))
    assert errors(lost, truth, times)["period_error"] == 1.0
    slope = np.stack([force, 2.0 * force])
    assert derivative_error(slope * np.array([1.1, 1.0])[:, None, None, None], slope) == pytest.approx(0.1)


@pytest.mark.slow
def test_settings_of_a_joint():
    given = load("joint")
    found = {s.name: s for s in settings(given)}
    assert {s.group for s in found.values()} == {
        "tolerance", "fidelity", "model", "smoothing", "friction speed", "friction law", "output", "precision",
    }  # fmt: skip
    # Every one of them is a scene file; what an option takes out of the model leaves the file, too.
    for s in found.values():
        resolved = from_table(s.table, None).resolved
        own = {"lugre": {"bristle_stiffness", "bristle_damping"}, "memory": {"friction_memory"}}
        own["frictional_lag"] = {"friction_memory", "friction_viscous"}
        more = set().union(*(names for law, names in own.items() if law in s.name))
        read = {name: value for name, value in resolved["parameters"].items() if name not in more}
        assert s.group == "model" or {**resolved, "parameters": read} == s.table
    none = next(s for name, s in found.items() if name.startswith("friction none"))
    assert "friction_static" not in none.table["parameters"] and "no friction" in none.physics
    assert found["quasistatic"].physics and not found["as given"].physics
    # What the tolerance does not tell apart is one setting: the joint's is capped.
    assert next(s.error for s in found.values() if s.ladder == "sdirk2") == 1e-2
    assert [s.name for s in settings(given, ("fidelity",))] == ["as given", "kinematic", "quasistatic"]
    with pytest.raises(bj.InputError, match="did you mean 'sdirk2'"):
        settings(given, ("sdirk",))


@pytest.mark.parametrize(
    "options",
    [{}, dict.fromkeys(PLAIN, True), {"spin": True, "cage": "fixed", "head": "fixed", "track": "circular"}],
    ids=["plain", "default", "fixed"],
)
def test_every_other_choice_of_a_joint_is_another_joint(options):
    scene = plain_joint(**options)
    made = [loaded(s.table).scene for s in settings(from_table({"scene": {"kind": "joint", **PLAIN, **options}}, None))
            if s.group == "model" and "scene" in s.change]  # fmt: skip
    assert len(made) == len(scene.variants(scene.parameters())) - 1
    assert scene not in made and len(set(made)) == len(made)
    assert plain_joint(**options, fidelity="quasistatic").variants({}) == ()


def test_laws_of_one_coefficient_of_restitution_are_tried():
    found = settings(from_table({"scene": {"kind": "impact", "law": "flores"}}, None), ["model"])
    assert [s.name for s in found] == ["as given", "law hunt_crossley", "law lankarani_nikravesh"]


def test_contacts_that_both_models_have_are_compared():
    force = np.zeros((4, 3, 3))
    force[1, :, 0] = 10.0, 4.0, 2.0
    truth = Measured(force, np.array([0, 0, 1]), np.full(3, np.nan), np.ones(3), np.ones(3))
    more = np.concatenate([3.0 * force[:, 2:], 1.2 * force[:, :2], force[:, 2:]], 1)
    found = Measured(more, np.array([0, 1, 1, 2]), np.full(4, np.nan), np.ones(4), np.ones(4))
    ours, theirs = compared(found, ["new", "ball", "ring"], truth, ["ball", "ring"])
    assert peak_change(ours, theirs) == (0, pytest.approx(0.2))
    # Of a ring that bears 3 N more in place of 2 and a ball that bears 4 N more in place of 10 the ball counts.
    graver = ours._replace(force=theirs.force + np.array([4.0, 0.0, 3.0])[:, None] * (theirs.force > 0.0))
    assert peak_change(graver, theirs) == (0, pytest.approx(0.4))
    ours, theirs = compared(found, ["ring", "ball", "new"], truth, ["other", "ring"])
    assert peak_change(ours, theirs) == (0, pytest.approx(2.0))
    assert peak_change(ours, theirs._replace(force=0.0 * theirs.force)) is None


def model_row(setting, **values):
    return {"setting": setting, "group": "model", "status": "ok", "reason": "", "force_rms_error": 0.2, **values}


def test_the_line_of_the_model_form_names_what_moves_most():
    todo = [SimpleNamespace(group=group, physics=group) for group in ("tolerance", "model", "model", "model")]
    rows = [
        {"setting": "as given", "group": "tolerance", "wall_s": 2.0, "peak_change": 9.0},
        model_row("balls roll", contact="seat_cage", peak_change=0.25, wall_s=3.0),
        model_row("head fixed", contact="head_cage", peak_change=-0.75, wall_s=1.0),
        model_row("no time", contact="", peak_change=float("nan"), wall_s=float("nan")),
    ]
    done = study.Study(todo, rows, None, False)
    assert "2 other choices" in command.model_form(done)
    assert "up to 75 % (head fixed: head_cage -75 %)" in command.model_form(done)
    table = command.model_rows(done)
    assert [row[0] for row in table[1:]] == ["head fixed", "balls roll", "no time"]
    assert table[2][1:4] == ["seat_cage +25 %", "20 %", "1.5 times"] and table[3][1] == "-"
    assert command.model_form(study.Study(todo[:1], rows[:1], None, False)) == ""


@pytest.mark.slow
def test_32_bit_numbers_are_measured_in_a_process_of_their_own():
    table = load("impact").resolved
    tight = {**table, "accuracy": {"force_error": 1e-6, "max_steps": 20_000}}
    truth, _ = trial(loaded(tight))
    broken = {**table, "parameters": {**table["parameters"], "stiffness": -1.0}}
    (found, cost), refused = singles([tight, broken], 600.0)
    assert found.status == "ok" and cost["wall_s"] > 0 and found.force["contact"].shape == truth.force["contact"].shape
    # As many digits as the numbers have, over some hundred steps: not those of 64 bits, which keep 1e-6 of the peak.
    times = truth.times
    off = worst(errors(measured(found, times, False), measured(truth, times, False), times))
    assert 1e-8 < off < 1e-4
    assert jnp.result_type(float) == jnp.float64
    for error, said in ((refused, "stiffness"), (singles([table], 1.0)[0], "not done within the 1 s")):
        assert isinstance(error, RuntimeError) and str(error).startswith("32-bit numbers: ") and said in str(error)


@pytest.mark.slow
def test_solvers_by_name():
    scene = bj.scenes.impact()
    with pytest.raises(bj.InputError, match="did you mean 'bosh3'"):
        bj.simulate(scene, scene.parameters(), [0.0, 1e-5], solver="bosh")
    with pytest.raises(bj.InputError, match=r"\[accuracy\] solver: no solver 'tsit5'"):
        from_table({"scene": {"kind": "joint"}, "accuracy": {"solver": "tsit5"}}, Path("s.toml"))
    # A mechanism is solved by the one that is named, explicit or implicit, each at its own tolerance.
    named = from_table({"scene": {"kind": "impact"}, "accuracy": {"solver": "bdf"}}, Path("s.toml"))
    times = named.times[::100]
    implicit, own = (bj.simulate(scene, scene.parameters(), times, solver=name) for name in ("bdf", None))
    assert named.scene.traits.stiff and implicit.stats["tolerance"] != own.stats["tolerance"]
    peak = own.force["contact"].max()
    np.testing.assert_allclose(implicit.force["contact"], own.force["contact"], atol=0.01 * peak)
    joint = plain_joint()
    how = plan(joint, "balanced", solver="rodas3")
    with pytest.raises(bj.InputError, match="'rodas3' has no derivatives"):
        bj.force_history(joint, joint.parameters(), [0.0, 1e-3], accuracy=how, mode="forward")


@pytest.mark.parametrize("harm", ["", "cut", "altered", "another", "gone", "no digest"])
def test_a_reference_that_is_damaged_is_not_restored(tmp_path, harm):
    parts = [np.arange(12.0).reshape(2, 2, 3), np.zeros(2, int), np.ones(2), np.ones(2), np.ones(2)]
    certificate = {"derivatives": {"error": None}}
    truth = reference.Reference(reference.Measured(*parts), None, certificate)
    path, digest = tmp_path / reference.NAME, reference.save(truth, tmp_path)
    whole = path.read_bytes()
    if harm == "gone":
        path.unlink()
    elif harm == "another":
        np.savez_compressed(path, force=np.zeros(3))
    elif harm:
        path.write_bytes(whole[:100] if harm == "cut" else whole[:60] + b"7" + whole[61:])
    found = reference.restore(certificate, tmp_path, None if harm == "no digest" else digest)
    assert (found is None) == bool(harm)
    if found:
        np.testing.assert_array_equal(found.truth.force, parts[0])
        assert found.digest == digest
