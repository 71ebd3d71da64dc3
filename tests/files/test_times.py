"""Time columns: every way to write them, and every way that is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError, TimeError
from becalm.files import ReadOptions, SourceFile, read_source
from becalm.files.timing.time_column import is_time_name

COUNT = 40
EVERY_10_MS = np.arange(COUNT) / 100


def source_of(folder: Path, header: str, stamps: list[str], **said: object) -> SourceFile:
    """A file with these stamps and one channel, separated by semicolons."""
    path = folder / "log.csv"
    noise = np.random.default_rng(2).normal(size=len(stamps))
    lines = [f"{stamp};{value:.6f}" for stamp, value in zip(stamps, noise, strict=True)]
    path.write_text(f"{header};force\n" + "\n".join(lines) + "\n")
    return read_source(path, ReadOptions(**said))  # type: ignore[arg-type]


def clocked(pattern: str, start: str = "2022-03-07T16:35:15.000") -> list[str]:
    """Date-times every 10 ms; {f} stands for milliseconds, the rest is strftime's."""
    from datetime import datetime, timedelta

    first = datetime.fromisoformat(start)
    moments = [first + timedelta(milliseconds=10 * i) for i in range(COUNT)]
    return [m.strftime(pattern).replace("{f}", f"{m.microsecond // 1000:03d}") for m in moments]


NUMERIC = {
    "seconds": ("time_s", 1.0, "s"),
    "milliseconds": ("Time (ms)", 1e3, "ms"),
    "microseconds": ("t_us", 1e6, "us"),
    "micro sign": ("Zeit [µs]", 1e6, "us"),
    "nanoseconds": ("timestamp_ns", 1e9, "ns"),
    "minutes": ("Time (min)", 1 / 60, "min"),
    "hours": ("elapsed_h", 1 / 3600, "h"),
    "no unit, fractions": ("t", 1.0, "s"),
    "Arduino": ("millis", 1e3, "ms"),
    "capitals": ("Time (Min)", 1 / 60, "min"),
    "mS of a time": ("Time (mS)", 1e3, "ms"),
    "words": ("t [mSec]", 1e3, "ms"),
    "long words": ("Time (Microseconds)", 1e6, "us"),
    "short with a dot": ("Time (min.)", 1 / 60, "min"),
    "days": ("time (days)", 1 / 86_400, "d"),
    "hr": ("time_hr", 1 / 3600, "h"),
    "in minutes": ("Time in minutes", 1 / 60, "min"),
    "the name is the unit": ("milliseconds", 1e3, "ms"),
    "last word": ("timestampMs", 1e3, "ms"),
    "behind a slash": ("time/ms", 1e3, "ms"),
}


@pytest.mark.parametrize(("header", "per_second", "unit"), NUMERIC.values(), ids=NUMERIC.keys())
def test_numbers_with_a_unit(header: str, per_second: float, unit: str, tmp_path: Path) -> None:
    source = source_of(tmp_path, header, [f"{float(t) * per_second:.12g}" for t in EVERY_10_MS])
    assert source.layout.time_columns == (header,)
    assert source.layout.time_unit == unit
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)


@pytest.mark.parametrize(("unit", "per_second"), [("hours", 1 / 3600), ("msec", 1e3), ("Microsecond", 1e6)])
def test_a_unit_from_metadata(unit: str, per_second: float, tmp_path: Path) -> None:
    stamps = pa.field("t", pa.float64(), metadata={"unit": unit})
    schema = pa.schema([stamps, pa.field("force", pa.float64())])
    pq.write_table(pa.table([EVERY_10_MS * per_second, np.sin(EVERY_10_MS)], schema=schema), tmp_path / "log.parquet")
    assert read_source(tmp_path / "log.parquet").recording.rate_hz == pytest.approx(100)


@pytest.mark.parametrize("header", ["Time (ticks)", "distance (m)"])
def test_a_first_column_of_another_unit_is_no_time(header: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"(ticks|'m')"):
        source_of(tmp_path, header, [f"{t:.2f}" for t in EVERY_10_MS])
    with pytest.raises(TimeError, match=r"(ticks|'m')"):
        source_of(tmp_path, header, [f"{t:.2f}" for t in EVERY_10_MS], time=header)


def test_a_unit_from_the_row_of_units(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,force\nms,N\n" + "".join(f"{10 * i},{i * i % 7}\n" for i in range(COUNT)))
    source = read_source(path)
    assert source.recording.rate_hz == pytest.approx(100)
    assert source.recording.units == ("N",)


@pytest.mark.parametrize(("unit", "per_second"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_counts_since_1970_are_told_by_their_size(unit: str, per_second: int, tmp_path: Path) -> None:
    if unit == "s":
        stamps = [f"{1_646_670_915 + i / 100:.2f}" for i in range(COUNT)]
    else:
        stamps = [str(1_646_670_915 * per_second + i * per_second // 100) for i in range(COUNT)]
    source = source_of(tmp_path, "timestamp", stamps)
    assert source.layout.time_kind == "epoch"
    assert source.layout.time_unit == unit
    assert source.layout.time_start.startswith("2022-03-07T16:35:15")
    assert source.recording.timebase.uniform
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-6)
    if unit != "s":
        assert [str(int(value)) for value in source.table["timestamp"].to_pylist()] == stamps


DATE_TIMES = {
    "iso": "%Y-%m-%d %H:%M:%S.{f}",
    "iso T": "%Y-%m-%dT%H:%M:%S.{f}",
    "iso Z": "%Y-%m-%dT%H:%M:%S.{f}Z",
    "iso zone": "%Y-%m-%dT%H:%M:%S.{f}+01:00",
    "iso comma": "%Y-%m-%d %H:%M:%S,{f}",
    "slashes": "%Y/%m/%d %H:%M:%S.{f}",
    "german": "%d.%m.%Y %H:%M:%S,{f}",
    "german, short year": "%d.%m.%y %H:%M:%S,{f}",
    "american": "%m/%d/%Y %I:%M:%S.{f} %p",
    "colon before milliseconds": "%Y-%m-%d %H:%M:%S:{f}",
    "month by name": "%d-%b-%Y %H:%M:%S.{f}",
}


@pytest.mark.parametrize("pattern", DATE_TIMES.values(), ids=DATE_TIMES.keys())
def test_date_times_in_every_dress(pattern: str, tmp_path: Path) -> None:
    stamps = clocked(pattern)
    source = source_of(tmp_path, "Timestamp", stamps)
    assert source.layout.time_kind == "date-time"
    assert source.table["Timestamp"].to_pylist() == stamps
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)
    start = "2022-03-07T15:35:15" if "+01" in pattern else "2022-03-07T16:35:15"
    if pattern != DATE_TIMES["american"]:  # 03/07 may be either; the distances are the same
        assert source.layout.time_start.startswith(start)


def test_time_of_day_passes_midnight(tmp_path: Path) -> None:
    source = source_of(tmp_path, "Uhrzeit", clocked("%H:%M:%S,{f}", "2022-03-07T23:59:59.800"))
    assert source.layout.time_kind == "time of day"
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)


def test_a_date_and_a_time_in_two_columns(tmp_path: Path) -> None:
    stamps = clocked("%d.%m.%Y;%H:%M:%S,{f}", "2022-03-07T23:59:59.800")
    source = source_of(tmp_path, "Datum;Zeit", stamps)
    assert source.layout.time_columns == ("Datum", "Zeit")
    assert source.recording.names == ("force",)
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)


@pytest.mark.parametrize(
    ("dates", "start"),
    [
        (["25/03/2022", "26/03/2022", "27/03/2022"], "2022-03-25"),
        (["03/25/2022", "03/26/2022", "03/27/2022"], "2022-03-25"),
        (["30/04/2022", "01/05/2022", "02/05/2022"], "2022-04-30"),
    ],
)
def test_day_and_month_are_told_by_values_over_12(dates: list[str], start: str, tmp_path: Path) -> None:
    assert source_of(tmp_path, "Date", dates).layout.time_start.startswith(start)
    assert source_of(tmp_path, "Date", dates).recording.rate_hz == pytest.approx(1 / 86_400)


def test_day_and_month_that_cannot_be_told_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TimeError, match="YYYY-MM-DD"):
        source_of(tmp_path, "Date", ["01/02/2022", "02/02/2022", "03/02/2022"])


@pytest.mark.parametrize(
    ("pattern", "start"),
    [
        ("%d/%m/%Y %I:%M:%S.{f} %p", "2024-06-05T23:59:59.800"),
        ("%m/%d/%Y %I:%M:%S.{f} %p", "2024-06-05T23:59:59.800"),
        ("%d/%m/%Y %H:%M:%S.{f}", "2024-06-05T23:59:59.800"),
        ("%d/%m/%Y;%H:%M:%S.{f}", "2024-06-05T23:59:59.800"),
        ("%y/%m/%d %H:%M:%S.{f}", "2024-06-05T23:59:59.800"),
        ("%y-%m-%d %H:%M:%S.{f}", "2025-03-14T23:59:59.800"),
        ("%d/%m/%y %H:%M:%S.{f}", "2024-06-05T23:59:59.800"),
        ("%d.%m.%y %H:%M:%S.{f}", "1999-12-31T23:59:59.800"),
    ],
)
def test_a_midnight_shows_the_order_of_dates(pattern: str, start: str, tmp_path: Path) -> None:
    source = source_of(tmp_path, "Date;Time" if ";" in pattern else "Time", clocked(pattern, start))
    assert source.layout.time_start.startswith(start)
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)


@pytest.mark.parametrize(
    ("pattern", "start", "says"),
    [
        ("%m/%d/%Y %H:%M:%S.{f}", "", "day first or month first, so"),
        ("%m/%d/%Y;%H:%M:%S.{f}", "", "day first or month first, so"),
        ("%y/%m/%d %H:%M:%S.{f}", "", "year of two digits first, so"),
        ("%m/%d/%Y %I:%M:%S.{f} %p", "2022-03-07T16:35:15", "because AM or PM"),
        ("%m/%d/%Y %I:%M:%S.{f}\u202f%p", "2022-03-07T16:35:15", "because AM or PM"),
        ("%d.%m.%Y %H:%M:%S.{f}", "2022-03-07T16:35:15", ""),
        ("%m/%d/2007 %H:%M:%S.{f}", "2007-07-07T16:35:15", ""),
    ],
)
def test_one_day_does_not_show_the_order_of_its_date(pattern: str, start: str, says: str, tmp_path: Path) -> None:
    day = "2022-07-07T16:35:15.000" if "2007" in pattern else "2022-03-07T16:35:15.000"
    layout = source_of(tmp_path, "Date;Time" if ";" in pattern else "Time", clocked(pattern, day)).layout
    assert layout.time_start[:19] == start
    assert says in "".join(layout.notes)
    assert bool(says) == bool(layout.notes)


def test_a_date_beside_a_time_with_a_zone_is_of_that_zone(tmp_path: Path) -> None:
    stamps = clocked("%Y-%m-%d;%H:%M:%S.{f}+02:00", "2024-06-15T23:59:59.800")
    source = source_of(tmp_path, "date;time", stamps)
    assert source.layout.time_start == "2024-06-15T21:59:59.800000000Z"
    np.testing.assert_allclose(source.recording.times_s, EVERY_10_MS, atol=1e-9)


REFUSED = {
    "counter": ("time", [str(i) for i in range(COUNT)], "--rate HZ"),
    "counter from 1": ("index", [str(i + 1) for i in range(COUNT)], "--rate HZ"),
    "whole steps": ("time", [str(10 * i) for i in range(COUNT)], "(ms)"),
    "fractions over 1": ("t", [str(2.5 * i) for i in range(COUNT)], "--rate HZ"),
    "Excel days": ("date", [f"{44627.5 + i / 8_640_000:.9f}" for i in range(COUNT)], "days"),
    "no time": ("b", [str(i * i % 17) for i in range(COUNT)], "--time COLUMN"),
    "bad date": ("Date", ["2022-02-28", "2022-02-30", "2022-03-01"], "Row 2"),
    "bad clock": ("time", ["10:00:00", "10:00:01", "25:00:02"], "Row 3"),
    "mixed": ("time", ["10:00:00", "10:00:01", "soon", "10:00:03"], "soon"),
    "digits of a clock": (
        "UTC",
        [f"1159{59 + i / 10:04.1f}" if i < 10 else f"1200{i / 10 - 1:04.1f}" for i in range(COUNT)],
        "hhmmss",
    ),
    "fractions of a day": ("time", [f"{0.4 + i / 86_400:.9f}" for i in range(COUNT)], "days"),
    "hours or minutes": ("elapsed", [f"00:{i:02d}" for i in range(COUNT)], "hh:mm:ss"),
    "backwards": ("time_s", ["0.1", "0.2", "0.15", "0.3", "0.4"], "backwards"),
}


@pytest.mark.parametrize(("header", "stamps", "says"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_known_is_refused(header: str, stamps: list[str], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refusal:
        source_of(tmp_path, header, stamps)
    assert says in str(refusal.value)
    assert "--rate HZ" in str(refusal.value)
    assert refusal.value.exit_code == 3
    if says not in ("--time COLUMN",):
        counted = source_of(tmp_path, header, stamps, rate_hz=50.0)
        assert counted.recording.names == ("force",)
        assert counted.recording.rate_hz == 50.0


def test_two_times_are_refused_and_settled_by_name(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,t_ms,a\n" + "".join(f"{i / 100},{i * 20},{i % 3}\n" for i in range(COUNT)))
    with pytest.raises(InputError, match="--time 'time_s' or --time 't_ms'"):
        read_source(path)
    source = read_source(path, ReadOptions(time="t_ms"))
    assert source.recording.rate_hz == pytest.approx(50)
    assert source.recording.names == ("a",)
    assert read_source(path, ReadOptions(time="time")).recording.rate_hz == pytest.approx(100)


def test_a_column_of_stamps_that_tells_none_is_not_asked_about(tmp_path: Path) -> None:
    """As in the rows of a stream over a fleet, which has a column for when an event was noticed."""
    path, stamps = tmp_path / "rows.parquet", pa.timestamp("us")
    when = pa.array(1_764_000_000_000_000 + 10_000 * np.arange(COUNT), stamps)
    pq.write_table(pa.table({"noticed": pa.nulls(COUNT, stamps), "when": when, "a": np.arange(COUNT) % 3}), path)
    assert read_source(path).recording.rate_hz == pytest.approx(100)
    pq.write_table(pa.table({"noticed": when, "when": when, "a": np.arange(COUNT) % 3}), path)
    with pytest.raises(InputError, match="--time 'noticed' or --time 'when'"):
        read_source(path)


def test_a_rate_counts_rows_and_the_time_passes_through(tmp_path: Path) -> None:
    source = source_of(tmp_path, "time_s", [f"{t:.2f}" for t in EVERY_10_MS], rate_hz=200.0)
    assert source.recording.rate_hz == 200.0
    assert source.recording.names == ("force",)
    assert source.table.column_names == ["time_s", "force"]
    assert source.layout.time_kind == "counted rows"


def test_a_nearly_even_first_column_is_time_whatever_its_name(tmp_path: Path) -> None:
    source = source_of(tmp_path, "x", [f"{t + 1e-4 * (i % 3):.4f}" for i, t in enumerate(EVERY_10_MS)])
    assert source.layout.time_columns == ("x",)


def test_a_fast_log_of_seconds_is_not_of_days(tmp_path: Path) -> None:
    assert source_of(tmp_path, "t", [f"{0.1 + i / 1e5:.9f}" for i in range(COUNT)]).recording.rate_hz == pytest.approx(
        1e5
    )


def test_a_gap_stays_a_gap(tmp_path: Path) -> None:
    stamps = [f"{t:.2f}" for i, t in enumerate(EVERY_10_MS) if i not in (10, 11)]
    layout = source_of(tmp_path, "time_s", stamps).layout
    assert layout.gaps == 1
    assert layout.uniform


@pytest.mark.parametrize(
    "name",
    ["time", "Time (s)", "t", "TIMESTAMP", "Zeit [s]", "log.time_ms", "Time since start", "temps", "Elapsed Time"],
)
def test_names_of_time(name: str) -> None:
    assert is_time_name(name)


@pytest.mark.parametrize("name", ["temperature", "acc_t", "Time constant", "tension", "timeout", "data"])
def test_names_that_are_not_time(name: str) -> None:
    assert not is_time_name(name)
