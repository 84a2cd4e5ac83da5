"""A record of impacts as features of its contacts: against closed forms, and a fit of ten bounces from them."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax import InputError, scenes
from calibration import Experiment, Free, Problem, fit, load
from calibration.impacts.trains import observations

# Half sines: impulse 2 F T/pi, centre in the middle, width T (1/4 - 2/pi^2)^(1/2).
PEAKS, LENGTH = (40.0, 30.0, 20.0), 10e-3
BEGINS = np.array([0.05, 0.15, 0.22])
WIDTH = LENGTH * np.sqrt(0.25 - 2.0 / np.pi**2)
TIMES = np.arange(0.0, 0.3, 0.25e-3)


def record() -> np.ndarray:
    force = np.zeros(TIMES.size)
    for begin, peak in zip(BEGINS, PEAKS, strict=True):
        inside = (begin < TIMES) & (begin + LENGTH > TIMES)
        force[inside] = peak * np.sin(np.pi * (TIMES[inside] - begin) / LENGTH)
    return force


def truth() -> dict[str, float]:
    found = {}
    for k, (begin, peak) in enumerate(zip(BEGINS, PEAKS, strict=True), start=1):
        found |= {f"contact.impulse_{k}": 2.0 * peak * LENGTH / np.pi, f"contact.center_{k}": begin + 0.5 * LENGTH}
        found |= {f"contact.width_{k}": WIDTH, f"contact.peak_{k}": peak}
    return found


def test_features_of_half_sines_are_those_of_the_closed_form():
    found = {o.feature: o for o in observations("contact.normal", TIMES, record() + 5.0)}
    assert found.keys() == truth().keys()
    for name, true in truth().items():
        assert found[name].value == pytest.approx(true, rel=2e-3), name
        # What samples lie apart for is in the deviation.
        assert abs(found[name].value - true) <= 4.0 * found[name].sigma, name


def test_their_deviations_are_those_of_repeated_records():
    rng, sigma, force = np.random.default_rng(0), 0.4, record()
    drawn = [
        {
            o.feature: o
            for o in observations("contact.normal", TIMES, force + sigma * rng.standard_normal(force.size), sigma)
        }
        for _ in range(200)
    ]
    for name, true in truth().items():
        values = np.array([d[name].value for d in drawn])
        stated = np.mean([d[name].sigma for d in drawn])
        assert 0.8 < stated / np.std(values) < 1.5, name
        assert abs(np.mean(values) - true) < 0.5 * stated, name


def test_the_rest_tells_the_noise():
    force = record() + 3.0 + 0.4 * np.random.default_rng(1).standard_normal(TIMES.size)
    stated, found = ({o.feature: o.sigma for o in observations("contact.normal", TIMES, force, s)} for s in (0.4, None))
    for name, sigma in stated.items():
        assert found[name] == pytest.approx(sigma, rel=0.1)


def test_records_without_whole_contacts_are_refused():
    force = record()
    for times, values, words in (
        (TIMES, np.zeros(TIMES.size), "no contact"),
        (TIMES[220:], force[220:], "begins in contact"),
        (TIMES[::20], force[::20], "samples"),
    ):
        with pytest.raises(InputError, match=words):
            observations("contact.normal", times, values)
    with pytest.raises(InputError, match="no normal force"):
        observations("body.acceleration.x", TIMES, force)
    cut = BEGINS[2] + 0.5 * LENGTH > TIMES
    assert {o.feature[-1] for o in observations("contact.normal", TIMES[cut], force[cut])} == {"1", "2"}


FILE = """
scene = "bounce"
[[experiment]]
file = "drop.csv"
time = "time [s]"
observe = { "contact.normal" = "force [N]" }
events = true
[free]
stiffness = [1e4, 1e8]
"""


def test_a_file_may_ask_for_events(tmp_path):
    table = np.column_stack([TIMES, record() + 0.1 * np.random.default_rng(2).standard_normal(TIMES.size)])
    np.savetxt(tmp_path / "drop.csv", table, delimiter=",", header="time [s],force [N]", comments="")
    (tmp_path / "fit.toml").write_text(FILE)
    problem = load(tmp_path / "fit.toml")
    (one,) = problem.experiments
    assert not one.channels and not one.times.size and one.span == pytest.approx(TIMES[-1])
    assert {o.feature for o in one.features} == truth().keys()
    # The clock is the record's own, the zero is out of it.
    assert "time_offset" in [f.name for f in problem.free] and "force_offset" not in [f.name for f in problem.free]
    (tmp_path / "fit.toml").write_text(FILE.replace("[free]", "[free.bandwidth]\nlower = 1e2\nupper = 1e4\n[free]"))
    with pytest.raises(InputError, match="bandwidth moves features of single contacts"):
        load(tmp_path / "fit.toml")


@pytest.mark.slow
def test_ten_bounces_are_calibrated_from_their_events():
    """Features by the closed form of the undamped bounce, noise added: stiffness over three decades, every start."""
    from benchmarks.references.bounce_events import closed

    scene = scenes.bounce(smoothing=False)
    law = {"stiffness": 1e5, "exponent": 1.0, "damping": 0.0, "mass": 0.1, "gravity": 9.81, "drop_height": 0.05}
    exact, rng = closed(law, 10), np.random.default_rng(3)
    from calibration import Observation

    seen, sizes = [], {"begin": 2e-5, "peak": 0.1, "impulse": 5e-4}
    for kind, sigma in sizes.items():
        values = exact[kind][0] + sigma * rng.standard_normal(10)
        seen += [Observation(f"contact.{kind}_{k + 1}", float(x), sigma) for k, x in enumerate(values)]
    one = Experiment("drop", np.zeros(0), (), features=tuple(seen), span=float(exact["end"][0][-1]) + 0.05)
    params = {k: float(v) for k, v in scene.parameters(law).items()}
    free = (Free("stiffness", 10**3.5, 10**6.5), Free("mass", 0.02, 0.5))
    found = fit(Problem(scene, params, (one,), free), starts=8)
    assert found.verdict == "identified", found.reasons
    # By Gauss-Newton at the truth with the closed form's derivatives.
    rows = np.concatenate([exact[k][1][:, [0, 3]] * [1e5, 0.1] / s for k, s in sizes.items()])
    spread = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    for name, deviation in zip(("stiffness", "mass"), spread, strict=True):
        assert abs(np.log(found.parameters[name].value / law[name])) < 4.0 * deviation
        ends = found.parameters[name].ci95
        assert ends is not None
        low, high = np.log(ends)
        assert (high - low) / 2.0 == pytest.approx(1.96 * deviation, rel=0.1)
    assert sum(s["chi2"] < found.starts[0]["chi2"] + 1.0 for s in found.starts) == 8


@pytest.mark.slow
def test_a_stiff_scene_is_calibrated_from_its_events():
    """Three bounces by implicit steps, which do not land on contacts; exact features by the closed form."""
    from benchmarks.references.bounce_events import closed
    from calibration import Observation

    law = {"stiffness": 1e5, "exponent": 1.0, "damping": 0.0, "mass": 0.1, "gravity": 9.81, "drop_height": 0.05}
    exact, scene = closed(law, 3), scenes.bounce(smoothing=False)
    end, params = float(exact["end"][0][-1]) + 0.05, scene.parameters(law)
    kinds = {"begin": 1e-5, "peak": 0.1, "impulse": 5e-4}
    seen = [
        Observation(f"contact.{kind}_{k + 1}", float(x), sigma)
        for kind, sigma in kinds.items()
        for k, x in enumerate(exact[kind][0])
    ]
    one = Experiment("drop", np.zeros(0), (), features=tuple(seen), span=end)
    values = {k: float(v) for k, v in params.items()}
    free = (Free("stiffness", 1e4, 1e6), Free("mass", 0.05, 0.2))
    found = fit(Problem(scene.suited(params, end, "bdf"), values, (one,), free), starts=4)
    for name in ("stiffness", "mass"):
        assert found.parameters[name].value == pytest.approx(law[name], rel=1e-4), found.reasons
