"""Parts that hold arrays: a law, a friction and a load of an equinox module are trained through ``force_history``."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
from bcfj_jax.mechanism.arrays import Held
from bcfj_jax.mechanism.model import of_numbers

TIMES = np.linspace(0.0, 6e-3, 31)


class Pad(bj.laws.AbstractLaw):
    """F = (k d + sum of exp(w) (d - x)_+^2)(1 + a d'): a spline, with an array that is no parameter."""

    weights: jax.Array
    knots: np.ndarray
    order: jax.Array
    needs = ("stiffness", "damping")
    quantities = {"stiffness": bj.Quantity("stiffness", "N/m", "slope at touch", 0.0)}

    def force(self, penetration, rate, c):
        """Of any shape of penetration."""
        d = jnp.maximum(penetration, 0.0)
        beyond = jnp.maximum(d[..., None] - 1e-4 * self.knots, 0.0) ** self.order
        elastic = c["stiffness"] * d + 1e7 * jnp.sum(jnp.exp(self.weights) * beyond, -1)
        return elastic * jnp.maximum(1.0 + c["damping"] * rate, 0.0)


class Rub(bj.laws.AbstractFriction):
    """mu of a network of the slip."""

    net: eqx.nn.MLP
    needs = ("friction_speed",)

    def mobility(self, speed_squared, c):
        """mu/|v|."""
        square = jnp.asarray(speed_squared) / c["friction_speed"] ** 2
        mu = jax.nn.softplus(jnp.vectorize(lambda s: self.net(jnp.tanh(s)[None])[0])(square))
        return 0.3 * mu / jnp.sqrt(speed_squared + c["friction_speed"] ** 2)


class Wind(eqx.Module):
    """A force of a network of the place."""

    net: eqx.nn.MLP

    def __call__(self, t, bodies, p):
        """Along x."""
        (x, *_), push = bodies.place("block"), self.net(jnp.stack([100.0 * bodies.place("block")[0], t / 6e-3]))[0]
        del x
        return [bj.loads.Action("block", force=(200.0 * push, 0.0, 0.0))]


def parts():
    """Law, friction and load, with arrays."""
    one, two = jax.random.split(jax.random.key(0))
    law = Pad(jnp.linspace(-0.5, 0.5, 3), np.array([0.0, 1.0, 3.0]), jnp.asarray(2))
    rub = Rub(eqx.nn.MLP(1, 1, 4, 1, activation=jnp.tanh, key=one))
    wind = Wind(eqx.nn.MLP(2, 1, 4, 1, activation=jnp.tanh, key=two))
    return law, rub, wind


def scene_of(law, rub, wind):
    """A block thrown at a pad, along which it slides, blown at."""
    block = bj.Body("block", "particle", mass=0.1, start={"y": 1e-5, "vy": -1.0, "vx": 0.5})
    values = {"stiffness": 2e5, "damping": 0.1, "friction_speed": 0.05}
    pad = bj.Contact("pad", ("ground", "block"), bj.gaps.PointOnPlane("y"), law, rub, smoothing=False, values=values)
    return bj.Mechanism("learned", [block], [pad], [bj.Load("wind", wind, ("block",))], implicit=False)


@pytest.fixture(scope="module")
def whole():
    """The parts and their scene."""
    law, rub, wind = parts()
    return scene_of(law, rub, wind), {"pad.law": law, "pad.friction": rub, "wind.function": wind}


def test_arrays_are_parameters_of_their_shape_and_the_scene_is_static(whole):
    scene, modules = whole
    params = scene.parameters()
    shapes = {name: x.shape for name, x in params.items() if x.ndim}
    layers = {"layers.0.weight": (4, 1), "layers.0.bias": (4,), "layers.1.weight": (1, 4), "layers.1.bias": (1,)}
    expected = {"pad.law.weights": (3,), "pad.law.knots": (3,)}
    expected |= {f"pad.friction.net.{name}": shape for name, shape in layers.items()}
    expected |= {f"wind.function.net.{name}": shape for name, shape in layers.items()} | {
        "wind.function.net.layers.0.weight": (4, 2)
    }
    assert shapes == expected
    assert hash(scene) == hash(scene_of(*parts())) and scene == scene_of(*parts())
    assert all(isinstance(x, Held) is False for x in jax.tree.leaves(scene))
    doubled = jax.tree.map(lambda x: 2 * x if eqx.is_inexact_array(x) else x, modules)
    again = scene.parameters(doubled)
    for name in shapes:
        np.testing.assert_array_equal(again[name], 2 * params[name])


@pytest.mark.full
def test_a_part_with_arrays_runs_as_one_with_numbers(whole):
    """A spline whose arrays are parameters, and one of plain Python numbers, are the same law."""
    scene, _ = whole

    class Plain(bj.laws.AbstractLaw):
        """``Pad`` of numbers."""

        needs = Pad.needs
        quantities = Pad.quantities

        def force(self, penetration, rate, c):
            """As ``Pad.force``."""
            return parts()[0].force(penetration, rate, c)

    same = scene_of(Plain(), *parts()[1:])
    found, expected = (bj.simulate(s, s.parameters(), TIMES) for s in (scene, same))
    assert found.status == expected.status == "ok" and found.force["pad"].max() > 50.0
    np.testing.assert_allclose(found.force["pad"], expected.force["pad"], rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mode", tiers.ci(["auto", "reverse"], "auto"))
def test_gradients_of_modules_are_those_of_differences(whole, mode):
    scene, modules = whole

    @eqx.filter_jit
    def loss(modules):
        force = bj.force_history(scene, scene.parameters(modules), TIMES, accuracy=1e-7, mode=mode)["pad"]
        return jnp.sum(force[:, 0] ** 2 + 4.0 * force[:, 1] ** 2 + 4.0 * force[:, 2] ** 2) * 1e-4

    gradient = eqx.filter_grad(loss)(modules)
    for k, name in enumerate(modules):
        way = jax.tree.map(lambda x: np.random.default_rng(3).normal(size=x.shape), eqx.filter(modules[name], _trained))
        along = sum(jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(gradient[name]), jax.tree.leaves(way), strict=True))
        ends = [
            loss({**modules, name: eqx.apply_updates(modules[name], jax.tree.map(lambda x, s=s: s * x, way))})
            for s in (2e-3, -2e-3)
        ]
        difference = float(ends[0] - ends[1]) / 4e-3
        assert abs(difference) > 1e-4, (k, name)
        assert float(along) == pytest.approx(difference, rel=2e-3), name


def _trained(x):
    return isinstance(x, (jax.Array, np.ndarray)) and jnp.issubdtype(x.dtype, jnp.floating)


@pytest.mark.slow
def test_arrays_go_through_vmap_and_jvp(whole):
    scene, _ = whole
    params = scene.parameters()

    def peak(weights):
        return jnp.max(bj.force_history(scene, {**params, "pad.law.weights": weights}, TIMES)["pad"][:, 0])

    many = jnp.stack([params["pad.law.weights"] + shift for shift in (0.0, 0.3)])
    peaks = jax.vmap(peak)(many)
    assert peaks[1] > peaks[0]
    value, slope = jax.jvp(peak, (many[0],), (jnp.ones(3),))
    assert float(value) == pytest.approx(float(peaks[0]), rel=1e-9)
    assert float(slope) == pytest.approx(float(peaks[1] - peaks[0]) / 0.3, rel=0.2)


def test_parameters_of_ones_own_may_be_arrays():
    weights = bj.Quantity("weights", "N", "force by time", 0.0)

    def push(t, bodies, p):
        return [bj.loads.Action("a", force=(jnp.interp(t, jnp.linspace(0.0, 1.0, 4), p["weights"]), 0.0, 0.0))]

    make = lambda default, **more: bj.Mechanism(  # noqa: E731
        "own", [bj.Body("a", "particle", mass=2.0)], loads=[bj.Load("push", push)], own=[(weights, default)], **more
    )
    scene = make(np.ones(4))
    assert hash(scene) == hash(make([1.0, 1.0, 1, 1]))
    run = bj.simulate(scene, scene.parameters(weights=np.full(4, 3.0)), [0.0, 1.0], read=["a.place.x"])
    assert run.readings["a.place.x"][-1] == pytest.approx(0.75, rel=1e-6)
    assert make(np.ones(4), given={"weights": np.full(4, 2.0)}).parameters()["weights"].tolist() == [2.0] * 4
    for bad, found in (
        (np.ones(3), r"weights has shape \(3,\); give an array of shape \(4,\)"),
        (1.0, r"weights has shape \(\); give an array of shape \(4,\)"),
        (np.array([1.0, -1.0, 1.0, 1.0]), "weights = -1 N is out of range"),
        ("2 N", r"weights has shape \(\)"),
    ):
        with pytest.raises(bj.InputError, match=found):
            scene.parameters(weights=bad)
    with pytest.raises(bj.InputError, match=r"shape \(2, 4\); give an array of shape \(4,\); many runs"):
        bj.simulate(scene, {"weights": np.ones((2, 4)), "a.mass": 2.0}, [0.0, 1.0])
    with pytest.raises(bj.InputError, match="is an array of shape"):
        bj.sensitivity(scene, scene.parameters(), np.linspace(0.0, 1.0, 5), ["weights"])


def test_modules_in_the_wrong_place_are_refused(whole):
    scene, modules = whole
    with pytest.raises(bj.InputError, match=r"no parameter 'pad.frction.net.layers.0.weight'.*did you mean"):
        scene.parameters({"pad.frction": modules["pad.friction"]})
    for refused in (
        lambda: bj.design(scene, scene.parameters(), TIMES, "pad.peak", {"pad.damping": (0.05, 0.3)}),
        lambda: of_numbers(scene),
    ):
        with pytest.raises(bj.InputError, match=r"has parameters that are arrays: pad\.law\.weights, "):
            refused()
    with pytest.raises(bj.InputError, match="holds no array"):
        scene.parameters({"pad.law": bj.laws.MemoryFree()})


def test_traced_structure_is_refused_and_the_message_says_where_values_are_passed(whole):
    law, _, wind = parts()
    plane = bj.gaps.PointOnPlane("y")
    makers = {
        "mass": lambda x: bj.Body("b", "slide", mass=x),
        "start": lambda x: bj.Body("b", "slide", start={"position": x}),
        "place": lambda x: bj.Body("b", "slide", at=(0.0, x, 0.0)),
        "inertia": lambda x: bj.Body("b", "hinge", inertia=[1.0, x, 1.0]),
        "load": lambda x: bj.loads.Force("f", "b", size=x),
        "table": lambda x: bj.loads.Force("f", "b", table=([0.0, 1.0], [0.0, x])),
        "given": lambda x: bj.Mechanism("m", [bj.Body("b", "slide")], given={"mass": x}),
        "own": lambda x: bj.Mechanism("m", [bj.Body("b", "slide")], own=[(bj.Quantity("w", "1", "w"), x)]),
        "law": lambda x: bj.Contact(
            "c", ("ground", "b"), plane, eqx.tree_at(lambda a: a.weights, law, law.weights * x)
        ),
        "value": lambda x: bj.Contact("c", ("ground", "b"), plane, values={"stiffness": x}),
        "closure": lambda x: bj.Mechanism(
            "m", [bj.Body("b", "slide")], loads=[bj.Load("l", lambda t, bodies, p: [x * bodies, wind])]
        ),
        "drive": lambda x: bj.Body("b", "slide", drive=bj.Drive("function", function=lambda t, p: x * t)),
        "size": lambda x: bj.Mechanism("m", [bj.Body("b", "slide", mass=lambda p: x)]),
    }
    for name, make in makers.items():
        for transform in (jax.jit, jax.grad):

            def of(x, make=make):
                make(x)
                return x

            with pytest.raises(bj.InputError) as caught:
                transform(of)(1.0)
            assert "traced" in caught.value.found and "pass the values as parameters" in caught.value.remedy, name
