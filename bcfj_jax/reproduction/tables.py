"""The claims beside the model's values, as rows for people and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bcfj_jax.io.page import by_columns
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.reproduction.claims import CLAIMS, FIGURE, INPUT, Claim
from bcfj_jax.reproduction.fit import ERROR, KNOWN, TARGETS, UNKNOWNS, PeakFit, combination, targets
from bcfj_jax.reproduction.frames import FRAMED, FRAMES
from bcfj_jax.reproduction.measures import Inequality, Measured, onset_remark

VARIANTS = ("as given", "sudden start", "calibrated")
HEAD = ["id", "quantity", "paper", *VARIANTS, "verdict", "read in", "picture", "remark"]
REACHED, MISSED, OPEN = "reached", "missed", "undecidable"
# Claims about the start, which the paper gives no drive or load over time for.
GUESSED = "the paper gives neither drive nor load over time: the start is a guess (load_ramp)"
_WHY_OPEN = {
    "Q24": "the paper's table is missing",
    "Q29": f"{GUESSED}; a time of first load, not a lag of two histories. {onset_remark()}",
    "Q30": GUESSED,
    "Q31": GUESSED,
}
# How each claim was measured, and its picture.
READ = {
    "Q17": ("autocorrelation of each component, 1.2 to 3 s", "frames.png"),
    "Q18": ("greatest less smallest of Q17", "frames.png"),
    "Q19": ("1 over the normal period of Q17", "frames.png"),
    "Q20": ("largest normal force of the run", "point_1_seat_cage.png"),
    "Q21": ("largest normal force of the run", "point_2_head_cage.png"),
    "Q22": ("best correlation of the normal components", "frames.png"),
    "Q23": ("least and largest force along the cage's axis", "point_3_cage_ball.png"),
    "Q24": ("sum of forces less mass times acceleration", "-"),
    "Q25": ("autocorrelation of ball 1", "point_4_seat_ball.png"),
    "Q26": ("largest resultant of any ball", "point_4_seat_ball.png"),
    "Q27": ("largest resultant of any ball", "point_5_head_ball.png"),
    "Q28": ("loss between the peaks of points 4 and 5", "point_5_head_ball.png"),
    "Q29": ("first ball at 5 % of its settled peak", "sudden_start.png"),
    "Q30": ("pilots bear without a break", "sudden_start.png"),
    "Q31": ("every ball repeats itself within 5 %", "point_4_seat_ball.png"),
    "Q35": ("half range of the polynomial's residual, absolute", "no_clearance_fit.png"),
    "Q36": ("half range of the polynomial's residual, absolute", "no_clearance_fit.png"),
    "Q37": ("inequalities, table below", "small_clearances.png"),
}
FITTED_TO = "Q20, Q21, Q23, Q26, Q27"
FITTED = tuple(FITTED_TO.split(", "))
AS_GIVEN = (
    "As given: the scene's defaults, nothing fitted. The paper states speed, torque, angle, friction and exponent; the "
    "others are sizes of the same group's joint, derived from them, or guesses marked GUESS in "
    "bcfj_jax/models/joint/defaults.py."
)
CALIBRATED = (
    f"Calibrated: {len(UNKNOWNS)} unknowns fitted to {FITTED_TO}; not a prediction for these rows. They were fitted in "
    "the quasistatic model without friction; the column is what the dynamic model with friction gives at the fitted "
    "values."
)
MISFIT = (
    "The fit misses part of what it was fitted to: its values estimate no real joint, and the rest of the calibrated "
    "column is what this model does at them, nothing more."
)
BOUNDED = (
    "The calibration stays inside physical bounds, and the stiffness of the pilots follows their play (Lankarani and "
    "Nikravesh)."
)
SETTLED_WINDOW = (
    "Both signs of 15 kN at a window are no settled state: with balls of at most 39.84 kN a static balance gives 1.65 kN "
    "of both signs on the bisector (linear program), 12.6 kN with any tilting moment that friction could give."
)

# Numbers for each claim by variant.
Found = Mapping[str, Mapping[str, Measured]]


def _decided(row: Claim, found: Mapping[str, Measured] | None) -> tuple[float, ...]:
    """A run's numbers for a claim that they can decide; none where either has none, or a guess decides."""
    values = found[row.id].values if found is not None and row.id in found else ()
    open_ = row.id in _WHY_OPEN or len(values) != len(row.values) or not all(map(math.isfinite, values))
    return () if open_ else values


def verdict_of(row: Claim, found: Mapping[str, Measured] | None) -> str:
    """Whether a run's numbers reach a claim within ``ERROR``."""
    if not (values := _decided(row, found)):
        return OPEN
    met = all(abs(v - p) <= ERROR * abs(p) for v, p in zip(values, row.values, strict=True))
    return REACHED if met else MISSED


def shown(values: Sequence[float], unit: str) -> str:
    """Numbers for people; units apart by a comma belong to one number each."""
    units = unit.split(", ")
    units = units if len(units) == len(values) else units * len(values)
    return ", ".join(f"{v:.3%}" if u == "%" else format_si(v, u, 4) for v, u in zip(values, units, strict=True))


def used(params: Params, end: float, step: float, balls: int) -> dict[str, str]:
    """What the model takes for each input of the paper."""
    p = {name: float(value) for name, value in params.items()}
    modulus = format_si(DEFAULTS["effective_modulus"][0], "Pa", 4)
    return {
        "Q3": "not in the model",
        "Q4": format_si(end, "s"),
        "Q5": f"output every {format_si(step, 's')}; the solver's steps are its own",
        "Q6": f"ball of {format_si(p['ball_mass'], 'kg', 4)}",
        "Q7": f"in the derived stiffnesses ({modulus} effective)",
        "Q8": "in the derived stiffnesses",
        "Q9": f"{p['friction_static']:g}, {p['friction_dynamic']:g}",
        "Q10": "not read by the law used",
        "Q11": "not read by the law used",
        "Q12": f"{p['exponent']:g}",
        "Q13": f"{180 - math.degrees(p['joint_angle']):g} deg",
        "Q14": f"{p['drive_speed'] * 30 / math.pi:g} r/min",
        "Q15": format_si(p["load_torque"], "N m"),
        "Q16": str(balls),
        **dict.fromkeys(("Q32", "Q33", "Q34"), "as the paper's"),
    }


def _cell(row: Claim, found: Mapping[str, Measured] | None, tests: Sequence[Inequality] | None) -> str:
    if row.id == "Q37" and tests is not None:
        known = [t.holds for t in tests if t.holds is not None]
        unknown = len(tests) - len(known)
        return f"{sum(known)} of {len(known)} hold{f', {unknown} unknown' if unknown else ''}"
    if row.kind != FIGURE or found is None or row.id not in found:
        return "-"
    shares = [v / p - 1.0 for v, p in zip(_decided(row, found), row.values, strict=False)]
    miss = f" ({', '.join(f'{share:+.0%}' for share in shares)})" if all(abs(x) < 10.0 for x in shares) else ""
    return shown(found[row.id].values, row.unit) + (miss if shares else "")


def rows(
    inputs: Mapping[str, str], measured: Found, tests: Mapping[str, Sequence[Inequality]], framed: Mapping[str, str]
) -> list[list[str]]:
    """The table, its titles first, from ``used`` and, by variant, ``measured`` and ``tests``; ``framed``: by claim the frame in
    which its number was read, where that is not the contact's.
    """
    table = [HEAD]
    for row in CLAIMS:
        found = [measured.get(name) for name in VARIANTS]
        cells = [_cell(row, one, tests.get(name)) for name, one in zip(VARIANTS, found, strict=True)]
        read, picture, verdict = "-", "-", "-"
        if row.kind == INPUT:
            cells = [inputs[row.id]] * len(VARIANTS)
        if row.kind == FIGURE:
            how, picture = READ[row.id]
            read = f"{framed.get(row.id, 'contact')} axes; {how}"
            words = [verdict_of(row, one) for one in found]
            verdict = words[0] if len(set(words)) == 1 else "; ".join(words)
        if row.id == "Q37":
            verdict = "one by one, below"
        fitted = "calibrated: fitted to this, no prediction; sudden start: met by hand" if row.id in FITTED else ""
        remark = found[0][row.id].remark if found[0] is not None and row.id in found[0] else ""
        remarks = (row.remark, fitted, _WHY_OPEN.get(row.id, ""), f"model: {remark}" if remark else "")
        whole = "; ".join(filter(None, remarks))
        table.append([row.id, row.quantity, row.printed, *cells, verdict, read, picture, whole])
    return table


def frame_rows(found: Mapping[str, Mapping[str, Mapping[str, tuple[float, ...]]]]) -> list[list[str]]:
    """Claims whose number depends on the frame, by variant and frame; the first row has the paper's."""
    ids = [row for row in CLAIMS if row.id in FRAMED]
    table = [["run", "axes", *(row.id for row in ids)]]
    table.append(["paper", "not stated", *(shown(row.values, row.unit) for row in ids)])
    for name, frames in found.items():
        for frame, values in frames.items():
            table.append([name, FRAMES[frame], *(shown(values[row.id], row.unit) for row in ids)])
    return table


def residual_rows(found: Mapping[str, Mapping[str, tuple[float, float]]]) -> list[list[str]]:
    """Residuals of the polynomial's fit by run and contact: absolute and relative, always both."""
    table = [["run", "contact", "rms, absolute", "rms over mean fit, relative"]]
    for name, contacts in found.items():
        table += [[name, contact, format_si(a, "N", 3), f"{r:.3f}"] for contact, (a, r) in contacts.items()]
    return table


def inequality_rows(tests: Mapping[str, Sequence[Inequality]]) -> list[list[str]]:
    """The qualitative claims, a line each and run."""
    words = {True: "holds", False: "does not hold", None: "cannot say"}
    return [["run", "claim (Q37)", "verdict", "numbers"]] + [
        [name, test.text, words[test.holds], test.numbers] for name, each in tests.items() for test in each
    ]


def unknown_rows(params: Params, fit: PeakFit) -> list[list[str]]:
    """The unknowns: as given, fitted, bounds, and whether the data determine them."""
    table = [["unknown", "as given", "fitted", "known to a factor of", "verdict", "bounds", "why these"]]
    for u in UNKNOWNS:
        e = fit.estimates[u.name]
        given, value, lower, upper = (
            format_si(v, u.unit, 4) for v in (float(params[u.name]), e.value, u.lower, u.upper)
        )
        table.append([u.name, given, value, f"{e.factor95:.2g}", e.verdict, f"{lower} to {upper}", u.reason])
    return table


def peak_rows(
    given: Mapping[str, Measured] | None, fit: PeakFit, calibrated: Mapping[str, Measured] | None
) -> list[list[str]]:
    """The numbers fitted: paper, quasistatic at the fit, dynamic at the fit and as given."""
    wanted = targets()
    places = [(name.split()[0], int(name.endswith("greatest"))) for name in TARGETS]

    def of(found: Mapping[str, Measured] | None) -> list[float]:
        return [math.nan if found is None else found[id].values[part] for id, part in places]

    def newtons(values: Iterable[float]) -> list[str]:
        return [format_si(float(v), "N", 4) for v in values]

    def misses(values: Iterable[float]) -> list[str]:
        return [f"{v / p - 1:+.1%}" if math.isfinite(v) else "-" for v, p in zip(values, wanted, strict=True)]

    return by_columns(
        ("fitted to", TARGETS),
        ("paper", newtons(wanted)),
        ("fit, quasistatic", newtons(fit.peaks)),
        ("miss", misses(fit.peaks)),
        ("same values, dynamic", newtons(of(calibrated))),
        ("miss", misses(of(calibrated))),
        ("as given, dynamic", newtons(of(given))),
        ("least and greatest met in the search", [shown(ends, "N") for ends in fit.reach.T.tolist()]),
    )


def combination_rows(fit: PeakFit) -> list[list[str]]:
    """What the peaks determine: combinations of the unknowns (in the unit box), best known first."""
    return by_columns(
        ("singular value", [f"{s:.3g}" for s in fit.singular]),
        ("combination of logarithms", [combination(d, tuple(fit.estimates)) for d in fit.directions]),
        ("verdict", ["determined" if s > KNOWN else "not determined" for s in fit.singular]),
    )


def fit_json(fit: PeakFit, params: Params) -> dict[str, Any]:
    """The fit in full."""
    return {
        "fitted_to": list(TARGETS),
        "model": "quasistatic, without friction",
        "loss": f"Huber at {ERROR:g} of relative residuals",
        "assumed_error": ERROR,
        "unknowns": {
            u.name: {
                "as_given": float(params[u.name]), "unit": u.unit, "bounds": [u.lower, u.upper], "reason": u.reason,
                "fitted": fit.estimates[u.name].value, "factor95_if_model_right": fit.estimates[u.name].factor95,
                "verdict": fit.estimates[u.name].verdict,
            }
            for u in UNKNOWNS
        },
        "peaks": dict(zip(TARGETS, fit.peaks.tolist(), strict=True)),
        "least_and_greatest_met": dict(zip(TARGETS, fit.reach.T.tolist(), strict=True)),
        "residuals": dict(zip(TARGETS, fit.residuals.tolist(), strict=True)),
        "singular_values": fit.singular, "directions": fit.directions, "combinations_determined": fit.combinations,
        "costs": fit.costs, "agreeing_starts": fit.agreeing, "evaluations": fit.evaluations,
    }  # fmt: skip


def markdown(
    title: str, verdict: str, notes: Sequence[str], tables: Sequence[tuple[str, Sequence[Sequence[str]]]]
) -> str:
    """A document of tables, the verdict first."""
    lines = [f"# {title}", "", f"**{verdict}**", ""]
    lines += [line for note in notes for line in (note, "")]
    for heading, table in tables:
        cells = [[cell.replace("|", "\\|") for cell in row] for row in table]
        head, *others = [f"| {' | '.join(row)} |" for row in cells]
        lines += [f"## {heading}", "", head, "|" + "---|" * len(table[0]), *others, ""]
    return "\n".join(lines)
