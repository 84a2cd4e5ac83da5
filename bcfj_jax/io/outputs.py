"""Result files: where they go, that none is overwritten or left half written, and what each one holds."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcfj_jax.core.errors import InputError
from bcfj_jax.io.provenance import environment as environment
from bcfj_jax.mechanism.readings import STATES

if TYPE_CHECKING:
    from bcfj_jax.models.joint.observe import Whole
    from bcfj_jax.solve.simulation import Run

COMPONENTS = ("normal", "axial", "tangential")


def open_folder(out: Path | None, verb: str, stem: str, will_write: Sequence[str]) -> Path:
    """The folder for a command's results; it is created with the first file that is written.

    Args:
        out: what the user asked for; None: ``results/<verb>-<stem>``, numbered where that exists.
        verb, stem: what was done to what.
        will_write: names of the files to come.

    Raises:
        InputError: if the folder asked for already holds one of them, or is no folder.
    """
    if out is None:
        base, number = Path("results") / f"{verb}-{stem}", 1
        folder = base
        while folder.exists():
            number += 1
            folder = base.with_name(f"{base.name}-{number}")
        return folder
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}", "this is not a folder", "name a folder")
    there = [name for name in will_write if (out / name).exists()]
    if there:
        found = f"already holds {', '.join(there)}"
        raise InputError(f"--out {out}", found, "name another folder, or remove them: nothing is overwritten")
    return out


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A temporary name beside a file; the file appears whole when the block ends without error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
        # mkstemp makes the file private; results get the mode any new file has.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """A UTF-8 file, atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def plain(value: Any) -> Any:
    """A value as JSON knows it: arrays to lists, paths to texts, NaN and infinities to None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """A JSON file, atomically; NaN and infinities become null."""
    write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV file, atomically; floats in full precision, NaN as an empty cell."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_cell(value) for value in row] for row in rows)
    write_text(path, buffer.getvalue())


def _cell(value: Any) -> Any:
    if isinstance(value, (float, np.floating)):
        return "" if math.isnan(value) else repr(float(value))
    return value


def write_toml(path: Path, content: Mapping[str, Any], comment: str = "") -> None:
    """A TOML file, atomically, under comment lines."""
    import tomli_w

    head = "".join(f"# {line}\n" for line in comment.splitlines())
    write_text(path, head + tomli_w.dumps(dict(content)))


def channels(history: Mapping[str, np.ndarray], components: int = 0) -> dict[str, np.ndarray]:
    """Histories by contact, members apart: (T, 6, 3) under ``seat_ball`` becomes ``seat_ball_1`` .. ``_6``.

    Args:
        history: per contact (T, ...) or, with members, (T, k, ...).
        components: number of axes after those: 1 for forces, 0 for penetrations and rates.
    """
    apart: dict[str, np.ndarray] = {}
    for name, values in history.items():
        if values.ndim == 2 + components:
            apart.update({f"{name}_{k + 1}": values[:, k] for k in range(values.shape[1])})
        else:
            apart[name] = values
    return apart


def write_forces(path: Path, run: Run) -> None:
    """``forces.csv``: time [s], then every contact's three components [N]."""
    forces = channels(run.force, 1)
    header = ["time [s]", *(f"{name}.{part} [N]" for name in forces for part in COMPONENTS)]
    table = np.column_stack([run.times, *forces.values()])
    write_csv(path, header, table.tolist())


def write_contacts(path: Path, run: Run) -> None:
    """``contacts.csv``: time [s], then every contact's penetration [m], sliding speed [m/s] where it slides, state."""
    slip, state = channels(run.slip), channels(run.state)
    header, columns = ["time [s]"], [run.times.tolist()]
    for name, depth in channels(run.penetration).items():
        header.append(f"{name}.penetration [m]")
        columns.append(depth.tolist())
        if name in slip:
            header.append(f"{name}.sliding_speed [m/s]")
            columns.append(slip[name].tolist())
        header.append(f"{name}.state")
        # A failed run's state is unknown: an empty cell, as its numbers.
        columns.append([STATES[code] if code >= 0 else "" for code in state[name].tolist()])
    write_csv(path, header, zip(*columns, strict=True))


def write_resultants(path: Path, run: Run, resultants: Mapping[str, np.ndarray]) -> None:
    """``resultants.csv``: time [s], then ``joint.observe.resultants`` of every contact along x, y and z [N]."""
    header = ["time [s]", *(f"{name}.{axis} [N]" for name in run.force for axis in "xyz")]
    table = np.column_stack([run.times, *(resultants[name] for name in run.force)])
    write_csv(path, header, table.tolist())


def share_of_time(times: np.ndarray, state: np.ndarray) -> dict[str, float]:
    """Share of the time spent in each of ``STATES``, of the samples whose state is known; NaN where none is.

    A sample counts for half of the intervals beside it.
    """
    gaps = np.diff(times)
    weight = np.where(state >= 0, 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps)), 0.0)
    total = weight.sum() if weight.any() else float("nan")
    return {word: float(weight[state == code].sum() / total) for code, word in enumerate(STATES)}


def summary(run: Run) -> dict[str, Any]:
    """``summary.json``: status, every contact's features, what the solver did, and a rung that was chosen, and why.

    The period of a scene that turns is that of its force history, of the last two thirds; else that of its contacts.
    """
    from bcfj_jax.analysis import features, histories

    penetration, rate = channels(run.penetration), channels(run.rate)
    stats = run.stats
    contacts: dict[str, dict[str, Any]] = {
        name: features.summary(run.times, force[:, 0], penetration[name], rate[name])
        for name, force in channels(run.force, 1).items()
    }
    if run.slip:
        for name, force in channels(run.force, 1).items():
            found = histories.settled_period(run.times, force[:, 0]) if run.status == "ok" else float("nan")
            contacts[name]["period"] = found
    for name, state in channels(run.state).items():
        contacts[name]["share_of_time"] = share_of_time(run.times, state)
    chosen = {"fidelity": run.choice._asdict()} if run.choice else {}
    return chosen | {
        "status": run.status,
        "reason": run.reason,
        "failure_time": run.failure_time,
        "contacts": contacts,
        "units": features.UNITS | {"share_of_time": "1", "failure_time": "s", "wall_s": "s", "compile_s": "s"},
        "solver": {key: stats[key] for key in ("accepted", "rejected", "tolerance")},
        "wall_s": stats["wall_s"],
        "compile_s": stats["compile_s"],
    }


def joint_summary(times: np.ndarray, whole: Whole) -> dict[str, Any]:
    """What ``summary.json`` says of a joint as a whole: what it transmits, its energy, Newton's law of its cage.

    Transmission is that of the last two thirds. Works [J] are trapezoidal sums over the samples, and their closure,
    |in - out - lost - change of the store| over the largest of them, is as good as these: ``ledger.balance`` resolves
    the motion between samples.
    """
    settled = times >= times[-1] / 3.0

    def work(power: Any, part: Any = slice(None)) -> float:
        return float(np.trapezoid(np.asarray(power)[part], times[part]))

    works = {name: work(flow) for name, flow in whole.power._asdict().items()}
    store = np.asarray(whole.stored.total)
    change = float(store[-1] - store[0])
    largest = max(map(abs, (*works.values(), change)))
    error, ratio = (np.asarray(x)[settled] for x in (whole.angle_error, whole.speed_ratio))
    given = work(whole.power.drive + whole.power.hold, settled)
    found = {
        "transmission": {
            "angle_error_min": float(error.min()),
            "angle_error_max": float(error.max()),
            "speed_ratio_min": float(ratio.min()),
            "speed_ratio_mean": float(ratio.mean()),
            "speed_ratio_max": float(ratio.max()),
            "efficiency": work(whole.power.load, settled) / given if given else float("nan"),
            "units": {"angle_error": "rad", "speed_ratio": "1", "efficiency": "1"},
        },
        "energy": {
            **works,
            "stored_change": change,
            "closure": abs(work(whole.power.net) - change) / largest if largest else float("nan"),
            "units": {"work": "J", "closure": "1"},
        },
    }
    if whole.cage_residual is not None:
        on_cage = [np.asarray(whole.resultants[name]) for name in whole.resultants if "cage" in name]
        found["cage_equilibrium"] = {
            "largest_residual": float(np.abs(whole.cage_residual).max()),
            "largest_resultant": float(np.abs(on_cage).max()) if on_cage else 0.0,
            "units": {"largest_residual": "N", "largest_resultant": "N"},
        }
    return found
