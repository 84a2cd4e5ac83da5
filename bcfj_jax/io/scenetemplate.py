"""The commented scene file that ``bcfj init`` writes; it loads back to the scene's defaults."""

from __future__ import annotations

from collections.abc import Iterable

from bcfj_jax.contact import laws
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io.units import format_si
from bcfj_jax.models import scenes
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.scene import AUTO, CAGES, CONTACTS, DRIVES, FIDELITIES, HEADS, TRACKS, Joint
from bcfj_jax.solve import named

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

_JOINT_PARAMETERS = """\
# After each meaning, where the number is from. paper: Zhu et al., Machines 2023, 11(4), 466. group: sizes of the same
# group's optimised joint (Energies 2022, 15, 7591). derived: computed from these. GUESS: nowhere stated, chosen within
# what is usual. None of them was measured. Other options have other parameters.
"""

_JOINT_OWN = """\

# A contact's own coefficients, in place of the shared ones above (whose values stand here).
"""


def template(kind: str) -> str:
    """A scene's file to start from: every parameter with unit, range, meaning and default.

    Raises:
        InputError: for a scene that does not exist.
    """
    if kind not in scenes.SCENES:
        raise InputError("scene", f"no scene '{kind}'", nearest(kind, scenes.SCENES))
    scene = scenes.make(kind)
    joint = isinstance(scene, Joint)
    defaults = dict(scene.defaults)
    sources = {name: DEFAULTS[name][1] for name in defaults} if joint else _GUESSED
    given = [(quantity, defaults[name]) for name, quantity in scene.quantities.items() if name in defaults]
    shared = [(q, defaults[name.rpartition(".")[2]]) for name, q in scene.quantities.items() if name not in defaults]
    lines = [_parameter(quantity, value, sources.get(quantity.name)) for quantity, value in given]
    own = [f"# {_parameter(quantity, value, None)}" for quantity, value in shared]
    names = named.STIFF if joint else tuple(named.NOT_STIFF)
    return f"""# A scene of bcfj-jax: run it with  bcfj simulate {kind}.toml
# Numbers are SI; a text may carry a unit, such as "1.2 mm". The values here are the defaults.

[scene]
kind = "{kind}"
law = "memory_free"  # {_wrapped(laws.LAWS)}
# Without a law, giving restitution below selects the law exact, which delivers it. Each law has its own parameters.
{"# " if kind == "joint" else ""}elastic = "power"  # {_wrapped(laws.ELASTIC)}
smoothing = true  # false takes the smooth onset of penetration, and its parameter, out
{_joint_options() if joint else _SPHERES if kind == "impact" else ""}
[parameters]
{_JOINT_PARAMETERS if joint else ""}{chr(10).join(lines)}
{_JOINT_OWN + chr(10).join(own) + chr(10) if own else ""}
[time]
# end = "{format_si(float(scene.horizon(scene.parameters())), "s")}"  # by default long enough for this scene
samples = {scene.samples}  # equally spaced, the first at 0

[accuracy]
level = "balanced"  # fast (5 % of the peak force), balanced (1 %), reference (0.001 %)
# force_error = "1 %"  # of the peak force, in place of a level
max_steps = 400000  # attempted steps; beyond them the run fails
# solver = "{names[0]}"  # in place of the scene's own, {_wrapped(names)}
"""


def _wrapped(names: Iterable[str]) -> str:
    text, width = "one of", 8
    for name in names:
        if width + len(name) > 84:
            text, width = text + "\n#    ", 4
        text, width = f"{text} {name},", width + len(name) + 2
    return text.rstrip(",")


def _joint_options() -> str:
    """The options that only the joint has; what an option takes out is not in the program."""
    contacts = ", ".join(f'"{name}"' for name in CONTACTS)
    return f"""friction = true  # false for none, true for brown_mcphee, or {_wrapped(laws.FRICTION)}
# laws = {{ cage_ball = "hertz" }}  # other normal-force laws for single contacts, by name
# frictions = {{ cage_ball = false }}  # other friction laws for single contacts, as friction
# contacts = [{contacts}]
#    those there are; without this line all, but seat_cage where the cage is fixed. Balls need both of theirs.
track = "gothic"  # {_wrapped(TRACKS)}: two flanks at the contact angle, or one, of the ball's radius and clearance
spin = false  # true lets the balls turn, and so roll; without, a ball is a particle at its centre
cage = "free"  # {_wrapped(CAGES)}: to the bisecting plane, turning with the drive
head = "free"  # {_wrapped(HEADS)}: at the centre; it turns about its own axis either way
drive = "prescribed"  # {_wrapped(DRIVES)}: adds seat_inertia, drive_stiffness and drive_damping
fidelity = "dynamic"  # {_wrapped((*FIDELITIES, AUTO))}
#    kinematic: closed-form load sharing. quasistatic: equilibrium at each instant, without friction. dynamic: motion.
#    auto: the cheapest that keeps [accuracy], and motion of the last pitch repeated where it repeats itself.
#    Without this line: dynamic, and at the level fast auto.
balls = 6  # 3 or more, each in a track of its own
"""


def _parameter(quantity: Quantity, default: float, source: str | None) -> str:
    unit = "-" if quantity.unit == "1" else quantity.unit
    key = f'"{quantity.name}"' if "." in quantity.name else quantity.name
    note = f" {source}." if source else ""
    return f"{key} = {default!r}  # [{unit}] {quantity.range}. {quantity.meaning}.{note}"
