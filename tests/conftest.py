"""Shared test set-up: float64, a compilation cache inside the build tree, and the three tiers.

==============  ====================================================  ==========================
``make``        runs                                                  what is marked so
==============  ====================================================  ==========================
``fast``        tests without a mark: what the README promises, and   nothing
                every test that is cheap; three minutes
``test``        also ``full``; CI runs it                             costly programs of physics
``all-tests``   also ``slow``, and more examples of each property     long runs, many repetitions
==============  ====================================================  ==========================

Marks stand in the test files, so that a tier is the same on every machine. What is slow compiles: most of a test's time
is XLA's. A worker therefore runs whole files (``--dist loadfile``), whose tests share programs and fixtures.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are (see the CLI).
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import pytest
from hypothesis import settings
from problems import PROBLEM, SCENE, TABLE

from bcfj_jax.xla import programs, surroundings

BUILD = Path(__file__).resolve().parent.parent / "build"
# Where child processes keep programs: not in the user's own folder.
os.environ["BCFJ_CACHE"] = str(BUILD / "jax-cache")


def _opened(open_cache=surroundings.open_cache):
    """A command within this process keeps programs only where its test names a folder: what is kept is lowered twice."""
    if os.environ.get("BCFJ_CACHE") != str(BUILD / "jax-cache"):
        open_cache()


surroundings.open_cache = _opened

# As the command has it (bcfj_jax/cli): nearly all that tracing makes stays, and need not be looked through again and again.
gc.set_threshold(1_000_000, 20, 20)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", str(BUILD / "jax-cache"))
_KEPT_FROM = 0.2
# Bytes of a worker from which it forgets what is compiled.
_LARGE = 5 * 2**30
jax.config.update("jax_persistent_cache_min_compile_time_secs", _KEPT_FROM)

# Deterministic on CI and here; compiling inside an example is slow, which is no failure.
# All tests take a hundred examples; the fast tier takes 25 (--hypothesis-profile fast).
for name, count in (("all", 100), ("fast", 25)):
    settings.register_profile(name, deadline=None, derandomize=True, max_examples=count, database=None)
settings.load_profile("all")


# Most of a test's time is XLA's. Its optimisations take two fifths of that, and the tests' programs run too shortly to win
# it back. The slow tier compiles as users do, as does every command that a test runs in a process of its own.
_QUICK = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"


def pytest_configure(config):
    """XLA reads its options when the first device is asked for; processes of tests do not inherit them."""
    if "not slow" in (config.option.markexpr or ""):
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} {_QUICK}"
        jax.devices()
        os.environ["XLA_FLAGS"] = flags


# The files that take longest go first, so that no worker is left alone with one at the end.
LONG = ("test_types_and_pages.py", "test_docs.py", "test_tradeoff.py", "test_extremes.py", "test_memory.py")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Long files first."""
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


@pytest.fixture(scope="module")
def optimised():
    """Programs compiled as users compile them, for bounds on motion that is sensitive to rounding."""
    made = programs._compiled

    def compiled(call, wanted):
        return made(call, wanted._replace(options={"xla_backend_optimization_level": 3, **wanted.options}))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programs, "_compiled", compiled)
        programs._loaded.clear()
        yield
    programs._loaded.clear()


@pytest.fixture(autouse=True, scope="module")
def bounded_memory():
    """Programs of earlier files go where a worker has grown large: two that keep all of the slow tier's need over 24 GB."""
    yield
    statistics = Path("/proc/self/statm")
    if statistics.exists() and int(statistics.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > _LARGE:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True)
def kept_for_one_test():
    """Keeping of programs that a test's command has switched on ends with it."""
    yield
    if programs.Settings.folder is not None:
        programs.Settings.folder = None
        jax.config.update("jax_persistent_cache_min_compile_time_secs", _KEPT_FROM)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Each test in its own folder, with a good problem in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    for name, text in (("p.toml", PROBLEM), ("s.toml", SCENE), ("d.csv", TABLE)):
        Path(name).write_text(text)
    return tmp_path
