"""From one unit to another: known figures, there and back, and what is refused."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.errors import UsageError
from becalm.files.units.unit_conversion import conversion
from becalm.files.units.unit_spelling import QUANTITIES
from becalm.identification.at_rest.datasheet import convert

G0 = 9.80665


@pytest.mark.parametrize(
    ("unit_from", "unit_to", "factor"),
    [
        ("g", "m/s^2", G0),
        ("mg", "m/s2", G0 / 1000),
        ("m.s-2", "g", 1 / G0),
        ("g", "kg", 1e-3),
        ("kg/m3", "g/cm3", 1e-3),
        ("mV", "V", 1e-3),
        ("mV/V", "V/V", 1e-3),
        ("dps", "rad/s", math.pi / 180),
        ("°/s", "mdeg/s", 1000),
        ("rpm", "deg/s", 6),
        ("µε", "mm/m", 1e-3),
        (r"um\m", "%", 1e-4),
        ("N/mm²", "MPa", 1),
        ("psi", "kPa", 6.894757293168361),
        ("kgf", "N", G0),
        ("kN", "N", 1000),
        ("Nm", "kN*m", 1e-3),
        ("counts", "LSB", 1),
        ("uT", "Gauss", 0.01),
        ("ug/sqrt(Hz)", "m/s^2/sqrt(Hz)", G0 * 1e-6),
        ("deg/s/sqrt(Hz)", "(rad/s)/sqrt(Hz)", math.pi / 180),
        ("deg/sqrt(h)", "deg/sqrt(s)", 1 / 60),
        ("um/m/sqrt(Hz)", "ustrain/sqrt(Hz)", 1),
        ("degC/s", "K/min", 60),
        ("pC/g", "pC/(m/s^2)", 1 / G0),
    ],
)
def test_a_known_factor(unit_from: str, unit_to: str, factor: float) -> None:
    found = conversion(unit_from, unit_to)
    assert found.factor == pytest.approx(factor, rel=1e-15)
    assert found.offset == 0


@pytest.mark.parametrize(
    ("unit_from", "unit_to", "value", "is_value"),
    [
        ("degC", "K", 0, 273.15),
        ("degF", "degC", 212, 100),
        ("°C", "°F", -40, -40),
        ("K", "degF", 273.15, 32),
        ("F", "C", 32, 0),
    ],
)
def test_a_temperature(unit_from: str, unit_to: str, value: float, is_value: float) -> None:
    factor, offset = conversion(unit_from, unit_to)
    assert factor * value + offset == pytest.approx(is_value, abs=1e-12)


KINDS = [
    ("V", "mV", "uV"),
    ("g", "mg", "m/s^2", "cm/s^2"),
    ("kg", "lb", "t"),
    ("deg/s", "rad/s", "rpm", "mdps"),
    ("um/m", "mm/m", "%", "ppm"),
    ("N", "kN", "kgf", "lbf"),
    ("MPa", "bar", "psi", "mbar"),
    ("degC", "degF", "K"),
    ("uT", "mG", "T"),
    ("ug/sqrt(Hz)", "m/s^2/sqrt(Hz)", "mg/sqrt(Hz)"),
]


@settings(max_examples=50)
@given(data=st.data(), value=st.floats(-1e6, 1e6))
def test_there_and_back_again(data: st.DataObject, value: float) -> None:
    units = data.draw(st.sampled_from(KINDS))
    one, other = data.draw(st.sampled_from(units)), data.draw(st.sampled_from(units))
    there, back = conversion(one, other), conversion(other, one)
    carried = there.factor * value + there.offset
    assert back.factor * carried + back.offset == pytest.approx(value, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize(("unit", "other"), [("g", "m/s^2"), ("ug", "mg"), ("deg/s", "deg/h"), ("um/m", "nm/m")])
def test_data_sheets_agree(unit: str, other: str) -> None:
    assert conversion(unit, other).factor == pytest.approx(convert(1.0, unit, other), rel=1e-14)


@pytest.mark.parametrize(
    ("unit_from", "unit_to", "sentence"),
    [
        ("foo", "V", "'foo' is not a unit that becalm can convert; write one as V, mV/V, g"),
        ("V", "9^9^9^9", "is not a unit"),
        ("V", "m^999", "is not a unit"),
        ("V", "V)", "is not a unit"),
        ("V" * 70, "V", "is not a unit"),
        ("", "V", "'' is not a unit"),
        ("V", "g", "'V' is a unit of voltage, 'g' of acceleration; they cannot be converted.*voltage, as 'mV'"),
        ("kg", "N", "'kg' is a unit of mass, 'N' of force.*Kilograms of force are written kgf"),
        ("g", "N", "A g is standard gravity; it is a gram only if the other unit is a mass"),
        ("counts", "V", "unit of count"),
        ("counts", "rad", "unit of count"),
        ("rpm", "Hz", "'rpm' is a unit of angular rate, 'Hz' of frequency"),
        ("rad", "m/m", "unit of angle"),
        ("mV/V", "um/m", "ratio of voltage, 'um/m' of length; to convert them, the sensitivity"),
        ("deg/sqrt(h)", "deg/s/sqrt(Hz)", "two conventions, one-sided per root of hertz"),
        ("m^0.5", "m", "length\\^0.5"),
    ],
)
def test_what_cannot_be_converted_is_said(unit_from: str, unit_to: str, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        conversion(unit_from, unit_to)


@pytest.mark.parametrize(("name", "unit"), QUANTITIES.items())
def test_no_two_quantities_are_one(name: str, unit: str) -> None:
    for other, example in QUANTITIES.items():
        if other != name:
            with pytest.raises(UsageError, match=f"{name}.* of {other}"):
                conversion(unit.replace("g_n", "g"), example.replace("g_n", "g"))


def test_equal_units_need_no_library() -> None:
    code = "from becalm.files.units.unit_conversion import conversion; print(conversion('widgets', 'widgets'))"
    ran = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; assert 'pint' not in sys.modules"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.strip() == "Conversion(factor=1.0, offset=0.0)"


def test_no_unit_is_told_twice() -> None:
    code = (
        "import logging; logging.basicConfig(level=logging.WARNING)\n"
        "from becalm.files.units.unit_conversion import conversion; print(conversion('V', 'mV').factor)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout.strip(), ran.stderr) == ("1000.0", "")
