"""Programs kept between processes: the same results, nothing traced again, and never one that is damaged or foreign."""

from __future__ import annotations

import errno
import functools
import hashlib
import json
import os
import re
import subprocess
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
import pytest
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax.analysis.engine import simulated
from bcfj_jax.analysis.simulation import results
from bcfj_jax.io.scenefile import load, quickest
from bcfj_jax.solve.measured_error import Accuracy
from bcfj_jax.xla import compile_cache, programs

TIMES = np.linspace(0.0, 5e-5, 50)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Programs kept in a folder of the test's own, and none in this process yet."""
    monkeypatch.setattr(programs.Settings, "folder", tmp_path)
    monkeypatch.setattr(programs, "_loaded", {})
    monkeypatch.setattr(programs, "_asked", {})
    monkeypatch.setattr(programs, "_told", set())
    for names in (programs.traced, programs.fetched):
        names.clear()
    return tmp_path


def double(factor, x):
    return {"twice": factor * x, "rest": (None, jnp.sum(x))}


def run(factor=2.0, x=(1.0, 2.0)):
    """What the program ``double`` gives, and how often it was traced and fetched."""
    traced, fetched = len(programs.traced), len(programs.fetched)
    arguments = (np.asarray(x),)
    found = programs.program("double", double, (factor,), arguments)[0](*arguments)
    return found, (len(programs.traced) - traced, len(programs.fetched) - fetched)


def test_a_program_is_traced_once_and_fetched_by_the_next_process(folder):
    first, counts = run()
    assert counts == (1, 0) and len(list(folder.iterdir())) == 1
    assert run()[1] == (0, 0)
    programs.forget()
    again, counts = run()
    assert counts == (0, 1)
    assert jax.tree.structure(first) == jax.tree.structure(again)
    assert first["twice"].tobytes() == again["twice"].tobytes() == np.array([2.0, 4.0]).tobytes()
    # Other structure and other shapes are other programs; other numbers are not.
    assert run(3.0)[1] == run(2.0, (1.0, 2.0, 3.0))[1] == (1, 0)
    assert run(2.0, (5.0, 7.0))[0]["twice"].tolist() == [10.0, 14.0]


@pytest.mark.slow
@pytest.mark.parametrize("options", [programs.QUICK, {"no_option_of_this_jaxlib": 1}])
def test_options_change_no_result_and_none_is_needed(folder, options):
    made, _ = programs.program("double", double, (2.0,), (np.ones(2),), options)
    np.testing.assert_array_equal(made(np.array([1.0, 2.0]))["twice"], [2.0, 4.0])


@pytest.mark.slow
def test_a_run_has_the_same_bits_with_and_without_kept_programs(folder, monkeypatch):
    scene = bj.scenes.oblique_impact()
    runs = [bj.simulate(scene, scene.parameters(), TIMES)]
    programs.forget()
    runs.append(bj.simulate(scene, scene.parameters(), TIMES))
    assert "simulate" in programs.traced and "simulate" in programs.fetched
    monkeypatch.setattr(programs.Settings, "folder", None)
    programs.forget()
    runs.append(bj.simulate(scene, scene.parameters(), TIMES))
    assert len({run.force["contact"].tobytes() for run in runs}) == 1
    assert runs[0].status == "ok" and runs[0].force["contact"].max() > 0


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "noise", "foreign", "newer", "lying"])
def test_a_damaged_or_foreign_file_is_made_anew(folder, damage):
    expected = run()[0]["twice"]
    run(3.0)
    ours, other = (programs._path(programs._wanted("double", double, (k,), (np.ones(2),))) for k in (2.0, 3.0))
    content = ours.read_bytes()
    head, payload = content.split(b"\n", 2)[1:]
    written = {
        "cut": content[: len(content) // 2],
        "flipped": content[:-20] + bytes([content[-20] ^ 1]) + content[-19:],
        "empty": b"",
        "noise": os.urandom(500),
        "foreign": other.read_bytes(),
        "newer": content.replace(b"program 1", b"program 2"),
        # A digest that fits a payload which is no program.
        "lying": content.split(b"\n")[0] + b"\n" + _head(head, payload[:100]) + b"\n" + payload[:100],
    }[damage]
    ours.write_bytes(written)
    programs.forget()
    found, counts = run()
    assert counts == (1, 0)
    assert found["twice"].tobytes() == expected.tobytes()
    programs.forget()
    assert run()[1] == (0, 1), "it was not written again"


def _head(head, payload):
    return json.dumps({**json.loads(head), "digest": hashlib.sha256(payload).hexdigest()}).encode()


def test_a_full_disk_is_said_once_and_changes_nothing(folder, monkeypatch, caplog):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(programs, "_write", full)
    assert run()[0]["twice"].tolist() == [2.0, 4.0]
    assert run(3.0)[0]["twice"].tolist() == [3.0, 6.0]
    assert [r.getMessage().count("No space left") for r in caplog.records] == [1]
    assert not list(folder.iterdir())


def test_old_programs_go_when_the_folder_is_full(folder):
    for age, name in enumerate(("new", "older", "oldest")):
        (folder / name).write_bytes(bytes(100))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    programs.prune(folder, 250)
    assert {p.name for p in folder.iterdir()} == {"new", "older"}


# What can be kept.


class Pair(NamedTuple):
    """Of the test's module, which is no package of ours."""

    a: float


def test_structure_that_no_text_describes_is_not_kept(folder):
    arguments = (np.ones(2),)
    for static in ((lambda x: x,), (Pair(1.0),), (object(),)):
        with pytest.raises(programs.Unkept):
            programs.describe(static)
        found = programs.program("of one's own", lambda _, x: x + 1.0, static, arguments)[0](*arguments)
        assert found.tolist() == [2.0, 2.0]
    assert not list(folder.iterdir())


def test_descriptions_tell_what_differs():
    closures = [functools.partial(double, k) for k in (1, 1.0)]
    for known in (bj.scenes.impact, bj.scenes.slider_crank):
        assert programs.describe(known()) == programs.describe(known())
    scenes = [
        bj.scenes.impact(),
        bj.scenes.impact("hertz"),
        bj.scenes.bounce(),
        plain_joint(),
        plain_joint(spin=True),
    ]
    assert len({programs.describe(scene) for scene in scenes}) == len(scenes)
    assert (
        programs.describe((1, "1", 1.0, None, True))
        == "builtins.tuple(int:1,str:'1',float:0x1.0000000000000p+0,NoneType:None,bool:True)"
    )
    # What this test defines is not of a package of ours.
    with pytest.raises(programs.Unkept):
        programs.describe(closures[0])
    assert programs.describe(Accuracy) != programs.describe(bj.InputError)


def test_questions_are_answered_without_compiling_and_kept(folder):
    x = (np.array([3.0, 4.0]),)
    assert programs.ask("norm", jnp.linalg.norm, (), x) == 5.0
    assert programs.traced == ["norm"] and not list(folder.iterdir())
    programs.keep_asked()
    programs.forget()
    assert programs.ask("norm", jnp.linalg.norm, (), x) == 5.0
    assert programs.traced == ["norm"] and programs.fetched == ["norm"]


def test_a_program_is_made_and_not_run(folder):
    ran = []

    def use():
        ran.append(programs.program("double", double, (3.0,), (np.array([1.0, 2.0]),)))

    programs.make(use)
    assert programs.traced == ["double"] and not ran
    use()
    assert programs.traced == ["double"] and len(ran) == 1
    # Who needs it meets what went wrong.
    programs.make(functools.partial(double, "no", "number"))


OF_RESULTS = {"whole", "accounts", "orbits", "scenery"}


@pytest.mark.parametrize(
    ("scene", "own"),
    [("impact", set()), ("slider_crank", {"orbits"}), pytest.param("joint", {"whole"}, marks=pytest.mark.slow)],
)
def test_results_find_their_programs_made(folder, tmp_path, scene, own):
    given = quickest(load(scene))
    results.get_ready(given)
    ready = {"accounts", "scenery"} | own
    assert set(programs.traced) & OF_RESULTS == ready
    run = simulated(given)
    begun = len(programs.traced)
    written = results.write(tmp_path, given, run, scene)
    results.draw(tmp_path, given, run, scene, written)
    assert not OF_RESULTS & set(programs.traced[begun:])


# Where they are kept.


@pytest.fixture
def settings(monkeypatch):
    """Settings that a test may change."""
    for name in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"):
        monkeypatch.setattr(jax.config, "update", lambda *_: None)
        assert hasattr(jax.config, name)
    monkeypatch.setattr(programs.Settings, "folder", None)
    monkeypatch.setattr(programs, "_told", set())


def test_the_folder_is_private_and_of_one_build(tmp_path, monkeypatch, settings):
    monkeypatch.setenv("BCFJ_CACHE", str(tmp_path / "cache"))
    before = os.umask(0)
    try:
        compile_cache.open_cache()
    finally:
        os.umask(before)
    assert programs.Settings.folder is not None
    parts = [tmp_path / "cache", programs.Settings.folder.parent, programs.Settings.folder]
    assert [p.stat().st_mode & 0o777 for p in parts] == [0o700] * 3
    assert jax.lib.__version__ in str(programs.Settings.folder)


def test_a_folder_of_another_user_is_not_used(tmp_path, monkeypatch, settings, caplog):
    monkeypatch.setenv("BCFJ_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    compile_cache.open_cache()
    compile_cache.open_cache()
    assert programs.Settings.folder is None
    assert len(caplog.records) == 1 and "belongs to another user" in caplog.text


def test_a_folder_that_others_can_write_is_not_used(tmp_path, monkeypatch, settings, caplog):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o775)
    monkeypatch.setenv("BCFJ_CACHE", str(tmp_path / "cache"))
    compile_cache.open_cache()
    compile_cache.open_cache()
    assert programs.Settings.folder is None
    assert len(caplog.records) == 1 and "can be written by other users" in caplog.text


@pytest.mark.parametrize("mask", [0o000, 0o777])
def test_a_folder_is_private_whatever_the_umask(tmp_path, monkeypatch, settings, mask):
    monkeypatch.setenv("BCFJ_CACHE", str(tmp_path / "a" / "cache"))
    before = os.umask(mask)
    try:
        compile_cache.open_cache()
    finally:
        os.umask(before)
    made = [tmp_path / "a", *(p for p in (tmp_path / "a").rglob("*") if p.is_dir())]
    assert len(made) == 5 and {p.stat().st_mode & 0o777 for p in made} == {0o700}


def test_without_a_home_nothing_is_kept(tmp_path, monkeypatch, settings, caplog):
    monkeypatch.delenv("BCFJ_CACHE")
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: "~/.cache/bcfj-jax")
    monkeypatch.chdir(tmp_path)
    compile_cache.open_cache()
    assert programs.Settings.folder is None and "no absolute path" in caplog.text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("case", ["a file", "below a file", "read-only", "off"])
def test_a_folder_that_cannot_be_used_is_said_once(case, tmp_path, monkeypatch, settings, caplog):
    (tmp_path / "file").write_text("")
    places = {
        "a file": tmp_path / "file",
        "below a file": tmp_path / "file" / "x",
        "read-only": tmp_path / "r",
        "off": "off",
    }
    monkeypatch.setenv("BCFJ_CACHE", str(places[case]))
    if case == "read-only":
        monkeypatch.setattr(os, "access", lambda *_: False)
    compile_cache.open_cache()
    compile_cache.open_cache()
    assert programs.Settings.folder is None
    assert len(caplog.records) == (0 if case == "off" else 1)
    assert case == "off" or "BCFJ_CACHE" in caplog.text


# Whole processes.

_COUNTED = """
import jax
misses = []
jax.monitoring.register_event_listener(lambda name, **_: misses.append(name) if name.endswith("cache_misses") else None)
import sys
from bcfj_jax.xla import programs
from bcfj_jax.cli import main
try:
    main()
except SystemExit as done:
    print(f"counted {programs.traced} {len(programs.fetched)} {len(misses)} {done.code}")
"""


def counted(*words, cache):
    """What a process traced, how many programs it fetched, how often XLA's cache missed, and its exit code."""
    surroundings = {**os.environ, "BCFJ_CACHE": str(cache), "EQX_ON_ERROR": "nan"}
    return subprocess.Popen(
        [sys.executable, "-c", _COUNTED, *words],
        env=surroundings,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def told(process):
    out, err = process.communicate(timeout=300)
    assert "counted" in out, err
    return out.splitlines()[-1]


def test_two_processes_at_once_and_a_third_that_traces_nothing(tmp_path):
    words = [["simulate", "impact", "--out", str(tmp_path / str(k))] for k in range(3)]
    both = [counted(*words[k], cache=tmp_path / "cache") for k in (0, 1)]
    for process in both:
        assert told(process).endswith(" 0")
    # Nothing traced, several programs fetched, nothing that XLA's cache had not.
    assert re.fullmatch(r"counted \[\] [1-9] 0 0", told(counted(*words[2], cache=tmp_path / "cache")))
    tables = {(tmp_path / str(k) / "forces.csv").read_bytes() for k in range(3)}
    assert len(tables) == 1


@pytest.mark.parametrize(
    "words", [["--help"], ["simulate", "missing.toml"], ["study", "run", "missing.toml"], ["report", "missing"]]
)
def test_help_and_a_missing_file_need_no_jax(words):
    probe = (
        "import sys\nfrom bcfj_jax.cli import main\n"
        "try:\n    main()\nexcept SystemExit as done:\n    print(done.code, 'jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", probe, *words], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == ("0 False" if words == ["--help"] else "2 False"), done.stderr
