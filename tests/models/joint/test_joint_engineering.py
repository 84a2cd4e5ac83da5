"""Pressure, patch and power of the joint's contacts against the physics sheet's table and closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from joints import plain_joint

from bcfj_jax.analysis.simulation.page import contact_rows
from bcfj_jax.models.joint.constants import patch
from bcfj_jax.models.joint.engineering import of_the_contacts

# Physics sheet 1.4: r = 8 mm, Rc = 35.8 mm, 45 degrees, f = 0.52.
SHEET = {"contact_angle": np.pi / 4, "pitch_radius": np.sqrt(35.8e-3**2 - 4.5e-3**2), "offset": 4.5e-3}
# The section of a groove is wider by the clearance, of which the sheet has none.
SHEET |= {"clearance_seat_ball": 0.0, "clearance_head_ball": 0.0}


@pytest.mark.parametrize(
    ("name", "pressure", "depth"), [("seat_ball", 3.09e9, 46.4e-6), ("head_ball", 3.57e9, 47.8e-6)]
)
def test_grooves_of_the_sheet(name, pressure, depth):
    scene = plain_joint()
    shape, _ = patch(scene, scene.parameters(SHEET), name)
    assert float(shape.peak_pressure(11.95e3)) == pytest.approx(pressure, rel=3e-3)
    assert float(shape.penetration(11.95e3)) == pytest.approx(depth, rel=3e-3)


def test_patches_power_and_what_is_void():
    scene = plain_joint()
    params = scene.parameters()
    times = np.linspace(0.0, 3.0, 31)
    force = {name: np.zeros((31, 6, 3) if "ball" in name else (31, 3)) for name in ("cage_ball", "seat_cage")}
    force["cage_ball"][..., 0] = -5e3
    force["seat_cage"][:] = [20e3, 300.0, 400.0]
    depth = {"cage_ball": np.full((31, 6), 1e-4), "seat_cage": np.full(31, 8.1e-3)}
    run, rubbed = (
        SimpleNamespace(times=times, force=force, penetration=depth),
        {"cage_ball": 0.0 * times, "seat_cage": 10.0 * (times >= 1.0)},
    )
    found = of_the_contacts(scene, params, run, rubbed)
    window, pilot = found["cage_ball"], found["seat_cage"]
    # Circle of a ball on a flat: a^3 = 3 F r/(4 E*), p = 3 F/(2 pi a^2).
    a = (3 * 5e3 * 8e-3 / (4 * 113e9)) ** (1 / 3)
    assert window["half_axes"] == pytest.approx([a, a], rel=1e-6)
    assert window["pressure"] == pytest.approx(1.5 * 5e3 / (np.pi * a * a), rel=1e-6)
    # The audit's 5.8 GPa at 5 kN.
    assert window["pressure"] == pytest.approx(5.8e9, rel=0.01) and "ISO 76" in window["void"]
    assert pilot["power"] == 10.0 and window["power"] == 0.0
    assert pilot["half_axes"][0] / 39.95e-3 > 0.3 and "too wide" in pilot["void"]
    assert "yields above 4.2 GPa (ISO 76, ball contact): cage_ball 5.78 GPa; a patch" in found["warning"]
    assert "deeper than a ball's radius: seat_cage 0.0081 m" in found["warning"]
    content = {"contacts": {"seat_cage": {"peak": 20e3}} | {f"cage_ball_{k}": {"peak": k} for k in range(1, 7)}}
    rows = {row[0]: row[1:] for row in contact_rows(scene, content | {"engineering": found})}
    assert rows["feature"] == ["seat_cage", "cage_ball (1 to 6)"] and rows["peak"] == ["20 kN", "1 to 6 N"]
    assert rows["half-axes of patch"][1] == "643 x 643 µm" and rows["Hertz pressure"][1] == "5.78 GPa"
    assert rows["friction power"] == ["10 W", "0 W"]
    assert "power" not in of_the_contacts(scene, params, run)["seat_cage"]
