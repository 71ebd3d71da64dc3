"""Units out of headers."""

from __future__ import annotations

import pytest

from becalm.files.units.unit_spelling import looks_like_unit, parse_header


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Gyroscope X (deg/s)", "Gyroscope X", "deg/s"),
        (r"DMS_CN (um\m)", "DMS_CN", "um/m"),
        ("DMS_CN (µm/m)", "DMS_CN", "um/m"),
        ("DMS (μm/m)", "DMS", "um/m"),
        ("acc_0_mps2", "acc_0", "m/s^2"),
        ("time_s", "time", "s"),
        ("speed_mps", "speed", "m/s"),
        ("gyro_0_radps", "gyro_0", "rad/s"),
        ("[V]", "[V]", ""),
        ("Force [N]", "Force", "N"),
        ("Force[N]", "Force", "N"),
        ("a (m/s²)", "a", "m/s^2"),
        ("a (m/s2)", "a", "m/s^2"),
        ("T (°C)", "T", "degC"),
        ("w (°/s)", "w", "deg/s"),
        ("Time (-)", "Time", ""),
        ("U_mV", "U", "mV"),
        ("Force, kN", "Force", "kN"),
        ("Force in kN", "Force", "kN"),
        ("Time in s", "Time", "s"),
        ("Temp °C", "Temp", "degC"),
        ("Humidity %", "Humidity", "percent"),
        ("DMS µm/m", "DMS", "um/m"),
        ("a_x/(m/s^2)", "a_x", "m/s^2"),
        ("a [m/s²]", "a", "m/s^2"),
        ("a [m.s-2]", "a", "m/s^2"),
        ("a (m s^-2)", "a", "m/s^2"),
        ("w (rad.s-1)", "w", "rad/s"),
        ("p (N/mm2)", "p", "N/mm^2"),
        ("noise (ug{RMS})", "noise", "ug"),
        ("noise (ug/sqrt(Hz))", "noise", "ug/sqrt(Hz)"),
        ("sensitivity [V/(m/s^2)]", "sensitivity", "V/(m/s^2)"),
        ("Acc (m/(s^2))", "Acc", "m/s^2"),
        ("EMG 1 [Volts]", "EMG 1", "V"),
        ("Temp, \u00b0C (LGR S/N: 1, SEN S/N: 2)", "Temp", "degC"),
        ("R (k\u03a9)", "R", "kohm"),
        ("T (Degrees C)", "T", "degC"),
        ("adc (counts)", "adc", "counts"),
        ("level (dB)", "level", "dB"),
        ("w (degrees/second)", "w", "degrees/second"),
        ("V(out)", "V(out)", ""),
        ("G(x)", "G(x)", ""),
        ("timestamp (+0100)", "timestamp (+0100)", ""),
        ("Pressure (Formatted)", "Pressure (Formatted)", ""),
        ("acc (g) (raw)", "acc (raw)", "g"),
        ("Accel X (G)", "Accel X", "g"),
        ("Accel X [mG]", "Accel X", "mg"),
        ("Mag X (mG)", "Mag X", "mG"),
        ("Bx (G)", "Bx", "G"),
        ("temp in box", "temp in box", ""),
        ("ratio x/y", "ratio x/y", ""),
        ("Signal A", "Signal A", ""),
        ("left_sensor.acc_x", "left_sensor.acc_x", ""),
        ("vel_n", "vel_n", ""),
        ("quat_w", "quat_w", ""),
        ("_s", "_s", ""),
        ("sound_mPa", "sound", "mPa"),
        ("stress_mpa", "stress", "MPa"),
        ("time_min", "time", "min"),
        ("temp_min", "temp_min", ""),
        ("plain", "plain", ""),
        ("", "", ""),
    ],
)
def test_header(header: str, name: str, unit: str) -> None:
    assert parse_header(header) == (name, unit)


@pytest.mark.parametrize(
    "cell", ["s", "[V]", "(g)", "m/s^2", "m/s²", "°C", "µm/m", "-", "%", "mV/V", "kN", "deg/s", "rad/s"]
)
def test_unit_cells(cell: str) -> None:
    assert looks_like_unit(cell)


@pytest.mark.parametrize("cell", ["force", "acc_x", "x", "time", "1.5", "left", ""])
def test_other_cells(cell: str) -> None:
    assert not looks_like_unit(cell)
