"""A fit that is cut off goes on where it was: the journal alone, and ``bcfj calibrate`` under Ctrl-C and kill -9."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import BUILD

from bcfj_jax import InputError
from bcfj_jax.io.journal import NAME, Journal, key_of
from bcfj_jax.io.stop import check, heeded
from calibration import command
from calibration.forward.model import build
from calibration.problemfile import load
from calibration.search import starts
from calibration.search.starts import Interrupted

# A shell's background jobs, and what they start, ignore Ctrl-C; a user's do not.
COMMAND = (
    "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "runpy.run_module('bcfj_jax', run_name='__main__', alter_sys=True)"
)
EXAMPLE = Path(__file__).parents[2] / "examples" / "chung_ooi_fit.toml"


def filled(folder: Path, count: int) -> Path:
    with Journal(folder, "job") as journal:
        assert not journal.resumed
        for k in range(count):
            journal.add(f"piece {k}", {"points": [[0.1 * k, 1 / 3]], "costs": [np.inf, k / 7]})
    return folder / NAME


def test_finished_pieces_come_back_to_the_last_bit(tmp_path):
    filled(tmp_path, 3)
    with Journal(tmp_path, "job") as journal:
        assert journal.resumed
        assert len(journal) == 3
        assert journal.get("piece 2") == {"points": [[0.2, 1 / 3]], "costs": [None, 2 / 7]}
        assert journal.get("piece 3") is None
        journal.remove()
    assert not (tmp_path / NAME).exists()


@pytest.mark.parametrize("cut", [1, 2, 17, 40])
def test_torn_last_line_is_dropped_and_written_again(tmp_path, cut):
    path = filled(tmp_path, 3)
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with Journal(tmp_path, "job") as journal:
        assert len(journal) == 2
        assert journal.get("piece 2") is None
        journal.add("piece 2", {"points": [[0.2, 1 / 3]], "costs": [np.inf, 2 / 7]})
    assert path.read_bytes() == whole


def test_torn_header_begins_again(tmp_path):
    (tmp_path / NAME).write_bytes(b'{"key": "jo')
    with Journal(tmp_path, "job") as journal:
        assert not journal.resumed
        journal.add("piece 0", {})
    with Journal(tmp_path, "job") as journal:
        assert len(journal) == 1


def damaged(line: bytes) -> dict[str, bytes]:
    """A line of a journal in which something is wrong."""
    piece = json.loads(line)
    return {
        "altered number": line.replace(b"0.1", b"0.7", 1),
        "altered name": line.replace(b"piece 1", b"piece 7"),
        "other keys": json.dumps({"points": 1}).encode() + b"\n",
        "a list": b"[1, 2]\n",
        "no text": b"\xff\x00\n",
        "deep": b"[" * 5000 + b"\n",
        "deep result": b'{"name": "piece 1", "result": ' + b"[" * 700 + b"]" * 700 + b', "digest": ""}\n',
        "long number": b'{"name": "piece 1", "result": ' + b"9" * 5000 + b"}\n",
        "no digest": json.dumps({k: v for k, v in piece.items() if k != "digest"}).encode() + b"\n",
        "more": json.dumps({**piece, "more": 1}).encode() + b"\n",
        "twice": line[:-1] + line,
        "empty": b"\n",
    }


@pytest.mark.parametrize("fault", damaged(b'{"name": "piece 1", "result": {"a": 0.1}, "digest": ""}\n'))
def test_a_damaged_line_costs_its_own_piece(tmp_path, capsys, fault):
    path = filled(tmp_path, 3)
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    lines[2] = damaged(lines[2])[fault]
    path.write_bytes(b"".join(lines))
    with Journal(tmp_path, "job") as journal:
        assert len(journal) == 2
        assert journal.get("piece 1") is None
        assert journal.get("piece 2") == {"points": [[0.2, 1 / 3]], "costs": [None, 2 / 7]}
        journal.add("piece 1", {"points": [[0.1, 1 / 3]], "costs": [np.inf, 1 / 7]})
    assert capsys.readouterr().err == f"{path}: 1 of 3 pieces are damaged and computed again\n"
    assert sorted(path.read_bytes().splitlines()) == sorted(whole.splitlines())


def test_a_damaged_first_line_costs_nothing(tmp_path):
    path = filled(tmp_path, 3)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([b'{"key": "jab"}\n', *lines[1:]]))
    with Journal(tmp_path, "job") as journal:
        assert len(journal) == 3
    assert path.read_bytes() == b"".join(lines)
    # Whose it is cannot be known.
    before = b"".join([b'{"key": "jab"}\n', *(line.replace(b"0.", b"1.") for line in lines[1:])])
    path.write_bytes(before)
    with pytest.raises(InputError, match="none of its pieces can be read"):
        Journal(tmp_path, "job")
    assert path.read_bytes() == before


def test_a_line_of_another_job_is_not_believed(tmp_path):
    path = filled(tmp_path, 1)
    with Journal(tmp_path / "other", "another job") as other:
        other.add("piece 7", {})
    path.write_bytes(path.read_bytes() + (tmp_path / "other" / NAME).read_bytes().splitlines(keepends=True)[1])
    with Journal(tmp_path, "job") as journal:
        assert journal.get("piece 7") is None and len(journal) == 1


def test_a_full_disk_leaves_no_half_line(tmp_path, monkeypatch):
    path = filled(tmp_path, 1)
    whole = path.read_bytes()
    with Journal(tmp_path, "job") as journal:

        def full(_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            journal.add("piece 1", {})
    assert path.read_bytes() == whole


def test_journal_of_another_job_is_refused_and_kept(tmp_path):
    path = filled(tmp_path, 1)
    before = path.read_bytes()
    with pytest.raises(InputError, match="another problem"):
        Journal(tmp_path, "another job")
    assert path.read_bytes() == before


def test_key_distinguishes_data_and_is_the_same_again():
    key = key_of({"values": np.array([1.0, 2.0])}, 3)
    assert key == key_of({"values": np.array([1.0, 2.0])}, 3)
    assert key != key_of({"values": np.array([1.0, np.nextafter(2.0, 3.0)])}, 3)
    assert key != key_of({"values": np.array([1.0, 2.0])}, 4)


def calibrate(out: Path) -> subprocess.Popen:
    """The command as a user runs it, with 48 starts: four batches."""
    words = [sys.executable, "-c", COMMAND, "calibrate", str(EXAMPLE), "--out", str(out), "--starts", "48"]
    env = {**os.environ, "BCFJ_CACHE": str(BUILD / "jax-cache")}
    return subprocess.Popen(words, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def fitted(out: Path) -> dict:
    found = json.loads((out / "fit.json").read_text())
    found.pop("wall_s")
    return found


def cut_off(out: Path, how: signal.Signals, lines: int) -> int:
    """Begin, and send a signal once the journal has so many lines; the exit code."""
    job = calibrate(out)
    while job.poll() is None and not ((out / NAME).exists() and (out / NAME).read_bytes().count(b"\n") >= lines):
        time.sleep(0.01)
    job.send_signal(how)
    return job.wait()


@pytest.mark.parametrize(
    ("stop", "reported"),
    [(Interrupted("3 of 12", {"stiffness": 2.0}, 7.0, "1 of 2"), "3 of 12"), (KeyboardInterrupt(), "all")],
)
def test_ctrl_c_leaves_what_is_known_whenever_it_comes(tmp_path, monkeypatch, stop, reported):
    def stopped(*_, **__):
        raise stop

    monkeypatch.setattr(command, "solve", stopped)
    assert command.run(EXAMPLE, tmp_path / "out", 0, 12) == 5
    so_far = json.loads((tmp_path / "out" / "interrupted.json").read_text())
    assert so_far["finished_starts"] == reported
    assert so_far["best"] == getattr(stop, "values", None)


def test_ctrl_c_while_screening_says_so(monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(starts, "stages", stopped)
    problem = load(EXAMPLE)
    model = build(problem, problem.experiments)
    with pytest.raises(Interrupted) as caught:
        starts.screen(model, 12, 0)
    assert (caught.value.finished, caught.value.stage, caught.value.values) == ("0 of 12", "screening", None)


def test_ctrl_c_that_was_swallowed_comes_back():
    # A shell's background jobs ignore it; this one must not.
    found, before = signal.getsignal(signal.SIGINT), signal.default_int_handler
    signal.signal(signal.SIGINT, before)
    with heeded():
        check()
        with contextlib.suppress(KeyboardInterrupt):  # As a callback of the garbage collector does.
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            check()
        # A verb that begins after the modules that swallowed it were loaded.
        with pytest.raises(KeyboardInterrupt), heeded():
            pytest.fail("the verb began")
    check()
    assert signal.signal(signal.SIGINT, found) is before


@pytest.mark.slow
def test_cut_off_fit_goes_on_to_the_same_result(tmp_path):
    straight, cut = tmp_path / "straight", tmp_path / "cut"
    code = calibrate(straight).wait()
    assert code in (0, 4)
    assert not (straight / NAME).exists()

    assert cut_off(cut, signal.SIGKILL, 2) == -signal.SIGKILL
    kept = (cut / NAME).read_bytes()
    assert cut_off(cut, signal.SIGINT, 3) == 5
    assert (cut / NAME).read_bytes().startswith(kept[: kept.rindex(b"\n")])
    so_far = json.loads((cut / "interrupted.json").read_text())
    assert so_far["best"].keys() == {"stiffness", "exponent", "time_offset"}
    assert not (cut / "fit.json").exists()

    assert calibrate(cut).wait() == code
    assert fitted(cut) == fitted(straight)
    assert sorted(p.name for p in cut.iterdir()) == sorted(p.name for p in straight.iterdir())
