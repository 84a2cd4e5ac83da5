"""The trade of speed and accuracy: its errors against SciPy, its advice run again, cut off and gone on with."""

from __future__ import annotations

import csv
import json
import math
import threading
import time
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BUILD
from pages import check
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

import bcfj_jax as bj
from bcfj_jax.analysis.tradeoff import advice, command, reference, study
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.cli import app
from bcfj_jax.io.scenefile import from_table, load

FIRST = [
    "setting", "force_rms_error", "peak_error", "impulse_error", "derivative_error", "wall_s", "compile_s", "status",
    "pareto",
]  # fmt: skip
K, N, A, M = 1e7, 1.5, 0.111, 0.016731
# Drop height or speed, end, samples.
SCENES = {"impact": (0.0, 1.5, 1.2e-3, 1001), "bounce": (0.02, 0.0, 0.2, 10001)}
TEXT = """
[scene]
kind = "{kind}"
[parameters]
stiffness = 1e7
{more}
[time]
end = {end}
samples = {samples}
"""


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """Scene files of a soft impact and of some bounces."""
    folder = tmp_path_factory.mktemp("tradeoff")
    for kind, (height, _, end, samples) in SCENES.items():
        more = f"drop_height = {height}" if height else ""
        (folder / f"{kind}.toml").write_text(TEXT.format(kind=kind, more=more, end=end, samples=samples))
    return folder


def bcfj(*arguments):
    environment = {"BCFJ_CACHE": str(BUILD / "jax-cache")}
    return CliRunner().invoke(app, ["tradeoff", *map(str, arguments)], env=environment)


@pytest.fixture(scope="module", params=["impact", pytest.param("bounce", marks=pytest.mark.slow)])
def done(request, base):
    """A finished study by two solvers, without derivatives."""
    out = base / f"out-{request.param}"
    file = base / f"{request.param}.toml"
    found = bcfj(file, "--only", "tsit5,bosh3,output", "--no-derivatives", "--out", out)
    assert found.exit_code == 0, found.stderr
    with (out / "tradeoff.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    content = json.loads((out / "tradeoff.json").read_text())
    return SimpleNamespace(kind=request.param, out=out, file=file, rows=rows, json=content, stdout=found.stdout)


def number(row, name):
    return float(row[name] or "nan")


def by_scipy(kind):
    """Times and force by DOP853, contact by contact, flights in closed form."""
    height, speed, end, samples = SCENES[kind]
    times = np.linspace(0.0, end, samples)
    gravity = 9.81 if height else 0.0
    force = np.zeros_like(times)

    def push(d, rate):
        return K * np.maximum(d, 0.0) ** N * np.maximum(1.0 + A * rate, 0.0)

    def parted(_, y):
        return y[0]

    parted.terminal, parted.direction = True, -1
    now, speed = (math.sqrt(2.0 * height / gravity), math.sqrt(2.0 * gravity * height)) if height else (0.0, speed)
    while now < end:
        run = solve_ivp(
            lambda _, y: (y[1], gravity - push(*y) / M), (0.0, 1.0), (1e-20, speed), "DOP853", rtol=1e-12,
            atol=(1e-18, 1e-14), events=parted, dense_output=True,
        )  # fmt: skip
        inside = (times >= now) & (times <= now + run.t[-1])
        force[inside] = push(*run.sol(times[inside] - now))
        speed = -run.y[1, -1]
        now += run.t[-1] + (2.0 * speed / gravity if gravity else math.inf)
    return times, force


def off(table, times, force):
    """rms, peak and impulse error of a scene file's run, as a user would take them."""
    given = from_table(table, None)
    spent = {"accuracy": given.accuracy, "max_steps": given.max_steps, "solver": given.solver}
    run = bj.simulate(given.scene, given.params, given.times, **spent)
    found = run.force["contact"][:, 0]
    peak, push = force.max(), np.trapezoid(force, times)
    return (
        np.sqrt(np.mean((found - force) ** 2)) / peak,
        abs(found.max() - peak) / peak,
        abs(np.trapezoid(found - force, times)) / push,
    )


@pytest.mark.slow
def test_files_and_columns(done):
    assert {path.name for path in done.out.iterdir()} == {*command.FILES, "journal.jsonl", "reference.npz"}
    assert list(done.rows[0])[: len(FIRST)] == FIRST
    assert done.rows[0]["setting"] == "as given"
    assert {row["status"] for row in done.rows} == {"ok"}
    assert {row["precision"] for row in done.rows} == {"float64"}
    assert set(done.json["recommended"]) == {"10 %", "5 %", "2 %", "1 %", "0.5 %", "0.1 %"}
    check(done.out / "report.html")
    page = (done.out / "report.html").read_text()
    assert page.index("a run") < page.index("data:image/png;base64,") < page.index("<table>")
    assert "Recommended settings" in done.stdout


def test_claimed_errors_are_those_against_scipy(done):
    times, force = by_scipy(done.kind)
    claimed = {row["setting"]: row for row in done.json["settings"]}
    own = done.json["reference"]["errors"]
    # DOP853's own error, by the force that a rounded penetration has.
    slack = 1e-8
    for setting in settings(load(done.file), ("tsit5", "bosh3"), False):
        if setting.name == "as given" or setting.error in (0.2, 0.05, 1e-2, 1e-3, 1e-4):
            found = off(setting.table, times, force)
            for name, value in zip(advice.MAIN, found, strict=True):
                allowed = 0.2 * value + own[name] + slack
                assert claimed[setting.name][name] == pytest.approx(value, rel=0, abs=allowed), (setting.name, name)


def test_a_pasted_block_keeps_its_budget(done):
    times, force = by_scipy(done.kind)
    user = tomllib.loads(done.file.read_text())
    for budget, one in done.json["recommended"].items():
        limit = float(budget.removesuffix(" %")) / 100
        # What asks for less than the budget is right here by luck.
        chosen = next(row for row in done.json["settings"] if row["setting"] == one["setting"])
        assert chosen["force_error"] <= limit
        whole = tomllib.loads(one["toml"])
        pasted = {**user, **{k: {**user.get(k, {}), **v} for k, v in tomllib.loads(one["change"]).items()}}
        assert max(off(whole, times, force)) <= limit
        assert off(pasted, times, force) == off(whole, times, force)
        assert one["physics"] == "the model is the given one"


def test_front_and_compilation(done):
    place = [(number(row, "wall_s"), max(number(row, name) for name in advice.MAIN)) for row in done.rows]
    least_error = 3.0 * max(done.json["reference"]["errors"][name] for name in advice.MAIN)
    place = [(wall, max(error, least_error)) for wall, error in place]
    for row, p in zip(done.rows, place, strict=True):
        beaten = any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in place)
        assert row["pareto"] == str(not beaten)
    # Tolerances are traced: a solver's program is compiled once, for the first level or the reference before it.
    for solver in ("tsit5", "bosh3"):
        levels = [row for row in done.rows if row["setting"].startswith(solver)]
        assert [number(row, "compile_s") > 0 for row in levels[1:]] == [False] * (len(levels) - 1)


@pytest.mark.full
def test_it_goes_on_where_it_was_cut_off(base, monkeypatch):
    out, ran = base / "cut", []
    real = study.trial

    def few(given):
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(given.accuracy)
        return real(given)

    arguments = (base / "impact.toml", "--only", "tsit5", "--no-derivatives", "--out", out)
    monkeypatch.setattr(study, "trial", few)
    found = bcfj(*arguments)
    assert found.exit_code == 5
    kept = json.loads((out / "tradeoff.json").read_text())
    assert kept["status"] == "interrupted"
    assert [row["status"] for row in kept["settings"]][:3] == ["ok", "ok", "not run: interrupted"]
    # No time: nothing more is run, and it says so.
    monkeypatch.setattr(study, "trial", real)
    monkeypatch.setattr(study, "reference", None)
    found = bcfj(*arguments, "--budget", 0)
    assert found.exit_code == 0
    again = json.loads((out / "tradeoff.json").read_text())
    assert again["settings"][:2] == kept["settings"][:2]
    assert {row["status"] for row in again["settings"][2:]} == {"not run: budget"}
    found = bcfj(*arguments)
    assert found.exit_code == 0
    last = json.loads((out / "tradeoff.json").read_text())
    assert {row["status"] for row in last["settings"]} == {"ok"}
    assert last["settings"][1]["wall_s"] == kept["settings"][1]["wall_s"]
    assert last["reference"] == kept["reference"]
    # Another scene has no business there.
    assert bcfj("impact", "--out", out).exit_code == 2


@pytest.mark.parametrize(
    "late", [pytest.param("reference", marks=pytest.mark.full), pytest.param("study", marks=pytest.mark.slow)]
)
def test_a_stage_that_takes_too_long_is_left_behind(base, monkeypatch, late):
    """Whatever cannot be stopped: the call ends within its budget, with a table that says what was left out."""
    out, over, module = base / f"late-{late}", threading.Event(), {"reference": reference, "study": study}[late]
    real = module.trial

    def slow(given, **more):
        return real(given, **more) if late == "study" and given.accuracy == 0.2 else over.wait(120.0)

    arguments, only = (base / "impact.toml", "--out", out), ("--only", "tsit5")
    if late == "study":
        # The reference and the programs are there; time goes to the settings.
        assert bcfj(*arguments, *only, "--budget", 0).exit_code == 3
        assert bcfj(*arguments, "--only", "output").exit_code == 0
    monkeypatch.setattr(module, "trial", slow)
    begin = time.monotonic()
    found = bcfj(*arguments, *only, "--budget", 6)
    assert time.monotonic() - begin < 1.1 * 6
    over.set()
    rows = json.loads((out / "tradeoff.json").read_text())["settings"]
    if late == "reference":
        assert found.exit_code == 3 and {row["status"] for row in rows} == {"not run: no reference"}
        assert "tsit5 took longer than was left" in rows[0]["reason"]
        return
    assert found.exit_code == 0
    assert rows[0]["status"] == "ok" or rows[0]["status"] == "not run: budget"
    assert "not run: budget" in {row["status"] for row in rows}
    assert "took longer than was left" in next(row["reason"] for row in rows if row["status"] == "not run: budget")


@pytest.mark.slow
def test_failures_are_rows(base):
    file = base / "short.toml"
    file.write_text((base / "impact.toml").read_text() + "[accuracy]\nmax_steps = 60\n")
    found = bcfj(file, "--only", "tsit5", "--no-derivatives", "--out", base / "short")
    assert found.exit_code == 0, found.stderr
    rows = json.loads((base / "short/tradeoff.json").read_text())["settings"]
    bad = [row for row in rows if row["status"] == "failed"]
    assert bad and len(bad) < len(rows)
    for row in bad:
        assert "the step budget of 60 steps was spent" in row["reason"]
        assert row["peak_error"] is None and not row["pareto"]


def test_no_reference_no_advice(base, monkeypatch):
    def failing(given, repeated=True):
        run = SimpleNamespace(status="failed", reason="the state stopped being finite")
        return SimpleNamespace(run=run, cost={"wall_s": 0.1})

    monkeypatch.setattr(reference, "trial", failing)
    found = bcfj(base / "impact.toml", "--only", "tsit5", "--out", base / "none")
    assert found.exit_code == 3
    content = json.loads((base / "none/tradeoff.json").read_text())
    assert content["status"] == "failed"
    assert "tsit5: the state stopped being finite" in content["reasons"][0]
    assert {row["status"] for row in content["settings"]} == {"not run: no reference"}
    assert all(one["setting"] is None for one in content["recommended"].values())


def test_references_that_disagree_say_so(done):
    certificate = {**done.json["reference"], "errors": dict.fromkeys(advice.MAIN, 1e-3), "reason": "too dear"}
    doubtful = reference.Reference(SimpleNamespace(force=np.ones(2)), None, certificate)
    assert "differ by 1.0e-03: budgets below 0.6 % cannot be tested: too dear" in advice.doubts(doubtful)[0]
    todo = settings(load(done.file), ("tsit5", "bosh3", "output"), False)
    found = advice.recommended(study.Study(todo, done.json["settings"], doubtful, False))
    assert [bool(one["setting"]) for one in found.values()] == [True, True, True, True, False, False]
    assert "certain to 3.0e-03 only" in found["0.1 %"]["reason"]


def test_a_reference_without_contact_says_so(done):
    """Every error is 0 then; derivatives that were not asked for are no doubt."""
    left_out = {**done.json["reference"]["derivatives"], "reason": reference.NOT_ASKED}
    certificate = {**done.json["reference"], "derivatives": left_out}
    apart = reference.Reference(SimpleNamespace(force=np.zeros(2)), None, certificate)
    (said,) = advice.doubts(apart)
    assert "no contact touches" in said


@pytest.mark.slow
def test_derivative_errors_against_differences(base):
    out = base / "slopes"
    found = bcfj(base / "impact.toml", "--only", "tsit5", "--out", out)
    assert found.exit_code == 0, found.stderr
    content = json.loads((out / "tradeoff.json").read_text())
    rows = [row for row in content["settings"] if row["derivative_error"] is not None]
    assert len(rows) >= 6 and all(row["derivative_wall_s"] > 0 for row in rows)
    assert content["reference"]["derivatives"]["parameters"] == ["stiffness", "damping", "approach_speed"]
    assert content["reference"]["derivatives"]["error"] < 1e-6
    with np.load(out / "reference.npz") as kept:
        slopes = kept["slopes"]
    given, step = load(base / "impact.toml"), 1e-4
    for name, slope in zip(content["reference"]["derivatives"]["parameters"], slopes, strict=True):
        ends = [
            bj.simulate(given.scene, {**given.params, name: given.params[name] * f}, given.times, accuracy=1e-9)
            for f in (1 + step, 1 - step)
        ]
        central = (ends[0].force["contact"] - ends[1].force["contact"]) / (2 * step)
        # Where the contact ends the slope jumps: a sample at which only one of the runs touches tells no slope.
        both = (ends[0].penetration["contact"] > 0) == (ends[1].penetration["contact"] > 0)
        assert np.count_nonzero(~both) <= 2
        assert slope[both, 0] == pytest.approx(central[both], rel=0, abs=1e-4 * np.abs(central).max())


@pytest.mark.slow
def test_a_joint_over_a_short_time(base):
    (base / "joint.toml").write_text('[scene]\nkind = "joint"\n[time]\nend = "20 ms"\nsamples = 41\n')
    out = base / "joint"
    found = bcfj(base / "joint.toml", "--only", "rodas3,fidelity", "--no-derivatives", "--out", out)
    assert found.exit_code == 0, found.stderr
    content = json.loads((out / "tradeoff.json").read_text())
    assert [method["solver"] for method in content["reference"]["methods"]] == ["bdf", "rodas3"]
    assert max(content["reference"]["errors"][name] for name in advice.MAIN) < 1e-4
    rows = {row["setting"]: row for row in content["settings"]}
    # No inertia, no friction: far off while the load comes up, and that is what it says.
    assert rows["quasistatic"]["force_rms_error"] > 0.02
    assert rows["rodas3 at 0.01 %"]["force_rms_error"] < 1e-3
    best = content["recommended"]["1 %"]
    assert best["setting"].startswith(("rodas3", "as given"))
    assert max(best["errors"].values()) < 0.01
