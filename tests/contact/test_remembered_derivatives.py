"""Laws that remember an approach: every way to a derivative of an impact against differences of tight runs."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps, laws, loads
from bcfj_jax.contact.restitution import FACTORS
from benchmarks.analysis import chosen

# One program for all laws that are chosen among by a number.
SPEEDS = {name: laws.make(name) for name in FACTORS}
GIVEN = {"stiffness": 1e7, "exponent": 1.5, "mass": 0.5, "restitution": 0.7, "height": 0.1, "which": 0.0}
END, STEP, TIGHT, ACCURACY = 0.16, 2e-4, 1e-9, 1e-6
READ = "body.velocity.y"


def falling(known, coefficients):
    """A body that falls on a surface; the law is chosen by its number."""
    body = Body("body", "slide", axis="y", mass="mass", start={"position": "height"})
    contact = Contact("contact", ("ground", "body"), gaps.PointOnPlane("y"), law=chosen.law(known), smoothing=False)
    own = [(bj.Quantity("height", "m", "drop", 0.0), GIVEN["height"])]
    make = functools.partial(Mechanism, "drop", [body], [contact], [loads.Gravity("-y")], own=own, end=END)
    values = {**GIVEN, **coefficients}
    return make(given={n: x for n, x in values.items() if n in make().quantities and n != "height"})


class Ways:
    """A scene, and how the speed at its end depends on height and restitution: each way is compiled once."""

    def __init__(self, known, coefficients, wrt):
        self.scene, self.wrt, self.names = falling(known, coefficients), wrt, tuple(known)
        given, times = self.scene.parameters(), jnp.array([0.0, END])

        def leaving(x, which, accuracy, mode="forward"):
            params = {**given, "which": which, **dict(zip(wrt, x, strict=True))}
            return bj.reading_history(self.scene, params, times, [READ], accuracy=accuracy, mode=mode)[READ][-1]

        self.at = jnp.array([float(given[n]) for n in wrt])
        self.value = jax.jit(leaving)
        self.jvp = jax.jit(lambda x, d, *rest: jax.jvp(lambda x: leaving(x, *rest), (x,), (d,)))
        self.jacfwd = jax.jit(jax.jacfwd(leaving))
        self.grad = jax.jit(jax.grad(lambda *x: leaving(*x, "reverse")))
        self.params = lambda which, **more: {**given, "which": float(which), **more}


@pytest.fixture(scope="module")
def speeds():
    return Ways(SPEEDS, {}, ("height", "restitution"))


def close(found, right, size):
    np.testing.assert_array_less(np.abs(found - right), 2e-4 * (np.abs(right) + size))


def check(ways, name):
    """Every way to a derivative of a run through one impact."""
    which, x = float(ways.names.index(name)), ways.at
    moves = [STEP * x * e for e in np.eye(len(x))]
    tight = [float(ways.value(x + m, which, TIGHT) - ways.value(x - m, which, TIGHT)) / 2 for m in moves]
    right = np.array(tight) / (STEP * x)
    assert np.all(np.abs(right) > 0)
    size = float(ways.value(x, which, TIGHT)) / x

    for k, unit in enumerate(np.eye(len(x))):
        value, along = ways.jvp(x, unit, which, ACCURACY)
        close(value, size[k] * x[k], 0.0)
        close(along, right[k], size[k])
    close(ways.jacfwd(x, which, ACCURACY), right, size)
    close(ways.grad(x, which, ACCURACY), right, size)


def check_features(ways, name):
    """Derivatives of features of a run and of its contact against differences of tight runs."""
    which, x, wrt = float(ways.names.index(name)), ways.at, ways.wrt
    # Their quadrature is good to 2e-4.
    params, times = ways.params(which), np.array([0.0, END])
    kinds = ["begin_1", "end_1", "peak_1", "impulse_1"]
    names = [f"contact.{kind}" for kind in kinds]
    run = bj.contact_events(ways.scene, params, times, wrt, accuracy=ACCURACY, features=names)
    found = bj.sensitivity(
        ways.scene, params, np.linspace(0.0, END, 41), wrt, accuracy=ACCURACY, features=["contact.peak", "contact.impulse"],
        differences="none",
    )  # fmt: skip
    assert found.certificate is not None
    for p, value in zip(wrt, x, strict=True):
        moved = [
            bj.contact_events(
                ways.scene, {**params, p: float(value * (1 + s))}, times, accuracy=TIGHT, features=names
            ).features
            for s in (STEP, -STEP)
        ]
        for kind, feature in zip(kinds, names, strict=True):
            difference = (moved[0][feature] - moved[1][feature]) / (2 * STEP * float(value))
            size = abs(run.features[feature] / float(value))
            close(run.feature_derivatives[p][feature], difference, size)
            if kind in ("peak_1", "impulse_1"):
                whole = f"contact.{kind[:-2]}"
                if whole in found.sampled:
                    continue
                bound = found.certificate.parameters[p].features[whole]
                off = abs(found.feature_derivatives[p][whole] - difference)
                assert off <= (min(bound, 1e-3) + 2e-4) * max(abs(difference), 1e-2 * size)


# In CI's tier: memories through a touch, in test_continuous_derivatives.py and test_memory.py.
@pytest.mark.slow
@pytest.mark.parametrize("law", SPEEDS)
def test_laws_with_an_approach_speed(speeds, law):
    check(speeds, law)


# Of one law: test_continuous_derivatives.py, by sensitivity and contact_events.
@pytest.mark.slow
@pytest.mark.parametrize("law", SPEEDS)
def test_features_of_laws_with_an_approach_speed(speeds, law):
    check_features(speeds, law)
