"""Slow tests, of a body that is driven into a contact, forces that pull as they push, and motions without a contact."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.io.units import column, format_si
from calibration.impacts.events import bent, turning
from calibration.impacts.lines import NOISE, Draft, Line, Said, box, read_as, scene_of, toml, with_scene
from calibration.impacts.otherwise import Steady
from calibration.impacts.proposal import Run, Understood, first_and_last
from calibration.noise.scatter import scatter

# A contact of a body that strikes is shorter [s]; up to its peak such a body loses at least that share of its speed, and before
# contact its speed changes by less than that share of how it does in contact.
_LONG, _LOST, _LED = 1.0, 0.1, 0.3
# A force that pulls: its ends are alike but for this share of its range, and this share of the samples is near each.
_ALIKE, _PULLS = 0.33, 0.1
# Friction takes at least this share of the power that goes to and fro; a spring none.
_RUBS = 0.5
# Friction is above half its peak on that share of the way, and changes along it by less than this share of itself.
_GOES_ON, _LEVEL = 0.8, 0.5
# Of a loop the share of the work that comes back from which on nothing is lost.
_ELASTIC = 0.96
# A steady force rises with speed where it ends by so much above its least beyond the peak.
_RISES = 1.05
# A curve falls from its slowest row on if it begins at this share of its greatest.
_EARLY = 0.8
# Of a table of places the least rows, and the share of its range to which it follows them; samples up to a peak by which a
# speed is told, rows of a curve of steady states.
_FINE, _ROWS, _FEW, _STEADY = 1e-3, 300, 4, 8
_DRIVEN = (
    'write a scene file whose body follows the measured displacement, drive = { kind = "table", table = [[times], [places]] }, '
    "and a calibration file that observes its force: docs/howto/force_displacement.md#by-hand (play: #bodies-that-turn)"
)

# A contact that throws a body back by less than that share of its speed is a shorter share of a record.
_BACK, _WHOLE = 0.1, 0.3
# A place leaves its line in a contact by more than so many times its noise, or that share of its range, which is rounding.
_SEEN, _ROUNDED = 6.0, 1e-4
_SLIDES = "docs/howto/force_displacement.md#a-body-that-slides-to-rest"


def refuse(found: Understood) -> None:
    """Refuse places or velocities of one body, that does not fall, which hold no contact; forces and accelerations pass."""
    if found.falls or found.body == "struck" or not found.columns.keys() <= {"m", "m/s"}:
        return
    header = next(iter(found.columns.values())).removeprefix("-")
    for run in found.records:
        said = _turned(run) if "m/s" not in run.readings else ""
        way = "sample faster; or fit the loss to that restitution, as a result: docs/howto/problem_file.md#results"
        if _lasts(run):
            said = "changes its speed over most of the record, as friction or a slope does, and a contact is short"
            way = f"write a scene of a body that slides to rest: {_SLIDES}; to take it as an impact give --scene impact"
        if said:
            raise InputError(f"{found.path} {run.name}", f"'{header}' {said}", way)


def _lasts(run: Run) -> bool:
    """Whether what would be the contact is a large part of the record, and does not throw the body back."""
    before, after = first_and_last(_speed(run))
    long = run.events[0].last - run.events[0].first > _WHOLE * run.clock.size
    return bool(long and after * before > -_BACK * before**2)


def _turned(run: Run) -> str:
    """The speeds and the restitution of places that turn between two samples, and so show no law; "" of others."""
    seen = np.isfinite(run.readings["m"])
    clock, places = run.clock[seen], run.readings["m"][seen]
    turn = turning(clock, places)
    if not 4 <= turn <= clock.size - 5:
        return ""
    (before, level), (after, _) = (np.polyfit(clock[k], places[k], 1) for k in (slice(turn), slice(turn + 1, None)))
    away = np.abs(places[:turn] - level - before * clock[:turn]).max()
    if away > max(_SEEN * scatter(places), _ROUNDED * float(np.ptp(places))) or before * after > 0.0:
        return ""
    speeds = " before and ".join(format_si(abs(v), "m/s", 3) for v in (before, after))
    return f"turns between two samples: they show {speeds} after, a restitution of {abs(after / before):.3g}, but no contact"


def pulls(run: Run, where: str) -> bool:
    """Whether a force pulls about as it pushes, or stays as the body goes on; refused where its motion is not friction's."""
    if _slides(run):
        return True
    force = run.readings.get("N", np.zeros(0))
    force = force[np.isfinite(force)]
    if force.size < _FEW:
        return False
    # Of three readings the middle one: a wrong sample is no pull.
    middle = np.median([force[:-2], force[1:-1], force[2:]], axis=0)
    high, low = float(middle.max()), float(middle.min())
    shares = np.mean(middle > 0.5 * high), np.mean(middle < 0.5 * low)
    found = high > 0.0 > low and abs(high + low) < _ALIKE * (high - low) and min(shares) > _PULLS
    # A slow test's force that falls below 0, and below its rest, is no ringing.
    beyond = np.where(np.abs(x := middle - min(run.rest("N"), 0.0)) > 6.0 * scatter(force), x, 0.0)
    found = found or (is_slow(run) and -beyond.clip(max=0.0).sum() > 2.0 * _PULLS * beyond.clip(min=0.0).sum())
    if found and not abs(_taken(run)) > _RUBS:
        found = "the force pulls as it pushes, as friction and joints with two sides do, and a contact only pushes"
        raise InputError(where, found, f"{_DRIVEN}; to take it as impacts all the same give --scene impact")
    return bool(found)


def _slides(run: Run) -> bool:
    """Whether a force stays about the same over most of the way on which there is one: one that presses grows with depth."""
    if "N" not in run.readings or run.events[0].duration < _LONG:
        return False
    force, steps = run.readings["N"] - run.rest("N"), np.nan_to_num(_speed(run) * np.gradient(run.clock))
    way, place = np.abs(steps) * np.isfinite(force), np.nan_to_num(run.readings.get("m", np.cumsum(steps)))
    force, peak = np.nan_to_num(force), float(np.nanmax(force))
    high = way * (force > 0.5 * peak)
    if not high.sum() > _GOES_ON * (way * (force > 0.05 * peak)).sum() > 0.0:
        return False
    slope = float(np.polyfit(place, force, 1, w=np.sqrt(high))[0])
    return abs(slope) * float(np.ptp(place[high > 0.0])) < _LEVEL * float(np.average(force, weights=high))


def _speed(run: Run) -> np.ndarray:
    """Measured, or of the measured places [m/s]; not a number where neither is."""
    if "m/s" in run.readings:
        return run.readings["m/s"]
    return np.gradient(run.readings["m"], run.clock) if "m" in run.readings else np.full(run.clock.size, np.nan)


def _taken(run: Run) -> float:
    """Power of the force along the motion over its size, -1 to 1: its sign is that of a force along the motion; 0 of none."""
    power = run.readings["N"] * _speed(run)
    whole = float(np.nansum(np.abs(power)))
    return float(np.nansum(power)) / whole if whole > 0.0 else 0.0


def is_slow(run: Run) -> bool:
    """Whether force and place are those of a slow test: the body is driven into the contact, which does not slow it down."""
    if not {"N", "m"} <= run.readings.keys():
        return False
    event, place = run.events[0], run.readings["m"]
    peak = event.first + int(np.nanargmax(run.readings["N"][event.first : event.last + 1]))
    way, speeds = peak - event.first, []
    # Some instruments show no place before the touch: the speed at first is then that of the first third.
    before, early = slice(max(event.first - way, 0), event.first + 1), slice(event.first, event.first + way // 3 + 1)
    for rows in (before, early, slice(event.first, peak + 1)):
        t, x = (values[rows][np.isfinite(place[rows])] for values in (run.clock, place))
        speeds.append(abs(float(np.polyfit(t, x, 1)[0])) if t.size >= _FEW else 0.0)
    at_first = speeds[1] if speeds[0] < 0.8 * speeds[1] else speeds[0]
    return event.duration > _LONG or bool(speeds[2] > (1.0 - _LOST) * at_first > 0.0) or _is_led(run)


def _is_led(run: Run) -> bool:
    """Whether a place bends before a contact about as in it, and does not fall: a machine moves the body to and fro."""
    event, place, span = run.events[0], run.readings["m"], run.events[0].duration / 2.0
    if min(event.first, event.last - event.first) < 4 * _FEW:
        return False
    pieces = slice(0, event.first + 1), slice(event.first, event.last + 1)
    before, inside = (float(np.median(np.abs(bent(run.clock[p], place[p], span)))) for p in pieces)
    noise = 2.0 * scatter(place[np.isfinite(place)]) * np.sqrt(180.0 * event.step / span) / span**2
    return bool(before > max(_LED * inside, 3.0 * noise) and abs(before / GRAVITY - 1.0) > 0.5)


def draft(found: Understood, said: Said, path: Path, file: str) -> Draft:
    """The problem file at ``path`` of a slow test, which names the record ``file``."""
    if found.runs[0]:
        many = f"{found.runs[1]} slow tests, by {found.runs[0]}"
        way = f'--rows "{found.runs[0]} = 1"'
        if found.parts:
            many, one = f"{found.runs[1]} slow tests beside each other", found.parts[0].columns["N"].removeprefix("-")
            way = f'--observe "{one}" for the first'
        raise InputError(str(found.path), many, f"choose one: {way}")
    rubbed = pulls(found.records[0], str(found.path))
    scene, free, reading = (_rubbed if rubbed else _driven)(found.records[0])
    # Its sign may be turned already, and is turned back then.
    column = ("-" * reading.startswith("-") + found.columns["N"]).removeprefix("--")
    lines = [
        f"# A slow test, {found.path.name}: the body is driven, its mass does not count. Next: bcfj calibrate {quote(path.name)}",
        *([f"# Read as {found.said}."] if found.said else []),
        Line(f"scene = {toml(scene_of(path).name)}", "in which the body follows the measured motion"),
        "[[experiment]]",
        *read_as(found, said, file),
        f'observe = {{ "{reading.removeprefix("-")}" = {toml(column)} }}',
        NOISE,
        "[free]",
        *free,
    ]
    what = "a force that pulls as it pushes, or stays as the body goes on, is taken for friction of a driven body"
    what = what if rubbed else "force and displacement are those of a slow test"
    kind = f"{what}, no impact; --scene impact takes one all the same"
    return with_scene(path, scene, lines, kind)


def _motion(run: Run) -> str:
    """The drive that follows the measured places, or else speeds."""
    unit = "m" if "m" in run.readings else "m/s"
    seen = np.flatnonzero(np.isfinite(run.readings[unit]))
    whole = run.readings[unit][seen]
    noise = max(2.0 * scatter(whole), _FINE * float(np.ptp(whole)))
    for count in _ROWS * 2 ** np.arange(16):  # Until what lies between the rows is noise.
        rows = seen[np.unique(np.linspace(0, seen.size - 1, min(count, seen.size)).astype(int))]
        clock, values = run.clock[rows], run.readings[unit][rows]
        if np.std(whole - np.interp(run.clock[seen], clock, values)) <= noise:
            break
    values = values - values[0] if unit == "m" else values
    if clock[0] > 0.0:  # Steady states, the first of which is reached from time 0 on.
        clock, values = np.r_[0.0, clock], np.r_[values[0], values]
    table = ", ".join("[" + ", ".join(f"{x:.6g}" for x in row) + "]" for row in (clock, values))
    return f'drive = {{ kind = "{"table" if unit == "m" else "speeds"}", table = [{table}] }}'


def steady(curve: Steady, path: Path) -> Draft:
    """The problem file at ``path`` of friction against speed: rows by their speed, states of a driven body, one a second."""
    table, (speed, rubs, presses) = curve.table, curve.columns
    unit = "N" if column(rubs)[1] is not None or presses else "1"
    values = [table.numbers(h, u, table.name, True) for h, u in ((speed, "m/s"), (rubs, unit), (presses, "N")) if h]
    speeds, forces = np.abs(values[0]), np.abs(values[1] / values[2] if presses else values[1])
    # Where nothing slides friction is what it has to be.
    seen = np.flatnonzero(np.isfinite(speeds) & np.isfinite(forces) & (speeds > 0.0))
    seen = seen[np.argsort(speeds[seen], kind="stable")]
    seen = seen[np.unique(np.linspace(0, seen.size - 1, min(_ROWS, seen.size)).astype(int))] if seen.size else seen
    if seen.size < _STEADY:
        few = f"{seen.size} rows hold a speed above 0 and friction"
        raise InputError(table.name, few, f"give {_STEADY} or more")
    speeds, forces, ratio = speeds[seen], forces[seen], bool(presses) or unit == "1"
    run = Run("", 1.0 + np.arange(seen.size), {"m/s": speeds, "N": forces}, [])
    data = path.with_name(f"{path.stem}_states.csv")
    of = "ratio to a normal force of 1 N" if ratio else "force"
    scene, free = _stribeck(run)
    lines = [
        f"# Friction against speed, {table.name}, as a {of}. Next: bcfj calibrate {quote(path.name)}",
        Line(f"scene = {toml(scene_of(path).name)}", "in which the body goes from speed to speed"),
        Line('sensor = "exact"', "steady states have no clock"),
        "[[experiment]]",
        Line(f"file = {toml(data.name)}", "the rows above speed 0, by their speed, one a second; no inertia counts"),
        'time = "time [s]"',
        'observe = { "body.drive" = "friction [N]" }',
        NOISE,
        Line("[instrument]", "a state is a second long: neither clock nor lag counts"),
        'bandwidth = "1 kHz"',
        'resonance = "1 kHz"',
        'clock = "0 s"',
        "[free]",
        *free,
    ]
    kind = f"friction against speed without a clock: its rows are taken for steady states, the {of} is fitted"
    found = with_scene(path, scene, lines, kind)
    rows = "\n".join(f"{t:.0f},{v:.9g},{x:.9g}" for t, v, x in zip(run.clock, speeds, forces, strict=True))
    return found._replace(files={data: f"time [s],speed [m/s],friction [N]\n{rows}\n", **found.files})


def _stribeck(run: Run) -> tuple[str, list[Line]]:
    """A scene of a body that is driven against friction which falls with speed, and with a viscous part if it rises again.

    Friction that falls from the slowest row on is LuGre's, mu_d + (mu_s - mu_d) exp(-(v/v_s)^2) at steady slip, with
    bristles that bend within a hundredth of a second; else the law begins at 0.
    """
    speeds, force = run.readings["m/s"], run.readings["N"]
    smooth = np.median([force[:-2], force[1:-1], force[2:]], axis=0)
    top = int(np.argmax(smooth[: max(smooth.size // 2, 1)]))
    least, ends, most, fast = float(smooth[top:].min()), float(smooth[-1]), float(smooth[top]), float(speeds[-1])
    rises, falls = ends > _RISES * least, float(smooth[0]) > _EARLY * most
    half = top + int(np.argmax(smooth[top:] < 0.5 * (most + least)))
    law, low = ("lugre", f"bristle_stiffness = {100.0 * most / speeds[0]:.3g}\n") if falls else ("brown_mcphee", "")
    spring = f"""[[load]]
kind = "spring"
name = "oil"
between = ["ground", "body"]
damping = {(ends - least) / fast:.3g}
"""
    scene = f"""{_follows(run, "Friction against speed", 0)}[[load]]
kind = "joint_friction"
name = "friction"
body = "body"
friction = "{law}"
breakaway = {most:.3g}
sliding = {least:.3g}
speed = {max(float(speeds[(half if falls else top) + 1]), 1e-3 * fast):.3g}
{low}{spring if rises else ""}[time]
end = {run.clock[-1]:.6g}
samples = {run.clock.size}
"""
    ends_of = f"{0.3 * least:.1g}", f"{3 * most:.1g}"
    free = [
        box('"friction.breakaway"', ends_of, "N; the greatest, at the speed below"),
        box('"friction.sliding"', ends_of, "N; of fast motion"),
        box('"friction.speed"', (f"{1e-4 * fast:.1g}", f"{fast:.1g}"), "m/s"),
    ]
    viscous = box('"oil.damping"', ("0.0", f"{10 * (ends - least) / fast:.1g}"), "N s/m; it rises again")
    return scene, [*free, viscous] if rises else free


def _follows(run: Run, what: str, mass: object) -> str:
    """The first lines of a scene: a body that follows the measured motion."""
    return f"""# {what}: the body follows the measured motion, and no inertia counts; written by bcfj init calibration.
[scene]
kind = "mechanism"
[[body]]
name = "body"
joint = "slide"
axis = "x"
mass = {mass}
{_motion(run)}
"""


def _rubbed(run: Run) -> tuple[str, list[Line], str]:
    """A scene in which a body without mass follows the measured motion against dry friction; what is searched, and read."""
    force, clock = run.readings["N"], run.clock
    size, fast = float(np.nanmedian(np.abs(force))), float(np.nanmax(np.abs(_speed(run))))
    scene = f"""{_follows(run, "Friction", 0)}[[load]]
kind = "joint_friction"
name = "friction"
body = "body"
sliding = {size:.3g}
speed = {0.03 * fast:.3g}
[time]
end = {clock[-1]:.6g}
samples = {clock.size}
"""
    free = [
        box('"friction.sliding"', (f"{size / 30:.1g}", f"{30 * size:.1g}"), "N"),
        box('"friction.speed"', (f"{1e-4 * fast:.1g}", f"{fast:.1g}"), "m/s; friction fades below it"),
    ]
    return scene, free, f"{'-' if _taken(run) > 0.0 else ''}friction.drive"


def _driven(run: Run) -> tuple[str, list[Line], str]:
    """A scene in which a body follows the measured places, and what of its contact is searched."""
    seen, clock = np.flatnonzero(np.isfinite(run.readings["m"])), run.clock
    force, event = run.readings["N"] - run.rest("N"), run.events[0]
    peak = event.first + int(np.nanargmax(force[event.first : event.last + 1]))
    places = np.interp(run.clock, run.clock[seen], run.readings["m"][seen])
    touch, deep = (float(places[k] - places[0]) for k in (event.first, peak))
    depth = max(deep - touch, 1e-3 * deep)
    # A press that comes back shows what it lost.
    taken = float(np.trapezoid(np.nan_to_num(force[: peak + 1]), places[: peak + 1]))
    # Of several cycles it is the first.
    last = run.events[1].first if len(run.events) > 1 else places.size
    given = -float(np.trapezoid(np.nan_to_num(force[peak:last]), places[peak:last]))
    back = bool(places[last - 1] - places[0] < touch + 0.5 * depth) and given < _ELASTIC * taken
    ends = [float(force[peak]) / depth**n for n in ((1.0,) if back else (1.0, 2.5))]
    law = 'law = "walton_braun"\n' if back else ""
    values = "restitution = 0.7" if back else "exponent = 1.0\ndamping = 0.0"
    scene = f"""{_follows(run, "A slow test", '"1 kg"')}[[contact]]
name = "contact"
between = ["ground", "body"]
gap = {{ kind = "point_on_plane", axis = [-1.0, 0.0, 0.0], clearance = true }}
{law}[parameters]
stiffness = {ends[0]:.3g}
{values}
"contact.clearance" = {max(touch, 0.0):.3g}
[time]
end = {clock[-1]:.6g}
samples = {clock.size}
"""
    shape = ("restitution", ("0.05", "1.0")) if back else ("exponent", ("1.0", "2.5"))
    return (
        scene,
        [
            box("stiffness", (f"{min(ends) / 30:.1g}", f"{30 * max(ends):.1g}")),
            box(*shape),
            box('"contact.clearance"', ("0.0", f"{touch + 0.5 * depth:.3g}"), "m; where the body touches"),
        ],
        "contact.normal",
    )
