"""Folders of results: one process each, tried before the run, and as they were where a run came to nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bcfj_jax import InputError
from bcfj_jax.io import folder as folders
from bcfj_jax.io.folder import LOCK, Claim, inside, open_folder, session
from bcfj_jax.io.guard import guarded
from bcfj_jax.io.outputs import create, write_text, write_toml

FILES = ("a.csv", "b.json")
# A process that holds a folder until it is allowed to end.
HOLDER = """
import sys
import tomllib
from pathlib import Path
from bcfj_jax.io.folder import Claim, open_folder, session
with session():
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    found = open_folder(out, "x", Claim("simulate", ("a.csv", "b.json")))
    (found / "a.csv").write_text("half")
    print(found, flush=True)
    sys.stdin.read()
"""


def holder(*arguments):
    environment = {**os.environ, "PYTHONPATH": str(Path(folders.__file__).parents[2])}
    command = [sys.executable, "-c", HOLDER, *map(str, arguments)]
    return subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )


def run(out, text="whole", goes_on="", fail=None):
    with session():
        found = open_folder(out, "x", Claim("simulate", FILES, goes_on=goes_on))
        for name in FILES:
            write_text(found / name, text)
        if fail:
            raise fail
    return found


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(folders, "WAIT_S", 0.1)


def test_a_folder_belongs_to_one_process(tmp_path):
    out = tmp_path / "out"
    first = holder(out)
    assert first.stdout.readline().strip() == str(out)
    with session(), pytest.raises(InputError, match=r"another process writes there \(bcfj simulate\)"):
        open_folder(out, "x", Claim("simulate", FILES, wait_s=0.1))
    assert (out / "a.csv").read_text() == "half"
    first.communicate("")
    assert sorted(p.name for p in out.iterdir()) == ["a.csv"]
    with pytest.raises(InputError, match=r"already holds a.csv"):
        run(out)


def test_default_folders_that_are_asked_for_at_once_are_several():
    team = [holder() for _ in range(3)]
    found = {one.stdout.readline().strip() for one in team}
    assert len(found) == 3
    for one in team:
        one.communicate("")
    assert {str(p) for p in Path("results").iterdir()} == found


def test_what_a_killed_run_left_is_no_result(tmp_path):
    out = tmp_path / "out"
    first = holder(out)
    first.stdout.readline()
    first.kill()
    first.communicate()
    (out / ".a.csv.rest").write_text("half")
    (out / "notes.txt").write_text("mine")
    run(out)
    assert sorted(p.name for p in out.iterdir()) == [*FILES, "notes.txt"]
    assert (out / "a.csv").read_text() == "whole"


@pytest.mark.parametrize("said", ["", "{", "[]", '{"files": 3}', "[" * 900, '{"files": ["../keep", "a.csv", 3, null]}'])
def test_a_damaged_lock_file_costs_nothing(tmp_path, said):
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "keep").write_text("mine")
    (out / LOCK).write_text(said)
    run(out)
    assert (tmp_path / "keep").exists()
    assert sorted(p.name for p in out.iterdir()) == [*FILES]


@pytest.mark.parametrize("fail", [KeyboardInterrupt(), InputError("a", "b", "c"), OSError(28, "No space left", "x")])
def test_a_run_that_fails_leaves_what_was_there(tmp_path, fail):
    (tmp_path / "mine.txt").write_text("mine")
    for out in (tmp_path / "deep" / "er" / "out", tmp_path):
        with pytest.raises(type(fail)):
            run(out, fail=fail)
        assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_kept_work_stays(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "journal").write_text("pieces")
    said = []
    for fail, code in ((KeyboardInterrupt(), 5), (OSError(28, "No space left on device", "x"), 5)):
        assert guarded(lambda fail=fail: run(out, goes_on="journal", fail=fail), said.append) == code
        assert sorted(p.name for p in out.iterdir()) == [*FILES, "journal"]
    assert "x: No space left on device; free some space" in "\n".join(said)


@pytest.mark.parametrize(
    ("fail", "code", "says"),
    [
        (KeyboardInterrupt(), 130, "nothing was kept"),
        (MemoryError(), 2, "not enough memory"),
        (RecursionError(), 2, "nested too deeply"),
        (OSError(5, "Input/output error", "x"), 2, "x: Input/output error"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes"), 2, "not enough memory"),
    ],
)
def test_what_the_system_refuses_is_a_sentence(tmp_path, fail, code, says):
    said = []
    assert guarded(lambda: run(tmp_path / "out", fail=fail), said.append) == code
    assert says in said[0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("out", ["file/out", "x" * 300, "file", "nul\0"])
def test_what_cannot_be_a_folder_is_refused_before_the_run(tmp_path, out):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written|not a folder") as refused:
        run(tmp_path / out)
    assert refused.value.remedy
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_disk_without_room_is_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(folders.shutil, "disk_usage", lambda _: type("", (), {"free": 1000}))
    with pytest.raises(InputError, match=r"0.001 MB are free, and the results need about 1 MB"):
        run(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_is_created_once(tmp_path):
    create(tmp_path / "new" / "a.toml", "first")
    with pytest.raises(InputError, match=r"already holds a.toml"):
        create(tmp_path / "new" / "a.toml", "second")
    assert (tmp_path / "new" / "a.toml").read_text() == "first"
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.toml"]


@pytest.mark.parametrize(
    "name", ["../x", "/x", "a/../../x", "", "a//b", "C:\\x", "a\\b", "x\0", "a\nb", ".", "x" * 300, "a/./b"]
)
def test_names_do_not_leave_their_folder(tmp_path, name):
    with pytest.raises(InputError, match="may leave its folder"):
        inside(tmp_path, name, "a worker")
    assert inside(tmp_path, "a/b.parquet", "a worker") == tmp_path / "a" / "b.parquet"


def test_the_lock_names_what_will_be_written(tmp_path):
    with session():
        open_folder(tmp_path, "x", Claim("simulate", FILES))
        assert json.loads((tmp_path / LOCK).read_text()) == {"verb": "bcfj simulate", "files": list(FILES)}
    assert not (tmp_path / LOCK).exists()


@pytest.mark.parametrize("name", ["a\x01b", "a\nb", "a\x85b\u2028c", "\udce4"])
def test_a_comment_of_any_characters_can_be_read_back(tmp_path, name):
    write_toml(tmp_path / "a.toml", {"key": 1, "name": name.encode(errors="replace").decode()}, f"what {name} was")
    assert tomllib.loads((tmp_path / "a.toml").read_text())["key"] == 1


def test_messages_hold_no_control_characters(tmp_path):
    said = []
    fail = InputError("a\x1b[31m\0", "b", "c\nd")
    assert guarded(lambda: run(tmp_path / "out", fail=fail), said.append) == 2
    assert said == ["error: a\\x1b[31m\\x00: b; c\nd"]


def test_an_interruption_after_a_stage_leaves_it_and_says_so(tmp_path):
    def staged(fail):
        with session():
            found = open_folder(tmp_path / "out", "x", Claim("simulate", FILES))
            write_text(found / FILES[0], "half")
            folders.stays(found, "not checked yet")
            if fail:
                raise fail
        return 0

    said = []
    assert guarded(lambda: staged(KeyboardInterrupt()), said.append) == 130
    assert said == [f"interrupted; what there was stays in {tmp_path / 'out'} (stage: not checked yet): start again"]
    assert (tmp_path / "out" / FILES[0]).read_text() == "half"
    # The next run begins anew there; what fails otherwise leaves nothing.
    run(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [*FILES]
    for name in FILES:
        (tmp_path / "out" / name).unlink()
    assert guarded(lambda: staged(MemoryError()), said.append) == 2 and not list((tmp_path / "out").iterdir())
