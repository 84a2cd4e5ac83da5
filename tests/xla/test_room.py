"""A process that goes on compiling lives: programs are dropped before Linux has no memory maps left for XLA."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.xla import programs

# Maps that others hold count, too: with two fifths of all there are, fewer programs have to be made. XLA's optimisations,
# which change no number of maps, are left out.
CHILD = """
import mmap
from pathlib import Path
import jax, jax.numpy as jnp, numpy as np
import bcfj_jax
from bcfj_jax.xla import programs

def sorted_often(n, x):
    for _ in range(10):
        x = jnp.sort(jnp.cos(x)) + jnp.cumsum(x)[-1] + n
    return x

taken = lambda: len(Path("/proc/self/maps").read_bytes().splitlines())
limit = int(Path("/proc/sys/vm/max_map_count").read_text())
held = [mmap.mmap(-1, 4096) for _ in range(2 * limit // 5)]
most = before = taken()
assert before >= len(held)
wanted, n = before, 0
while wanted <= limit and n < 1000:
    run, _ = programs.program("sorted", sorted_often, (n,), (np.ones(3),))
    now = taken()
    wanted, most, before, n = wanted + max(0, now - before), max(most, now), now, n + 1
    assert np.isfinite(run(np.ones(3))).all()
print(wanted, most, limit, n, n - len(programs._loaded))
"""


def double(n, x):
    """A small program."""
    return n * x


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="memory maps are counted on Linux")
def test_more_programs_than_there_are_maps_do_not_end_the_process():
    quick = {**os.environ, "XLA_FLAGS": "--xla_backend_optimization_level=0"}
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, check=False, env=quick)
    assert done.returncode == 0, done.stderr[-2000:]
    wanted, most, limit, made, dropped = map(int, done.stdout.split())
    # Kept, they would have needed more than there are.
    assert wanted > limit > most and made > dropped > made // 2


@pytest.fixture
def few_maps(tmp_path, monkeypatch):
    """A process that is told to have few maps, and how many it is told to take."""
    taken, most = tmp_path / "maps", tmp_path / "most"
    most.write_text("100")
    monkeypatch.setattr(programs, "_MAPS", taken)
    monkeypatch.setattr(programs, "_MOST", most)
    monkeypatch.setattr(programs, "_EVERY", 0)
    monkeypatch.setattr(programs, "_loaded", {})
    return taken


@pytest.mark.slow
def test_the_oldest_programs_go_where_maps_become_few(few_maps):
    few_maps.write_text("one\n" * 50)
    made = [programs.program("double", double, (n,), (np.ones(2),))[0] for n in range(4)]
    assert len(programs._loaded) == 4
    traced = []

    @jax.jit
    def of_the_user(x):
        traced.append(None)
        return x + 1.0

    of_the_user(1.0)
    few_maps.write_text("one\n" * 51)
    programs.make_room()
    assert [key[1] for key in programs._loaded] == [(2,), (3,)]
    of_the_user(1.0)
    assert len(traced) == 2
    # What is at hand goes on, and what is asked for again is made again.
    np.testing.assert_array_equal(made[0](np.ones(2)), np.zeros(2))
    few_maps.unlink()
    again, _ = programs.program("double", double, (1,), (np.ones(2),))
    np.testing.assert_array_equal(again(np.ones(2)), np.ones(2))
    assert len(programs._loaded) == 3


def test_room_can_be_made_under_a_trace(few_maps):
    few_maps.write_text("one\n" * 60)

    @jax.jit
    def within(x):
        y = jnp.sin(x)
        programs.make_room()
        return jax.grad(lambda z: jnp.sum(jnp.sin(z) ** 2))(y)

    x = jnp.linspace(0.0, 1.0, 3)
    np.testing.assert_allclose(within(x), np.sin(2.0 * np.sin(x)), rtol=1e-14)
