"""A command in odd surroundings: a sentence in place of a traceback; output that nobody reads."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BUILD

import bcfj_jax
from bcfj_jax.analysis.studies import specification
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import guard, outputs, plots
from bcfj_jax.xla import backend


def bcfj(*arguments, stdout=subprocess.PIPE, **variables):
    environment = {
        **{k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")},
        "PYTHONPATH": str(Path(bcfj_jax.__file__).parents[1]),
        "BCFJ_CACHE": str(BUILD / "jax-cache"),
        **variables,
    }
    command = [sys.executable, "-m", "bcfj_jax", *map(str, arguments)]
    return subprocess.run(command, env=environment, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


@pytest.mark.full
@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"JAX_PLATFORMS": "foo"}, "JAX_PLATFORMS=foo: JAX cannot start"),
        ({"JAX_DISABLE_JIT": "1"}, "JAX_DISABLE_JIT: is set"),
        ({"XLA_FLAGS": "--xla_foo=1"}, "Unknown flag in XLA_FLAGS: --xla_foo=1"),
    ],
)
def test_what_jax_cannot_work_with_is_a_sentence(tmp_path, variables, says):
    done = bcfj("simulate", "impact", "--out", tmp_path / "out", **variables)
    assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_output_that_nobody_reads_does_not_end_a_run(tmp_path):
    readable, writable = os.pipe()
    os.close(readable)
    try:
        done = bcfj(
            "simulate", "impact", "--out", tmp_path / "out", stdout=writable, JAX_ENABLE_X64="0",
            MPLBACKEND="module://matplotlib_inline.backend_inline", LC_ALL="C", COLUMNS="1",
        )  # fmt: skip
    finally:
        os.close(writable)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "forces.png").exists() and (tmp_path / "out" / "report.html").exists()


@pytest.mark.full
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs the device of a full disk")
@pytest.mark.parametrize(("words", "code"), [(["schema", "scene"], 2), (["init", "impact"], 0)])
def test_what_is_only_printed_is_an_error_where_it_cannot_be(tmp_path, words, code):
    out = ["--out", tmp_path / "out"] if words[0] == "init" else []
    with open("/dev/full", "wb") as full:
        done = bcfj(*words, *out, stdout=full)
    assert done.returncode == code and "Traceback" not in done.stderr, done.stderr
    assert ("error: stdout cannot be written (No space left on device)" in done.stderr) == (code == 2)


@pytest.mark.skipif(os.name != "posix", reason="a shell closes streams")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_streams_that_are_closed_change_no_exit_code(closed, tmp_path):
    """As of a service: Python has no stream then."""
    words = [sys.executable, "-m", "bcfj_jax", "init", "impact", "--out", tmp_path / "s.toml"]
    done = subprocess.run(["sh", "-c", f'exec "$0" "$@" {closed}', *words], check=False)
    assert done.returncode == 0 and (tmp_path / "s.toml").exists()


def test_a_full_disk_is_said_with_the_file(tmp_path):
    out = []
    held = tmp_path / "forces.csv"

    def write() -> int:
        with outputs.atomic(held):
            raise OSError(errno.ENOSPC, "No space left on device")

    assert guard.guarded(write, out.append) == 2
    assert out == [f"error: {held}: No space left on device; free some space"] and not list(tmp_path.iterdir())


def test_a_file_of_any_name_has_a_picture(tmp_path):
    """A dollar sign would begin a formula, and what is no character cannot be drawn."""
    with plots.panels(1, 1, tmp_path / "drawn.png", 4.0, 2.0) as axes:
        axes[0].set_title(plots.plain("a$^$ and \udcff: scene"))
    assert axes[0].get_title("left") == r"a\$^\$ and \udcff: scene" and (tmp_path / "drawn.png").stat().st_size > 100


def test_options_of_xla_are_ours_or_the_users(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "")
    backend.set_up()
    assert backend.own_flags(os.environ["XLA_FLAGS"]) == ""
    monkeypatch.setenv("XLA_FLAGS", "--xla_foo=1")
    backend.set_up()
    assert backend.own_flags(os.environ["XLA_FLAGS"]) == "--xla_foo=1"


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"kind": "impact"}, "has a kind, as in a scene file"),
        ({}, "has no table scene"),
        ({"scene": {}}, "kind"),
        ({"scene": 3}, "3 is not accepted"),
        ("x" * 5000, "no file and no scene"),
        ("x" * 5000 + ".toml", "no file and no scene"),
        ("a\0b.toml", "no file and no scene"),
        ({"scene": {"kind": "chain", "count": 10**400}}, "chain"),
    ],
    ids=["kind", "empty", "no kind", "number", "long name", "long file", "NUL", "many spheres"],
)
def test_a_study_of_no_scene_is_refused(scene, says):
    with pytest.raises(InputError) as refused:
        specification.from_table({"scene": scene, "vary": {"stiffness": {"values": [1e6]}}})
    assert says in str(refused.value) and len(str(refused.value)) < 2000
