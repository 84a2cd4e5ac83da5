"""What a suspect is in a problem file: its lines, what to do about it, and the problem that these lines make."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.contact import laws
from bcfj_jax.core.quantities import CATALOGUE
from bcfj_jax.mechanism.channels import unit_of
from bcfj_jax.mechanism.model import AbstractModel
from calibration.diagnostics.catalogue import LOSS, SUSPECTS
from calibration.diagnostics.signatures import Scene
from calibration.diagnostics.suspects import Found
from calibration.fit import Fit
from calibration.impacts import stated
from calibration.problem import OFFSETS, Channel, Free, Problem, units_of
from calibration.problemfile import FreeTable, free_of

# Laws that lose energy each in a way of its own: as the speed, at every speed alike, by a dent, by a dashpot, by creeping.
_LOSSES = ("memory_free", "exact", "walton_braun", "elasto_gap", "standard_linear_solid")
_RELAXING, _PLASTIC = "standard_linear_solid", "walton_braun"
# What to do or to check first.
ADVICE = {
    "bandwidth": "The sensor is slow: take its bandwidth from its data sheet, or use a faster one.",
    "resonance": "The load cell rings: take its natural frequency as mounted, by a tap, or mount it more stiffly.",
    "hum": "A periodic disturbance is on the signal: record without a contact, and check earth and shielding.",
    "drift": "The zero moves during the record: check charge amplifier and temperature, or subtract the rest before each run.",
    "clock offset": "The record's clock is not the motion's: check trigger and delays.",
    "offset": "The reading at rest is not zero: subtract the mean before contact.",
    "gain bend": "The gain depends on the load: calibrate the sensor at several loads.",
    "stop": "Something stiffer is touched at depth: look for a second contact or a layer that bottoms out.",
    "relaxation": "The force relaxes under load: hold a load and record how it falls.",
    "plasticity": "Unloading is steeper than loading: look for a dent, and repeat at one place.",
    LOSS: "The loss goes with the speed otherwise than the law's: try other laws of loss, or hand on the elastic force alone.",
    "clock jitter": "The noise grows with the slope: check the sampling clock.",
    "quantisation": "The readings have steps: use a smaller range of the converter.",
    "saturation": "The sensor is at its limit at the peak: use a larger range, and drop these samples.",
    "correlated noise": "Residuals remember each other, and no suspect says why: a shape that the law misses looks the same.",
}


def taken(problem: Problem) -> frozenset[str]:
    """Suspects that the problem has in it already."""
    named = {f.name for f in problem.free}.union(*(e.fixed for e in problem.experiments))
    channels = [c for e in problem.experiments for c in e.channels]
    taken = {name for name, shape in SUSPECTS.items() if shape.nuisance in named}
    taken |= {"offset"} if named & {*OFFSETS.values()} else set()
    # One number in the channels' unit needs channels of one unit.
    taken |= {"hum", "drift", "offset", "gain bend"} if len(units_of(problem.observed)) > 1 else set()
    taken |= {"correlated noise"} if any(c.correlation != 0.0 for c in channels) else set()
    return frozenset(taken | ({"clock jitter"} if any(c.jitter for c in channels) else set()))


def laws_of(problem: Problem) -> tuple[str, ...]:
    """Suspects of the law whose law there is, of a scene with one contact."""
    law = problem.scene.only_law()
    if law is None:
        return ()
    found = ["stop"] if isinstance(getattr(law, "elastic", None), type(laws.ELASTIC["power"])) else []
    found += ["relaxation"] if isinstance(law, (laws.MemoryFree, laws.Hertz)) and _RELAXING in laws.LAWS else []
    found += ["plasticity"] if hasattr(law, "elastic") and _PLASTIC in laws.LAWS and not _plastic(law) else []
    return (*found, LOSS)


def _plastic(law: Any) -> bool:
    return any(isinstance(law, type(laws.LAWS[name])) for name in (_PLASTIC, "thornton"))


def lines(f: Found, scene: Scene, problem: Problem, result: Fit) -> str:
    """What the problem file would say of a suspect; "" where there is nothing to say."""
    v, span = f.values, max(float(np.ptp(s.clock)) for s in scene.series)
    peak = scene.peak
    if f.name == "bandwidth":
        return _free("bandwidth", v["bandwidth"] / 30.0, v["bandwidth"] * 30.0, v["bandwidth"])
    if f.name == "resonance":
        damping = min(max(v["resonance_damping"], 0.003), 0.8)
        text = _free("resonance", v["resonance"] / 3.0, v["resonance"] * 3.0, v["resonance"])
        return text + _free("resonance_damping", 0.001, 0.95, damping)
    if f.name == "hum":
        low, high = max(v["hum_frequency"] - 1.0 / span, v["hum_frequency"] / 3.0), v["hum_frequency"] + 1.0 / span
        text = _free("hum_frequency", low, high, v["hum_frequency"], "linear")
        return text + _free("hum_sine", -0.5 * peak, 0.5 * peak) + _free("hum_cosine", -0.5 * peak, 0.5 * peak)
    if f.name == "drift":
        return _free("drift", -2.0 * peak / span, 2.0 * peak / span)
    if f.name == "clock offset":
        return _free("time_offset", -0.3 * scene.contact, 0.3 * scene.contact)
    if f.name == "offset":
        return _free("force_offset", -0.5 * peak, 0.5 * peak)
    if f.name == "gain bend":
        return _free("gain_bend", -0.4 / peak, 0.4 / peak, float(np.clip(v["gain_bend"], -0.3 / peak, 0.3 / peak)))
    if f.name in ("stop", "relaxation", "plasticity"):
        return _law_lines(f, scene)
    if f.name == LOSS:
        return "".join(['[[model]]\nname = "as fitted"\n', *loss_models(scene, problem).values()])
    return _record_lines(f, result)


def _free(name: str, lower: float, upper: float, start: float | None = None, scale: str = "") -> str:
    # Three digits are enough of a box that spans decades; a narrow one, on a linear scale, needs more.
    low, high, first = (None if x is None else x if scale else float(f"{x:.3g}") for x in (lower, upper, start))
    more = ("" if first is None else f"start = {first:.6g}\n") + (f'scale = "{scale}"\n' if scale else "")
    return f"[free.{name}]\nlower = {low:.6g}\nupper = {high:.6g}\n{more}"


def _law_lines(f: Found, scene: Scene) -> str:
    if f.name == "stop":
        depth, stiffness = f.values["bottoming_penetration"], f.values["bottoming_stiffness"]
        head = f'scene = {{ elastic = "two_stage" }}\nparameters = {{ bottoming_width = {0.05 * depth:.3g} }}\n'
        own = _free("bottoming_stiffness", stiffness / 30.0, stiffness * 30.0, stiffness)
        own += _free("bottoming_penetration", 0.2 * depth, 1.5 * depth, depth)
    elif f.name == "relaxation":
        time, share = f.values["relaxation_time"], min(max(f.values["relaxation"], 0.01), 2.0)
        head = f'scene = {{ law = "{_RELAXING}" }}\n'
        own = _free("relaxation", 0.0, 3.0, share)
        own += _free(
            "relaxation_time", min(time, 0.01 * scene.contact) / 2.0, max(time, 3.0 * scene.contact) * 2.0, time
        )
    else:
        head = f'scene = {{ law = "{_PLASTIC}", elastic = "power" }}\n'
        own = _free("restitution", 0.05, 1.0, 0.9)
    return f'[[model]]\nname = "{f.name}"\n{head}' + own.replace("[free.", "[model.free.")


def loss_models(scene: Scene, problem: Problem) -> dict[str, str]:
    """``[[model]]`` lines by name: the laws of other loss with the same elastic part, each coefficient in a wide box."""
    law: Any = problem.scene.only_law()
    elastic = getattr(law, "elastic", None)
    motions = [held[0] for held in scene.motions if held]
    if elastic is None or not motions:
        return {}
    speeds = [float(np.abs(m.rate).max()) for m in motions]
    stiff = max(float(m.force.max()) for m in motions) / max(speeds)
    boxes = {
        "damping": _free("damping", 1e-3 / max(speeds), 5.0 / min(speeds)),
        "restitution": _free("restitution", 0.02, 1.0, scale="linear"),
        "dashpot": _free("dashpot", 1e-4 * stiff, 10.0 * stiff),
        "relaxation": _free("relaxation", 0.0, 3.0),
        "relaxation_time": _free("relaxation_time", 0.005 * scene.contact, 6.0 * scene.contact),
    }
    found, named = {}, {f.name for f in problem.free}
    for name in _LOSSES:
        if type(laws.LAWS[name]) is not type(law):
            own = [n for n in laws.LAWS[name].needs if n in boxes and n not in named]
            text = "".join(boxes[n] for n in own).replace("[free.", "[model.free.")
            found[name] = f'[[model]]\nname = "{name}"\nscene = {{ law = "{name}" }}\n{text}'
    return found


def _record_lines(f: Found, result: Fit) -> str:
    """Keys of [[experiment]]."""
    channel = result.optimum.model.channels[0]
    unit = unit_of(channel)
    sigma = result.noise.get(channel, {}).get("sigma", f.values.get("sigma", 0.0))
    if f.name == "correlated noise":
        return 'correlation = "estimate"\n'
    if f.name == "saturation":
        return f'saturation = "{f.values["level"]:.8g} {unit}"\n'
    if f.name == "clock jitter":
        return f'noise = "{f.values["sigma"]:.3g} {unit} + {f.values["jitter"]:.3g} s of clock"\n'
    rest = np.sqrt(max(sigma**2 - f.values["step"] ** 2 / 12.0, (0.1 * f.values["step"]) ** 2))
    return f'noise = "{rest:.3g} {unit} + {f.values["step"]:.6g} {unit} of steps"\n'


def joined(first: str, second: str) -> str:
    """The lines of two suspects: keys of [[experiment]] before tables; "" where one has none, or both are laws."""
    if not (first and second) or ("[[model]]" in first and "[[model]]" in second):
        return ""
    return "".join(sorted((first, second), key=lambda text: text.startswith("[[") * 2 + text.startswith("[free")))


def altered(problem: Problem, text: str, plain: Fit) -> Problem:
    """A problem with a suspect's lines, starting at the plain fit's values."""
    content = tomllib.loads(text.replace("[[model]]\n", "[model]\n"))
    model = content.get("model", {})
    scene, params = problem.scene, dict(problem.params)
    if model:
        scene = _swapped(problem, **model["scene"])
        given = {**params, **model.get("parameters", {})}
        known = {name: value for name, value in given.items() if name in scene.quantities}
        params = {name: float(value) for name, value in scene.parameters(known).items()}
    tables = {**content.get("free", {}), **model.get("free", {})}
    known = {**CATALOGUE, **problem.quantities, **scene.quantities}
    new = [free_of(name, FreeTable(**table), Path(problem.where), known) for name, table in tables.items()]
    kept = [_started(f, plain) for f in problem.free if f.name in {**problem.quantities, **scene.quantities}]
    kept = [f for f in kept if f.name in scene.quantities or f.name not in problem.scene.quantities]
    channel = {key: content[key] for key in ("noise", "saturation", "correlation") if key in content}
    experiments = problem.experiments
    if channel:
        experiments = tuple(replace(e, channels=tuple(_read(c, channel) for c in e.channels)) for e in experiments)
    return replace(problem, scene=scene, params=params, free=(*kept, *new), experiments=experiments)


def _swapped(problem: Problem, law: str | None = None, elastic: str | None = None) -> AbstractModel:
    """The scene with another law of its one contact."""
    kept: Any = problem.scene.only_law()
    if law is None:
        new: Any = replace(kept, elastic=laws.ELASTIC[str(elastic)])
    else:
        own = getattr(kept, "elastic", None)
        new = laws.make(law, elastic)
        new = new if elastic or own is None else replace(new, elastic=own)
    return problem.scene.with_law(new, _DEFAULTS)


# Values of coefficients that a scene made for another law has no default of: their lines seek them.
_DEFAULTS = {
    "bottoming_stiffness": 0.0, "bottoming_penetration": 1.0, "bottoming_width": 0.0, "relaxation": 0.0,
    "relaxation_time": 1.0, "restitution": 0.9, "damping": 0.0, "dashpot": 0.0,
}  # fmt: skip


def _started(f: Free, plain: Fit) -> Free:
    value = plain.values.get(f.name)
    if value is None:
        return f
    margin = 1e-6 * (f.upper - f.lower)
    return replace(f, start=float(np.clip(value, f.lower + margin, f.upper - margin)))


def _read(c: Channel, said: dict[str, str]) -> Channel:
    """A channel as the keys of [[experiment]] would make it."""
    if "noise" in said:
        sigma, relative, jitter = stated.noise(said["noise"], c.observes, c.values, "noise")
        c = replace(c, sigma=sigma, relative=relative, jitter=jitter)
    if "saturation" in said:
        limit = float(said["saturation"].split()[0])
        c = replace(c, values=np.where(np.abs(c.values) >= limit * (1.0 - 1e-9), np.nan, c.values))
    return replace(c, correlation=None) if "correlation" in said else c
