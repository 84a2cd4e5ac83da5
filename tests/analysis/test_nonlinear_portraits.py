"""Contact modes against made-up histories; every picture is drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax import nonlinear, scenes
from bcfj_jax.analysis.nonlinear import diagrams, portraits
from bcfj_jax.core.errors import InputError
from bcfj_jax.solve.simulation import Run

PNG = b"\x89PNG\r\n\x1a\n"


def joint_run(scene, times):
    """A made-up run of a joint: each ball is loaded by its azimuth, windows touch at twice the drive's frequency."""
    turn = 2.0 * np.pi * times
    around = turn[:, None] + scene.azimuths
    states = np.zeros((times.size, scene.states))
    states[:, scene.coordinates()["seat_turn"][0]] = turn
    load = 1e4 * (1.0 + 0.5 * np.cos(around))
    depth = {name: 1e-5 * np.sin(2.0 * around) for name in ("cage_ball", "seat_ball", "head_ball")}
    rate = {name: 4e-5 * np.pi * np.cos(2.0 * around) for name in depth}
    depth |= {name: 1e-5 * np.cos(turn) for name in ("seat_cage", "head_cage")}
    rate |= {name: -2e-5 * np.pi * np.sin(turn) for name in ("seat_cage", "head_cage")}
    force = {name: np.zeros((*d.shape, 3)) for name, d in depth.items()}
    force["seat_ball"][..., 0] = load
    return Run(times, force, depth, rate, {}, "ok", "", math.nan, {}, {}, states)


def test_modes_of_half_sines():
    """d = sin(2 pi t): contacts of half a second each second."""
    times = np.linspace(0.25, 3.1, 2000)
    depth, rate = np.sin(2.0 * np.pi * times), 2.0 * np.pi * np.cos(2.0 * np.pi * times)
    for longest, code in ((0.6, portraits.IMPACT), (0.4, portraits.CONTINUOUS)):
        found = nonlinear.contact_modes(times, depth, rate, longest)
        assert np.array_equal(found == portraits.FREE, depth <= 0)
        assert (found[(times > 1.001) & (times < 1.499)] == code).all()
        # Cut off by either end: nobody knows how long.
        assert (found[times < 0.499] == portraits.CONTINUOUS).all()
        assert (found[times > 3.001] == portraits.CONTINUOUS).all()


def test_mode_of_a_contact_between_samples_and_after_a_failure():
    times = np.linspace(0.0, 1.0, 100)
    depth, rate = -np.abs(times - 0.4), np.where(times < 0.4, 1.0, -1.0)
    found = nonlinear.contact_modes(times, depth, rate, 0.1)
    assert np.count_nonzero(found == portraits.IMPACT) == 1 and abs(times[np.argmax(found)] - 0.4) < 0.02
    depth[60:] = np.nan
    assert (nonlinear.contact_modes(times, depth, rate, 0.1)[60:] == portraits.UNKNOWN).all()
    with pytest.raises(InputError, match="impact_time"):
        nonlinear.contact_modes(times, depth, rate, 0.0)


def test_coordinates_of_the_state_move_at_their_rates():
    """Of the assembled joint at two instants near by."""
    scene = plain_joint()
    params = scene.parameters()
    from bcfj_jax.models.joint.kinematic import nominal

    first, second = (np.asarray(nominal(scene, params, turn)) for turn in np.array([0.3, 0.3 + 1e-6]))
    elapsed = 1e-6 / float(params["drive_speed"])
    places = scene.coordinates()
    assert len(places) == 18 + 3 + 1 + 3 + 1
    for at, rate in places.values():
        assert (second[at] - first[at]) / elapsed == pytest.approx(0.5 * (first[rate] + second[rate]), abs=1e-6)
    assert scenes.bounce().coordinates() == {"body": (0, 1)}


def test_pictures_of_a_run(tmp_path):
    scene = plain_joint()
    run = joint_run(scene, np.linspace(0.0, 2.0, 801))
    drawn = [
        nonlinear.contact_portrait(run, "cage_ball", tmp_path / "a.png", window=(1.0, 2.0)),
        nonlinear.contact_portrait(run, "seat_cage", tmp_path / "b.png"),
        nonlinear.state_portrait(run, scene, "cage.x", tmp_path / "c.png"),
        nonlinear.contact_raster(run, tmp_path / "d.png", impact_time=0.1),
        nonlinear.ball_loads(run, scene, tmp_path / "e.png", window=(1.0, 2.0)),
    ]
    assert [path.name for path in drawn] == ["a.png", "b.png", "c.png", "d.png", "e.png"]
    assert all(path.read_bytes().startswith(PNG) for path in drawn)


def test_pictures_of_a_bounce_that_failed(tmp_path):
    scene = scenes.bounce()
    times = np.linspace(0.0, 0.5, 501)
    depth, rate = 1e-3 * np.sin(60.0 * times), 60e-3 * np.cos(60.0 * times)
    for part in (depth, rate):
        part[300:] = np.nan
    states = np.stack([-depth, -rate], 1)
    readings = {"contact": depth}, {"contact": rate}
    run = Run(times, {"contact": np.zeros((501, 3))}, *readings, {}, "failed", "", 0.3, {}, {}, states)
    assert nonlinear.contact_portrait(run, "contact", tmp_path / "a.png").exists()
    assert nonlinear.state_portrait(run, scene, "body", tmp_path / "b.png").exists()
    assert nonlinear.contact_raster(run, tmp_path / "c.png", impact_time=0.01).exists()


def test_pictures_of_maps(tmp_path):
    values = np.linspace(2.8, 4.0, 60)
    points = nonlinear.map_bifurcation(lambda x, r: r * x * (1.0 - x), 0.3, values, transients=100, kept=20)
    points[7] = np.nan
    names = {"parameter": "r", "reading": "x"}
    assert nonlinear.draw_bifurcation(values, points, tmp_path / "a.png", **names).exists()
    assert nonlinear.draw_bifurcation(values, np.stack([points, 1 - points], -1), tmp_path / "b.png", **names).exists()
    assert nonlinear.draw_section(points[3], points[4], tmp_path / "c.png", labels=("x", "y")).exists()
    found = nonlinear.map_exponent(lambda x: 4.0 * x * (1.0 - x), 0.3, 100)
    assert nonlinear.draw_exponent({"r = 4": found}, tmp_path / "d.png").exists()


def test_what_is_wrong_with_a_picture_is_said(tmp_path):
    scene, bounce = plain_joint(), scenes.bounce()
    run = joint_run(scene, np.linspace(0.0, 1.0, 11))
    path = tmp_path / "x.png"
    with pytest.raises(InputError, match="did you mean 'cage_ball'"):
        nonlinear.contact_portrait(run, "cage_bal", path)
    with pytest.raises(InputError, match="cage_turn"):
        nonlinear.state_portrait(run, scene, "cage_turn", path)
    with pytest.raises(InputError, match="no members"):
        nonlinear.ball_loads(run, bounce, path)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="contact of a ball"):
        nonlinear.ball_loads(run, scene, path, contact="seat_cage")
    with pytest.raises(InputError, match="no states"):
        nonlinear.state_portrait(run._replace(trajectory=None), scene, "cage.x", path)
    with pytest.raises(InputError, match="window"):
        nonlinear.contact_raster(run, path, impact_time=0.1, window=(0.5, 3.0))
    assert not path.exists()


def test_a_failed_value_is_nan_throughout():
    kept = diagrams._without(np.ones((3, 2, 4)), ["", "why", ""])
    assert np.isnan(kept[1]).all() and np.isfinite(kept[[0, 2]]).all()
