"""Work side by side, what is begun ahead, and the line that says what is waited for."""

from __future__ import annotations

import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.core.progress import Waiting, stage
from bcfj_jax.xla import programs, threads


@pytest.mark.parametrize("cores", [1, 2])
def test_results_come_in_order_whichever_ends_first(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    assert threads.together(lambda: (time.sleep(0.02), 1)[1], lambda: 2, lambda: 3) == [1, 2, 3]


@pytest.mark.parametrize("cores", [1, 2])
def test_what_is_begun_is_computed_once_and_raises_where_it_is_wanted(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    calls: list[int] = []
    wanted = threads.begun(lambda: (calls.append(0), len(calls))[1])
    assert [wanted(), wanted()] == [1, 1]
    failing = threads.begun(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        failing()


def test_on_two_cores_both_run_at_once(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    met = threading.Barrier(2, timeout=10.0)
    assert len(threads.together(met.wait, met.wait)) == 2


@pytest.mark.parametrize("cores", [1, 2])
def test_an_error_is_raised(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    with pytest.raises(ZeroDivisionError):
        threads.together(lambda: 1, lambda: 1 // 0)


def test_what_is_begun_ahead_is_busy_until_it_ends_and_its_error_is_dropped():
    go = threading.Event()

    def wait() -> None:
        go.wait(10.0)
        raise ValueError

    threads.ahead(wait)
    assert threads.busy()
    go.set()
    for thread in threads._ahead:
        thread.join(10.0)
    assert not threads.busy()


def test_a_program_asked_for_twice_at_once_is_made_once():
    def slow(x):
        time.sleep(0.05)
        return 2.0 * x

    def once():
        return programs.program("test: made once", slow, (), (np.ones(3),))[0]

    before = programs.traced.count("test: made once")
    first, second = threads.together(once, once)
    assert first is second
    assert programs.traced.count("test: made once") == before + 1


def test_a_program_within_a_trace_does_not_wait_for_one_that_waits_for_the_trace():
    inside = threading.Event()

    def inner(x):
        return 2.0 * x

    def asked():
        return programs.program("test: asked for within", inner, (), (np.ones(3),))[0]

    def outer(x):
        inside.set()
        # The other thread holds the inner program, and waits until this one has traced.
        time.sleep(0.1)
        return x + asked()(np.ones(3))

    def other():
        inside.wait(5.0)
        return asked()(np.ones(3))

    pool = ThreadPoolExecutor(2)
    whole = pool.submit(lambda: programs.program("test: outer", outer, (), (np.ones(3),))[0](np.ones(3)))
    second = pool.submit(other)
    assert np.array_equal(whole.result(30.0), np.full(3, 3.0))
    assert np.array_equal(second.result(30.0), np.full(3, 2.0))
    pool.shutdown()


def test_a_line_is_said_only_of_what_takes_long(monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(Waiting, "say", said.append)
    monkeypatch.setattr(Waiting, "after", 0.05)
    with stage("short"):
        pass
    with stage("long"):
        time.sleep(0.3)
    assert said == ["long"]
    monkeypatch.setattr(Waiting, "say", None)
    with stage("nobody listens"):
        time.sleep(0.1)
    assert said == ["long"]


@pytest.mark.parametrize("kept", ["", "[1]", '{"x": "long"}', "\x00", '{"test: said ": 12.3}'])
def test_compiling_is_said_with_the_last_time_if_that_is_known(tmp_path, monkeypatch, kept):
    said: list[str] = []
    monkeypatch.setattr(Waiting, "say", said.append)
    monkeypatch.setattr(Waiting, "after", 0.0)
    monkeypatch.setattr(programs.Settings, "folder", tmp_path)
    monkeypatch.setattr(programs, "_LONG", 0.0)
    (tmp_path / "seconds.json").write_text(kept)

    def slow(x):
        time.sleep(0.1)
        return x + 1.0

    programs.program("test: said", slow, (), (np.ones(len(kept) + 1),))
    known = ": 12 s the last time" if "12.3" in kept else ""
    assert said == [f"compiling 'test: said'{known}"]
    assert json.loads((tmp_path / "seconds.json").read_text())["test: said "] > 0.0


def test_the_first_compilation_is_estimated_by_what_was_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(programs.Settings, "folder", tmp_path)
    measured = json.loads(programs._MEASURED.read_text())
    assert {"simulate joint", "simulate impact"} <= set(measured) and all(t > 0.0 for t in measured.values())
    file = tmp_path / "measured.json"
    file.write_text('{"simulate joint": 5.2, "simulate impact": 1.6, "look joint": 0.2, "pitch joint": 9.0}')
    monkeypatch.setattr(programs, "_MEASURED", file)
    where = "s of one core where it was measured; kept for the next run"
    assert programs._estimate("simulate", "simulate joint") == f" for the first time here: 5 {where}"
    assert programs._estimate("simulate", "simulate mine") == f" for the first time here: 2 to 5 {where}"
    # What is over soon, and what nobody has measured, is not estimated.
    assert programs._estimate("pitch", "pitch mine") == ""
    assert programs._estimate("look", "look joint") == "" == programs._estimate("other", "other joint")
    programs.remember("simulate joint", 31.0)
    assert programs._estimate("simulate", "simulate joint") == ": 31 s the last time"
    for bad in ("", "[[", "[" * 100_000, '{"simulate joint": NaN}', '{"simulate joint": -1.0}'):
        (tmp_path / "seconds.json").write_text(bad)
        assert programs._estimate("simulate", "simulate joint").startswith(" for the first time here: 5 s")
        file.write_text(bad)
        assert programs._estimate("simulate", "simulate joint") == ""
        file.write_text('{"simulate joint": 5.2}')
    scene = bj.scenes.impact()
    assert programs._kind(programs._wanted("n", len, (scene,), ())) == "impact"


def test_verbose_stages_say_their_time(monkeypatch):
    said: list[str] = []
    for name, value in (("say", said.append), ("after", 0.0), ("times", True), ("bar", None)):
        monkeypatch.setattr(Waiting, name, value)
    with stage("short"):
        time.sleep(0.05)
    assert said[0] == "short" and re.fullmatch(r"short: done in 0\.\d\d s", said[1])
