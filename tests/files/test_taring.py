"""Zeros from a stretch of the file, and temperatures from another channel: by resistors, in blocks of any size."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pytest

from becalm.cleaning.sensor_files.sensor_file import load_sensors
from becalm.core.arrays import Floats
from becalm.errors import SensorError, UsageError
from becalm.files.calibrated.calibrated_source import with_sensors
from becalm.files.inputs.opening import OpenSource, open_source
from becalm.files.read_options import ReadOptions
from becalm.files.rows import MemoryRows
from becalm.files.source import RawTable
from becalm.files.timing.times import RowTimes, rows_between

LOT = (-31.8, 2.77, -6.55e-2, 3.28e-4, -3.26e-7)
BRIDGE = f"""
[[sensor]]
kind = "bridge"
channel = "root"
raw_unit = "mV/V"
configuration = "quarter I"
gauge_factor = 2.1
thermal_output_um = {list(LOT)}
gauge_factor_percent_per_100_k = 1.3
temperature_channel = "T1"
tare = "0s:2s"
"""
CELL = """
[[sensor]]
kind = "load cell"
channel = "pull"
raw_unit = "mV"
unit = "N"
rated_output_mv_per_v = 2.0
capacity = 1000
excitation_v = 10.0
tare = "1s:3s"
"""
THERMOMETER = """
[[sensor]]
kind = "polynomial"
channel = "T1"
raw_unit = "V"
unit = "degF"
coefficients = [32, 18]
"""
ROWS, RATE_HZ, NOISE = 1000, 100.0, 1e-4  # of a reading in mV/V
T = np.arange(ROWS) / RATE_HZ
STRAIN = np.where(T < 2, 0.0, 1e-3 * np.sin(T - 2))
DEGC = np.where(T < 2, 40.0, 40.0 + 5 * (T - 2))


def ratios() -> Floats:
    """Return what resistors put out in mV/V: the gauge is strained and warm, and one resistor is 0.1 % off."""
    factor = 2.1 * (1 + 1.3e-4 * (DEGC - 24.0))
    gauge = 350.0 * (1 + factor * STRAIN + 2e-6 * sum(a * DEGC**k for k, a in enumerate(LOT)))
    noise = NOISE * np.random.default_rng(4).normal(size=ROWS)
    return 1e3 * (350.0 / (350.0 + gauge) - 350.0 / (350.35 + 350.0)) + noise


def written(folder: Path, thermometer: str, degrees: Floats) -> Path:
    cells = ["" if np.isnan(value) else f"{value:.9f}" for value in degrees]
    rows = zip(T, ratios(), cells, strict=True)
    path = folder / "log.csv"
    path.write_text(f"time_s,root,{thermometer}\n" + "".join(f"{t:.2f},{r:.9f},{c}\n" for t, r, c in rows))
    return path


def opened(path: Path, text: str, **said: Any) -> OpenSource:
    sheet = path.with_name("sensors.toml")
    sheet.write_text(text, encoding="utf-8")
    return open_source(path, ReadOptions(sensors=load_sensors(sheet), **said))


THERMOMETERS = {
    "degC": ("T1 (degC)", DEGC, ""),
    "no unit": ("T1", DEGC, ""),
    "kelvin": ("T1 (K)", DEGC + 273.15, ""),
    "degF": ("T1 (degF)", 32 + 1.8 * DEGC, ""),
    "a sensor": ("T1 (mV)", 100 * DEGC, THERMOMETER),
}


@pytest.mark.parametrize("kind", THERMOMETERS)
@pytest.mark.parametrize("first", ["bridge", "thermometer"])
def test_a_warm_bridge_tells_the_strain_of_its_resistors(kind: str, first: str, tmp_path: Path) -> None:
    header, degrees, own = THERMOMETERS[kind]
    with opened(written(tmp_path, header, degrees), BRIDGE + own if first == "bridge" else own + BRIDGE) as source:
        found = source.recording().channel("root")
        tare, offset_std = source.calibrations["root"].tare, source.calibrations["root"].offset_std
        notes = source.notes
    noise_um = 4e3 * NOISE / 2.1
    error = found - 1e6 * STRAIN
    assert abs(error[:200].mean()) < 1e-6 * noise_um  # of the zero's own readings; a bridge bends by 4e-7 of its noise
    np.testing.assert_allclose(error, 0.0, atol=5 * noise_um + 1e-3 * 1e6 * np.abs(STRAIN).max())  # R1 is 0.1 % off
    assert tare is not None
    assert (tare.readings, tare.raw_unit, tare.start_s, tare.stop_s) == (200, "mV/V", 0.0, 2.0)
    assert tare.temperature_degc == pytest.approx(40.0)
    assert offset_std == pytest.approx(noise_um / np.sqrt(200), rel=0.2)
    assert any("the zero of 'root' was measured from 0 s to 2 s" in note and "at 40 degC" in note for note in notes)
    untold = [note for note in notes if "the file has no unit for 'T1'; degC is assumed" in note]
    assert len(untold) == (kind == "no unit")


def test_uncorrected_it_is_far_off(tmp_path: Path) -> None:
    plain = "\n".join(line for line in BRIDGE.splitlines() if "temperature" not in line and "thermal" not in line)
    with opened(written(tmp_path, "T1", DEGC), plain.replace("gauge_factor_percent_per_100_k = 1.3", "")) as source:
        assert np.abs(source.recording().channel("root") - 1e6 * STRAIN).max() > 20


def test_a_missing_temperature_makes_the_strain_missing(tmp_path: Path) -> None:
    degrees = DEGC.copy()
    degrees[[5, 700]] = np.nan
    with opened(written(tmp_path, "T1 (degC)", degrees), BRIDGE) as source:
        found = source.recording().channel("root")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found)), [5, 700])


def test_a_missing_stamp_moves_no_interval() -> None:
    stamps = np.array([0.0, 1.0, np.nan, 3.0, 4.0, np.nan, 5.0])
    for cut in range(len(stamps)):
        blocks = [block for block in (stamps[:cut], stamps[cut:]) if len(block)]
        times = RowTimes(cast(Any, SimpleNamespace(count=7)), cast(Any, None), cast(Any, Blocks(blocks)), None)
        assert rows_between(times, 3.0, 4.5) == (3, 6)
        assert rows_between(times, 0.0, 3.0) == (0, 3)


class Blocks:
    """Stamps in blocks."""

    def __init__(self, blocks: list[Floats]) -> None:
        self._blocks, self.count = blocks, sum(map(len, blocks))

    def blocks(self) -> list[Floats]:
        return self._blocks


def test_a_row_at_the_start_of_an_interval_is_in_it() -> None:
    raw = RawTable(MemoryRows(pa.table({"a": np.zeros(100)})), 100, "csv")
    counted = RowTimes(raw, cast(Any, None), None, 100.0)
    assert rows_between(counted, 0.07, 0.29) == (7, 29)
    later = SimpleNamespace(count=100, blocks=lambda: iter([86.0 + np.arange(100) / 100]))
    assert rows_between(counted._replace(stamps=cast(Any, later)), 0.07, 0.29) == (7, 29)


def test_a_constant_temperature_is_taken_off(tmp_path: Path) -> None:
    text = BRIDGE.replace('temperature_channel = "T1"', "temperature_degc = 40.0")
    with opened(written(tmp_path, "T1 (degC)", DEGC), text) as source:
        found = source.recording().channel("root")
        note, tared, *_ = source.notes
    assert "corrected for temperature by 40 degC" in note
    assert "at 40 degC" in tared
    np.testing.assert_allclose(found[:250], 1e6 * STRAIN[:250], atol=6)


def test_blocks_of_any_size_give_the_same_bits(tmp_path: Path) -> None:
    sheet = tmp_path / "s.toml"
    sheet.write_text(BRIDGE + THERMOMETER)
    table = pa.table({"time_s": T, "root": ratios(), "T1": DEGC / 10})
    (sensed,), _ = with_sensors([RawTable(MemoryRows(table), ROWS, "test")], ReadOptions(sensors=load_sensors(sheet)))

    def bits(most_rows: int) -> Floats:
        return np.concatenate([block.column(0).to_numpy() for block in sensed.blocks(["root"], most_rows=most_rows)])

    for rows in (1, 7, 64):
        np.testing.assert_array_equal(bits(rows), bits(ROWS))


def pulled(folder: Path, pull: Floats, time: Floats = T) -> Path:
    path = folder / "pull.csv"
    path.write_text("time_s,pull\n" + "".join(f"{t:.4f},{v:.6f}\n" for t, v in zip(time, pull, strict=True)))
    return path


NOISY = 0.5 + 1e-3 * np.random.default_rng(7).normal(size=ROWS)


@pytest.mark.parametrize("said", [{}, {"rate_hz": RATE_HZ, "channels": ("pull",)}])
def test_the_stretch_is_of_time_since_the_first_row(said: dict[str, Any], tmp_path: Path) -> None:
    load = np.where(T < 5, 0.0, 4.0)
    with opened(pulled(tmp_path, NOISY + load, T + 86.0), CELL, **said) as source:
        found = source.recording().channel("pull")
    assert abs(found[100:300].mean()) < 1e-9
    assert found[600:].mean() == pytest.approx(200.0, abs=0.05)  # 4 mV of 20 mV at 1000 N


def test_uneven_time_is_counted_by_its_stamps(tmp_path: Path) -> None:
    time = np.cumsum(np.random.default_rng(3).uniform(0.002, 0.018, ROWS))
    with opened(pulled(tmp_path, NOISY, time), CELL) as source:
        tare = source.calibrations["pull"].tare
    seconds = np.round(time, 4) - np.round(time[0], 4)
    inside = (seconds >= 1) & (seconds < 3)
    assert tare is not None
    assert tare.readings == inside.sum()
    assert tare.reading == pytest.approx(np.round(NOISY, 6)[inside].mean(), abs=1e-12)


def test_the_zero_is_as_uncertain_as_its_mean_and_what_the_sheet_says(tmp_path: Path) -> None:
    with opened(pulled(tmp_path, NOISY), CELL + "zero_uncertainty = 6.0\n", units={"pull": "kN"}) as source:
        found = source.calibrations["pull"].offset_std
    mean_n = 50 * NOISY[100:300].std(ddof=1) / np.sqrt(200)
    assert found == pytest.approx(1e-3 * np.hypot(mean_n, 3.0), rel=1e-6)


@pytest.mark.parametrize("wild", [np.inf, -1e200])
def test_what_no_sensor_gives_is_not_in_the_zero(wild: float, tmp_path: Path) -> None:
    pull = NOISY.copy()
    pull[150] = wild
    with opened(pulled(tmp_path, pull), CELL) as source:
        tare = source.calibrations["pull"].tare
    assert tare is not None
    assert tare.readings == 199
    assert tare.reading == pytest.approx(np.delete(NOISY, 150)[100:299].mean(), abs=1e-6)


QUIET = "The zero of 'pull' cannot be measured in its tare interval, 1 s to 3 s: "
REFUSED = {
    "a drift": (NOISY + 0.01 * T, QUIET + "The stretch is not quiet: it drifts by"),
    "a knock": (NOISY + np.where(np.abs(T - 2) < 0.1, np.sin(200 * T), 0.0), QUIET + "The stretch is not quiet"),
    "the end of full scale": (np.maximum(NOISY, 0.5), QUIET + "[0-9]* of its 200 readings reach the end of full scale"),
    "nothing there": (np.where((T > 0.5) & (T < 3.5), np.nan, NOISY), QUIET + "The stretch has 0 readings"),
    "no noise": (np.full(ROWS, 0.5), QUIET + "All 200 readings of the stretch are 0.5 mV.*give zero_uncertainty, in N"),
    "a short log": (NOISY[:250], QUIET + "The rows end after 2.5 s. Give an earlier interval"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_stretch_that_tells_no_zero_is_refused(kind: str, tmp_path: Path) -> None:
    pull, said = REFUSED[kind]
    ends = "lowest_reading = 0.5\nhighest_reading = 0.6\n" if "full scale" in kind else ""
    with pytest.raises(SensorError, match=said):
        opened(pulled(tmp_path, pull, T[: len(pull)]), CELL + ends)


def test_readings_that_do_not_vary_have_the_uncertainty_that_was_said(tmp_path: Path) -> None:
    with opened(pulled(tmp_path, np.full(ROWS, 0.5)), CELL + "zero_uncertainty = 6.0\n") as source:
        np.testing.assert_array_equal(source.recording().channel("pull"), np.zeros(ROWS))
        assert source.calibrations["pull"].offset_std == 3.0


MISTAKES = {
    "no thermometer": ("T2 (degC)", BRIDGE, "names 'T1', which is not a column"),
    "no temperature": ("T1 (V)", BRIDGE, r"expects 'T1 \(V\)' in degC"),
    "a thermometer's zero": ("T1", BRIDGE + THERMOMETER + 'tare = "0:1"\n', "is a temperature, whose zero"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_thermometer_that_cannot_serve_is_refused(kind: str, tmp_path: Path) -> None:
    header, text, said = MISTAKES[kind]
    with pytest.raises(UsageError, match=said):
        opened(written(tmp_path, header, DEGC), text)
