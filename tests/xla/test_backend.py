"""What the package takes for granted of JAX and its backend: shapes it compiles rightly, traces, 64 bits, imports."""

from __future__ import annotations

import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax import Body, Contact, InputError, Mechanism, force_history, gaps, scenes, simulate

RUNS = 20_000


@pytest.mark.parametrize("rows", [3, 6])
@pytest.mark.parametrize("reduce", ["sum", "min"])
def test_batched_small_products(rows, reduce):
    # jax 0.10.2 compiles this shape wrongly on the CPU (jax-ml/jax#39103): a lock on the versions allowed.
    rng = np.random.default_rng(1)
    a, x = rng.normal(size=(rows, 3)), rng.normal(size=(RUNS, 3))
    found = jax.jit(jax.vmap(lambda vector: getattr(jnp, reduce)(jnp.asarray(a) @ vector)))(x)
    expected = getattr(np, reduce)(x @ a.T, axis=1)
    assert np.abs(np.asarray(found) - expected).max() < 1e-13  # three products and at most six terms of size 1


@pytest.mark.slow
def test_many_histories_in_a_batch():
    # A linear undamped contact: F = v sqrt(K m) sin(sqrt(K/m) t) until it ends at pi sqrt(m/K), then 0.
    scene = scenes.impact("hertz", "linear", smoothing=False)
    mass, speed, error = 0.02, 1.5, 5e-2
    stiffness = np.geomspace(1e7, 1e8, RUNS)
    times = np.linspace(0.1, 1.3, 5) * np.pi * np.sqrt(mass / 5e7)
    p = scene.parameters(mass=mass, approach_speed=speed)

    @jax.jit
    @jax.vmap
    def forces(k):
        return force_history(scene, {**p, "stiffness": k}, times, accuracy="fast")["contact"]

    found = np.asarray(forces(stiffness))
    assert found.shape == (RUNS, 5, 3) and not np.any(found[..., 1:])
    k = stiffness[:, None]
    expected = speed * np.sqrt(k * mass) * np.maximum(np.sin(np.minimum(np.sqrt(k / mass) * times, np.pi)), 0.0)
    peak = speed * np.sqrt(stiffness * mass)
    # Every lane to what "fast" promises, and the soft lanes still in contact at the last time, the stiff ones not.
    assert np.abs(found[..., 0] - expected).max(axis=1) == pytest.approx(0.0 * peak, abs=error * peak.min())
    assert found[0, -1, 0] > 0 and found[-1, -1, 0] == 0


def counted_scene():
    """An impact whose gap counts how often it is traced."""
    count = [0]

    def depth(place, c):
        count[0] += 1
        return place[0] - c["clearance"]

    ball = Body("body", "slide", axis="x", mass="mass", start={"velocity": "approach_speed"})
    wall = Contact("contact", ("ground", "body"), gaps.from_depth(depth, ("clearance",)), law="hertz", smoothing=False)
    given = {"stiffness": 1.3476e10, "exponent": 1.5, "mass": 0.016731, "approach_speed": 1.5, "clearance_contact": 0.0}
    scene = Mechanism("counted", (ball,), (wall,), given=given)
    return scene, count


@pytest.mark.full
def test_new_numbers_do_not_compile_again():
    scene, count = counted_scene()
    times = np.linspace(0.0, 5e-5, 7)
    first = simulate(scene, scene.parameters(), times)
    traces = count[0]
    assert traces > 0 and first.status == "ok"
    for speed, accuracy in ((1.0, "fast"), (2.0, "reference"), (0.5, 1e-3)):
        run = simulate(scene, scene.parameters(approach_speed=speed), times * speed, accuracy=accuracy)
        assert run.status == "ok" and run.stats["compile_s"] < 0.1
    assert count[0] == traces
    simulate(scene, scene.parameters(), times[:-1])  # another number of times is another program
    assert count[0] > traces


def test_a_users_function_is_traced_once():
    scene = scenes.impact("hertz", smoothing=False)

    @jax.jit
    @eqx.debug.assert_max_traces(max_traces=1)
    def peak(params, times):
        return jnp.max(force_history(scene, params, times, mode="forward")["contact"])

    times = jnp.linspace(0.0, 5e-5, 7)
    peaks = [float(peak(scene.parameters(approach_speed=v), times / v)) for v in (1.0, 2.0, 3.0)]
    assert peaks == sorted(peaks)


def test_parameters_are_64_bit():
    p = scenes.bounce().parameters(stiffness=1, mass=np.float32(0.5), damping=jnp.float32(0.1))
    assert all(leaf.dtype == jnp.float64 and leaf.shape == () for leaf in p.values())


_PROBE = """
import jax, os, sys
import diffrax  # a dependency may have settings of its own
before = dict(jax.config.values)
import bcfj_jax
after = dict(jax.config.values)
print([name for name in after if after[name] is not before.get(name) and after[name] != before.get(name)])
print([name for name in ("matplotlib", "pint", "pydantic", "typer", "calibration") if name in sys.modules])
print(bcfj_jax.scenes.impact().parameters()["mass"].dtype)
print(os.environ["XLA_FLAGS"])
"""
_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
_OURS = f"{_LOOPS}=1048576,xla_cpu_disable_new_fusion_emitters"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", f"--xla_backend_extra_options={_OURS}"),
        pytest.param(
            # XLA reads nothing behind the second word.
            "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
            f"--xla_backend_extra_options={_OURS} --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "--xla_backend_extra_options=a=1", f"--xla_backend_extra_options={_OURS},a=1", marks=pytest.mark.slow
        ),
        (f"--xla_backend_extra_options={_LOOPS}=2", f"--xla_backend_extra_options={_LOOPS}=2"),
    ],
)  # fmt: skip
def test_importing_sets_64_bits_and_options_of_xla_and_loads_no_tools(before, after):
    # A process of its own: this one has imported everything.
    surroundings = {**os.environ, "XLA_FLAGS": before}
    done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, check=False, env=surroundings)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["['jax_enable_x64']", "[]", "float64", after]


def test_32_bit_numbers_are_refused():
    scene = scenes.impact()
    params = scene.parameters()
    # The check of values comes before the refusal, and its program is made with 64 bits here.
    scene.check(params)
    with jax.enable_x64(False), pytest.raises(InputError, match=r"jax_enable_x64.*32 bits"):
        simulate(scene, params, [0.0, 1e-4])
