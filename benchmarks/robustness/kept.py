"""What a cut-off job or an earlier process has kept, made small; how it is restored; whether that is what was kept.

Each kind writes one good file into a folder of its own, restores it after it was damaged, and compares: what is restored must
be what was kept, bit for bit, or not be restored at all.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Kept(NamedTuple):
    """A kind of kept work.

    Attributes:
        content: a good file.
        read: restores it from a file with this content, or damaged.
        then: what is wrong with what was restored; "" for nothing.
    """

    content: bytes
    read: Callable[[Path], Any]
    then: Callable[[Any], str]


def _quietly(function: Callable[[], Any]) -> Any:
    """What a function gives; its words about damage are not printed a thousand times."""
    said, sys.stderr = sys.stderr, StringIO()
    try:
        return function()
    finally:
        sys.stderr = said


def journal(folder: Path) -> Kept:
    """Eight finished pieces of a job."""
    from bcfj_jax.io.journal import NAME, Journal

    pieces = {f"start {k}": {"chi2": 1.0 / (k + 1), "point": [0.1 * k, 0.3], "reason": ""} for k in range(8)}
    with Journal(folder / "good", "key") as whole:
        for name, piece in pieces.items():
            whole.add(name, piece)
    content = (folder / "good" / NAME).read_bytes()

    def read(file: Path) -> dict[str, Any]:
        place = folder / file.stem
        place.mkdir(exist_ok=True)
        (place / NAME).write_bytes(file.read_bytes())

        def restored() -> dict[str, Any]:
            with Journal(place, "key") as found:
                return {name: found.get(name) for name in pieces}

        return _quietly(restored)

    def then(found: dict[str, Any]) -> str:
        wrong = [name for name, piece in found.items() if piece is not None and piece != pieces[name]]
        return f"pieces that were never kept: {wrong}" if wrong else ""

    return Kept(content, read, then)


def program(folder: Path) -> Kept:
    """A compiled program's export."""
    from bcfj_jax.xla import programs

    values = np.array([1.0, 2.0, 3.0])
    before, programs.Settings.folder = programs.Settings.folder, folder / "programs"
    (folder / "programs").mkdir(mode=0o700)
    try:
        found = programs.program("fuzz", _twice, (), (values,))[0]
        expected = np.asarray(found(values)).tobytes()
    finally:
        programs.Settings.folder = before
    good = next(path for path in (folder / "programs").iterdir() if path.stat().st_size > 200)

    def read(file: Path) -> Any:
        good.write_bytes(file.read_bytes())
        return programs._read(good)

    def then(found: Any) -> str:
        return "" if found is None or np.asarray(found.call(values)).tobytes() == expected else "another program"

    return Kept(good.read_bytes(), read, then)


def _twice(values: Any) -> Any:
    return 2.0 * values


def reference(folder: Path) -> Kept:
    """The reference solution of a trade-off."""
    from bcfj_jax.analysis.tradeoff import reference as kept
    from bcfj_jax.analysis.tradeoff.measures import Measured

    rng = np.random.default_rng(0)
    truth = Measured(rng.normal(size=(40, 1, 3)), np.zeros(1, int), np.ones(1), np.ones(1), np.ones(1))
    certificate = {"errors": {}, "derivatives": {"error": 0.1}}
    (folder / "reference").mkdir()
    digest = kept.save(kept.Reference(truth, None, certificate), folder / "reference")
    content = (folder / "reference" / kept.NAME).read_bytes()

    def read(file: Path) -> Any:
        (folder / "reference" / kept.NAME).write_bytes(file.read_bytes())
        return _quietly(lambda: kept.restore(certificate, folder / "reference", digest))

    def then(found: Any) -> str:
        if found is None:
            return ""
        same = all(np.array_equal(a, b) for a, b in zip(found.truth, truth, strict=True))
        return "" if same else "other numbers than were kept"

    return Kept(content, read, then)


def block(folder: Path) -> Kept:
    """A finished block of a study, with numbers that no run has given: what is restored is compared with them."""
    from bcfj_jax.analysis.studies import specification
    from bcfj_jax.analysis.studies.block import Blocks, Table
    from bcfj_jax.analysis.studies.store import Store

    (folder / "study.toml").write_text(
        'scene = "impact"\n[design]\nkind = "grid"\n[vary.stiffness]\nvalues = [1e9, 2e9, 3e9]\n[results]\n'
        'features = ["contact.peak"]\n'
    )
    blocks = Blocks(specification.load(folder / "study.toml"))
    first = Store(folder / "study", blocks)
    at, rng = blocks.points(0), np.random.default_rng(0)
    results = rng.normal(size=(len(at), len(first.study.columns)))
    values, ends, nothing = first.study.points[at], first.study.ends[at], np.zeros((len(at), 0, 0, 0))
    texts = ["ok"] * len(at), [""] * len(at)
    first.write(0, Table(at, values, results, *texts, rng.integers(9, 99, len(at)), 99, nothing, ends))
    good, table = first.path(0), first.read(0)
    content = good.read_bytes()

    def read(file: Path) -> Any:
        good.write_bytes(file.read_bytes())
        store = Store(folder / "study", blocks)
        return store.read(0) if _quietly(lambda: store.finished(0)) else None

    def then(found: Any) -> str:
        return "" if found is None or found.equals(table) else "another table than was kept"

    return Kept(content, read, then)


KINDS: dict[str, Callable[[Path], Kept]] = {
    "journal": journal, "program": program, "reference": reference, "block": block,
}  # fmt: skip
