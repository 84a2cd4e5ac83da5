"""Units at the edges."""

from __future__ import annotations

import math

import pytest

from bcfj_jax.core.errors import InputError
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
    ],
)
def test_texts_become_si(given, unit, wanted):
    assert quantity(given, unit, "here") == pytest.approx(wanted, rel=1e-15)


@pytest.mark.parametrize("text", ["100 r/min", "100 rpm", "100rpm"])
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
    ],
)
def test_bad_values_say_what_is_right(given, unit, parts):
    with pytest.raises(InputError) as caught:
        quantity(given, unit, "f.toml: [parameters] x")
    for part in ["f.toml: [parameters] x", *parts]:
        assert part in str(caught.value)


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
    assert scale_of("us", "s", "here") == 1e-6
    assert scale_of("kN", "N", "here") == 1000.0
    assert scale_of("%", "1", "here") == 0.01
    with pytest.raises(InputError, match="column 2: 'kN' is not in a unit that converts to s"):
        scale_of("kN", "s", "column 2")


def test_text_for_people():
    assert engineering([0.0, -4e-5, math.nan]) == (1e6, "u")
    assert engineering([]) == (1.0, "")
    assert format_si(1.2345678e4, "N") == "12.3457 kN"
    assert format_si(6e-5, "s") == "60 us"
    assert format_si(0.0167, "kg") == "16.7 g"
    assert format_si(0.9, "1") == "0.9"
    assert format_si(math.nan, "N") == "-"
