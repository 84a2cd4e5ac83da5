"""Force plates: the force that is hit, its sign, and where on the plate it acts."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax.data.reading import read
from benchmarks.calibration import instruments
from calibration import init
from calibration.impacts import plates

X, Y = 0.02, -0.03
SI = {"x": X, "y": Y}


def plate(path, sign=-1.0, moments=False):
    force = sign * instruments.FORCE
    where = {"Mx [N.mm]": 1e3 * Y * force, "My [N.mm]": -1e3 * X * force} if moments else {}
    where = where or {"Cx [mm]": 1e3 * X + 0 * force, "Cy [mm]": 1e3 * Y + 0 * force}
    columns = {"Time [s]": instruments.CLOCK, "Fx [N]": 0.1 * force, "Fy [N]": 0 * force, "Fz [N]": force, **where}
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


@pytest.mark.parametrize("moments", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_force_that_is_hit_its_sign_and_its_place(moments, sign, tmp_path):
    path = plate(tmp_path / "plate.csv", sign, moments)
    init.run(path, tmp_path / "p.toml", init.Said(mass="0.8 kg"), lambda line: None)
    text = (tmp_path / "p.toml").read_text()
    assert f'"contact.normal" = "{"-" if sign < 0 else ""}Fz [N]"' in text
    assert (
        "Of Fx [N], Fy [N], Fz [N] the one that changes most is read, Fz [N]; at its peak it acts at x = 20 mm, y = -30 mm"
        in text
    )
    # Where a force acts is not where a body is: no speed comes of it.
    assert "body.place" not in text and "from the motion before contact" not in text


def test_a_place_beside_one_force_is_that_of_a_body(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],Fz [N],Cx [mm]\n0,1,2\n1,2,3\n2,1,4\n")
    table = read(path, "here")
    assert not plates.is_pressure(table, "Cx [mm]")
    assert plates.said(table, "Fz [N]", np.array([1.0, 2.0, 1.0])) == ""


def test_a_plate_of_c3d_has_its_place_and_what_is_not_described_is_said(tmp_path):
    pytest.importorskip("ezc3d", reason="the extra io is not installed")
    path = tmp_path / "a.c3d"
    whole = instruments.files()["plate_arm.c3d"]().content
    path.write_bytes(whole)
    table = read(path, "here", "plate 1")
    peak = int(np.argmax(instruments.FORCE))
    found = [table.numbers(f"COP {axis}", "m", "here", True)[peak] for axis in "xy"]
    np.testing.assert_allclose(found, [0.02, 0.03], rtol=1e-5)
    said = plates.said(table, "Fz [N]", table.numbers("Fz", "N", "here", True))
    assert said.startswith("Of Fx [N], Fy [N], Fz [N]") and "x = 20 mm, y = 30 mm" in said
    # A type of plate that is a number with decimals, as ezc3d itself writes it.
    path.write_bytes(whole.replace(b"FORCE_PLATFORM", b"FORCE_PLATFARM"))
    assert read(path, "here", "analog").channels[3].name == "Fz"
