"""Coefficients that leave: a contact in the terms of another simulator, a file that runs there, and what is lost.

``drop`` runs a mass against a surface with either law, the scene's and the translated one, in this simulator. What the other
tool has exactly is copied. What it has not is matched at this drop: the loss by the rebound, a linear spring by the peak too.
It is then right at this mass and speed, and the table says by how much it is off elsewhere in the drop (its duration).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jax import Array
from scipy.optimize import brentq

from bcfj_jax.contact import normal
from bcfj_jax.contact.elastic import Coefficients, Linear, Power, Reference
from bcfj_jax.contact.restitution import undamped_duration, undamped_penetration
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.numerics import positive, power
from bcfj_jax.core.quantities import CATALOGUE, scalar
from bcfj_jax.io import scenefile
from bcfj_jax.models.scenes import SCENES
from bcfj_jax.solve.simulation import simulate

# Peak and rebound that agree within this share are called the same.
AGREES = 0.01
# Of z = c/(2 sqrt(K m)) and its like: far beyond what rebounds.
_HEAVY = 30.0
# A drop is followed for so many durations of the undamped contact: damped ones last longer.
_SPAN, _SAMPLES = 8.0, 4001
_OURS = (normal.Hertz, normal.MemoryFree, normal.Restitution, normal.KelvinVoigt, normal.AdamsImpact, normal.ElastoGap)


class ChronoHertz(normal.AbstractLaw):
    """F = max(0, K d^1.5 + G d^0.5 d'): Chrono's Hertz model with given kn and gn, K = R kn, G = R m gn.

    ChContactSMC (Chrono 8 and 9) with ``UseMaterialProperties(false)``; R and m effective radius and mass.
    Coefficients: ``stiffness`` K [N/m^1.5], ``dashpot`` G [N s/m^1.5].
    """

    ends: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("stiffness", "dashpot")  # pyright: ignore[reportIncompatibleMethodOverride]

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        """As ``AbstractLaw``."""
        return positive(c["stiffness"] * power(penetration, 1.5) + c["dashpot"] * power(penetration, 0.5) * rate)


class Outcome(NamedTuple):
    """What a drop shows: greatest force [N], time in contact [s], speed after over speed before [-]."""

    peak: float
    duration: float
    rebound: float


class Spring(NamedTuple):
    """F = K d^n: stiffness K [N/m^n], exponent n."""

    stiffness: float
    exponent: float

    def like(self, depth: float, exponent: float) -> Spring:
        """With another exponent, of the same force at that depth [m]."""
        return Spring(self.stiffness * depth ** (self.exponent - exponent), exponent)


class Row(NamedTuple):
    """What of a contact is translated how: "exact", "approximate" or "lost", and a remark."""

    what: str
    how: str
    remark: str


@dataclass(frozen=True)
class Source:
    """A contact that leaves: its law and coefficients (SI), the mass [kg] and speed [m/s] of its drop."""

    contact: str
    law: normal.AbstractLaw
    values: Mapping[str, float]
    mass: float
    speed: float
    friction: Mapping[str, float]

    @property
    def spring(self) -> Spring:
        """Its elastic part."""
        part, c = self.law.elastic, self.values  # type: ignore[attr-defined]
        n = 1.0 if isinstance(part, Linear) else c["exponent"]
        if isinstance(part, Reference):
            return Spring(c["reference_force"] / c["reference_penetration"] ** n, n)
        return Spring(c["stiffness"], n)

    @property
    def depth(self) -> float:
        """Penetration of the undamped drop [m]."""
        return float(undamped_penetration(*self.spring, self.mass, self.speed))

    @property
    def loss(self) -> float | None:
        """chi = a v0 of F = K d^n (1 + chi d'/v0); None of a law of another form."""
        if isinstance(self.law, normal.Restitution):
            return float(self.law.factor(self.values["restitution"]))  # type: ignore[arg-type]
        if isinstance(self.law, normal.MemoryFree):
            return self.values["damping"] * self.speed
        return 0.0 if isinstance(self.law, normal.Hertz) else None


@dataclass(frozen=True)
class Export:
    """A contact in a tool's terms."""

    # tool, name, text: where to; the file's name and content.
    tool: str
    name: str
    text: str
    terms: Mapping[str, float]  # the tool's coefficients by their names there
    rows: tuple[Row, ...]  # what is translated how
    # before, after: the drop with the scene's law and with the translated one.
    before: Outcome
    after: Outcome

    @property
    def same(self) -> bool:
        """Whether peak and rebound agree within ``AGREES``."""
        pairs = (self.before.peak, self.after.peak), (self.before.rebound, self.after.rebound)
        return all(abs(b - a) <= AGREES * abs(a) for a, b in pairs)


def drop(law: normal.AbstractLaw, values: Mapping[str, float], mass: float, speed: float, lasting: float) -> Outcome:
    """A mass [kg] meets a fixed surface at a speed [m/s], without weight; the contact is sharp (without regularisation).

    ``lasting``: duration of an undamped contact of this kind [s]. ``InputError`` where the run fails.
    """
    scene = SCENES["impact"](law, smoothing=False)
    given: dict[str, Any] = {k: v for k, v in values.items() if k in law.needs}
    given |= {"mass": mass, "approach_speed": speed, "clearance_contact": 0.0}
    params = scene.parameters(**given)
    times = np.linspace(0.0, _SPAN * lasting, _SAMPLES)
    run = simulate(scene, params, times, accuracy="reference", resolved_peaks=True, longest_step=lasting / 200.0)
    if run.status == "failed":
        raise InputError("drop", run.reason, "give another mass or speed")
    seen = run.extremes["contact"]
    return Outcome(float(seen.peak), float(seen.touching), max(-float(run.rate["contact"][-1]) / speed, 0.0))


# A translated law: itself, its coefficients, the tool's terms, rows.
_Law = tuple[normal.AbstractLaw, dict[str, float], dict[str, float], tuple[Row, ...]]
_EXACT_SPRING = Row("spring K d^n", "exact", "stiffness and exponent as they are")


def _damped(
    source: Source, spring: Spring, law: normal.AbstractLaw, before: Outcome, **more: float
) -> dict[str, float]:
    """Coefficients of a law with a dashpot, from 0 to ``_HEAVY``, that rebounds from this drop as the source does."""
    lasting = float(undamped_duration(*spring, source.mass, source.speed))
    # K d^n over v: the dashpot whose force at the approach speed is the spring's greatest.
    unit = spring.stiffness * source.depth**spring.exponent / source.speed
    unit *= source.depth**-0.5 if isinstance(law, ChronoHertz) else 1.0

    def values(share: float) -> dict[str, float]:
        return {**spring._asdict(), "dashpot": share * unit, **more}

    def off(share: float) -> float:
        return drop(law, values(share), source.mass, source.speed, lasting).rebound - before.rebound

    found: Any = 0.0 if before.rebound >= 1.0 - 1e-9 else brentq(off, 0.0, _HEAVY, xtol=1e-9 * _HEAVY)
    return values(float(found))


def _loss_row(source: Source, form: str) -> Row:
    remark = f"{form}, matched to the rebound at {source.speed:.4g} m/s; another speed or mass loses another share"
    return Row("loss", "exact" if source.loss == 0.0 else "approximate", "none" if source.loss == 0.0 else remark)


def _linear(source: Source, before: Outcome) -> tuple[dict[str, float], tuple[Row, ...]]:
    """Kelvin-Voigt that has the drop's peak and rebound: z from the rebound, then K from the peak, which goes as sqrt(K)."""
    first = Spring(source.mass * (source.speed / source.depth) ** 2, 1.0)
    values = _damped(source, first, normal.KelvinVoigt(), before)
    lasting = float(undamped_duration(*first, source.mass, source.speed))
    ratio = before.peak / drop(normal.KelvinVoigt(), values, source.mass, source.speed, lasting).peak
    values = {"stiffness": values["stiffness"] * ratio**2, "exponent": 1.0, "dashpot": values["dashpot"] * ratio}
    pulls = isinstance(source.law, normal.KelvinVoigt) and source.law.tension
    if source.spring.exponent == 1.0 and isinstance(source.law, (normal.KelvinVoigt, normal.Hertz)) and not pulls:
        values |= {"stiffness": source.spring.stiffness, "dashpot": source.values.get("dashpot", 0.0)}
        return values, (_EXACT_SPRING, Row("loss", "exact", "c d', pushing only"))
    secant = source.spring.like(source.depth, 1.0).stiffness
    remark = f"linear, matched to the drop's peak: {values['stiffness'] / secant:.3g} times the secant at {source.depth:.3g} m"
    return values, (Row("spring K d^n", "approximate", remark), _loss_row(source, "c d'"))


def _mujoco(source: Source, before: Outcome) -> _Law:
    """Negative solref (-stiffness, -damping): m d'' = -m (stiffness d + damping d'), pushing only, per unit of mass.

    MuJoCo documentation, "Modeling: solver parameters": aref = -b v - k r, b = damping/dmax, k = stiffness d(r)/dmax^2, and
    force = m d (aref - a0) with the impedance d = solimp constant at 0.9999, the greatest. So stiffness = K/m, damping = c/m.
    """
    values, rows = _linear(source, before)
    terms = {"stiffness": values["stiffness"] / source.mass, "damping": values["dashpot"] / source.mass}
    remark = f"solref is per unit of mass: these numbers hold for {source.mass:.4g} kg"
    return normal.KelvinVoigt(), values, terms, (*rows, Row("force at another mass", "lost", remark))


def _adams(source: Source, before: Outcome) -> _Law:
    """IMPACT(x, x', x1, k, e, cmax, d) = max(0, k (x1 - x)^e - STEP(x, x1 - d, cmax, x1, 0) x'), Adams/Solver help."""
    if isinstance(source.law, normal.AdamsImpact):
        values = {**source.spring._asdict(), **{k: source.values[k] for k in ("dashpot", "damping_depth")}}
        rows = (_EXACT_SPRING, Row("loss", "exact", "IMPACT's own"))
    else:
        values = _damped(source, source.spring, normal.AdamsImpact(), before, damping_depth=source.depth)
        rows = (_EXACT_SPRING, _loss_row(source, "cmax reached at the undamped depth"))
    names = {"k": "stiffness", "e": "exponent", "cmax": "dashpot", "d": "damping_depth"}
    return normal.AdamsImpact(), values, {key: values[name] for key, name in names.items()}, rows


def _exudyn(source: Source, before: Outcome) -> _Law:
    """ObjectContactSphereSphere: k d^n with impactModel 1 (Hunt-Crossley, chi = 3 (1 - e)/2) or 0 (c d' added, which may pull).

    Exudyn documentation; the impact speed is latched at touch, and e is a coefficient, not the rebound. Model 1 has every
    chi below 1.5.
    """
    terms = {"contactStiffness": source.spring.stiffness, "contactStiffnessExponent": source.spring.exponent}
    if source.loss is not None and source.loss < 1.5:
        e = 1.0 - source.loss / 1.5
        kept = isinstance(source.law, normal.MemoryFree) and source.loss > 0.0
        remark = f"chi d'/v0 with restitutionCoefficient {e:.4g}" if source.loss else "none"
        speed = "; of this speed: a d' of another speed has another coefficient" if kept else ""
        law = normal.Restitution(factor=_hunt_crossley)
        values = {**source.spring._asdict(), "restitution": e}
        terms |= {"restitutionCoefficient": e, "impactModel": 1.0, "contactDamping": 0.0}
        return law, values, terms, (_EXACT_SPRING, Row("loss", "exact", remark + speed))
    law = normal.KelvinVoigt(elastic=Power(), tension=True)  # type: ignore[arg-type]
    if isinstance(source.law, normal.KelvinVoigt) and source.law.tension:
        values, row = {**source.spring._asdict(), "dashpot": source.values["dashpot"]}, Row("loss", "exact", "c d'")
    else:
        values = _damped(source, source.spring, law, before)
        row = _loss_row(source, "a dashpot from touch on, which pulls before the surfaces part")
    terms |= {"contactDamping": values["dashpot"], "restitutionCoefficient": 1.0, "impactModel": 0.0}
    return law, values, terms, (_EXACT_SPRING, row)


def _hunt_crossley(restitution: Any) -> Any:
    return 1.5 * (1.0 - restitution)


def _modelica(source: Source, before: Outcome) -> _Law:
    """ElastoGap(c, d, s_rel0, n) of Modelica.Mechanics.Translational: f_c = c s^n, |f_d| = min(d |v|, f_c), MSL 3.2 to 4.0."""
    if isinstance(source.law, normal.ElastoGap):
        values = {**source.spring._asdict(), "dashpot": source.values["dashpot"]}
        rows = (_EXACT_SPRING, Row("loss", "exact", "ElastoGap's own"))
    else:
        values = _damped(source, source.spring, normal.ElastoGap(), before)
        rows = (_EXACT_SPRING, _loss_row(source, "a dashpot within the spring's force"))
    terms = {"c": values["stiffness"], "n": values["exponent"], "d": values["dashpot"]}
    return normal.ElastoGap(), values, terms, rows


def _chrono(source: Source, before: Outcome) -> _Law:
    """SMC with kn and gn given: Hooke F = kn d + m gn d' near n = 1, else Hertz (``ChronoHertz``) with R = 1 m.

    Chrono's source, ChContactSMC: normal force kn delta - gn v, cut off at 0; m is the effective mass.
    """
    n, hertz = source.spring.exponent, source.spring.exponent >= 1.25
    if hertz:
        values = _damped(source, source.spring.like(source.depth, 1.5), ChronoHertz(), before)
        remark = f"of exponent 1.5 and the same force at {source.depth:.3g} m, in place of {n:.4g}"
        spring = _EXACT_SPRING if n == 1.5 else Row("spring K d^n", "approximate", remark)
        rows = spring, _loss_row(source, "G d^0.5 d'")
    else:
        values, rows = _linear(source, before)
    # The drop's sphere has a radius of 1 m, so that R kn = K.
    terms = {"kn": values["stiffness"], "gn": values["dashpot"] / source.mass, "hertz": float(hertz)}
    return ChronoHertz() if hertz else normal.KelvinVoigt(), values, terms, rows


# By tool: what translates a contact, and the file that runs the drop there; its form is in the folder ``peers``.
TOOLS: dict[str, tuple[Callable[[Source, Outcome], _Law], str]] = {
    "mujoco": (_mujoco, "drop.xml"),
    "adams": (_adams, "drop.adm"),
    "exudyn": (_exudyn, "drop_exudyn.py"),
    "modelica": (_modelica, "Drop.mo"),
    "chrono": (_chrono, "drop_chrono.py"),
}


def source(what: str | Path, contact: str = "", mass: str | float = "", speed: str | float = "") -> Source:
    """The contact of a scene file, of a built-in scene, or of the folder or fit.json of a calibration.

    ``InputError`` for a scene without such a contact, a law that no tool has, and a mass or speed that is not known.
    """
    path = Path(what)
    folder = path.parent if path.name == "fit.json" else path
    given = scenefile.load(folder / "fitted_scene.toml" if (folder / "fitted_scene.toml").is_file() else what)
    known: dict[str, Any] = {c.name: c for c in given.scene.contacts}
    name = contact or next(iter(known))
    if name not in known:
        raise InputError("--contact", f"'{name}'", f"this scene has {', '.join(known)}{nearest(name, known)}")
    found = known[name]
    if type(found.law) not in _OURS or not isinstance(found.law.elastic, (Power, Linear, Reference)):
        law = f"{type(found.law).__name__} with {type(getattr(found.law, 'elastic', None)).__name__}"
        remedy = "the nearest that leaves is law = 'memory_free' with elastic = 'power': fit that to the same records"
        raise InputError(f"contact '{name}'", f"no tool here has the law {law}", remedy)
    p = {key: float(value) for key, value in given.params.items() if not np.ndim(value)}
    rubbing = () if found.friction is None else tuple(found.friction.needs)
    own = {key: p.get(f"{name}.{key}", p.get(key, math.nan)) for key in (*found.law.needs, *rubbing)}
    struck = p.get("struck_mass", math.inf)
    body = p["mass"] / (1.0 + p["mass"] / struck) if "mass" in p else None
    fall = math.sqrt(2.0 * p["gravity"] * p["drop_height"]) if "drop_height" in p else None
    m = _stated("mass", mass, body)
    v = _stated("approach_speed", speed, p.get("approach_speed", fall))
    return Source(name, found.law, own, m, v, {k: own[k] for k in rubbing})


def _stated(name: str, text: str | float, known: float | None) -> float:
    option, example = ("--mass", "1 kg") if name == "mass" else ("--speed", "1 m/s")
    value = known if text == "" else scalar(option, CATALOGUE[name], text)
    if value is None or not value > 0.0:
        raise InputError(option, "the scene does not say it", f'give the drop\'s: {option} "{example}"')
    return value


def export(given: Source, tool: str) -> Export:
    """A contact in the terms of a tool, with the drop run with either law; ``InputError`` for an unknown tool."""
    if tool not in TOOLS:
        raise InputError("--to", f"'{tool}'", f"give one of {', '.join(TOOLS)}{nearest(tool, TOOLS)}")
    lasting = float(undamped_duration(*given.spring, given.mass, given.speed))
    values = {**given.values, "approach_speed": given.speed}
    before = drop(given.law, values, given.mass, given.speed, lasting)
    translate, name = TOOLS[tool]
    law, values, terms, rows = translate(given, before)
    after = drop(law, values, given.mass, given.speed, lasting)
    if given.friction:
        mu = given.friction.get("friction_dynamic", math.nan)
        rows += (Row("friction", "lost", f"the file has none; Coulomb's coefficient is {mu:.4g}"),)
    if given.values.get("smoothing", 0.0) != 0.0:
        rows += (Row("regularisation at touch", "lost", "the translated contact is sharp"),)
    form = resources.files("bcfj_jax.analysis").joinpath("peers", f"{name}.txt").read_text(encoding="utf-8")
    told = {"mass": given.mass, "speed": given.speed, "model": "Hertz" if terms.get("hertz") else "Hooke"}
    told |= {"lasting": lasting, "fine": lasting / 2000, "coarse": lasting / 500, "span": _SPAN * lasting}
    return Export(tool, name, form.format(**told, **terms), terms, rows, before, after)


def tables(found: Export) -> tuple[list[list[str]], list[list[str]], list[list[str]]]:
    """What is shown: the tool's terms, what is translated how, the drop side by side."""
    terms = [["term", "value, SI"], *([name, f"{value:.8g}"] for name, value in found.terms.items())]
    rows = [["what", "translated", "remark"], *(list(row) for row in found.rows)]
    units = {"peak": "peak [N]", "duration": "duration [s]", "rebound": "rebound [1]"}
    pairs = zip(units.values(), found.before, found.after, strict=True)
    side = [["drop", "scene's law", f"{found.tool}'s law", "off"]]
    side += [[name, f"{a:.6g}", f"{b:.6g}", f"{100.0 * (b / a - 1.0) if a else 0.0:+.2f} %"] for name, a, b in pairs]
    return terms, rows, side
