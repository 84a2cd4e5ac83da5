"""Motion capture of a body tossed on a plane: its places and attitudes become a scene with a box, and a fit of its contact.

Every run starts from a state of its own, which is free within what its first rows and the sensor's noise leave open.
"""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.data.reading import read
from bcfj_jax.data.record import Record
from calibration.attitudes import rotation
from calibration.impacts.headers import stated_mass
from calibration.impacts.lines import Draft, Line, Said, box, scene_of, toml, with_scene
from calibration.impacts.otherwise import ATTITUDE, PLACES, InMotion
from calibration.impacts.parting import matching
from calibration.noise.scatter import scatter

# Rows from which a first state is told, and the deviations of it that its bounds leave open.
_FIRST, _OPEN = 8, 6.0
# Bounds of an inertia, of that of a full cube.
_INERTIAS = 0.7, 1.7
# A body at rest moves by less [m].
_STILL = 1e-3
# At least: what a law that misses a bounce may ask of the state before it, ten times the noise of usual motion capture.
_LEAST = {"place": 5e-3, "velocity": 0.1, "attitude": 0.05, "spin": 1.0}


class State(NamedTuple):
    """A first state: values and half widths of their bounds by a free body's coordinates and speeds, SI."""

    values: dict[str, float]
    halves: dict[str, float]


def first(clock: np.ndarray, places: np.ndarray, attitudes: np.ndarray, axis: int) -> State:
    """The state of the first row of a flight, by its first rows: clock (N,), places (3, N), attitudes (4, N) scalar first.

    ``axis``: upwards, 0 to 2.
    """
    rows = slice(0, min(_FIRST, clock.size))
    t, span = clock[rows] - clock[0], float(clock[rows][-1] - clock[0])
    values, halves = {}, {}
    for k, name in enumerate(PLACES):
        falls = 0.5 * GRAVITY * t**2 if k == axis else 0.0
        speed, place = np.polyfit(t, places[k, rows] + falls, 1)
        noise = scatter(places[k])
        values |= {name: float(place), f"v{name}": float(speed)}
        halves |= {
            name: max(_OPEN * noise, _LEAST["place"]),
            f"v{name}": max(_OPEN * noise / span, _LEAST["velocity"]),
        }
    q = attitudes / np.linalg.norm(attitudes, axis=0)
    turned = np.asarray(rotation(jnp.asarray(q[:, 1:_FIRST]), jnp.asarray(np.repeat(q[:, :1], _FIRST - 1, axis=1))))
    spin = (turned @ t[1:]) / (t[1:] @ t[1:])
    noise = max(scatter(row) for row in q)
    values |= {f"w{name}": float(w) for name, w in zip(PLACES, spin, strict=True)}
    halves |= {f"w{name}": max(2.0 * _OPEN * noise / span, _LEAST["spin"]) for name in PLACES}
    values |= {name: float(v) for name, v in zip(ATTITUDE, q[:, 0], strict=True)}
    halves |= {n: max(_OPEN * noise, _LEAST["attitude"]) for n in ATTITUDE}
    return State(values, halves)


def _read(table: Record, time: str, headers: dict[str, str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clock (N,), places (3, N) [m] and attitudes (4, N) of the rows that are whole."""
    clock = table.numbers(time, "s", table.name, False)
    found = np.array(
        [table.numbers(headers[k], "m" if k in PLACES else "1", table.name, True) for k in (*PLACES, *ATTITUDE)]
    )
    whole = np.asarray(np.isfinite(found).all(axis=0))
    if np.count_nonzero(whole) < 2 * _FIRST or not whole[0]:
        raise InputError(table.name, f"fewer than {2 * _FIRST} rows have all places and attitudes", "give a whole toss")
    return clock[whole], found[:3, whole], found[3:, whole]


def _flight(clock: np.ndarray, places: np.ndarray) -> tuple[int, int]:
    """The row from which a toss falls, and the axis along which its second derivative is then nearest to gravity, downwards.

    That is the first row, or where a body is held at first the first of several from each of which it falls.
    """
    spans = [slice(k, k + _FIRST) for k in range(clock.size - _FIRST + 1)]
    bends = 2.0 * np.array([np.polyfit(clock[s] - clock[s.start], places[:, s].T, 2)[0] for s in spans])
    falls = np.abs(bends + GRAVITY).min(axis=1) <= 0.5 * GRAVITY
    rows = np.flatnonzero(np.convolve(falls, np.ones(_FIRST), "valid") > _FIRST - 0.5)
    if not (falls[0] or rows.size):
        shown = ", ".join(f"{b:.3g}" for b in bends[0])
        found = f"its first rows fall along no axis: {shown} m/s^2 along x, y, z"
        raise InputError("record", found, "begin it in flight, up positive")
    begin = 0 if falls[0] else int(rows[0])
    return begin, int(np.argmin(np.abs(bends[begin] + GRAVITY)))


class Toss(NamedTuple):
    """One run: its clock (N,) [s] from its first row in flight on, places (3, N) [m], first state, and when it begins [s]."""

    clock: np.ndarray
    places: np.ndarray
    state: State
    begins: float

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Of its first state, by name."""
        values, halves = self.state
        return {name: (x - halves[name], x + halves[name]) for name, x in values.items()}


def draft(moved: InMotion, record: Path, said: Said, path: Path, file: str) -> Draft:
    """The problem file at ``path`` of tossed bodies: a box's corners on a plane, and a first state of each run.

    ``file``: the record as the problem file names it.
    """
    headers, time, runs, axes = moved.columns, said.hints.time or moved.table.clock, [], set[int]()
    if not time:
        raise InputError(moved.table.name, "no column is a time", 'say how often was sampled: --rate "200 Hz"')
    paths = [(one, table) for one in matching(record) for table in moved.tables]
    for one, inside in paths:
        clock, places, attitudes = _read(read(one, "record", inside, said.stated), time, headers)
        begin, axis = _flight(clock, places)
        axes.add(axis)
        if len(axes) > 1:
            raise InputError(str(one), "it falls along another axis than the first", "let all fall along one axis")
        begins, places, attitudes = float(clock[begin]), places[:, begin:], attitudes[:, begin:]
        clock = clock[begin:] - begins
        runs.append(Toss(clock, places, first(clock, places, attitudes, axis), begins))
    half, mass = _resting(runs, max(axes)), said.number("mass", "kg") or stated_mass(moved.table)
    # The component of the attitudes that stays in every run: the length of a quaternion says nothing.
    fixed = max(ATTITUDE, key=lambda n: min(abs(t.state.values[n]) for t in runs))
    names = {"place": PLACES, "attitude": ATTITUDE}
    observed = ", ".join(f'"body.{what}.{n}" = {toml(headers[n])}' for what, keys in names.items() for n in keys)
    lines: list[Line | str] = [
        f"# A body in motion, {record.name}, proposed by bcfj init calibration. Next: bcfj calibrate {quote(path.name)}",
        *([f"# Read as {moved.table.found}."] if moved.table.found else []),
        Line(f"scene = {toml(scene_of(path).name)}", "a box on a plane: CHECK its size and inertia there"),
        Line('sensor = "exact"', "each run has its own first state in place of a clock and zero"),
    ]
    for (one, inside), toss in zip(paths, runs, strict=True):
        place = (Path(file).parent / one.name).as_posix()
        bounds = ", ".join(
            f'"body.{n}" = [{low:.6g}, {high:.6g}]' for n, (low, high) in toss.bounds.items() if n != fixed
        )
        lines += [
            "[[experiment]]",
            f"file = {toml(place)}",
            *([f"table = {toml(inside)}"] if inside else []),
            f"time = {toml(time)}",
            f"observe = {{ {observed} }}",
            'noise = "estimate"',
            *([f'window = ["{toss.begins:.9g} s", "{toss.begins + toss.clock[-1]:.9g} s"]'] if toss.begins else []),
            f'parameters = {{ "body.{fixed}" = {toss.state.values[fixed]:.6g}, time_offset = {toss.begins:.9g} }}',
            f"bounds = {{ {bounds} }}",
        ]
    lines += ["[free]", *_free(runs, half, mass, fixed)]
    kind = f"places and attitudes are those of a tossed body: CHECK its size and inertia in {scene_of(path)}"
    kind += f'; of a ball take its height alone: --observe "{headers[PLACES[max(axes)]]}"'
    missing = "" if half else "write the sizes in place of the question marks, then "
    return with_scene(path, _scene(runs, max(axes), half, mass), lines, kind, missing)


def _resting(tosses: list[Toss], axis: int) -> float | None:
    """The height at which the body comes to rest [m], half the height of a box on a plane at 0; None where it does not."""
    ends = [t.places[:, -max(_FIRST, t.clock.size // 10) :] for t in tosses]
    still = [float(np.median(end[axis])) for end in ends if np.ptp(end, axis=1).max() < _STILL]
    return float(np.median(still)) if still and min(still) > 0.0 else None


def _scene(tosses: list[Toss], axis: int, half: float | None, mass: float | None) -> str:
    """The scene file: a box that flies, a plane, gravity."""
    m, up = mass or 1.0, PLACES[axis]
    size, inertia = (f'"{1e3 * half:.4g} mm"', f"{_full(half, m):.3g}") if half else ('"? mm"', '"? kg m^2"')
    start = ", ".join(f"{n} = {v:.6g}" for n, v in tosses[0].state.values.items())
    known = "as given, or as the file states" if mass else "unknown from places: stiffness is for a mass of 1 kg"
    gap = '"box_on_plane"' if up == "z" else f'{{ kind = "box_on_plane", axis = "{up}" }}'
    return f"""# A body tossed on a plane; written by bcfj init calibration.
[scene]
kind = "mechanism"
[[body]]
name = "body"
joint = "free"
start = {{ {start} }}  # of the first run; wx, wy, wz in the world's axes
[[contact]]
name = "corner"
between = ["ground", "body"]
gap = {gap}  # eight corners
friction = "coulomb"
[[load]]
kind = "gravity"
direction = "-{up}"
[parameters]
mass = "{m:.4g} kg"  # {known}
inertia = {inertia}  # of a full cube, about every axis; CHECK
half_length = {size}  # CHECK: half the height at which it rests
half_width = {size}
half_height = {size}
gravity = {GRAVITY}
stiffness = {m * GRAVITY / 1e-4:.3g}  # a tenth of a millimetre under its weight
exponent = 1.0
damping = 5.0
friction_dynamic = 0.2
friction_speed = "20 mm/s"
[time]
end = {float(max(t.clock[-1] for t in tosses)):.6g}
samples = {max(t.clock.size for t in tosses)}
"""


def _full(half: float, mass: float) -> float:
    """Moment of inertia of a full cube about every axis [kg m^2]; a hollow one has 5/3 of it."""
    return 2.0 / 3.0 * mass * half**2


def _free(tosses: list[Toss], half: float | None, mass: float | None, fixed: str) -> list[Line]:
    """What is searched: the contact, the inertia, and each run's first state within bounds that hold all."""
    weight = (mass or 1.0) * GRAVITY
    stiff = (f"{weight / 2e-3:.2g}", f"{weight / 1e-5:.2g}")
    lines = [
        box("stiffness", stiff, "N/m; 2 mm to 10 um under its weight"),
        box("damping", ("0.05", "50.0"), "s/m"),
        box("friction_dynamic", ("0.02", "1.0")),
    ]
    if half:
        ends = (f"{share * _full(half, mass or 1.0):.3g}" for share in _INERTIAS)
        lines.append(box("inertia", ends, "kg m^2; of a full to a hollow cube"))
    for n in tosses[0].state.values:
        if n != fixed:
            low, high = min(t.bounds[n][0] for t in tosses), max(t.bounds[n][1] for t in tosses)
            lines.append(box(f'"body.{n}"', (f"{low:.6g}", f"{high:.6g}"), more=", each = true"))
    return lines
