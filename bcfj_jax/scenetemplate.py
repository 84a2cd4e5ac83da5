"""The commented scene file that ``bcfj init`` writes; it loads back to the scene's defaults."""

from __future__ import annotations

from bcfj_jax import laws, scenes
from bcfj_jax.errors import InputError, nearest
from bcfj_jax.quantities import Quantity
from bcfj_jax.units import format_si

# Nowhere stated; scenes.py says why the number is what it is.
_GUESSED = {"damping": "GUESS, nowhere stated: gives e = 0.9 at 1.5 m/s"}

_SPHERES = """
# In place of stiffness, exponent and mass: two spheres, or a sphere and a plane (radius inf; modulus inf is rigid).
# [scene.spheres]
# radius = ["8 mm", inf]
# youngs_modulus = ["207 GPa", "207 GPa"]
# poisson = [0.29, 0.29]
# density = ["7800 kg/m^3", "7800 kg/m^3"]
"""


def template(kind: str) -> str:
    """A scene's file to start from: every parameter with unit, range, meaning and default.

    Raises:
        InputError: for a scene that does not exist.
    """
    if kind not in scenes.SCENES:
        raise InputError("scene", f"no scene '{kind}'", nearest(kind, scenes.SCENES))
    scene = scenes.make(kind)
    defaults = dict(scene.defaults)
    lines = [_parameter(quantity, defaults[name]) for name, quantity in scene.quantities.items()]
    return f"""# A scene of bcfj-jax: run it with  bcfj simulate {kind}.toml
# Numbers are SI; a text may carry a unit, such as "1.2 mm". The values here are the defaults.

[scene]
kind = "{kind}"
law = "memory_free"  # {_wrapped(laws.LAWS)}
# Without a law, giving restitution below selects the law exact, which delivers it. Each law has its own parameters.
elastic = "power"  # {_wrapped(laws.ELASTIC)}
smoothing = true  # false takes the smooth onset of penetration, and its parameter, out
{_SPHERES if kind == "impact" else ""}
[parameters]
{chr(10).join(lines)}

[time]
# end = "{format_si(float(scene.horizon(scene.parameters())), "s")}"  # by default long enough for this scene
samples = {scene.samples}  # equally spaced, the first at 0

[accuracy]
level = "balanced"  # fast (5 % of the peak force), balanced (1 %), reference (0.001 %)
# force_error = "1 %"  # of the peak force, in place of a level
max_steps = 100000  # attempted steps; beyond them the run fails
"""


def _wrapped(names: object) -> str:
    text, width = "one of", 8
    for name in names:  # type: ignore[attr-defined]
        if width + len(name) > 84:
            text, width = text + "\n#    ", 4
        text, width = f"{text} {name},", width + len(name) + 2
    return text.rstrip(",")


def _parameter(quantity: Quantity, default: float) -> str:
    unit = "-" if quantity.unit == "1" else quantity.unit
    guess = _GUESSED.get(quantity.name)
    note = f" {guess}." if guess else ""
    return f"{quantity.name} = {default!r}  # [{unit}] {quantity.range}. {quantity.meaning}.{note}"
