"""PEtab 2: what is written passes PEtab's own checks and comes back the same; what no scene can take is refused."""

from __future__ import annotations

import importlib.util
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import bcfj

from bcfj_jax import InputError
from bcfj_jax.io import scenefile
from calibration import problemfile
from calibration.filters import Filter
from calibration.petab import export, load
from calibration.problem import Channel, Doubt, Experiment, Free, Observation, Problem

# Not imported here: every worker of pytest collects every file.
pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.skipif(importlib.util.find_spec("petab") is None, reason="the extra petab is not installed"),
]

TIMES = np.linspace(-1e-4, 9e-4, 11)
FORCE = 1e3 * np.sin(np.pi * np.clip(TIMES, 0.0, None) / 1e-3) + 1.0 / 3.0


def experiment(name: str, **other) -> Experiment:
    values = np.where(np.arange(11) == 4, np.nan, FORCE)
    given = {"channels": (Channel("contact.normal", values, 20.0, 0.02),), "fixed": {"approach_speed": 0.7}}
    return Experiment(name, TIMES, **{**given, **other})


BASE = scenefile.load("impact")
FREE = (
    Free("stiffness", 1e8, 1e12, 4e9),
    Free("exponent", 1.0, 2.5, scale="linear"),
    Free("mass", 0.05, 0.5, each=True),
    Free("gain", 0.8, 1.25),
    Free("time_offset", -1e-4, 1e-4),
)


def problem(**other) -> Problem:
    seen = (Observation("contact.peak", 980.0, 10.0), Observation("contact.impulse", 0.6, 0.01))
    experiments = (
        experiment("run 1", features=seen, span=1e-3),
        experiment("run 2", fixed={"approach_speed": 1.1, "force_offset": 3.0}),
        experiment("run 3", hold_out=True),
    )
    given = {"params": {k: float(v) for k, v in BASE.params.items()}, "experiments": experiments, "free": FREE}
    return Problem(**{"scene": BASE.scene, "loss": "soft_l1", "accuracy": 3e-6, **given, **other})


def same(one: Problem, other: Problem) -> None:
    """The same scene, values, bounds and data; what no experiment was told it has from the scene."""
    assert other.scene == one.scene
    assert (other.loss, other.accuracy) == (one.loss, one.accuracy)
    for key in ("filter", "adequate", "tolerances", "doubts"):
        assert getattr(other, key) == getattr(one, key), key
    assert [e.tolerances for e in other.experiments] == [e.tolerances for e in one.experiments]
    assert {f.name: f for f in other.free} == {f.name: f for f in one.free}
    assert [e.name for e in other.experiments] == [e.name for e in one.experiments]
    neutral = {"gain": 1.0, "force_offset": 0.0, "time_offset": 0.0}
    for old, new in zip(one.experiments, other.experiments, strict=True):
        before, after = ({**neutral, **p.params, **e.fixed} for p, e in ((one, old), (other, new)))
        searched = {f.name for f in one.free}
        assert {k: v for k, v in after.items() if k not in searched} == pytest.approx(
            {k: v for k, v in before.items() if k not in searched}, rel=1e-14
        )
        assert (new.hold_out, new.span, new.features) == (old.hold_out, old.span, old.features)
        for was, now in zip(old.channels, new.channels, strict=True):
            kept = np.isfinite(was.values)
            np.testing.assert_array_equal(new.times, old.times[kept])
            np.testing.assert_array_equal(now.values, was.values[kept])
            assert (now.observes, now.correlation, now.instrument) == (was.observes, was.correlation, was.instrument)
            assert now.relative == pytest.approx(was.relative, rel=1e-14)
            assert now.sigma == (None if was.sigma is None else pytest.approx(was.sigma, rel=1e-14))


def test_a_problem_comes_back_the_same(tmp_path):
    same(problem(), load(export(problem(), BASE.resolved, tmp_path / "out")))


def test_a_filter_and_what_is_known_of_values_come_back(tmp_path):
    """PEtab has no place for them: the part of the file that is ours says so, and that the objective needs the filter."""
    import yaml

    told = experiment("run 1", fixed={"approach_speed": 0.7}, tolerances={"approach_speed": 0.014})
    said = {"gain": "0.5 %, k = 2", "clock": "1 us"}
    told = replace(told, channels=tuple(replace(c, instrument=said) for c in told.channels))
    more = {"filter": Filter("bessel", 3, True), "adequate": 0.02, "tolerances": {"mass": 0.01}, "loss": "linear"}
    more |= {
        "doubts": (Doubt("the mass is wrong", "the mass is right"), Doubt("two", "so", "mass", 0.1, 0.2, True)),
        "experiments": (told, experiment("run 2")),
    }
    one = problem(**more, free=(*FREE, Free("cutoff", 100.0, 1e4)))
    path = export(one, BASE.resolved, tmp_path / "out")
    same(one, load(path))
    content = yaml.safe_load(path.read_text())
    assert content["extensions"]["bcfj"]["required"] is True
    assert content["extensions"]["bcfj"]["filter"] == {"kind": "bessel", "order": 3, "zero_phase": True}
    path.write_text(path.read_text().replace("bessel", "chebyshev"))
    with pytest.raises(InputError, match="no filter 'chebyshev'"):
        load(path)


def test_bounds_of_each_record_come_back(tmp_path):
    own = tuple(experiment(n, bounds={"time_offset": (t, t + 1e-4)}) for n, t in (("a", 0.0), ("b", 3.0)))
    one = problem(experiments=own, free=(*FREE[:-1], Free("time_offset", 0.0, 3.0001)))
    other = load(export(one, BASE.resolved, tmp_path))
    same(one, other)
    assert [e.bounds for e in other.experiments] == [e.bounds for e in own]


def test_estimated_and_correlated_noise_comes_back(tmp_path):
    channel = Channel("contact.normal", FORCE, None, 0.0, None)
    estimated = problem(experiments=(experiment("a", channels=(channel,)), experiment("b")))
    same(estimated, load(export(estimated, BASE.resolved, tmp_path)))


def test_names_that_are_no_identifiers_come_back(tmp_path):
    base = scenefile.load("joint")
    channels = tuple(Channel(f"seat_ball_{k}.normal", FORCE, 5.0) for k in (1, 2))
    one = Problem(
        scene=base.scene,
        params={k: float(v) for k, v in base.params.items()},
        experiments=(Experiment("day 1: 5 kN m", TIMES, channels),),
        free=(Free("seat_ball.stiffness", 1e9, 1e12), Free("clearance_seat_cage", 1e-6, 1e-3)),
    )
    same(one, load(export(one, base.resolved, tmp_path)))


def test_petab_itself_reads_the_tables_and_finds_no_fault(tmp_path):
    """By PEtab's own classes, from the files; what is in the scene, whose language it cannot know, it is told."""
    from petab import v2
    from petab.v1.yaml import load_yaml, validate_yaml_syntax

    from calibration.petab.model import SceneModel

    # petab 0.8 calls pandas in ways that pandas 3.1 is to drop; the module's own filter would make that an error.
    warnings.simplefilter("ignore", DeprecationWarning)
    export(problem(), BASE.resolved, tmp_path)
    params = {k: float(v) for k, v in BASE.params.items()}
    outputs = ("contact.normal", "contact.peak", "contact.impulse")
    tables = v2.Problem(
        models=[SceneModel(BASE.scene, params, outputs, BASE.resolved)],
        parameter_tables=[v2.ParameterTable.from_tsv(tmp_path / "parameters.tsv")],
        observable_tables=[v2.ObservableTable.from_tsv(tmp_path / "observables.tsv")],
        condition_tables=[v2.ConditionTable.from_tsv(tmp_path / "conditions.tsv")],
        experiment_tables=[v2.ExperimentTable.from_tsv(tmp_path / "experiments.tsv")],
        measurement_tables=[v2.MeasurementTable.from_tsv(tmp_path / "measurements.tsv")],
        mapping_tables=[v2.MappingTable.from_tsv(tmp_path / "mapping.tsv")],
    )
    assert [str(issue) for issue in tables.validate()] == []
    # Ten samples of two runs and two features; of the estimated, mass, gain and clock are each run's own.
    assert len(tables.measurements) == 22
    assert sorted(tables.x_free_ids) == sorted(
        ["stiffness", "exponent", *(f"{n}__e{k}" for n in ("mass", "gain", "time_offset") for k in (1, 2))]
    )
    validate_yaml_syntax(load_yaml(tmp_path / "problem.yaml"))


def edit(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))


BAD = {
    "no file": (lambda d: (d / "measurements.tsv").unlink(), r"problem.yaml: cannot be read as PEtab 2"),
    "language": (lambda d: edit(d, "problem.yaml", "language: bcfj", "language: sbml"), "language sbml; name a scene"),
    "noise kind": (lambda d: edit(d, "observables.tsv", "\tnormal\t", "\tlaplace\t"), "laplace noise; only normal"),
    "formula": (lambda d: edit(d, "observables.tsv", "gain*model", "gain^2*model"), "gain.*; write gain \\* output"),
    "noise formula": (
        lambda d: edit(d, "observables.tsv", "noise__contact__peak", "exp(noise__contact__peak*time)"),
        r"contact__peak: the noise formula .*; write a number",
    ),
    "condition": (
        lambda d: edit(d, "conditions.tsv", "mass__e1", "mass__e1 * 2"),
        "'mass' becomes '2.*mass__e1'; give a number",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_scene_can_take_is_refused(name, tmp_path):
    change, message = BAD[name]
    export(problem(), BASE.resolved, tmp_path)
    change(tmp_path)
    with pytest.raises(InputError, match=message):
        load(tmp_path / "problem.yaml")


def test_a_scene_may_be_named_instead_of_the_file(tmp_path):
    path = export(problem(), BASE.resolved, tmp_path)
    edit(tmp_path, "problem.yaml", "language: bcfj", "language: sbml")
    same(problem(), load(path, "impact"))


def test_the_command_writes_what_the_problem_file_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pulse = 1e3 * np.sin(np.pi * np.arange(10) / 9)
    rows = "".join(f"{1e3 * t:.6f},{f:.6f}\n" for t, f in zip(TIMES[1:], pulse, strict=True))
    Path("d.csv").write_text("time [ms],force [N]\n" + rows)
    Path("p.toml").write_text(
        'scene = "impact"\n[[experiment]]\nfile = "d.csv"\ntime = "time"\nobserve = { "contact.normal" = "force" }\n'
        'noise = "2 %"\n[free.stiffness]\nlower = 1e8\nupper = 1e12\n[free.force_offset]\nlower = -1\nupper = 1\n'
    )
    done = bcfj("calibrate", "p.toml", "--export-petab", "out")
    assert (done.exit_code, done.stdout.strip()) == (0, "out/problem.yaml")
    same(problemfile.load("p.toml"), load("out/problem.yaml"))


def test_without_petab_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "petab.v2", None)
    one = replace(problem(), experiments=problem().experiments[:1])
    with pytest.raises(InputError, match=r'needs petab, which is not installed; pip install "bcfj-jax\[petab\]"'):
        export(one, BASE.resolved, tmp_path / "out")
    assert not (tmp_path / "out").exists()
