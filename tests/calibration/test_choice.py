"""Model choice: likelihoods against SciPy's normal density, choices against records whose law is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem, fit, load
from calibration.diagnostics.misfit_location import misses, reasons
from calibration.diagnostics.records import Record
from calibration.forward.model import build, residuals_and_jacobian
from calibration.noise import noise_model
from calibration.selection.alternatives import candidates, models
from calibration.selection.choice import Likelihood, Rival, _over_the_same, choose, decided, likelihood_of, rival, table

pytestmark = pytest.mark.filterwarnings("error")

# A 0.1 kg body on 1e6 N/m^1.5 that bottoms out at 2.4 mm on 1e6 N/m beside it.
MASS, STIFFNESS, DEPTH, BACKING = 0.1, 1e6, 2.4e-3, 1e6
TIMES = np.linspace(0.0, 6e-3, 121)
SIGMA = 1.0
SOFT = scenes.impact(law="hertz", smoothing=False)
STIFF = scenes.impact(law="hertz", elastic="two_stage", smoothing=False)
FREE = (Free("stiffness", 1e5, 1e7), Free("exponent", 1.0, 2.5))


def force(depth: float, backing: float) -> float:
    d = max(depth, 0.0)
    return STIFFNESS * d**1.5 + backing * max(d - DEPTH, 0.0)


def record(speed: float, backing: float, seed: int, hold_out: bool = False, correlation=0.0, sigma=SIGMA) -> Experiment:
    """A noisy force history by DOP853 of the law with its sharp corner."""
    run = solve_ivp(
        lambda _, s: (s[1], -force(s[0], backing) / MASS), (0, TIMES[-1]), (0.0, speed), "DOP853", TIMES, rtol=1e-10,
        atol=1e-14, max_step=2e-5,
    )  # fmt: skip
    values = np.array([force(d, backing) for d in run.y[0]]) + SIGMA * np.random.default_rng(seed).standard_normal(121)
    channel = Channel("contact.normal", values, sigma, correlation=correlation)
    return Experiment(f"{speed:g} m/s", TIMES, (channel,), hold_out, {"approach_speed": speed})


def problem(scene, experiments, free, **fixed) -> Problem:
    params = scene.parameters(mass=MASS, **fixed)
    return Problem(scene, {k: float(v) for k, v in params.items()}, experiments, free)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "correlation"), [(1.0, 0.0), (1.3, 2e-4), (None, 0.0), (None, 2e-4)])
def test_likelihood_is_that_of_the_normal_distribution(sigma, correlation):
    data = tuple(record(v, 0.0, k, sigma=sigma, correlation=correlation) for k, v in enumerate((1.0, 1.5)))
    stated = problem(SOFT, data, FREE, stiffness=STIFFNESS, exponent=1.5)
    model = build(stated, data)
    point = model.point(np.array([STIFFNESS, 1.5]))
    found = noise_model.Estimate({}, {}, [])
    if not noise_model.known(data):
        model, found = noise_model.estimate(model, data, point)
    residuals = np.asarray(residuals_and_jacobian(model, jnp.asarray(point))[0])
    reported = likelihood_of(data, model, residuals, found)
    assert (reported.numbers, reported.samples) == (2 + (sigma is None), 242)
    gaps = np.abs(TIMES[:, None] - TIMES)
    shape = np.exp(-gaps / correlation) if correlation else np.eye(TIMES.size)
    errors = [e.channels[0].values - clean(e) for e in data]
    # The likeliest deviation of normal errors of this shape, by its closed form.
    likeliest = np.sqrt(np.mean([e @ np.linalg.solve(shape, e) / e.size for e in errors]))
    covariance = (likeliest if sigma is None else sigma) ** 2 * shape
    expected = -2.0 * sum(multivariate_normal.logpdf(e, cov=covariance) for e in errors)
    assert reported.deviance == pytest.approx(expected, rel=1e-4)
    n, k = 242, reported.numbers
    assert reported.bic == pytest.approx(reported.deviance + k * np.log(n))
    assert reported.aicc == pytest.approx(reported.deviance + 2 * k * n / (n - k - 1))


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_models_that_follow_differently_far_are_compared_over_what_all_follow(sigma):
    whole = problem(SOFT, (record(1.5, 0.0, 0, sigma=sigma),), FREE)
    part = whole.until([3.5e-3])
    far, near = (rival(name, p, fit(p, starts=4, systematic=False)) for name, p in (("far", whole), ("near", part)))
    same = _over_the_same([whole, whole], [far, near])
    assert [r.likelihood.samples for r in (far, *same)] == [121, 71, 71]
    assert same[1] is near
    # The optimum of the part, whichever way it was reached.
    assert same[0].likelihood.deviance == pytest.approx(near.likelihood.deviance, abs=0.02)


def clean(experiment: Experiment) -> np.ndarray:
    speed = experiment.fixed["approach_speed"]
    run = solve_ivp(
        lambda _, s: (s[1], -force(s[0], 0.0) / MASS), (0, TIMES[-1]), (0.0, speed), "DOP853", TIMES, rtol=1e-10,
        atol=1e-14, max_step=2e-5,
    )  # fmt: skip
    return np.array([force(d, 0.0) for d in run.y[0]])


def scored(name, verdict="identified", bic=0.0, held_out=None, seconds=1.0, labels=("a",)) -> Rival:
    fit = SimpleNamespace(verdict=verdict, labels=labels, residual={"rms_of_peak": 1.0}, reasons=[])
    return Rival(name, fit, Likelihood(bic, 0, 100), held_out, seconds)


@pytest.mark.parametrize(
    ("rivals", "chosen", "said"),
    [
        # Of models that are kept the one of fewest numbers, though another predicts a little better.
        ([scored("small", held_out=0.011), scored("large", held_out=0.010, labels=("a", "b"))], "small", "cheapest"),
        # Not where the likelihood speaks for the larger one decisively.
        ([scored("small", bic=10.1), scored("large", labels=("a", "b"))], "large", "only model"),
        ([scored("small", bic=9.9), scored("large", labels=("a", "b"))], "small", "cheapest"),
        # A model that computes much faster is cheaper than one of fewer numbers.
        ([scored("slow"), scored("quick", seconds=0.2, labels=("a", "b"))], "quick", "do not ask for 'slow'"),
        # A misfit is refused, however well it predicts; an undetermined parameter is no misfit.
        ([scored("wrong", "misfit", held_out=0.01), scored("right", "not_identified", held_out=0.02)], "right", "only"),
        # Where none is kept the best predictor, and that it is none.
        ([scored("a", "misfit", held_out=0.2), scored("b", "misfit", held_out=0.1)], "b", "refuse every model"),
        ([scored("a", "misfit", bic=5.0), scored("b", "misfit", bic=4.0)], "b", "best by BIC; its verdict is misfit"),
    ],
)
def test_the_cheapest_model_that_is_kept_is_chosen(rivals, chosen, said):
    choice = decided(rivals)
    assert choice.chosen == chosen and said in choice.reasons[0]
    assert choice.fit is next(r.fit for r in rivals if r.name == chosen)
    scores = [r.held_out if r.held_out is not None else r.likelihood.bic for r in choice.rivals]
    assert scores == sorted(scores)
    assert [row[-1] for row in table(choice)].count("chosen") == 1


@dataclass(frozen=True)
class Judged:
    """What a choice asks of a fit."""

    verdict: str
    labels: tuple[str, ...] = ("a",)
    reasons: tuple[str, ...] = ()


def test_the_table_of_models_has_the_verdict_that_the_chosen_one_ends_with():
    """Where a filter that nobody stated may hide the law, as in a record of a thin pad; other models keep theirs."""
    rivals = [replace(scored("one", bic=10.1), fit=Judged("misfit")), replace(scored("two"), fit=Judged("adequate"))]
    choice: Any = decided(rivals)
    ended = choice.reported(Judged("not_identified", reasons=("a filter",)))
    verdicts = {row[0]: row[1] for row in table(ended)}
    assert verdicts["two"] == "not_identified" == ended.fit.verdict and verdicts["one"] == "misfit"
    assert ended.chosen == choice.chosen == "two" and ended.reasons[:-1] == choice.reasons
    assert "call 'two' adequate" in ended.reasons[-1] and "makes it not_identified" in ended.reasons[-1]
    assert choice.reported(Judged("adequate")) is choice


@pytest.mark.slow
def test_a_soft_layer_that_bottoms_out_is_seen_and_its_law_chosen():
    # Greatest penetrations of 2.1 to 2.6 mm: the two faster ones bottom out.
    data = (record(1.6, BACKING, 0), record(2.1, BACKING, 1), record(2.0, BACKING, 2, hold_out=True))
    more = (Free("bottoming_stiffness", 1e4, 1e8), Free("bottoming_penetration", 1e-3, 5e-3))
    one = problem(SOFT, data, FREE)
    two = problem(STIFF, data, FREE + more, bottoming_width=1e-5, bottoming_penetration=2e-3)
    choice = choose([("one stage", one), ("two stages", two)], starts=6)
    assert choice.chosen == "two stages" and "only model" in choice.reasons[0]
    by_name = {r.name: r for r in choice.rivals}
    worse, better = by_name["one stage"], by_name["two stages"]
    assert worse.fit.verdict == "misfit" and better.fit.verdict == "identified", better.fit.reasons
    assert worse.held_out > 2.0 * better.held_out
    assert worse.likelihood.bic - better.likelihood.bic > 100.0
    low, high = better.fit.parameters["bottoming_penetration"].ci95
    assert low < DEPTH < high
    # The moment named is one at which the layer has bottomed out, which the record of 1.6 m/s never does.
    run = solve_ivp(
        lambda _, s: (s[1], -force(s[0], BACKING) / MASS), (0, 6e-3), (0.0, 2.1), "DOP853", TIMES, rtol=1e-10
    )
    stage = TIMES[run.y[0] > DEPTH]
    first = misses(r for r in worse.fit.records if r.name == "2.1 m/s")[0]
    assert stage[0] <= first.time <= stage[-1] and first.error > 0 and first.brief
    assert any(f"at {first.time:.4g} s" in reason for reason in worse.fit.reasons)


def seen(spike: float = 0.0, at: float = 0.05, seed: int = 0) -> Record:
    times = np.linspace(-0.02, 0.12, 141)
    predicted = np.where((times > 0) & (times < 0.1), 5.0 * np.sin(np.pi * np.clip(times, 0, 0.1) / 0.1), 0.0)
    data = predicted + 0.02 * np.random.default_rng(seed).standard_normal(141)
    data[np.argmin(np.abs(times - at))] += spike
    channel = "contact.normal"
    return Record("run 3", False, times, {channel: data}, {channel: predicted}, {channel: 0.02}, {})


def test_a_miss_is_named_by_its_time():
    (miss,) = misses([seen(4.0, 0.051)])
    assert miss.time == pytest.approx(0.051) and miss.error == pytest.approx(4.0, abs=0.1) and miss.brief
    (said,) = reasons([seen(4.0, 0.051)])
    assert "in run 3" in said and "at 0.051 s" in said and "bottoms out" in said
    # Before the contact, or below the model, is no bottoming-out.
    assert not misses([seen(4.0, -0.01)])[0].brief and not misses([seen(-2.0)])[0].brief
    assert "below" in reasons([seen(-2.0)])[0]
    # Noise alone seldom shows a place.
    assert sum(bool(misses([seen(seed=seed)])) for seed in range(100)) <= 10


FILE = """
scene = "cart.toml"
[[experiment]]
file = "force.csv"
time = "time [ms]"
observe = {{ "contact.normal" = "force [N]" }}
noise = "1 N"
[free.stiffness]
lower = 1e5
upper = 1e7
[free.exponent]
lower = 1.0
upper = 2.5
[free.damping]
lower = "0.001 s/m"
upper = "1 s/m"
{}
"""


@pytest.fixture
def stated(tmp_path):
    def write(more: str):
        (tmp_path / "cart.toml").write_text('[scene]\nkind = "impact"\n[parameters]\nmass = 0.1\ndamping = 0.01\n')
        rows = [f"{1e3 * t:.6g},{f:.6g}" for t, f in zip(TIMES, record(1.0, 0.0, 0).channels[0].values, strict=True)]
        (tmp_path / "force.csv").write_text("\n".join(["time [ms],force [N]", *rows]))
        path = tmp_path / "fit.toml"
        path.write_text(FILE.format(more))
        return path

    return write


def test_models_of_a_file(stated):
    path = stated(
        '[[model]]\nname = "as it is"\n'
        '[[model]]\nname = "hertz"\nscene = { law = "hertz" }\nparameters = { exponent = 1.5 }\n'
        '[[model]]\nname = "two"\nscene = { elastic = "two_stage" }\n'
        'model.free.bottoming_stiffness = { lower = "1 kN/m", upper = "1 MN/m" }\n'.replace("model.free", "free")
    )
    path.write_text('sensor = "exact"\n' + path.read_text())
    problem = load(path)
    plain, hertz, two = models(path, problem)
    assert [a.name for a in (plain, hertz, two)] == ["as it is", "hertz", "two"]
    assert plain.problem.free == problem.free and plain.problem.params == problem.params
    # What is fixed, or unknown to the law, is not free; what the file says of the damping is not the law's.
    assert [f.name for f in hertz.problem.free] == ["stiffness"] and hertz.problem.params["exponent"] == 1.5
    assert "damping" not in hertz.base.resolved["parameters"]
    added = two.problem.free[-1]
    assert (added.name, added.lower, added.upper) == ("bottoming_stiffness", 1e3, 1e6)
    assert all(a.problem.experiments is problem.experiments for a in (plain, hertz, two))
    assert models(stated(""), problem) == [] and candidates(stated(""), problem) == []


def test_candidates_of_a_file(stated):
    path = stated(
        '[[candidate]]\nname = "faster"\nparameters = { approach_speed = "2000 mm/s" }\n'
        'observe = { "contact.normal" = "2 %" }\nend = "6 ms"\nsamples = 13\n'
    )
    (faster,) = candidates(path, load(path))
    assert faster.fixed == {"approach_speed": 2.0} and faster.noise == {"contact.normal": 0.02} and faster.share
    assert np.allclose(faster.times, np.linspace(0.0, 6e-3, 13))


@pytest.mark.parametrize(
    ("more", "reported"),
    [
        ('[[model]]\nname = "a"\nscene = { elastc = "linear" }', "elastc"),
        ('[[model]]\nname = "a"\nscene = { elastic = "liner" }', "did you mean 'linear'"),
        ('[[model]]\nname = "a"\nparameters = { mas = 1 }', "did you mean 'mass'"),
        ('[[model]]\nname = "a"\nfree.mas = { lower = 1, upper = 2 }', "no parameter 'mas'; did you mean 'mass'"),
        ('[[model]]\nname = "a"\nscene = { law = "hertz" }', r"\[free.damping\]: no \[\[model\]\] has it"),
        ('[[model]]\nnme = "a"', "nme"),
        (
            '[[candidate]]\nname = "a"\nobserve = { "contact.normal" = "1 %" }\nend = 0\nsamples = 9',
            "not after the start",
        ),
        ('[[candidate]]\nname = "a"\nobserve = {}\nend = 1\nsamples = 9', "observe"),
    ],
)
def test_what_is_not_right_is_named(stated, more, reported):
    path = stated(more)
    problem = load(path)
    with pytest.raises(InputError, match=reported):
        assert not (models(path, problem), candidates(path, problem))


def test_models_must_be_distinguishable():
    data = (record(1.0, 0.0, 0),)
    one, other = problem(SOFT, data, FREE), problem(SOFT, (record(1.0, 0.0, 1),), FREE)
    for pairs, reported in (
        ([("a", one), ("a", one)], "name of its own"),
        ([("a", one), ("b", other)], "same data"),
        ([], "none"),
    ):
        with pytest.raises(InputError, match=reported):
            choose(pairs)
