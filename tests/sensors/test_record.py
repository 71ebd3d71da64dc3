"""A record turns readings into what its conversion alone would tell, and leaves no reading invented."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.accelerometer import Accelerometer, FullScale, sensitivity_matrix
from becalm.sensors.bridge import Bridge
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.load_cell import LoadCell
from becalm.sensors.record import Sensitivity, SensorRecord, Sheet, convert_readings

CURVE = SensorRecord(("t",), "V", "degC", CalibrationCurve((-50.0, 100.0, 2.0)), full_scale=FullScale(0.0, 5.0))
CELL = SensorRecord(("f",), "mV", "N", LoadCell(2.0, 500.0), reading_size=0.1)
STRAIN = SensorRecord(("e",), "mV/V", "um/m", Bridge("quarter I", 2.1), reading_size=1e-3, result_size=1e6)
TRIAXIAL = SensorRecord(
    ("x", "y", "z"), "V", "g", Accelerometer(sensitivity_matrix([0.1, 0.1, 0.2], np.full((3, 3), 2.0)), np.zeros(3))
)
RECORDS = {"curve": CURVE, "cell": CELL, "strain": STRAIN, "triaxial": TRIAXIAL}
readings = arrays(float, (3, 7), elements=st.floats(-4, 4) | st.just(np.nan))


@pytest.mark.parametrize("record", RECORDS.values(), ids=RECORDS)
@given(raw=readings)
def test_every_record_keeps_the_house_rules(record: SensorRecord, raw: Floats) -> None:
    columns = {**dict(zip(record.channels, raw, strict=False)), "other": raw[0]}
    before = {name: column.copy() for name, column in columns.items()}
    told = convert_readings(record, columns)
    assert tuple(told) == record.channels
    for name, column in columns.items():
        np.testing.assert_array_equal(column, before[name])  # input untouched
    for name in record.channels:
        assert told[name].shape == (7,)
        assert np.isnan(told[name][np.isnan(columns[name])]).all()
    rows = [convert_readings(record, {name: column[k : k + 1] for name, column in columns.items()}) for k in range(7)]
    for name in record.channels:  # each row has the same bits, however many come
        np.testing.assert_array_equal([row[name][0] for row in rows], told[name])


def test_readings_become_what_sheets_say() -> None:
    np.testing.assert_allclose(convert_readings(CURVE, {"t": np.array([1.0, 2.0])})["t"], [52, 158])
    np.testing.assert_allclose(convert_readings(CELL, {"f": np.array([20.0])})["f"], [500])
    strain = -4e6 * 0.5e-3 / (2.1 * (1 + 1e-3))
    np.testing.assert_allclose(convert_readings(STRAIN, {"e": np.array([0.5])})["e"], [strain], rtol=1e-12)


def test_a_clipped_reading_is_missing() -> None:
    told = convert_readings(CURVE, {"t": np.array([0.0, 2.0, 4.9976, 5.0])})["t"]
    np.testing.assert_array_equal(np.isnan(told), [True, False, True, True])


def test_uncertainties_of_sheets_are_twice_standard_ones() -> None:
    told = SensorRecord(
        ("a",),
        "mV",
        "g",
        CalibrationCurve((0.0, 1.0)),
        sensitivities=(Sensitivity(-985.6, "mV/g", 9.856),),
        zero_uncertainty=0.2,
    )
    assert told.relative_stds == pytest.approx((0.005,))
    assert told.offset_std == 0.1
    assert TRIAXIAL.relative_stds == (0.0, 0.0, 0.0)


def test_a_sensor_is_due_on_its_day() -> None:
    sheet = Sheet(due=date(2026, 3, 1))
    assert [sheet.is_due(date(2026, *day)) for day in ((2, 28), (3, 1), (4, 1))] == [False, True, True]
    assert not Sheet().is_due(date(2026, 3, 1))


def test_columns_that_do_not_fit_are_refused() -> None:
    with pytest.raises(SensorError, match="channel 'z' is missing; there are x, y"):
        convert_readings(TRIAXIAL, {"x": np.zeros(2), "y": np.zeros(2)})
    with pytest.raises(SensorError, match="differ in length"):
        convert_readings(TRIAXIAL, {"x": np.zeros(2), "y": np.zeros(2), "z": np.zeros(3)})


@pytest.mark.parametrize("coefficients", [(), (3.0,), (3.0, 0.0), (np.nan, 1.0), (0.0, 1.0, np.inf)])
def test_a_curve_that_tells_nothing_is_refused(coefficients: tuple[float, ...]) -> None:
    with pytest.raises(SensorError, match=r"coefficients after the first are 0|not a finite"):
        CalibrationCurve(coefficients)


@pytest.mark.parametrize(
    "conversion", [CalibrationCurve((1.0, 2.0, 3.0)), Bridge("quarter I", 2.0), LoadCell(2.0, 100.0)]
)
def test_a_reading_without_bounds_is_no_number_and_no_warning(conversion: CalibrationCurve | Bridge | LoadCell) -> None:
    record = SensorRecord(("a",), "V", "N", conversion)
    told = convert_readings(record, {"a": np.array([np.inf, 1e-3, -np.inf, 1e-3])})["a"]
    np.testing.assert_array_equal(np.isfinite(told), [False, True, False, True])
