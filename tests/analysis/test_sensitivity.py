"""Sensitivities against closed forms, by both modes, of features, second ones; the command line."""

from __future__ import annotations

import csv
import json
import threading
import time
from types import SimpleNamespace
from typing import Any, cast

import jax
import numpy as np
import pytest
import tiers
from conftest import BUILD
from joints import plain_joint
from pages import check
from typer.testing import CliRunner

import bcfj_jax as bj
from bcfj_jax.analysis import features
from bcfj_jax.analysis.derivatives import differences
from bcfj_jax.analysis.derivatives.command import FILES
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import complete, default_features, derivative_unit, feature
from bcfj_jax.analysis.derivatives.table import Ranking, ranked_rows, ranking
from bcfj_jax.cli import app
from bcfj_jax.contact.restitution import delivered_restitution, undamped_duration

HERTZ = bj.scenes.impact("hertz", smoothing=False)
AT = {"stiffness": 1e10, "exponent": 1.5, "mass": 0.02, "approach_speed": 1.5}


def elasticity(found, values, name):
    """p/f df/dp of a feature, by parameter."""
    return {p: float(values[p]) * found.feature_derivatives[p][name] / found.features[name] for p in found.wrt}


@pytest.mark.slow
@pytest.mark.parametrize("n", tiers.ci([1.5, 2.2], 2.2))
def test_undamped_scaling_laws(n):
    values = {**AT, "stiffness": 1e10 * 1e-5 ** (1.5 - n), "exponent": n}
    params = HERTZ.parameters(values)
    duration = float(undamped_duration(*(values[k] for k in ("stiffness", "exponent", "mass", "approach_speed"))))
    # The greatest force falls on a sample, where dF/dt = 0.
    times = np.linspace(0.0, 1.25 * duration, 2501)
    wrt = ("stiffness", "mass", "approach_speed")
    found = bj.sensitivity(HERTZ, params, times, wrt, accuracy=1e-8)
    assert found.certificate.verdict == "trusted"
    peak = {"stiffness": 1 / (n + 1), "mass": n / (n + 1), "approach_speed": 2 * n / (n + 1)}
    assert elasticity(found, params, "contact.peak") == pytest.approx(peak, rel=1e-8)
    # T = c (m/K)^(1/(n+1)) v^((1-n)/(1+n)), and the contact's share of the times is T over their length.
    time = {"stiffness": -1 / (n + 1), "mass": 1 / (n + 1), "approach_speed": (1 - n) / (1 + n)}
    assert elasticity(found, params, "contact.contact_fraction") == pytest.approx(time, rel=1e-8)
    # Impulse 2 m v; trapezoids at the kink of d^1.5 cost most of what is allowed.
    impulse = elasticity(found, params, "contact.impulse")
    assert impulse == pytest.approx({"stiffness": 0.0, "mass": 1.0, "approach_speed": 1.0}, abs=3e-5)


@pytest.mark.slow
def test_restitution_by_damping():
    # Impulse m v (1 + e(chi)), chi = a v of the memory-free law: d/da = m v^2 e'(chi).
    scene = bj.scenes.impact("memory_free", smoothing=False)
    params = scene.parameters({**AT, "damping": 0.3})
    duration = float(undamped_duration(1e10, 1.5, 0.02, 1.5))
    found = bj.sensitivity(scene, params, np.linspace(0.0, 1.5 * duration, 4001), ("damping",), accuracy=1e-8)
    expected = 0.02 * 1.5**2 * float(jax.grad(delivered_restitution)(0.45))
    assert found.feature_derivatives["damping"]["contact.impulse"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
def test_reverse_finds_the_same_features():
    times = np.linspace(0.0, 6e-5, 201)
    wrt = ("stiffness", "mass")
    params = HERTZ.parameters(AT)
    forward = bj.sensitivity(HERTZ, params, times, wrt, certify=False)
    reverse = bj.sensitivity(HERTZ, params, times, wrt, certify=True, mode="reverse")
    once = bj.sensitivity(HERTZ, params, times, wrt, certify=False, mode="reverse")
    assert forward.certificate is None
    assert reverse.derivative == {}
    assert reverse.certificate.verdict == "trusted"
    for p in wrt:
        assert set(once.feature_derivatives[p]) == set(forward.features) - {"contact.period"}
        for name, value in once.feature_derivatives[p].items():
            size = abs(forward.features[name] / float(params[p]))
            assert value == pytest.approx(forward.feature_derivatives[p][name], rel=1e-8, abs=1e-10 * size)


@pytest.mark.slow
def test_the_same_numbers_as_force_history():
    times = np.linspace(0.0, 6e-5, 201)
    params = HERTZ.parameters(AT)
    found = bj.sensitivity(HERTZ, params, times, ("mass",), certify=False)

    def force(mass):
        return bj.force_history(HERTZ, {**params, "mass": mass}, times)["contact"]

    slope = np.asarray(jax.jit(jax.jacfwd(force))(params["mass"]))
    assert found.derivative["mass"]["contact"] == pytest.approx(slope, rel=1e-10, abs=1e-9 * np.abs(slope).max())


@pytest.mark.slow
def test_period_of_bounces_against_differences():
    scene = bj.scenes.bounce(smoothing=False)
    params = scene.parameters(stiffness=1e4, damping=0.05, drop_height=0.1)
    times = np.linspace(0.0, 1.0, 2001)
    found = bj.sensitivity(scene, params, times, ("gravity", "damping"), accuracy=1e-8, features=("contact.period",))

    def period(name, factor):
        changed = {**params, name: params[name] * factor}
        run = bj.simulate(scene, changed, times, accuracy=1e-8)
        return features.contact_interval(times, run.penetration["contact"], run.rate["contact"])

    for name in found.wrt:
        slope = (period(name, 1 + 1e-4) - period(name, 1 - 1e-4)) / (2e-4 * float(params[name]))
        assert found.feature_derivatives[name]["contact.period"] == pytest.approx(slope, rel=1e-3)


@pytest.mark.slow
def test_period_and_delay_of_what_turns():
    t, cycle, late = np.linspace(0.0, 2.0, 2001), 0.31, 0.04

    def wave(shift):
        return np.cos(2 * np.pi * (t - shift) / cycle) + 0.3 * np.cos(4 * np.pi * (t - shift) / cycle)

    def slope(shift):
        phase = 2 * np.pi * (t - shift) / cycle
        return np.sin(phase) + 0.6 * np.sin(2 * phase)

    force = np.zeros((2001, 2, 3))
    force[:, 0, 0], force[:, 1, 0] = wave(0.0), wave(late)
    change = np.zeros((2, 2001, 2, 3))
    by_cycle = [slope(s) * 2 * np.pi * (t - s) / cycle**2 for s in (0.0, late)]
    change[0, :, 0, 0], change[0, :, 1, 0] = by_cycle
    change[1, :, 1, 0] = slope(late) * 2 * np.pi / cycle
    value = Histories(force, force[..., 0], force[..., 0], None)
    derivative = Histories(change, change[..., 0], change[..., 0], None)
    contacts = {"a": 0, "b": 0}
    wanted = [feature(name, contacts) for name in ("a.period", "b.period", "a:b.delay")]
    numbers, slopes = measure(t, value, derivative, wanted, contacts, True)
    assert numbers == pytest.approx([cycle, cycle, late], rel=1e-3)
    # Windows that hold no whole number of periods cost a per cent.
    assert slopes == pytest.approx(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), abs=1.5e-2)


@pytest.mark.slow
def test_second_derivatives():
    params = HERTZ.parameters(AT)
    times = np.linspace(0.0, 1.25 * float(undamped_duration(*AT.values())), 2001)
    wrt, v = ("stiffness", "mass"), np.array([1e10, 0.02])
    found = bj.hessian_vector(HERTZ, params, times, "contact.peak", wrt, v)
    # f = c K^a m^b: H v of v = p is (a + b - 1) grad f, here with a + b = 1.
    peak = float(np.max(bj.simulate(HERTZ, params, times, accuracy=1e-8).force["contact"]))
    assert np.abs(found * v / peak).max() < 2e-3
    one = bj.hessian_vector(HERTZ, params, times, "contact.peak", ("stiffness",), [1.0])
    assert one == pytest.approx(0.4 * -0.6 * peak / 1e20, rel=2e-3, abs=0.0)
    impulse = bj.hessian_vector(HERTZ, params, times, "contact.impulse", wrt, v)
    # 2 m v.
    assert np.abs(impulse * v).max() < 1e-3 * 2.0 * AT["mass"] * AT["approach_speed"]


def test_a_contact_takes_the_shared_value():
    scene = plain_joint()
    params = scene.parameters()
    full, names = complete(scene, params, ("seat_ball.stiffness", "load_torque"))
    assert full["seat_ball.stiffness"] == params["stiffness"]
    assert names == ("seat_ball.stiffness", "load_torque")
    assert "seat_ball.stiffness" not in params
    members = scene.members
    assert members == {"seat_cage": 0, "head_cage": 0, "cage_ball": 6, "seat_ball": 6, "head_ball": 6}
    assert len(default_features(members)) == 35


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrt": ("stifness",)}, "did you mean 'stiffness'"),
        ({"wrt": ()}, "wrt: no parameter"),
        ({"wrt": ("mass", "mass")}, "named twice"),
        ({"features": ("contact.peek",)}, "did you mean 'peak'"),
        ({"features": ("contakt.peak",)}, "did you mean 'contact'"),
        ({"features": ("peak",)}, "is not <contact>.<feature>"),
        ({"features": ("contact.delay",)}, "write <first>:<second>.delay"),
        ({"mode": "foward"}, "did you mean 'forward'"),
        ({"differences": "all"}, "differences: no differences 'all'"),
        ({"average": 0.0}, "average = 0 s is out of range"),
        ({"accuracy": "god"}, "accuracy: no level 'god'"),
    ],
)
def test_errors(options, message):
    with pytest.raises(bj.InputError, match=message):
        bj.sensitivity(HERTZ, HERTZ.parameters(), [0.0, 1e-5], **{"wrt": ("mass",), **options})


def test_second_derivatives_refuse():
    joint = plain_joint()
    with pytest.raises(bj.InputError, match="no second derivatives"):
        bj.hessian_vector(joint, joint.parameters(), [0.0, 1.0], "seat_ball.peak", ("damping",), [1.0])
    with pytest.raises(bj.InputError, match=r"vector: shape \(2,\)"):
        bj.hessian_vector(HERTZ, HERTZ.parameters(), [0.0, 1.0], "contact.peak", ("mass",), [1.0, 2.0])


@pytest.mark.parametrize(
    ("elasticity", "apart", "text"),
    [
        (0.41234, 0.02, "+0.412"), (-0.41234, 0.061, "-0.41 ±6 %"), (0.41234, 0.48, "(+0.4 ±48 %)"),
        (0.41234, np.nan, "+0.412"), (np.nan, 0.02, "-"), (4.7e-6, 0.001, "0"), (0.00123456, 0.01, "+0.0012"),
        (0.00123456, 0.06, "+0.0012 ±0.0006"), (-0.00123456, 0.5, "(-0.001 ±0.0050)"),
    ],
)  # fmt: skip
def test_a_table_prints_no_number_better_than_it_is(elasticity, apart, text):
    one = Ranking(["contact.peak"], ["mass"], np.array([[elasticity]]), np.array([[apart]]), np.ones(1))
    assert ranked_rows(one)[1][2] == text


def test_what_is_not_known_does_not_lead_the_table():
    features = {"grazed.work": 1.0, "loaded.peak": 1.0, "loaded.mean": 1.0, "none.mean": 0.0}
    slopes = {"gap": {"grazed.work": 5.0, "loaded.peak": 0.1, "loaded.mean": 0.2, "none.mean": 9.0}}
    one = SimpleNamespace(
        lost=False, features={"grazed.work": 1.2, "loaded.peak": 0.01, "loaded.mean": 0.06, "none.mean": 0.0}
    )
    found = SimpleNamespace(
        features=features,
        feature_derivatives=slopes,
        wrt=("gap",),
        values={"gap": 1.0},
        certificate=SimpleNamespace(parameters={"gap": one}),
    )
    ranked = ranking(cast(Any, found))
    assert ranked.features == ["loaded.mean", "loaded.peak", "grazed.work", "none.mean"]


def test_units():
    assert derivative_unit("N", "kg") == "N/kg"
    assert derivative_unit("N", "1") == "N"
    assert derivative_unit("N", "N/m^n") == "N/(N/m^n)"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    return tmp_path


def bcfj(*arguments):
    return CliRunner().invoke(app, ["sensitivity", *map(str, arguments)])


@pytest.mark.slow
def test_command_line(here):
    done = bcfj("impact", "--wrt", "stiffness, exponent,mass", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert {p.name for p in (here / "out").iterdir()} == set(FILES)
    assert "Trusted: stiffness, exponent, mass." in done.stdout
    assert "% per %" in done.stdout
    with (here / "out/sensitivity.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["time [s]", "d(contact.normal)/d(stiffness) [N/(N/m^n)]"]
    assert rows[0][-1] == "d(contact.tangential)/d(mass) [N/kg]"
    assert len(rows) == 1002
    certificate = json.loads((here / "out/certificate.json").read_text())
    assert certificate["verdict"] == "trusted"
    assert certificate["parameters"]["stiffness"]["unit"] == "N/m^n"
    peak = certificate["features"]["contact.peak"]
    assert peak["derivatives"]["mass"] > 0
    assert certificate["features"]["contact.period"]["value"] is None
    check(here / "out/report.html")
    page = (here / "out/report.html").read_text()
    assert "exponent drives contact.peak: -" in page
    assert page.index("Trusted") < page.index("data:image/png;base64,") < page.index("<table>")
    assert bcfj("impact", "--wrt", "mass", "--out", "out").exit_code == 2


@pytest.mark.slow
def test_a_comparison_that_takes_too_long_is_left_behind(here, monkeypatch):
    """A compilation cannot be stopped: the call ends within its budget, says so, and writes what it has."""
    over, real = threading.Event(), differences.forces
    monkeypatch.setattr(differences, "forces", lambda *given: over.wait(60.0) and real(*given))
    begin = time.monotonic()
    done = bcfj("impact", "--wrt", "stiffness, exponent,mass", "--budget", 0.5, "--out", "out")
    assert done.exit_code == 0 and time.monotonic() - begin < 50.0, done.stderr
    over.set()
    said = "central differences do not check it: the budget of 0.5 s was spent, compiling included"
    assert f"Of stiffness, exponent, mass {said}." in done.stdout and said in (here / "out/report.html").read_text()
    assert {p.name for p in (here / "out").iterdir()} == set(FILES)
    certificate = json.loads((here / "out/certificate.json").read_text())
    assert certificate["verdict"] == "trusted" and certificate["direction"] is None
    for check_ in certificate["parameters"].values():
        assert check_["unchecked"] == said and len(check_["compared_with"]) == 1


@pytest.mark.slow
def test_command_line_without_a_certificate(here):
    done = bcfj("impact", "--wrt", "mass", "--features", "contact.peak", "--no-certify", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert "were not certified" in done.stdout
    content = json.loads((here / "out/certificate.json").read_text())
    assert content["verdict"] is None
    assert list(content["features"]) == ["contact.peak"]


@pytest.mark.slow
def test_command_line_refuses_and_fails(here):
    done = bcfj("impact", "--wrt", "stifness", "--out", "out")
    assert done.exit_code == 2
    assert "did you mean 'stiffness'?" in done.stderr
    assert bcfj("impact").exit_code == 2
    assert not (here / "out").exists()
    (here / "s.toml").write_text('[scene]\nkind = "impact"\n[accuracy]\nmax_steps = 5\n')
    done = bcfj("s.toml", "--wrt", "mass", "--out", "out")
    assert done.exit_code == 3, done.stderr
    assert "The simulation failed at" in done.stdout
    assert {p.name for p in (here / "out").iterdir()} == set(FILES)
