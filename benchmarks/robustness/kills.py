"""Verbs that are stopped by TERM, INT or KILL at random moments: resumed to equal results, or nothing is left.

    python -m benchmarks.robustness.kills [--trials 100] [--only calibrate,study,...] [--more] [--within 0.5]
writes results/kills.json; ``--more`` runs the trials that are not there. With ``--within`` signals come in so many
seconds at the start, while libraries are imported, and the file is results/kills_early.json. A verb is run undisturbed
first. A trial starts it in a folder of its own and sends a signal at a random moment of its processor time,
which other work on the machine does not stretch. Then

where work is kept    (calibrate, tradeoff, study) the exit code is 5, or that of a run that was at its end, or by a signal
                      where the process had not begun or was killed; the same command ends with equal results
where nothing is      (sensitivity, design, reproduce) after TERM and INT the folder is gone and the exit code is 143 or
                      130; after KILL the same command in the same folder ends with equal results

Equal means equal to the last bit: the digests of the results agree, of ``results.parquet`` and ``sensitivity.csv`` as
bytes, of the others with their numbers as they are written, which is in full. Times and dates are
left out. An INT or TERM that comes while Python starts ends the process by the signal, with nothing written.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import random
import resource
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bcfj_jax.io.journal import NAME
from benchmarks.common import load, markdown, options, save
from benchmarks.processes import (
    EXAMPLE,
    STUDY,
    command,
    done,
    ended,
    environment,
    files,
    last_line,
    start,
    wait_for,
)

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
# Keys whose values are of a run, not of its result.
_TIMES = ("wall_s", "compile_s", "written", "spent_s", "seconds")
# Processor time [s] that a run may still need when it ends as if there had been no signal: its files are being written.
_END_S = 2.0


class Verb(NamedTuple):
    """What is run, where its result is, and whether it keeps finished work."""

    words: list[str]
    result: str
    keeps: bool


def verbs(place: Path) -> dict[str, Verb]:
    study = place / "study.toml"
    study.write_text(STUDY.format(steps=150))
    return {
        "calibrate": Verb(["calibrate", str(EXAMPLE), "--starts", "24"], "fit.json", True),
        "tradeoff": Verb(["tradeoff", "impact", "--only", "tsit5", "--no-derivatives"], "tradeoff.csv", True),
        "study": Verb(["study", "run", str(study), "--workers", "2"], "results.parquet", True),
        "sensitivity": Verb(["sensitivity", "impact", "--wrt", "stiffness", "--budget", "2"], "sensitivity.csv", False),
        "design": Verb(
            ["design", "impact", "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--starts", "2"],
            "design.json", False,
        ),
        "reproduce": Verb(["reproduce"], "reproduce.json", False),
    }  # fmt: skip


def without_times(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: without_times(value) for key, value in content.items() if key not in _TIMES}
    return [without_times(value) for value in content] if isinstance(content, list) else content


def outcome(verb: Verb, folder: Path) -> str:
    """Digest of a result."""
    path = folder / verb.result
    if not path.exists():
        return "none"
    if path.suffix == ".json":
        text = json.dumps(without_times(json.loads(path.read_text())), sort_keys=True)
    elif verb.result == "tradeoff.csv":
        with path.open(newline="") as file:
            kept = ("setting", "force_rms_error", "peak_error", "impulse_error", "status", "steps")
            text = json.dumps([[row[name] for name in kept] for row in csv.DictReader(file)])
    else:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    return hashlib.sha256(text.encode()).hexdigest()


def trial(
    name: str, verb: Verb, place: Path, how: signal.Signals, moment: float, good: tuple[int, str]
) -> dict[str, Any]:
    """One run that is stopped; how it ended, and what came of it."""
    out = place / "out"
    words = [*verb.words, "--out", str(out)]
    # To a file: of a pipe that nobody reads meanwhile, a process that says much would wait for ever.
    with tempfile.TemporaryFile("w+") as file:
        job = start(words, place, stdout=subprocess.DEVNULL, stderr=file)
        wait_for(job, moment)
        running, before = job.poll() is None, resource.getrusage(resource.RUSAGE_CHILDREN)
        job.send_signal(how)
        code, _, _ = ended(job)
        file.seek(0)
        err = file.read()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    after = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime - moment
    left, traces = files(out), err.count("Traceback")
    row: dict[str, Any] = {
        "verb": name,
        "signal": how.name,
        "moment_s": round(moment, 2),
        "running": running,
        "after_s": round(after, 2),
        "code": code,
        "left": len(left),
    }
    row["said"] = last_line(err, place)
    # It was at its very end; a signal that is not heeded is a fault.
    finished = code == good[0] and (not running or after < _END_S)
    stopped = code == -how or (how != signal.SIGKILL and code == (5 if verb.keeps and left else 128 + how))
    row["clean"] = (
        traces == 0 and (finished or stopped) and not any(".bcfj-run" in x for x in left if how != signal.SIGKILL)
    )
    if not verb.keeps and how != signal.SIGKILL and not finished:
        row["clean"] = row["clean"] and not out.exists()
        row["same"] = None
    elif outcome(verb, out) == good[1] and not (out / NAME).exists():
        # It had ended, or was at its very end.
        row["same"] = True
    else:
        code, _, err = ended(start(words, place))
        row["again"], row["same"] = code, code == good[0] and outcome(verb, out) == good[1]
        if not row["same"]:
            row["said"] = last_line(err, place)
    shutil.rmtree(out, ignore_errors=True)
    return row


def table(names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """What came of the trials, a verb a row, and their sum."""
    counted = {
        "signals": lambda r: True, "while it ran": lambda r: r["running"],
        "right exit code, no traceback": lambda r: r["clean"], "folder as it was": lambda r: r["same"] is None,
        "run again": lambda r: "again" in r, "of these equal to the last bit": lambda r: "again" in r and r["same"] is True,
        "good": lambda r: r["clean"] and r["same"] is not False,
    }  # fmt: skip
    by = {name: [row for row in rows if name in (row["verb"], "all")] for name in (*names, "all")}
    cells = ([name, *(str(sum(map(of, own))) for of in counted.values())] for name, own in by.items())
    return [["verb", *counted], *cells]


def main() -> None:
    given = options(
        __doc__, trials=100, only="calibrate,tradeoff,study,sensitivity,design,reproduce",
        warm=(2, "undisturbed runs, the last of which is the measure"),
        more=(False, "run the trials that the results lack"), within=(math.inf, "latest processor time [s] of a signal"),
    )  # fmt: skip
    file = "kills_early" if math.isfinite(given.within) else "kills"
    rows: list[dict[str, Any]] = load(file)["trials"] if given.more else []
    # Each trial draws its own number, so that those to come do not depend on where a run of them ended.
    draws = [random.Random(number).random() for number in range(given.trials)]
    lasts, good = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        known = {name: verb for name, verb in verbs(place).items() if name in given.only.split(",")}
        for name, verb in known.items():
            for _ in range(given.warm):  # The first compiles.
                shutil.rmtree(place / "out", ignore_errors=True)
                ran = done(command([*verb.words, "--out", str(place / "out")]), place, environment())
                lasts[name], code = ran.cpu_s, ran.code
            good[name] = code, outcome(verb, place / "out")
            if code not in (0, 4):
                raise SystemExit(f"{name}: exit code {code}: {ran.err}")
            shutil.rmtree(place / "out")
            print(f"{name}: {lasts[name]:.1f} s of a processor undisturbed, exit code {code}", flush=True)
        for number in sorted(set(range(given.trials)) - {row["number"] for row in rows}):
            name = list(known)[number % len(known)]
            how = SIGNALS[number // len(known) % len(SIGNALS)]
            moment = 0.1 + draws[number] * (min(lasts[name], given.within) - 0.1)
            rows.append({"number": number, **trial(name, known[name], place, how, moment, good[name])})
            print(rows[-1], flush=True)
            save(file, {"undisturbed_processor_s": lasts, "trials": rows})
    counts = table(list(known), rows)
    save(file, {"undisturbed_processor_s": lasts, "counts": counts, "trials": rows})
    print(markdown(counts))


if __name__ == "__main__":
    main()
