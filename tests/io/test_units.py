"""Units at the edges."""

from __future__ import annotations

import math
import subprocess
import sys
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcfj_jax.core.errors import InputError, clip, together
from bcfj_jax.io import units
from bcfj_jax.io.units import column, engineering, format_si, quantity, scale_of

pytestmark = pytest.mark.filterwarnings("error")


@pytest.mark.parametrize(
    ("given", "unit", "wanted"),
    [
        (3, "m", 3.0),
        (1.5e-3, "m", 1.5e-3),
        ("12.5 um", "m", 1.25e-5),
        ("12.5 µm", "m", 1.25e-5),
        ("60us", "s", 6e-5),
        ("-5 us", "s", -5e-6),
        ("1.8 kN m", "N m", 1800.0),
        ("2 %", "1", 0.02),
        ("0.5", "1", 0.5),
        ("207 GPa", "Pa", 207e9),
        ("7.85 g/cm^3", "kg/m^3", 7850.0),
        ("8 deg", "rad", math.radians(8)),
        ("8°", "rad", math.radians(8)),
        ("12.5 μm", "m", 1.25e-5),
        ("3 N·m", "N m", 3.0),
        ("3 N*m", "N m", 3.0),
        ("3 Nm", "N m", 3.0),
        ("3 kNm", "N m", 3000.0),
        ("3 Nmm", "N m", 3e-3),
        ("3 Ns", "N s", 3.0),
        ("9.81 m/s2", "m/s^2", 9.81),
        ("9.81 m/s²", "m/s^2", 9.81),
        ("9.81 m s⁻²", "m/s^2", 9.81),
        ("9.81 m s-2", "m/s^2", 9.81),
        ("50 N/(m/s)", "N s/m", 50.0),
        ("5 kHz", "Hz", 5000.0),
        ("1 1/s", "rad/s", 1.0),
    ],
)
def test_texts_become_si(given, unit, wanted):
    assert quantity(given, unit, "here") == pytest.approx(wanted, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["100 r/min", "100 rpm", "100rpm", "100 1/min", "100 min^-1", "100 min⁻¹", "100 U/min"]
)
def test_revolutions_per_minute(text):
    assert quantity(text, "rad/s", "here") == pytest.approx(100 * 2 * math.pi / 60, rel=1e-14)


@pytest.mark.parametrize(
    ("given", "unit", "parts"),
    [
        (True, "m", ["True", '"1.2 mm"']),
        ([1], "m", ["[1]", '"1.2 mm"']),
        ("long", "m", ["'long'", '"1.2 mm"']),
        ("5", "m", ["'5' has no unit", '"1.2 mm"']),
        ("5 foo", "s", ["'5 foo'", "('foo')", '"60 us"']),
        ("3 m/", "m", ["'3 m/'"]),
        ("3 kg", "m", ["'3 kg'", "converts to m", '"1.2 mm"']),
        ("3 m", "1", ["'3 m'", '"90 %"']),
        ("20 degC", "K", ["offset"]),
        ("20 dB", "1", ["offset"]),
        ("0,5 kg", "kg", ["'0,5 kg' has a decimal comma", 'write "0.5 kg"']),
        ("0,5", "1", ["decimal comma", 'write "0.5"']),
        ("1,000.5 N", "N", ["commas between thousands", 'write "1000.5 N"']),
        ("1.234,5 N", "N", ["decimal comma", 'write "1234.5 N"']),
        ("1,000 N", "N", ['write "1.000 N" or "1000 N"']),
        ("1 KN", "N", ["('KN')", "write kN; case matters"]),
        ("10 Hz", "rad/s", ["counts cycles", "6000 rpm"]),
        ("10 rpm", "Hz", ["rotational speed", "50 Hz"]),
        ("1 kg**9**9**9", "kg", ["a power stands where a symbol must"]),
        ("1 kg^99", "kg", ["a power of 99", "at most 12"]),
        ("1 N/((m)(s))", "N s/m", ["brackets inside brackets"]),
        ("1 (m", "m", ["open bracket"]),
        ("1 " + "kg" * 100_000, "kg", ["a text of 200002 characters"]),
        ("9e999 kg", "kg", ["too large"]),
        (10**400, "kg", ["too large"]),
        (math.nan, "kg", ["not a number"]),
    ],
)
def test_bad_values_say_what_is_right(given, unit, parts):
    with pytest.raises(InputError) as caught:
        quantity(given, unit, "f.toml: [parameters] x")
    for part in ["f.toml: [parameters] x", *parts]:
        assert part in str(caught.value)
    assert len(str(caught.value)) < 500


PIECES = ["kN", "m", "^", "**", "9", "(", ")", "/", "*", " ", "-2", "e", "degC", "dB", "Hz"]


@pytest.mark.full
@settings(deadline=None, max_examples=150, derandomize=True)
@given(
    st.one_of(
        st.text(max_size=300),
        st.text("kNmsgµ°%·*^/()-+. 0123456789,[]", max_size=60),
        st.lists(st.sampled_from(PIECES), max_size=40).map("".join),
    ),
    st.sampled_from(["m", "1", "rad/s", "Hz", "K", "N/m^n", "N s/m"]),
)
def test_no_text_takes_long_or_raises_anything_else(text, unit):
    """0.1 s is what one text may take; Pint's own parser takes hours for an exponent tower."""
    scale_of("m", "m", "loads Pint")
    for read in (
        lambda: quantity(f"1 {text}", unit, "here"),
        lambda: scale_of(text, unit, "here"),
        lambda: column(text),
    ):
        start = time.process_time()
        try:
            found = read()
        except InputError as error:
            found = float(len(str(error)))
        assert not isinstance(found, float) or found < 1e300
        assert time.process_time() - start < 0.1


def test_messages_are_cut_and_faults_are_listed():
    assert (
        clip("a" * 200) == "a" * 200 and len(clip("a" * 5000)) <= 200 and clip(10**5000).startswith("a value of type")
    )
    assert len(str(InputError("w" * 5000, "f" * 500_000, "r" * 5000))) < 4000
    one, two = InputError("d.csv: line 3", "a", "b"), InputError("d.csv: line 4", "c", "d")
    assert together("d.csv", [one]) is one
    assert str(together("d.csv", [one, two])).splitlines()[:3] == [
        "d.csv: 2 faults; correct them, then repeat the command:",
        "  line 3: a; b",
        "  line 4: c; d",
    ]


def test_stiffness_is_converted_with_its_exponent():
    assert quantity("1e5 N/mm^1.5", "N/m^n", "here", exponent=1.5) == pytest.approx(1e5 * 1000**1.5)
    assert quantity("1e5 N/mm", "N/m^n", "here", exponent=1.0) == pytest.approx(1e8)
    assert quantity("1e5 N/mm^1.5", "N/m^n", "here") == pytest.approx(1e5 * 1000**1.5)


def test_stiffness_unit_trap():
    with pytest.raises(InputError, match=r"'1e5 N/mm' is in force over length\^1, .*exponent is 1.5; .*N/m\^1.5"):
        quantity("1e5 N/mm", "N/m^n", "here", exponent=1.5)
    with pytest.raises(InputError, match="not in a unit of force over length to the exponent"):
        quantity("1e5 N", "N/m^n", "here", exponent=1.5)


def test_columns_and_scales():
    assert column("force [kN]") == ("force", "kN")
    assert column(" contact.normal  [ N ] ") == ("contact.normal", "N")
    assert column("time") == ("time", None)
    for header in ("F (kN)", "F / kN", "F/kN", "F in kN", "F, kN", "F_kN", "F kN", "F / (kN)"):
        assert column(header) == ("F", "kN")
    for header in ("m/s", "Force (raw)", "Force (A)", "F/B", "run/experiment", "F_N", "Fx (1)"):
        assert column(header) == (header, None)
    assert column("contact_force_kN") == ("contact_force", "kN") and column("v_x_mm_s") == ("v_x", "mm/s")
    assert column("acc_m_s2") == ("acc", "m/s^2") and column("a_m_per_s2") == ("a", "m/s^2")
    assert column("t/s") == ("t", "s") and column("s/mm") == ("s", "mm") and column("v m/s") == ("v", "m/s")
    assert scale_of("-", "1", "here") == 1.0
    assert scale_of("us", "s", "here") == 1e-6
    assert scale_of("kN", "N", "here") == 1000.0
    assert scale_of("%", "1", "here") == 0.01
    with pytest.raises(InputError, match="column 2: 'kN' is not in a unit that converts to s"):
        scale_of("kN", "s", "column 2")


@pytest.mark.parametrize(
    ("header", "name", "unit", "si", "scale"),
    [
        ("Time (mSec)", "Time", "msec", "s", 1e-3),
        ("Load [LBF]", "Load", "lbf", "N", 4.4482216152605),
        ("Siła [kG]", "Siła", "kgf", "N", 9.80665),
        ("v_impact_mps", "v_impact", "m/s", "m/s", 1.0),
    ],
)
def test_units_of_words_in_any_case(header, name, unit, si, scale):
    assert column(header) == (name, unit)
    assert scale_of(unit, si, "") == pytest.approx(scale)


def test_text_for_people():
    assert engineering([0.0, -4e-5, math.nan]) == (1e6, "u")
    assert engineering([]) == (1.0, "")
    assert format_si(1.2345678e4, "N") == "12.3457 kN"
    assert format_si(6e-5, "s") == "60 us"
    assert format_si(0.0167, "kg") == "16.7 g"
    assert format_si(0.9, "1") == "0.9"
    assert format_si(math.nan, "N") == "-"


def test_common_units_are_what_pint_makes_of_them():
    for (text, unit), factor in units._COMMON.items():
        assert units._by_pint(text, unit, "here", None, text) == factor, (text, unit)


def test_a_common_unit_of_another_quantity_is_refused_as_pint_refuses_it(monkeypatch):
    asked = [(text, of, other) for text, of in units._COMMON for other in units._APART - {of} if of in units._APART]
    refused = []
    for text, _, other in asked:
        with pytest.raises(InputError) as by_pint:
            units._by_pint(text, other, "here", None, text)
        refused.append(str(by_pint.value))
    monkeypatch.setattr(units, "parse", None)  # Pint is not asked.
    for (text, _, other), said in zip(asked, refused, strict=True):
        with pytest.raises(InputError) as found:
            units.scale_of(text, other, "here")
        assert str(found.value) == said


def test_a_usual_scene_file_and_a_usual_record_need_no_pint(tmp_path):
    rows = "".join(f"{k},{k % 5},{k}\n" for k in range(40))
    (tmp_path / "a.csv").write_text("time [us],force [kN],depth [mm]\n" + rows)
    code = """
import sys
from pathlib import Path
from bcfj_jax.io.scenefile import from_table
from_table({
    "scene": {"kind": "impact"}, "parameters": {"mass": "500 g", "approach_speed": "20 mm/s"}, "time": {"end": "60 us"},
}, None)
from bcfj_jax.data.reading import read
table = read(Path(sys.argv[1]), "here")
assert table.clock == "time [us]" and table.numbers("force [kN]", "N", "here", False)[1] == 1e3
assert "pint" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.csv")], check=True)


@pytest.mark.parametrize("text", ["g", "G", "gn", "g's", "gs", "g_n"])
@pytest.mark.parametrize("name", ["acceleration", "Accel", "acc_z", "ax", "Beschleunigung", "Acceleration y"])
@pytest.mark.parametrize("way", ["{} [{}]", "{} ({})", "{} in {}", "{}_{}"])
def test_an_acceleration_in_g_is_one_of_the_standard_gravity(name, text, way):
    found, unit = column(way.format(name, text))
    assert found == name and scale_of(str(unit), "m/s^2", "here") == 9.80665


def test_grams_stay_grams():
    assert scale_of("g", "kg", "here") == 1e-3 and quantity("12 g", "kg", "here") == 0.012
    assert column("mass_g") == ("mass_g", None) and not units.accelerates("mass")
    assert quantity("2 g", "m/s^2", "here") == 2 * 9.80665
