"""Curves that the package itself computes: the beginning of a contact, its loop, restitution and friction by law."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import bcfj_jax as bj
from bcfj_jax.contact.normal import regularised_force
from docs.drawings.base import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, save


def law() -> None:
    """docs/images/contact_law.svg: force against penetration, with the regularisation, and the loop of an impact."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.5), layout="constrained")
    made, width = bj.laws.make("hertz"), 20e-6
    c = {"stiffness": jnp.asarray(3.7e10), "exponent": jnp.asarray(1.5)}
    d = jnp.linspace(-30e-6, 26e-6, 400)
    for wide, colour, name in ((None, INK, "sharp: K d^n"), (width, BLUE, "smoothing = 20 µm")):
        width_of = None if wide is None else jnp.asarray(wide)
        force = jax.vmap(lambda x, w=width_of: regularised_force(made, x, jnp.zeros(()), c, w))(d)
        left.plot(1e6 * d, 1e-3 * force, color=colour, lw=2 if wide else 1.4, ls="-" if wide else "--", label=name)
    left.axvspan(-20, 20, color=GREY, alpha=0.15, lw=0)
    left.axvline(0, color=GREY, lw=0.8)
    left.text(-10, 1.2, "from -w to w", ha="center", color=INK)
    left.set(xlabel="penetration d [µm] (a gap is negative)", ylabel="normal force [kN]", ylim=(-0.2, 4.6))
    left.legend(frameon=False, loc="upper left")
    scene = bj.scenes.impact()
    times = np.linspace(0.0, 60e-6, 1201)
    for damping, colour in ((0.0, INK), (0.1, BLUE), (0.3, RED)):
        run = bj.simulate(scene, scene.parameters(damping=damping), times, accuracy=1e-5)
        force, depth = np.array(run.force["contact"][:, 0]), np.array(run.penetration["contact"])
        inside = depth > 0
        right.plot(1e6 * depth[inside], force[inside], color=colour, lw=1.8, label=f"a = {damping:g} s/m")
    right.set(xlabel="penetration d [µm]", ylabel="normal force [N]")
    right.legend(frameon=False, title="one impact, F = K d^n (1 + a d')", loc="upper left", title_fontsize=9.5)
    save(figure, "contact_law")


def restitution() -> None:
    """docs/images/restitution.svg: what a law delivers of the restitution that it is asked for."""
    figure, axis = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    asked = np.linspace(0.05, 1.0, 96)
    shown = ("hunt_crossley", "lankarani_nikravesh", "flores", "gonthier", "exact")
    styles = ((ORANGE, ":"), (RED, "--"), (GREEN, "-."), (PURPLE, (0, (5, 1))), (BLUE, "-"))
    for name, (colour, line) in zip(shown, styles, strict=True):
        factor = bj.restitution.FACTORS[name]
        found = jax.vmap(lambda e, f=factor: bj.restitution.delivered_restitution(f(e)))(jnp.asarray(asked))
        axis.plot(asked, found, color=colour, ls=line, lw=2, label=name)
    axis.plot([0, 1], [0, 1], color=GREY, lw=0.8)
    axis.set(
        xlabel="restitution asked for", ylabel="restitution delivered", xlim=(0, 1), ylim=(0, 1.02), aspect="equal"
    )
    axis.legend(frameon=False, loc="lower right")
    save(figure, "restitution")


def friction() -> None:
    """docs/images/friction.svg: friction coefficient against slip, by law."""
    figure, axis = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    c = {"friction_static": 0.12, "friction_dynamic": 0.03, "friction_speed": 0.1}
    v = np.linspace(0.0, 0.5, 600)
    for name, colour, line in (("coulomb", ORANGE, "--"), ("step", GREEN, "-."), ("brown_mcphee", BLUE, "-")):
        made = bj.laws.make_friction(name)
        slope = jax.vmap(lambda s, f=made: f.mobility(s, c))(jnp.asarray(v**2))
        axis.plot(v, v * np.array(slope), color=colour, ls=line, lw=2, label=name)
    axis.axvline(0.1, color=GREY, lw=0.8)
    axis.text(0.105, 0.004, "friction_speed", color=INK)
    axis.set(xlabel="slip [m/s]", ylabel="friction force over normal force", ylim=(0, 0.14))
    axis.legend(frameon=False)
    save(figure, "friction")


def draw() -> None:
    """All three."""
    law()
    restitution()
    friction()
