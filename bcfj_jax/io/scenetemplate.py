"""The commented scene file that ``bcfj init`` writes; it loads back to the scene's defaults.

Options are those of the scene's function, each with what its docstring says of it; where default numbers are from is in
``scenes.sources``.
"""

from __future__ import annotations

import inspect
import json
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path

from bcfj_jax.contact import laws
from bcfj_jax.core.errors import one_of
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io.units import format_si
from bcfj_jax.io.usercode import MECHANISM
from bcfj_jax.mechanism.model import AbstractModel, horizon
from bcfj_jax.models import scenes
from bcfj_jax.solve import named

_WIDTH = 120
_SPHERES = """
# In place of stiffness, exponent and mass: two spheres, or a sphere and a plane (radius inf; modulus inf is rigid).
# [scene.spheres]
# radius = ["8 mm", inf]
# youngs_modulus = ["207 GPa", "207 GPa"]
# poisson = [0.29, 0.29]
# density = ["7800 kg/m^3", "7800 kg/m^3"]
"""
_OWN = """\

# A contact's own coefficients, in place of the shared ones above (whose values stand here).
"""

# A slider-crank, with every table and most keys.
_OF_A_MECHANISM = Path(__file__).with_name("templates") / "mechanism.toml"


def template(kind: str) -> str:
    """A scene's file to start from: every parameter with unit, range, meaning and default."""
    if kind == MECHANISM:
        return _OF_A_MECHANISM.read_text(encoding="utf-8")
    one_of("scene", "scene", kind, (*scenes.SCENES, MECHANISM))
    scene, sources = scenes.make(kind), scenes.sources(kind)
    defaults = dict(scene.defaults)
    given = [(quantity, defaults[name]) for name, quantity in scene.quantities.items() if name in defaults]
    shared = [(q, name.rpartition(".")[2]) for name, q in scene.quantities.items() if name not in defaults]
    lines = [_parameter(quantity, value, sources.by_name.get(quantity.name)) for quantity, value in given]
    own = [f"# {_parameter(quantity, defaults[name], None)}" for quantity, name in shared if name in defaults]
    own = own if len(scene.contacts) > 1 else []
    solvers = named.known(scene.traits.stiff)
    return f"""# A scene of bcfj-jax: run it with  bcfj simulate {kind}.toml
# Numbers are SI; a text may carry a unit, such as "1.2 mm". The values here are the defaults.

[scene]
kind = "{kind}"
{chr(10).join(_options(kind, scene))}
{_SPHERES if kind in scenes.OF_SPHERES else ""}
[parameters]
{_legend(sources.legend)}{chr(10).join(lines)}
{_OWN + chr(10).join(own) + chr(10) if own else ""}
[time]
# end = "{format_si(horizon(scene, scene.parameters()), "s")}"  # by default long enough for this scene
samples = {scene.samples}  # equally spaced, the first at 0
# longest_step = "1 ms"  # that the solver may take; by default as long as its errors allow

[accuracy]
level = "balanced"  # fast (5 % of the peak force), balanced (1 %), reference (0.001 %)
# force_error = "1 %"  # of the peak force, in place of a level
max_steps = 400000  # attempted steps; beyond them the run fails
# resolved_peaks = true  # peaks from every step of the solver, in place of the samples
# solver = "{solvers[0]}"  # in place of the scene's own, {_wrapped(solvers)}
"""


def _options(kind: str, scene: AbstractModel) -> Iterator[str]:
    """Lines of [scene]: those that many scenes share in the same words, all others in their docstring's."""
    function = scenes.SCENES[kind]
    said, several = _arguments(function), len(scene.contacts) > 1
    one = scene.contacts[len(scene.contacts) // 2].name if scene.contacts else ""
    off = "# " if several else ""  # Of several contacts each law has its own elastic part.
    # Lines of options that many scenes share; "..." stands for what the docstring says.
    shared = {
        "law": f"law = {{value}}  # {_wrapped(laws.LAWS)}\n# Without a law, giving restitution below selects the law exact, "
        "which delivers it. Each law has its own parameters.",
        "elastic": f'{off}elastic = "power"  # {_wrapped(laws.ELASTIC)}',
        "smoothing": "smoothing = {value}  # false leaves out the contact regularisation and its parameter",
        "friction": f"friction = {{value}}  # false for none, true for brown_mcphee, or {_wrapped(laws.FRICTION)}",
        "laws": f'# laws = {{{{ {one} = "hertz" }}}}  # other normal-force laws for single contacts, by name',
        "frictions": f"# frictions = {{{{ {one} = false }}}}  # other friction laws for single contacts, as friction",
        "elastics": '# elastics = {{ seat_cage = "liu_sphere" }}  # ...',
        "stiffnesses": '# stiffnesses = {{ seat_cage = "geometry" }}  # ...',
        "fluctuating": '# fluctuating = ["torque"]  # ...',
        "contacts": f"# contacts = {json.dumps([contact.name for contact in scene.contacts])}\n...",
    }
    for name, option in inspect.signature(function).parameters.items():
        value, text = json.dumps(option.default), said.get(name, "")
        follows = getattr(scene, name, None)
        if name in shared:
            line = shared[name].format(value=value)
        elif name.endswith("_table"):
            line = f'# {name} = "{name.removesuffix("_table")}.csv"  # ...'
        elif option.default is None:
            line = f"# {name} = {json.dumps(follows)}  # ..." if isinstance(follows, bool) else f"# {name}: ..."
        else:
            line = f"{name} = {value}..."
        before, dots, _ = line.rpartition("...")
        *above, last = (before if dots else line).split("\n")
        yield from above
        yield _commented(last, text) if dots else last


def _arguments(function: object) -> dict[str, str]:
    """What the docstring of a scene's function says of each of its options."""
    _, _, section = (inspect.getdoc(function) or "").partition("\nArgs:\n")
    section = section.partition("\n\n")[0]
    found = {}
    for names, text in re.findall(r"^    (\w[\w, ]*): (.*(?:\n {5,}.*)*)", section, re.MULTILINE):
        words = " ".join(text.split()).replace("``", "").removesuffix(".")
        found |= {name.strip(): words for name in names.split(",")}
    return found


def _commented(line: str, text: str) -> str:
    """A line with a comment behind it, which goes on below."""
    if not text:
        return line
    first = line if line.startswith("#") else f"{line}  # " if line else "#    "
    wrapped = textwrap.wrap(
        text, _WIDTH, initial_indent=first, subsequent_indent="#    ", break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(wrapped)


def _legend(text: str) -> str:
    if not text:
        return ""
    whole = f"After each meaning, where the number is from. {text} Other options have other parameters."
    return textwrap.fill(whole, _WIDTH, initial_indent="# ", subsequent_indent="# ") + "\n"


def _wrapped(names: Iterable[str]) -> str:
    text = f"one of {', '.join(names)}"
    return textwrap.fill(text, 85, initial_indent="   ", subsequent_indent="#     ", break_on_hyphens=False).lstrip()


def _parameter(quantity: Quantity, default: float, source: str | None) -> str:
    unit = "-" if quantity.unit == "1" else quantity.unit
    key = f'"{quantity.name}"' if "." in quantity.name else quantity.name
    note = f" {source}." if source else ""
    return f"{key} = {default!r}  # [{unit}] {quantity.range}. {quantity.meaning}.{note}"
