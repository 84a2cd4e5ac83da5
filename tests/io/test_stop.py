"""Ctrl-C and SIGTERM that come at a bad moment."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
import subprocess
import sys
import time

import pytest

from bcfj_jax import cli
from bcfj_jax.io import folder, stop


@pytest.fixture(autouse=True)
def heard():
    """Ctrl-C is not ignored, as it is in a shell's background jobs."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def collected(times: int, number: signal.Signals) -> list[int]:
    """Collect garbage; in the callbacks of so many collections a signal comes. The list grows by one each."""
    came: list[int] = []

    def callback(phase, info):
        del info
        if phase == "start" and len(came) < times:
            came.append(1)
            signal.raise_signal(number)

    gc.callbacks.append(callback)
    try:
        for _ in range(times):
            gc.collect(0)
    finally:
        gc.callbacks.remove(callback)
    return came


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("at_once", [False, True])
def test_what_is_lost_in_a_callback_comes_again(number, at_once, capsys, monkeypatch):
    if at_once:
        # It comes before the callback has returned, and is lost once more.
        monkeypatch.setattr(stop, "_RETURNED_S", 0.0)

    def work():
        with stop.heeded(signal.SIGTERM):
            assert collected(1, number) == [1]
            time.sleep(10.0)
            pytest.fail("the signal is lost")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert stop.last() == number
    assert capsys.readouterr().err == ""


def test_what_was_heard_does_not_come_again():
    def work():
        collected(1, signal.SIGINT)
        stop.check()

    with stop.heeded():
        with pytest.raises(KeyboardInterrupt):
            work()
        # As the work that tidies up does.
        time.sleep(0.1)


def test_what_an_import_swallows_is_heard_before_work_begins(tmp_path):
    with stop.heeded():
        # Libraries that may be missing are imported so.
        with contextlib.suppress(BaseException):
            os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            folder.open_folder(tmp_path / "out", "impact", folder.Claim("simulate", ["forces.csv"]))
    assert not (tmp_path / "out").exists()


def test_what_comes_within_an_import_is_raised_after_it(tmp_path, monkeypatch):
    """Compiled code in an import may take it for a fault of its own, or end the process."""
    (tmp_path / "signalled.py").write_text("import signal\nsignal.raise_signal(signal.SIGTERM)\nwhole = True\n")
    monkeypatch.syspath_prepend(tmp_path)

    def work():
        with stop.heeded(signal.SIGTERM):
            importlib.import_module("signalled")
            time.sleep(10.0)
            pytest.fail("the signal is lost")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert stop.last() == signal.SIGTERM and sys.modules.pop("signalled").whole


def test_a_signal_before_the_verb_has_its_own_exit_code(monkeypatch):
    def app():
        """As typer does it."""
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise SystemExit(130) from None

    for name, done in (("app", app), ("leave", lambda code: None), ("be_patient", lambda: None)):
        monkeypatch.setattr(cli, name, done)
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as end:
            cli.main()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert end.value.code == 143


def test_another_fault_of_a_callback_is_reported(monkeypatch):
    found = []
    monkeypatch.setattr("sys.unraisablehook", found.append)

    def callback(phase, info):
        raise ValueError(phase, info)

    with stop.heeded():
        gc.callbacks.append(callback)
        try:
            gc.collect(0)
        finally:
            gc.callbacks.remove(callback)
    assert {one.exc_type for one in found} == {ValueError}


def test_a_signal_after_the_end_changes_no_exit_code():
    before = signal.getsignal(signal.SIGTERM)
    try:
        with stop.heeded(signal.SIGTERM):
            stop.ended()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)


# Each of two threads waited for the other: one within the library's start, which runs Python, one importing another.
FONTS = """
import sys, threading
from bcfj_jax.io import plots
thread = []
start = threading.Thread.start
def seen(self):
    with open("/proc/self/maps") as file:
        thread.append(("ft2font" in file.read(), "matplotlib" in sys.modules))
    start(self)
threading.Thread.start = seen
plots.get_ready()
assert thread == [(True, False)], thread
from bcfj_jax.xla import threads
threads._ahead[0].join()
import matplotlib.ft2font
assert "matplotlib.figure" in sys.modules
"""


@pytest.mark.full
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks the system for the libraries of a process")
def test_the_library_of_fonts_is_loaded_before_there_are_threads():
    subprocess.run([sys.executable, "-c", FONTS], check=True, timeout=120.0)


@pytest.mark.parametrize(("watched", "apart"), [("", False), ("sys.setprofile(lambda *_: None)", True)])
@pytest.mark.parametrize(("words", "code"), [(["--help"], 0), (["simulate", "missing.toml"], 2)])
def test_a_process_of_the_command_does_what_is_registered_and_takes_nothing_apart(watched, apart, words, code):
    probe = f"""
import atexit, os, sys
from bcfj_jax.cli import command
class Last:
    def __del__(self, write=os.write):
        write(1, b"taken apart")
sys.argv, kept = ["bcfj", *{words}], Last()
atexit.register(print, "registered")
{watched}
command()
"""
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert ("taken apart" in done.stdout, "registered" in done.stdout) == (apart, True)
