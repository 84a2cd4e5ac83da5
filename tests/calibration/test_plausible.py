"""Records that may mislead: wrong samples, loud noise, two free bodies, wrong masses, too many samples, weight.

Contacts are SciPy's, of F = K d^n (1 + a d') without regularisation.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import bcfj
from scipy.integrate import solve_ivp

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.core.quantities import GRAVITY
from calibration import Channel, Experiment, Free, Problem, fit, init, load
from calibration.command import _absurd, text
from calibration.diagnostics.signatures import scene_of, weight
from calibration.forward.model import build, predictions
from calibration.impacts.events import alone, contacts
from calibration.impacts.preparation import _first_contact as onset
from calibration.noise.noise_model import _ratios as ratios
from calibration.noise.scatter import scatter
from calibration.problemfile import prepared
from calibration.selection.supposed import STANDS, freed, with_doubts_right

pytestmark = pytest.mark.filterwarnings("error")
TRUTH = {"stiffness": 3e6, "exponent": 1.45, "damping": 0.22}
TOUCH = 11.3e-3
FILE = """scene = "impact"
[[experiment]]
file = "run.csv"
time = "time [s]"
observe = {{ "contact.normal" = "force [N]" }}
noise = "estimate"
align = "onset"
parameters = {{ {known} }}
[free]
stiffness = [1e5, 3e9]
exponent = [1.0, 2.5]
damping = [0.005, 5.0]
{more}
"""


def law(depth: float, rate: float) -> float:
    elastic = TRUTH["stiffness"] * max(depth, 0.0) ** TRUTH["exponent"]
    return elastic * max(1.0 + TRUTH["damping"] * rate, 0.0)


def pair(times: np.ndarray, mass: float, struck: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Force (T,), and acceleration (T,) of the struck body, of two free bodies that touch at TOUCH."""
    run = solve_ivp(
        lambda t, y: [y[2], y[3], -law(y[0] - y[1], y[2] - y[3]) / mass, law(y[0] - y[1], y[2] - y[3]) / struck],
        (0.0, 0.04), [0.0, 0.0, speed, 0.0], "DOP853", rtol=1e-10, atol=1e-13, max_step=1e-4, dense_output=True,
    )  # fmt: skip
    state = run.sol(np.clip(times - TOUCH, 0.0, 0.04))
    force = np.array([law(a - b, u - v) for a, b, u, v in state.T]) * (times > TOUCH)
    return force, force / struck


def pulse(times: np.ndarray, mass: float = 0.5, speed: float = 1.0) -> np.ndarray:
    return pair(times, mass, 1e12, speed)[0]


def duration(force: np.ndarray, times: np.ndarray) -> float:
    return float(np.ptp(times[force > 0.0]))


CLOCK = np.arange(0.0, 0.05, 1e-4)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("height", [-6.0, -1.2, 0.4, 1.5, 8.0])
def test_one_wrong_sample_moves_no_onset(height, scale):
    force = pulse(CLOCK)
    read = force + 0.004 * force.max() * np.random.default_rng(2).standard_normal(CLOCK.size)
    expected = onset(CLOCK, "contact.normal", scale * read, "here")
    for at in (3, 40, 80, 400):
        wrong = read.copy()
        wrong[at] = height * force.max()
        assert onset(CLOCK, "contact.normal", scale * wrong, "here") == expected
        if at < 100 or abs(height) > 1.0:
            (found,) = contacts("contact.normal", CLOCK, wrong)[:1]
            assert abs(found.begin - TOUCH) < 0.15 * duration(force, CLOCK)
            assert np.flatnonzero(alone(wrong)).tolist() == [at]


def test_no_sample_of_a_contact_is_wrong():
    for step in (1e-4, 4e-4, 1e-3, 2.2e-3):
        times = np.arange(0.0, 0.06, step)
        for shift in np.linspace(0.0, step, 7):
            assert not alone(pulse(times + shift)).any()
    # Contacts of one sample or two, and a first one that is the highest.
    assert not alone(np.array([0.0] * 20 + [9.0] + [0.0] * 9 + [6.0, 4.0] + [0.0] * 9)).any()


@pytest.mark.parametrize("level", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("step", [5e-5, 1.5e-4])
def test_noise_sets_no_onset(level, step):
    times = np.arange(0.0, 0.05, step)
    force = pulse(times)
    for seed in range(20):
        read = force + level * force.max() * np.random.default_rng(seed).standard_normal(times.size)
        late = onset(times, "contact.normal", read, "here") - TOUCH
        assert abs(late) < 0.2 * duration(force, times)


def test_scatter_is_the_noise_and_not_the_signal():
    force = pulse(np.arange(0.0, 0.05, 5e-5))
    noise = 3.0 * np.random.default_rng(0).standard_normal(force.size)
    assert scatter(force + noise) == pytest.approx(3.0, rel=0.15)
    noise[::97] += 1e4
    assert scatter(force + noise) == pytest.approx(3.0, rel=0.2)
    assert scatter(7.0 * (force + noise)) == pytest.approx(7.0 * scatter(force + noise), rel=1e-12)


def test_records_of_clearly_different_noise_have_deviations_of_their_own():
    rng = np.random.default_rng(4)
    quiet, loud = rng.standard_normal(400), 20.0 * rng.standard_normal(400)
    found = ratios([quiet, loud])
    assert found[1] / found[0] == pytest.approx(20.0, rel=0.25) and np.prod(found) == pytest.approx(1.0)
    assert ratios([quiet, 2.0 * quiet]).tolist() == [1.0, 1.0]
    # A miss of the law is no noise.
    assert ratios([quiet, loud + 1e3 * np.sin(np.arange(400) / 30.0)]).tolist() == [1.0, 1.0]


@pytest.mark.slow
def test_two_free_bodies_are_one_of_their_effective_mass_and_keep_their_momentum():
    params = TRUTH | {"mass": 0.4, "struck_mass": 1.7, "approach_speed": 0.8}
    times = np.linspace(0.0, 0.02, 401)
    two, one = bj.scenes.impact(smoothing=False, struck=True), bj.scenes.impact(smoothing=False)
    ran = bj.simulate(two, two.parameters(params), times)
    same = one.parameters(TRUTH | {"mass": 0.4 * 1.7 / 2.1, "approach_speed": 0.8})
    force = np.asarray(ran.force["contact"])[:, 0]
    np.testing.assert_allclose(force, np.asarray(bj.simulate(one, same, times).force["contact"])[:, 0],
                               atol=1e-3 * force.max())  # fmt: skip
    np.testing.assert_allclose(force, pair(times + TOUCH, 0.4, 1.7, 0.8)[0], atol=1e-3 * force.max())
    names = ("body.velocity.x", "struck.velocity.x")
    read = bj.reading_history(two, two.parameters(params), times, names)
    moment = 0.4 * np.asarray(read[names[0]]) + 1.7 * np.asarray(read[names[1]])
    np.testing.assert_allclose(moment, 0.4 * 0.8, rtol=1e-4)


def written(folder: Path, known: str, more: str = "", columns: str = "") -> Problem:
    force, block = pair(CLOCK, 0.3, 3.5, 1.5)
    rng = np.random.default_rng(8)
    rows = [CLOCK, force + 0.004 * force.max() * rng.standard_normal(CLOCK.size)]
    rows += [block + 0.01 * block.max() * rng.standard_normal(CLOCK.size)] if columns else []
    np.savetxt(
        folder / "run.csv", np.stack(rows, axis=1), delimiter=",", header=f"time [s],force [N]{columns}", comments=""
    )
    (folder / "run.toml").write_text(FILE.format(known=known, more=more))
    return load(folder / "run.toml")


SPEED_FREE = "approach_speed = [0.02, 9.0]"
BLOCK = ",block acceleration [m/s^2]"


@pytest.mark.parametrize(
    ("known", "more", "columns", "said"),
    [
        ('mass = "3.5 kg", approach_speed = "1.5 m/s"', "", "", "impulse"),
        ('mass = "0.1 kg", approach_speed = "1.5 m/s"', "", "", "impulse"),
        ('mass = "3.5 kg"', "approach_speed = [0.5, 9.0]", "", "impulse"),
        ('mass = "3.5 kg"', SPEED_FREE, BLOCK, "block acceleration"),
        ('mass = "3.5 kg"', SPEED_FREE, "", ""),
        ('mass = "3.5 kg +- 1 %"', SPEED_FREE, BLOCK, ""),
        ('mass = "3.5 kg", struck_mass = "fixed"', SPEED_FREE, BLOCK, ""),
        ('mass = "0.3 kg", struck_mass = "3.5 kg"', SPEED_FREE, BLOCK, ""),
        ('mass = "0.3 kg", struck_mass = "3.5 kg", approach_speed = "1.5 m/s"', "", BLOCK, ""),
        ('mass = "0.2763 kg", approach_speed = "1.5 m/s"', "", BLOCK, ""),
    ],
)
def test_masses_that_the_impulse_or_another_sensor_contradicts_are_said(tmp_path, known, more, columns, said):
    doubts = written(tmp_path, known, more, columns).doubts
    assert bool(doubts) == bool(said) and all(said in doubt.text for doubt in doubts)


def hits(folder: Path, speeds: tuple[float, ...], known: str, speed: str, struck: float = 3.5) -> Problem:
    """A hammer of .3 kg at several speeds on a free block, by force and the block's acceleration."""
    rng, rows = np.random.default_rng(5), []
    for k, v in enumerate(speeds):
        force, block = pair(CLOCK, 0.3, struck, v)
        force = force + 0.004 * force.max() * rng.standard_normal(CLOCK.size)
        block = block + 0.01 * block.max() * rng.standard_normal(CLOCK.size)
        rows.append(np.stack([CLOCK, np.full(CLOCK.size, k + 1), force, block], axis=1))
    header = "time [s],hit,force [N],block acceleration [m/s^2]"
    np.savetxt(folder / "hits.csv", np.concatenate(rows), "%.9g", ",", header=header, comments="")
    more = f"approach_speed = {speed}"
    content = FILE.format(known=known, more=more if speed else "").replace("run.csv", "hits.csv")
    (folder / "hits.toml").write_text(content)
    return load(folder / "hits.toml")


@pytest.mark.parametrize("speeds", [(1.0, 1.2), (0.4, 1.6, 0.9), (2.0, 2.02)])
@pytest.mark.parametrize("struck", [3.5, 0.8])
def test_records_of_several_speeds_cannot_share_one(tmp_path, speeds, struck):
    mass = 'mass = "3.5 kg +- 1 %"'
    shared = hits(tmp_path, speeds, mass, "[0.001, 9.0]", struck)
    if max(speeds) < 1.1 * min(speeds):
        assert not shared.doubts
        return
    (doubt,) = shared.doubts
    assert "each = true" in doubt.text and doubt.name == "approach_speed" and doubt.each
    # The speeds that the mass as it is given implies, between impulse over mass and half of it.
    effective = 0.3 * struck / (0.3 + struck)
    assert doubt.lower < effective * min(speeds) / 3.5 and max(speeds) * effective / 3.5 < doubt.upper
    other = freed(shared, [doubt])
    assert not other.doubts and {f.name: f.per_experiment for f in other.free}["approach_speed"]
    assert not hits(tmp_path, speeds, mass, "{ lower = 0.001, upper = 9.0, each = true }", struck).doubts


@pytest.mark.slow
def test_hits_of_several_speeds_by_the_mass_of_the_block_say_what_holds_on_which_condition(tmp_path):
    """K goes as m^n and a as m, the exponent not at all: with those the right law follows from a wrong mass."""
    problem = hits(tmp_path, (0.7, 1.5), 'mass = "3.5 kg"', "[0.001, 9.0]")
    found = with_doubts_right(problem, fit(problem), 12)
    assert found.verdict == "misfit" and all(p.ci95 is None for p in found.parameters.values())
    assert found.conditional.condition == "each record has a speed of its own and the struck body is fixed"
    given, ratio = found.conditional.parameters, 0.3 * 3.5 / 3.8 / 3.5
    powers = {"stiffness": TRUTH["exponent"], "exponent": 0.0, "damping": 1.0}
    for name, power in powers.items():
        low, high = (end * ratio**power for end in given[name].with_budget)
        noise = given[name].intervals["noise"]
        assert low < TRUTH[name] < high and noise[1] < 1.5 * noise[0]
    for k, v in enumerate((0.7, 1.5)):
        low, high = (end / ratio for end in given[f"approach_speed[hit {k + 1}]"].with_budget)
        assert low < v < high
    assert "if each record has a speed of its own" in text(found) and "approach_speed[hit 2]" in text(found)


@pytest.mark.slow
def test_a_mass_that_impulse_and_speed_contradict_is_what_they_imply_on_condition(tmp_path):
    problem = hits(tmp_path, (1.5,), 'mass = "3.5 kg", approach_speed = "1.5 m/s"', "")
    (doubt,) = problem.doubts
    effective = 0.3 * 3.5 / 3.8
    assert doubt.name == "mass" and doubt.lower < effective < doubt.upper < 2.5 * doubt.lower and "imply" in doubt.text
    found = with_doubts_right(problem, fit(problem), 12)
    assert found.verdict not in STANDS
    assert found.conditional.condition == "speed and gain are right"
    for name, true in {**TRUTH, "mass": effective}.items():
        low, high = found.conditional.parameters[name].with_budget
        assert low < true < high
    assert "if speed and gain are right" in text(found) and "; mass " in text(found)
    # Both masses given as they are, nothing is doubted.
    assert not hits(tmp_path, (1.5,), 'mass = "0.3 kg", struck_mass = "3.5 kg", approach_speed = "1.5 m/s"', "").doubts


@pytest.mark.slow
def test_with_a_doubt_nothing_is_identified_and_with_both_masses_the_law_is(tmp_path):
    wrong = fit(written(tmp_path, 'mass = "3.5 kg"', SPEED_FREE, BLOCK))
    assert wrong.verdict == "not_identified" and "struck_mass" in wrong.reasons[0]
    assert wrong.parameters["stiffness"].value > 10.0 * TRUTH["stiffness"]
    assert all(p.ci95 is None for p in wrong.parameters.values())
    # What holds if the struck body is fixed is what a file says that states it.
    told = fit(written(tmp_path, 'mass = "3.5 kg", struck_mass = "fixed"', SPEED_FREE, BLOCK))
    assert wrong.conditional.condition == "the struck body is fixed" and told.conditional is None
    for name, p in told.parameters.items():
        for key in ("ci95", "with_budget"):
            np.testing.assert_allclose(getattr(wrong.conditional.parameters[name], key), getattr(p, key))
    printed = text(wrong)
    assert "if the struck body is fixed: stiffness" in printed and "95 % interval, if so" in printed
    assert " none " not in printed
    right = fit(written(tmp_path, 'mass = "0.3 kg", struck_mass = "3.5 kg", approach_speed = "1.5 m/s"', "", BLOCK))
    assert right.verdict == "identified"
    for name, true in TRUTH.items():
        low, high = right.parameters[name].ci95
        assert low < true < high


def test_a_struck_body_is_fixed_or_has_a_mass_of_an_impact(tmp_path):
    with pytest.raises(InputError, match='struck_mass = "fixed", where the scene has that mass'):
        written(tmp_path, 'mass = "3.5 kg", struck_mass = "fixed"', "struck_mass = [1.0, 9.0]")


def test_init_takes_no_force_over_acceleration_for_the_mass_of_a_contact(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, 'mass = "1 kg", approach_speed = "1 m/s"', "", BLOCK)
    Path("run.toml").unlink()
    done = bcfj("init", "calibration", "run.csv")
    content = Path("run.toml").read_text()
    assert done.exit_code == 0 and 'mass = "? kg"' in content and "Force over acceleration is 3." in content
    assert '# parameters.struck_mass = "fixed"' in content


def test_the_box_of_init_holds_the_speed_of_every_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    speeds, lines = (0.3, 0.9, 2.4, 2.4, 2.4), []
    for run, speed in enumerate(speeds):
        lines += [f"{run},{t:.6f},{f:.6g}" for t, f in zip(CLOCK, pulse(CLOCK, 0.5, speed), strict=True)]
    Path("run.csv").write_text("run,time [s],force [N]\n" + "\n".join(lines) + "\n")
    assert bcfj("init", "calibration", "run.csv", "--mass", "0.5 kg").exit_code == 0
    (box,) = [f for f in load("run.toml").free if f.name == "approach_speed"]
    assert box.lower < min(speeds) and max(speeds) < box.upper


@pytest.mark.parametrize("noise", ["estimate", "3 N"])
def test_a_record_of_too_many_samples_keeps_its_contact_and_its_noise(tmp_path, monkeypatch, noise):
    monkeypatch.chdir(tmp_path)
    times = np.arange(0.0, 0.14, 2e-6)
    force = pulse(times)
    read = force + 3.0 * np.random.default_rng(6).standard_normal(times.size)
    np.savetxt("run.csv", np.stack([times, read], axis=1), "%.8g", ",", header="time [s],force [N]", comments="")
    known = 'mass = "0.5 kg", approach_speed = "1 m/s"'
    Path("run.toml").write_text(FILE.format(known=known, more="").replace('"estimate"', f'"{noise}"'))
    (record,), problem = prepared("run.toml"), load("run.toml")
    kept = record.readings["contact.normal"].values
    assert 500 < record.times.size < 4000 and any("thinned" in note for note in record.notes)
    clock = record.times + record.first_contact
    inside = (clock > TOUCH) & (clock < TOUCH + duration(force, times))
    assert inside.sum() >= 240
    left = kept - np.interp(clock, times, force)
    assert np.std(left) == pytest.approx(3.0 / np.sqrt(record.averaged), rel=0.1)
    sigma = problem.experiments[0].channels[0].sigma
    assert sigma is None if noise == "estimate" else sigma == pytest.approx(3.0 / np.sqrt(record.averaged))
    # Remembered noise is not averaged.
    Path("run.toml").write_text(Path("run.toml").read_text().replace("align", 'correlation = "10 us"\nalign'))
    assert prepared("run.toml")[0].averaged == 1


@pytest.mark.slow
def test_weight_is_in_the_budget_of_an_impact_that_knows_none_and_may_be_asked_for():
    heavy, plain = bj.scenes.impact(smoothing=False, gravity=True), bj.scenes.impact(smoothing=False)
    params = {"stiffness": 1e5, "exponent": 1.5, "damping": 0.3, "mass": 0.6, "approach_speed": 0.4}
    times = np.linspace(-5e-3, 0.09, 500)
    after = times[times >= 0.0]

    def force(gravity: float) -> np.ndarray:
        ran = bj.simulate(heavy, heavy.parameters(params | {"gravity": gravity}), after)
        return np.r_[np.zeros(times.size - after.size), np.asarray(ran.force["contact"])[:, 0]]

    read = force(0.0) + 0.05 * np.random.default_rng(0).standard_normal(times.size)
    free = tuple(Free(n, 0.2 * params[n], 5.0 * params[n]) for n in ("stiffness", "damping"))
    runs = (Experiment("drop", times, (Channel("contact.normal", read, 0.05),)),)
    problem = Problem(plain, {k: float(v) for k, v in plain.parameters(params).items()}, runs, free)
    found = fit(problem)
    at = found.optimum
    scene = scene_of(at.model, at.series, predictions(at.model, at.end.point), at.end.point)
    seen = 0.05 * weight(scene, 0.02)
    expected = force(0.02) - force(0.0)
    assert np.sqrt(np.mean((seen - expected) ** 2)) < 0.05 * np.sqrt(np.mean(expected**2))
    known = replace(problem, scene=heavy, params=problem.params | {"gravity": 9.81})
    # Of a scene with weight what gravity differs by from place to place is left.
    for one, unit, size in ((found, f"of {GRAVITY} m/s^2", 1.0), (fit(known), "of itself", 0.003)):
        (line,) = (line for line in one.systematic.lines if line.error == "gravity")
        assert line.unit == unit and line.amplitude <= 1.01 * size


def test_gravity_of_an_impact_is_a_scene_of_its_own_where_a_file_names_it(tmp_path):
    plain = written(tmp_path, 'mass = "0.3 kg", approach_speed = "1.5 m/s"')
    heavy = written(tmp_path, 'mass = "0.3 kg", approach_speed = "1.5 m/s", gravity = "9.81 m/s^2"')
    assert "gravity" not in plain.scene.quantities and "gravity" in heavy.scene.quantities
    # Dropped onto the surface from 0.1 m at rest: sqrt(2 c/g).
    scene = bj.scenes.impact(gravity=True)
    at = scene.first_touch({"clearance_contact": 0.1, "approach_speed": 0.0, "gravity": 9.81})
    assert at == pytest.approx(np.sqrt(0.2 / 9.81))


@pytest.mark.parametrize(("stiffness", "deep"), [(100.0, True), (1000.0, False)])
def test_a_fit_that_presses_bodies_into_each_other_says_so(stiffness, deep):
    """A linear spring: d = v sqrt(m/K), 95 mm for 100 N/m, where 0.1 kg of water is a cube of 46 mm."""
    scene = bj.scenes.impact(smoothing=False)
    params = scene.parameters(stiffness=stiffness, exponent=1.0, damping=0.0, mass=0.1, approach_speed=3.0)
    times = np.linspace(0.0, 0.12, 50)
    record = Experiment("run", times, (Channel("contact.normal", np.zeros(50), 1.0),))
    model = build(Problem(scene, params, (record,), (Free("stiffness", 10.0, 1e4),)), (record,))
    middle = np.array([np.log10(stiffness / 10.0) / 3.0])
    outcome = SimpleNamespace(
        fit=SimpleNamespace(optimum=SimpleNamespace(model=model, end=SimpleNamespace(point=middle)))
    )
    found = _absurd(outcome)
    assert [one.what for one in found] == (["penetration"] if deep else [])
    assert not deep or found[0].value == pytest.approx(3.0 * (0.1 / stiffness) ** 0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("header", "on", "speed"),
    [("a [m/s^2]", "struck", "0.8 m/s"), ("a [m/s^2]", "body", "0.8 m/s"), ("a of the block [m/s^2]", "struck", None)],
)
def test_whose_acceleration_is_read_is_told_by_the_speed_or_by_its_name(header, on, speed, tmp_path):
    """Of two free bodies: m a_1 = -M a_2, their approach changes by v (1 + e); what is proposed is that body's motion."""
    clock = np.arange(0.0, 0.05, 2e-5)
    read = pair(clock, 0.3, 4.0, 0.8)[0] / (4.0 if on == "struck" else -0.3)
    rows = "".join(f"{t:.6f},{a + 1e-3 * np.sin(1e3 * t):.6f}\n" for t, a in zip(clock, read, strict=True))
    (tmp_path / "hit.csv").write_text(f"time [s],{header}\n{rows}")
    said = init.Said(mass="0.3 kg", speed=speed, struck="4 kg")
    init.run(tmp_path / "hit.csv", tmp_path / "hit.toml", said, lambda line: None)
    problem = load(tmp_path / "hit.toml")
    (experiment,) = problem.experiments
    assert [c.observes for c in experiment.channels] == [f"{on}.acceleration.x"]
    assert "is wrong" not in (tmp_path / "hit.toml").read_text()
    truth = {**problem.params, **experiment.fixed, **TRUTH, "approach_speed": 0.8}
    times = np.arange(0.0, 0.01, 1e-5)
    seen = bj.reading_history(problem.scene, truth, times, [f"{on}.acceleration.x"])[f"{on}.acceleration.x"]
    largest = max(experiment.channels[0].values, key=abs)
    assert float(seen[np.argmax(np.abs(seen))]) == pytest.approx(largest, rel=1e-2)
    if speed is None:
        (own,) = (f for f in problem.free if f.name == "approach_speed")
        assert own.lower < 0.8 < own.upper
