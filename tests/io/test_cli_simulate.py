"""The command line: simulate and init, their files, messages and exit codes."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import platformdirs
import pytest
from commands import bcfj
from conftest import BUILD
from pages import check

from bcfj_jax.analysis.simulation import pictures, results
from bcfj_jax.analysis.simulation.results import accuracy_sentences
from bcfj_jax.io.scenefile import load
from bcfj_jax.solve.measured_error import Accuracy
from bcfj_jax.solve.simulation import Run
from bcfj_jax.xla import programs
from bcfj_jax.xla.compile_cache import open_cache

pytestmark = pytest.mark.filterwarnings("error")

EXAMPLES = Path(__file__).parents[2] / "examples"
IMPACT = '[scene]\nkind = "impact"\n'
# Of a scene with contacts and without [[read]].
FILES = {*results.FILES, *results.PICTURES}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Each test in its own folder, with the tests' compile cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    return tmp_path


def rows_of(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


@pytest.mark.parametrize(
    ("name", "peak", "end"),
    [("chung_ooi_test1", 10.6969e3, 40.339e-6), ("chung_ooi_test2", 11.3699e3, 731.66e-6)],
)
def test_chung_ooi(name, peak, end, here):
    done = bcfj("simulate", EXAMPLES / f"{name}.toml", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert {p.name for p in (here / "out").iterdir()} == FILES
    summary = json.loads((here / "out/summary.json").read_text())
    contact = summary["contacts"]["contact"]
    assert summary["status"] == "ok"
    assert contact["peak"] == pytest.approx(peak, rel=1e-3)
    assert contact["contact_end"] == pytest.approx(end, rel=1e-3)
    assert contact["contact_start"] == 0.0
    assert contact["period"] is None
    assert summary["solver"]["accepted"] > 0
    assert f"Finished. Highest force {peak / 1e3:.3g} kN, in contact" in done.stdout
    assert f"peak              {peak / 1e3:.3g} kN" in done.stdout
    assert "simulating" in done.stderr
    assert "simulating" not in done.stdout

    rows = rows_of(here / "out/forces.csv")
    assert rows[0] == ["time [s]", "contact.normal [N]", "contact.axial [N]", "contact.tangential [N]"]
    assert len(rows) == 2002
    assert max(float(row[1]) for row in rows[1:]) == contact["peak_of_samples"]
    assert contact["peak"] == pytest.approx(contact["peak_of_samples"], rel=1e-4)

    check(here / "out/report.html")
    page = (here / "out/report.html").read_text()
    assert page.index("Highest force") < page.index("data:image/png;base64,") < page.index("<table>")
    assert "http" not in page
    environment = json.loads((here / "out/environment.json").read_text())
    assert list(environment["data"]) == [str(EXAMPLES / f"{name}.toml")]
    assert environment["device"]["backend"] == "cpu"
    assert load(here / "out/run.toml").resolved == load(EXAMPLES / f"{name}.toml").resolved


def test_the_force_error_is_measured_and_reported(here):
    done = bcfj("simulate", "impact", "--out", "out")
    accuracy = json.loads((here / "out/summary.json").read_text())["accuracy"]
    assert accuracy["asked"] == 0.01 and accuracy["agree_until"] is None
    errors = accuracy["measured"]["contact"]
    assert set(errors) == {"rms", "peak", "impulse"} and all(0.0 < error < 0.01 for error in errors.values())
    assert f"contact: asked 1 %, measured {100 * max(errors.values()):.2g} %\n" in done.stdout
    assert "Measured force error" in (here / "out/report.html").read_text()
    assert "asked" not in bcfj("simulate", "impact", "--no-measure-error", "--out", "without").stdout
    assert "accuracy" not in json.loads((here / "without/summary.json").read_text())


def test_runs_that_do_not_agree_are_reported():
    found = Accuracy(0.01, 5e-6, 0.0, {"pin": 0.003}, {"pin": 0.25}, {"pin": 0.02}, 0.41, "pin", 1.0)
    blank = np.zeros((2, 3))
    run = Run(np.zeros(2), {"pin": blank}, {}, {}, {}, "ok", "", float("nan"), {}, accuracy=found)
    first, second = accuracy_sentences(run)
    assert first == "pin: asked 1 %, measured 25 %"
    assert "agree until 410 ms" in second and "more than 10 times the error asked for" in second
    lost = found._replace(rms={"pin": float("nan")}, agree_until=float("nan"))
    assert accuracy_sentences(run._replace(accuracy=lost)) == ["pin: asked 1 %, measured unknown"]
    assert accuracy_sentences(run._replace(accuracy=None)) == []


def test_default_folders_are_numbered(here):
    assert bcfj("simulate", "impact").exit_code == 0
    assert bcfj("simulate", "impact").exit_code == 0
    assert sorted(p.name for p in (here / "results").iterdir()) == ["simulate-impact", "simulate-impact-2"]


def test_existing_results_are_refused(here):
    (here / "out").mkdir()
    (here / "out/forces.csv").write_text("mine")
    done = bcfj("simulate", "impact", "--out", "out")
    assert done.exit_code == 2
    assert "--out out: already holds forces.csv; name another folder" in done.stderr
    assert [p.name for p in (here / "out").iterdir()] == ["forces.csv"]
    assert (here / "out/forces.csv").read_text() == "mine"
    done = bcfj("simulate", "impact", "--out", "out/forces.csv")
    assert done.exit_code == 2
    assert "not a folder" in done.stderr


def test_failed_simulation_says_why_and_still_writes(here):
    (here / "s.toml").write_text(IMPACT + "[accuracy]\nmax_steps = 5\n")
    done = bcfj("simulate", "s.toml", "--out", "out")
    assert done.exit_code == 3
    assert "error: The simulation failed at" in done.stderr
    assert "budget of 5 steps" in done.stderr
    summary = json.loads((here / "out/summary.json").read_text())
    assert summary["status"] == "failed"
    assert "5 steps" in summary["reason"]
    assert 0 < summary["failure_time"] < 77e-6
    assert summary["contacts"]["contact"]["peak"] is None
    rows = rows_of(here / "out/forces.csv")
    assert rows[-1][1] == ""
    assert float(rows[2][1]) > 0
    check(here / "out/report.html")
    assert "Failed." in (here / "out/report.html").read_text()
    assert {p.name for p in (here / "out").iterdir()} == FILES


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (None, ["there is no such file"]),
        (IMPACT + "[parameters]\nstifness = 1\n", ["[parameters] stifness", "did you mean 'stiffness'?"]),
        (IMPACT + 'lawn = "hertz"\n', ["[scene] lawn", "did you mean 'law'?"]),
        (IMPACT + '[parameters]\nmass = "3 m"\n', ["[parameters] mass", "'3 m'", '"16.7 g"']),
        (IMPACT + "[parameters]\nmass = -1\n", ["[parameters] mass", "-1 kg", "must be > 0"]),
        (IMPACT + '[accuracy]\nlevel = "fast"\nforce_error = 0.01\n', ["[accuracy]", "give exactly one"]),
        (IMPACT + "law = hertz\n", ["line 3", "not TOML"]),
        (IMPACT + '[parameters]\nstiffness = "1e5 N/mm"\n', ["[parameters] stiffness", "exponent is 1.5"]),
        (
            IMPACT + "[scene.spheres]\nradius=[1,1]\nyoungs_modulus=[1,1]\npoisson=[0,0]\ndensity=[1,1]\n"
            "[parameters]\nstiffness = 1\n",
            ["[parameters] stiffness", "given twice"],
        ),
    ],
    ids=["missing", "parameter", "key", "dimension", "range", "both", "syntax", "trap", "twice"],
)
def test_bad_input_exits_2_and_writes_nothing(text, parts, here):
    if text is not None:
        (here / "s.toml").write_text(text)
    before = sorted(here.iterdir())
    for out in ([], ["--out", "out"]):
        done = bcfj("simulate", "s.toml", *out)
        assert done.exit_code == 2
        assert done.stdout == ""
        for part in ["error: s.toml", *parts]:
            assert part in done.stderr
        assert sorted(here.iterdir()) == before


@pytest.mark.slow
def test_unresolved_contacts_are_warned_of(here):
    Path("coarse.toml").write_text('[scene]\nkind = "bounce"\n[time]\nsamples = 1001\n')
    done = bcfj("simulate", "coarse.toml", "--out", "out")
    assert done.exit_code == 0
    assert "warning: contact: the shortest contact has only 1 sample," in done.stderr
    assert "raise [time] samples" in json.loads((here / "out/summary.json").read_text())["warnings"][0]


def test_init_writes_a_file_that_runs_and_never_overwrites(here):
    assert bcfj("init", "impact").exit_code == 0
    assert load("impact.toml").resolved == load("impact").resolved
    done = bcfj("init", "impact")
    assert done.exit_code == 2
    assert "already holds impact.toml" in done.stderr
    assert bcfj("init", "bounce", "--out", "deep/er").exit_code == 0
    assert load("deep/er/bounce.toml").resolved == load("bounce").resolved
    # What ends as the file does is the file.
    assert bcfj("init", "bounce", "--out", "mine.toml").exit_code == 0
    assert load("mine.toml").resolved == load("bounce").resolved
    done = bcfj("init", "impakt")
    assert done.exit_code == 2
    assert "did you mean 'impact'?" in done.stderr


def test_unknown_verbs_and_options_exit_2():
    assert bcfj("simulat", "impact").exit_code == 2
    assert bcfj("simulate", "impact", "--ouch", "x").exit_code == 2
    assert bcfj("simulate").exit_code == 2


def test_an_interrupt_leaves_nothing_and_says_so(monkeypatch, here):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(pictures, "forces", interrupted)
    done = bcfj("simulate", "impact", "--out", "out")
    assert done.exit_code == 130 and "nothing was kept" in done.stderr
    assert not list(here.iterdir())


def test_members_of_a_contact_are_numbered():
    from bcfj_jax.io.outputs import channels

    assert list(channels({"seat_ball": np.zeros((4, 6, 3))}, 1)) == [f"seat_ball_{k}" for k in range(1, 7)]
    assert list(channels({"contact": np.zeros((3, 3))}, 1)) == ["contact"]
    assert channels({"seat_ball": np.zeros((4, 3))})["seat_ball_3"].shape == (4,)


@pytest.mark.parametrize("variable", [None, "off", "mine"])
def test_compile_cache_is_per_user_unless_set(variable, here, monkeypatch):
    kept = {}
    monkeypatch.setattr(programs.Settings, "folder", None)
    monkeypatch.setattr(jax.config, "update", kept.__setitem__)
    monkeypatch.setenv("XDG_CACHE_HOME", str(here / "cache"))
    monkeypatch.delenv("BCFJ_CACHE") if variable is None else monkeypatch.setenv("BCFJ_CACHE", variable)
    with monkeypatch.context() as patch:
        patch.setattr(type(jax.config), "jax_compilation_cache_dir", None)
        open_cache()
    wanted = {None: platformdirs.user_cache_dir("bcfj-jax"), "off": None, "mine": "mine"}[variable]
    found = kept.get("jax_compilation_cache_dir")
    assert found is None if wanted is None else Path(found).parents[1] == Path(wanted)


@pytest.mark.slow
def test_as_a_process(here):
    root = str(Path(__file__).parents[2])
    command = [sys.executable, "-W", "error", "-m", "bcfj_jax"]
    # JAX has set its own level of messages in this process, which a user's has not.
    environment = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"} | {"PYTHONPATH": root}
    helped = subprocess.run([*command, "--help"], capture_output=True, text=True, env=environment, check=True)
    assert "BCFJ_CACHE" in helped.stdout
    done = subprocess.run(
        [*command, "simulate", "impact", "--out", "out"], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    # XLA's own lines, "E1123 16:22:24.473471 340 cpu_aot_loader.cc:195] ...", are not for users.
    assert ".cc:" not in done.stderr and "Target machine feature" not in done.stderr
    assert "1.71 kN" in done.stdout
    assert {p.name for p in (here / "out").iterdir()} == FILES
