"""A file of sensors says what its sheets say, and what it cannot say is refused in a sentence."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.sensor_files.sensor_file import due_warnings, load_sensors
from becalm.errors import SensorError
from becalm.sensors.accelerometer import FullScale
from becalm.sensors.bridge import Bridge
from becalm.sensors.record import Sensitivity, convert_readings

FILE = """
[[sensor]]
kind = "accelerometer"
channel = "seat"
raw_unit = "mV"
unit = "g"
sensitivity_mv = 985.6
sensitivity_uncertainty_mv = 9.856
bias_mv = 12.0
lowest_reading = -5000
highest_reading = 5000
zero_uncertainty = 0.02

[sensor.sheet]
manufacturer = "Some Works"
serial = "4711"
calibrated = 2025-03-01
due = 2026-03-01
range_high = 5.0
noise_density = 25e-6

[[sensor]]
kind = "triaxial"
channels = ["x", "y", "z"]
raw_unit = "counts"
unit = "m/s^2"
correction = [[0.0024, 0, 0], [0, 0.0024, 0], [0, 0, 0.0025]]
bias = [33100, 33200, 32300]

[[sensor]]
kind = "triaxial"
channels = ["u", "v", "w"]
raw_unit = "counts"
unit = "g"
span_v = 10.0
bits = 16
sensitivity_mv = [100, 100, 100]
cross_axis_percent = [[0, 1, 0], [0, 0, 0], [0, 0, 0]]

[[sensor]]
kind = "bridge"
channel = "root"
raw_unit = "V"
configuration = "half I"
gauge_factor = 2.1
gauge_factor_uncertainty = 0.021
poisson_ratio = 0.3
excitation_v = 5.0
lead_ohm = 2.0

[[sensor]]
kind = "load cell"
channel = "pull"
raw_unit = "mV"
unit = "N"
rated_output_mv_per_v = 2.0
capacity = 1000
excitation_v = 10.0

[[sensor]]
kind = "polynomial"
channel = "oil"
raw_unit = "V"
unit = "degC"
coefficients = [-50, 100]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "sensors.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_kind_is_read_and_applied(tmp_path: Path) -> None:
    records = load_sensors(written(tmp_path, FILE))
    columns = {
        "seat": np.array([12.0, 997.6, 4999.0]),
        "x": np.array([33_100.0]),
        "y": np.array([34_200.0]),
        "z": np.array([32_300.0]),
        "u": np.array([0.101 * 6553.6]),
        "v": np.array([0.1 * 6553.6]),
        "w": np.array([np.nan]),
        "root": np.array([0.0, -1e-3]),
        "pull": np.array([20.0]),
        "oil": np.array([1.0]),
    }
    told = {name: column for record in records for name, column in convert_readings(record, columns).items()}
    strain = Bridge("half I", 2.1, 0.3, lead_ohm=2.0).strain(np.array([0.0, -2e-4]))
    expected: dict[str, list[float]] = {
        "seat": [0.0, 1.0, np.nan],  # the last one is clipped
        "x": [0.0],
        "y": [2.4],
        "z": [0.0],
        "u": [1.0],
        "v": [1.0],
        "w": [np.nan],
        "root": list(1e6 * strain),
        "pull": [1000.0],
        "oil": [50.0],
    }
    assert told.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(told[name], values, rtol=1e-9, atol=1e-9, err_msg=name)


def test_the_record_says_what_the_sheet_says(tmp_path: Path) -> None:
    seat, *_, bridge, _, _ = load_sensors(written(tmp_path, FILE))
    assert seat.sensitivities == (Sensitivity(985.6, "mV/g", 9.856),)
    assert seat.relative_stds == pytest.approx((0.005,))
    assert (seat.offset_std, seat.full_scale) == (0.01, FullScale(-5000.0, 5000.0))
    assert (seat.sheet.manufacturer, seat.sheet.calibrated) == ("Some Works", date(2025, 3, 1))
    assert (seat.sheet.range_low, seat.sheet.noise_density) == (None, 25e-6)
    assert (bridge.unit, bridge.relative_stds) == ("um/m", (0.005,))


def test_a_sensor_that_is_due_is_named(tmp_path: Path) -> None:
    records = load_sensors(written(tmp_path, FILE))
    (said,) = due_warnings(records, date(2026, 11, 22))
    assert said.startswith("The sensor of seat (serial 4711) was due for calibration on 2026-03-01;")
    assert due_warnings(records, date(2026, 2, 28)) == ()


ONE = '[[sensor]]\nkind = "accelerometer"\nchannel = "a"\nraw_unit = "mV"\nunit = "g"\nsensitivity_mv = 100\n'
BRIDGE = '[[sensor]]\nkind = "bridge"\nchannel = "e"\nraw_unit = "mV/V"\nconfiguration = "full I"\ngauge_factor = 2\n'
TRIAXIAL = '[[sensor]]\nkind = "triaxial"\nchannels = ["x", "y", "z"]\nraw_unit = "V"\nunit = "g"\n'
MISTAKES = {
    "nothing": ("", "sensor: Field required"),
    "no TOML": ("[[sensor", "is not TOML"),
    "no kind": ('[[sensor]]\nchannel = "a"', "sensor.1: Unable to extract tag using discriminator 'kind'"),
    "another kind": (ONE.replace("accelerometer", "thermometer"), "expected tags.*'load cell'"),
    "a word unknown": (ONE + "sensitivity_v = 1", "sensor.1.accelerometer.sensitivity_v: Extra inputs"),
    "a unit unknown": (ONE.replace("mV", "kV", 1), "Input should be 'V', 'mV', 'mV/V', 'counts', 'g' or 'm/s\\^2'"),
    "no number": (ONE.replace("100", "nan"), "finite number"),
    "no sensitivity": (ONE.replace("100", "0"), "accelerometer: A sensitivity is 0; .* for 985.6 mV/g. Each sensor"),
    "a truth": (ONE.replace("100", "true"), "sensitivity_mv: Input should be a valid number"),
    "a text": (ONE.replace("100", '"100"'), "sensitivity_mv: Input should be a valid number"),
    "one bit": (ONE.replace('"mV"', '"counts"') + "span_v = 10\nbits = true", "bits: Input should be a valid integer"),
    "twice": (ONE + ONE, "the channel 'a' has two sensors"),
    "half of a scale": (ONE + "lowest_reading = -5", "give both, or neither"),
    "a scale upside down": (
        ONE + "lowest_reading = 5\nhighest_reading = -5",
        "lowest_reading must be less than highest_reading",
    ),
    "counts of what": (ONE.replace('"mV"', '"counts"'), "span_v and bits"),
    "counts of volts": (ONE + "bits = 16", "are only for raw_unit"),
    "volts in g": (ONE.replace('"mV"', '"g"'), "is only for a triaxial sensor with correction"),
    "no ratio": (ONE.replace('"mV"', '"mV/V"'), "is only for bridges and load cells"),
    "no supply": (BRIDGE.replace("mV/V", "V"), "needs excitation_v"),
    "no Poisson ratio": (BRIDGE.replace("full I", "full II"), "give poisson_ratio"),
    "half a shunt": (BRIDGE + "shunt_ohm = 1e5", "shunt_ohm and shunt_reading belong together"),
    "a shunt and a gain": (
        BRIDGE + "shunt_ohm = 1e5\nshunt_reading = 0.8\ngain_adjustment = 1.0",
        "a shunt replaces gain_adjustment",
    ),
    "a shunt the wrong way": (BRIDGE + "shunt_ohm = 1e5\nshunt_reading = -0.8", "no gain explains"),
    "no temperature": (BRIDGE + "gauge_factor_percent_per_100_k = 1.3", "give either temperature_degc"),
    "a temperature for nothing": (BRIDGE + "temperature_degc = 35.0", "a temperature changes nothing without"),
    "its own thermometer": (
        BRIDGE + 'gauge_factor_percent_per_100_k = 1.3\ntemperature_channel = "e"',
        "is the channel of the bridge itself",
    ),
    "output that cancels": (BRIDGE + "thermal_output_um = [1]\ntemperature_degc = 35", "compensate thermal output"),
    "no stretch": (ONE + 'tare = "20s"', 'tare = "20s" is not a stretch of time; write START:STOP'),
    "a stretch backwards": (ONE + 'tare = "2s:1000ms"', "is not a stretch of time"),
    "two zeros": (ONE + 'tare = "0:1"\nbias_mv = 1', "tare and bias_mv both give the zero"),
    "damping of nothing": (ONE + "[sensor.sheet]\ndamping_ratio = 0.7", "damping_ratio needs resonance_hz"),
    "no matrix": (TRIAXIAL, "give either sensitivity_mv, with bias_mv, or correction"),
    "two of them": (
        TRIAXIAL + "sensitivity_mv = [1, 1, 1]\ncorrection = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
        "give either sensitivity_mv",
    ),
    "the other's bias": (TRIAXIAL + "sensitivity_mv = [1, 1, 1]\nbias = [1, 1, 1]", "give either sensitivity_mv"),
    "axes alike": (TRIAXIAL + "correction = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]", "parallel axes"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_a_sentence(kind: str, tmp_path: Path) -> None:
    text, said = MISTAKES[kind]
    with pytest.raises(SensorError, match=said) as refusal:
        load_sensors(written(tmp_path, text))
    assert str(refusal.value).startswith("The sensor file ")
    assert str(refusal.value).endswith("has kind, channel, raw_unit and unit.")


def test_a_file_that_is_not_there_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(SensorError, match=r"none\.toml cannot be read: No such file"):
        load_sensors(tmp_path / "none.toml")


def test_a_shunt_tells_the_gain_of_a_bridge(tmp_path: Path) -> None:
    quarter = BRIDGE.replace("full I", "quarter I").replace("gauge_factor = 2\n", "gauge_factor = 2.1\n")
    shunted = 350 * 174_650 / (350 + 174_650)
    ratio = 1e3 * (350 / (350 + shunted) - 0.5)  # mV/V, by resistors
    text = quarter + f"shunt_ohm = 174650\nshunt_reading = {0.98 * ratio!r}\n"
    (record,) = load_sensors(written(tmp_path, text))
    found = convert_readings(record, {"e": np.array([0.98 * ratio])})["e"]
    np.testing.assert_allclose(found, -952.381, atol=5e-4)
