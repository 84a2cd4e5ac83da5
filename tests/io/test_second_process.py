"""Files that a second process makes: the same bytes as in this process, also where it cannot help."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

SCRIPT = """
    import os, signal, sys, time
    from pathlib import Path
    from bcfj_jax.io import second_process

    second_process.begin(lambda: None)
    from bcfj_jax.io import outputs, plots

    def drawn(folder, label=None):
        for k in range(6):
            with plots.sheet(folder / f"{k}.png") as (axis,):
                axis.plot([0.0, 1.0], [k, 2.0])
                if label and k == 2:
                    axis.xaxis.set_major_formatter(label)
        outputs.write_columns(folder / "t.csv", {"time [s]": plots.np.arange(5e4), "state": ["on"] * 50000})
        second_process.finish()

    folder, case = Path(sys.argv[1]), sys.argv[2]
    second = second_process._Second
    assert second.channel
    if case == "none":
        second.channel = None
    if case == "hangs":
        second_process._PATIENCE_S = 0.1
    if case in ("gone", "hangs"):
        for entry in Path("/proc/self/task").iterdir():
            for child in (entry / "children").read_text().split():
                os.kill(int(child), signal.SIGKILL if case == "gone" else signal.SIGSTOP)
    drawn(folder, (lambda x, place: f"{x:.3f}") if case == "lambda" else None)
    if case == "beside":
        outputs.write_later(folder / "stat", Path("/proc/self/stat").read_bytes)
        until = time.monotonic() + 60.0
        while not second.tasks[-1].made and time.monotonic() < until:
            time.sleep(0.01)
        second_process.finish()
        assert int((folder / "stat").read_bytes().split()[0]) != os.getpid()
        (folder / "stat").unlink()
    if case == "raises":
        outputs.write_later(folder / "x", int, "seven")
        try:
            second_process.finish()
        except ValueError as error:
            print(error)
"""


def _made(folder, case: str) -> dict[str, bytes]:
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), str(folder), case], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert ("seven" in done.stdout) == (case == "raises")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.skipif(sys.platform != "linux", reason="the second process is a fork")
def test_files_are_the_same_with_and_without_a_second_process(tmp_path):
    alone = _made(tmp_path / "none", "none")
    assert sorted(alone) == ["0.png", "1.png", "2.png", "3.png", "4.png", "5.png", "t.csv"]
    # As it is meant, made by another process; gone or stopped before its work; what fails there fails here, with its error.
    for case in ("beside", "gone", "hangs", "raises"):
        assert _made(tmp_path / case, case) == alone
    # A figure that cannot be sent is drawn here.
    there = _made(tmp_path / "lambda", "lambda")
    assert sorted(there) == sorted(alone) and there["2.png"] != alone["2.png"]
    assert {name: there[name] for name in there if name != "2.png"} == {n: alone[n] for n in alone if n != "2.png"}
