"""The systematic budget against fits of records with that very error planted, by SciPy and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from shown import brief, drawn

from bcfj_jax import InputError, scenes, simulate
from bcfj_jax.io.units import toleranced
from calibration import Channel, Experiment, Free, Problem, fit

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.6e-3, 161)


def problem(error, seed=0) -> Problem:
    params = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
    force = simulate(SCENE, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    sigma = 2e-3 * float(force.max())
    values = error(force) + sigma * np.random.default_rng(seed).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    return Problem(SCENE, params, (Experiment("drop", TIMES, (Channel("contact.normal", values, None),)),), free)


@pytest.mark.full
def test_a_line_says_what_a_fit_of_that_error_moves_by(tmp_path, monkeypatch):
    """Of the mass and of a bend of the gain, as large as their lines say."""
    found = fit(problem(lambda f: f), starts=4)
    lines = {line.error: line for line in found.systematic.lines}
    mass = lines["mass"].amplitude
    one = fit(
        replace(problem(lambda f: f), params={**problem(lambda f: f).params, "mass": 0.1 * (1.0 + mass)}), starts=4
    )
    bend = lines["bend of the gain"].amplitude
    two = fit(problem(lambda f: f * (1.0 + bend * f / f.max())), starts=4)
    for name in TRUTH:
        for error, other in (("mass", one), ("bend of the gain", two)):
            moved = abs(np.log(other.values[name] / found.values[name]))
            assert moved == pytest.approx(lines[error].moves[name], rel=0.15, abs=2e-4), (name, error)
    brief(found, f"Fit: {found.verdict}")
    drawn(found, tmp_path, monkeypatch)
    for name, one in found.parameters.items():
        assert found.to_pandas().loc[name, "value"] == one.value
    assert found.to_xarray().sizes["parameter"] == len(found.parameters)


@pytest.mark.slow
def test_an_error_that_residuals_show_is_bounded_by_them():
    """Less noise lets less pass, and nothing more than is called large."""
    loud = fit(problem(lambda f: f), starts=4)
    calm = problem(lambda f: f)
    (experiment,) = calm.experiments
    (channel,) = experiment.channels
    clean = simulate(SCENE, calm.params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    values = clean + 0.05 * (channel.values - clean)
    quiet = fit(
        replace(calm, experiments=(replace(experiment, channels=(replace(channel, values=values),)),)), starts=4
    )
    for more, less in zip(loud.systematic.lines, quiet.systematic.lines, strict=False):
        if more.error in ("bend of the gain", "lag", "drift"):
            assert 0.0 < less.amplitude <= more.amplitude <= 0.1


def stated(tolerance: str) -> tuple[float, float | None]:
    return toleranced(tolerance, "kg", "problem.toml: [parameters] mass")


def test_a_tolerance_is_a_share_or_a_value():
    assert stated("0.55 kg +- 2 %") == (0.55, pytest.approx(0.011))
    assert stated("550 g ± 5 g") == (pytest.approx(0.55), pytest.approx(0.005))
    assert stated("0.55 kg") == (0.55, None)
    with pytest.raises(InputError, match="mass: a tolerance of '-2 %'"):
        stated("0.55 kg +- -2 %")
    with pytest.raises(InputError, match="mass"):
        stated("0.55 kg +- 2 mm")


def test_what_is_known_better_widens_less():
    """Errors of the mass: none, 1 % (not said) and 5 %; of what the residuals let pass no more is allowed for."""
    plain = problem(lambda f: f)
    widths = []
    for tolerances in ({"mass": 0.0}, {}, {"mass": 0.005}):
        p = fit(replace(plain, tolerances=tolerances), starts=4).parameters["stiffness"]
        assert p.with_budget and p.ci95
        assert p.with_budget[0] < p.ci95[0] < p.ci95[1] < p.with_budget[1]
        widths.append(np.log(p.with_budget[1] / p.with_budget[0]))
    assert widths[0] <= widths[1] <= widths[2]


@pytest.mark.full
def test_an_error_that_no_residual_shows_is_allowed_for():
    """A lag of a five-hundredth of a contact, by SciPy: the law is consistent, the interval of the noise is wrong."""
    tau = 2e-6
    lagged = lambda f: lsim(((1.0,), (tau, 1.0)), f, TIMES)[1]  # noqa: E731
    found = fit(problem(lagged), starts=4)
    assert found.verdict == "identified"
    off = [p.ci95 and not p.ci95[0] < TRUTH[name] < p.ci95[1] for name, p in found.parameters.items()]
    assert any(off)
    for name, p in found.parameters.items():
        assert p.with_budget and p.with_budget[0] < TRUTH[name] < p.with_budget[1]


def test_a_stated_sensor_has_a_line_of_its_own():
    """A clock known to 1 us in place of half a sample, and a gain that is known for certain."""
    plain = problem(lambda f: f)
    (experiment,) = plain.experiments
    stated = {"time_offset": 0.0, "gain": 1.0}
    known = replace(experiment, fixed=stated, tolerances={"time_offset": 1e-6, "gain": 0.0})
    loose, tight = (fit(p, starts=4) for p in (plain, replace(plain, experiments=(known,))))
    assert loose.systematic and tight.systematic
    assert {"clock", "gain"} <= {line.error for line in loose.systematic.lines}
    named = {line.error: line for line in tight.systematic.lines}
    assert not {"clock", "gain"} & set(named) and named["time_offset"].amplitude <= 1.0
    wide, narrow = (f.parameters["stiffness"].with_budget for f in (loose, tight))
    assert wide and narrow and wide[0] < narrow[0] < narrow[1] < wide[1]
