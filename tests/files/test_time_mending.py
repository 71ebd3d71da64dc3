"""What loggers do to time is undone when a file is read, and said; --rate beats all of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from becalm.errors import TimeError, UsageError
from becalm.files import ReadOptions, SourceFile, read, read_source

COUNT = 4000
EVEN = np.arange(COUNT) / 200.0


def read_back(
    folder: Path, header: str, stamps: list[str], rate_hz: float | None = None, as_written: bool = False
) -> SourceFile:
    path = folder / "log.csv"
    noise = np.random.default_rng(2).normal(size=len(stamps))
    lines = [f"{stamp};{value:.6f}" for stamp, value in zip(stamps, noise, strict=True)]
    path.write_text(f"{header};force\n" + "\n".join(lines) + "\n")
    return read_source(path, ReadOptions(rate_hz=rate_hz, as_written=as_written))


def seconds(stamps: NDArray[np.floating[Any]]) -> list[str]:
    return [f"{stamp:.7f}" for stamp in stamps]


@pytest.mark.parametrize(("period", "ticks", "unit"), [(2**16, 5000, "us"), (2**8, 5, "ms"), (2**24, 5000, "us")])
def test_a_counter_that_wraps(period: int, ticks: int, unit: str, tmp_path: Path) -> None:
    counts = (np.arange(COUNT) * ticks + 100) % period
    source = read_back(tmp_path, f"time_{unit}", [str(count) for count in counts])
    wraps = (100 + (COUNT - 1) * ticks) // period
    said = f"{wraps:,} wraps were" if wraps > 1 else "one wrap was"
    assert source.layout.notes == (f"The counter of 'time_{unit}' wraps at {period}; {said} undone.",)
    assert source.recording.rate_hz == pytest.approx(200.0)
    np.testing.assert_allclose(np.diff(source.recording.times_s), 0.005, rtol=1e-6)


def test_a_counter_of_32_bits_in_parquet(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    counts = ((np.arange(COUNT) * 5000 + 2**32 - 7_000_000) % 2**32).astype(np.uint32)
    pq.write_table(pa.table({"time_us": counts, "a": np.random.default_rng(1).normal(size=COUNT)}), path)
    source = read_source(path)
    assert source.layout.notes == ("The counter of 'time_us' wraps at 4294967296; one wrap was undone.",)
    assert source.recording.timebase.uniform
    assert not source.layout.gaps


def test_a_counter_of_rows_that_wraps_still_needs_a_rate(tmp_path: Path) -> None:
    with pytest.raises(TimeError, match="--rate HZ"):
        read_back(tmp_path, "time", [str(row % 256) for row in range(COUNT)])


@pytest.mark.parametrize(
    ("start", "moved", "way", "keep"),
    [
        ("2024-10-27T02:59:50", -3600, "back", ""),
        ("2024-03-31T01:59:50", 3600, "forth", "; keep the stamps as written with --stamps as-written"),
    ],
)
def test_summer_time(start: str, moved: int, way: str, keep: str, tmp_path: Path) -> None:
    since = np.round(EVEN * 1000).astype(int)
    local = np.datetime64(start, "ms") + since + 1000 * moved * (since >= 10_000)
    source = read_back(tmp_path, "local time", [str(stamp) for stamp in local])
    assert source.layout.notes == (
        f"The clock of 'local time' was put {way} once by an hour, as for summer time; that was undone{keep}.",
    )
    np.testing.assert_allclose(source.recording.times_s, EVEN, atol=1e-9)
    with pytest.raises(TimeError, match="backwards"):
        read_back(tmp_path, "time", [f"{stamp}Z" for stamp in np.sort(local)[::-1]])


def test_jitter_of_a_driver(tmp_path: Path) -> None:
    stamps = np.sort(EVEN + np.random.default_rng(3).normal(0.0, 0.0003, COUNT))
    source = read_back(tmp_path, "time_s", seconds(stamps))
    (note,) = source.layout.notes
    assert note.startswith("The stamps of 'time_s' jitter by 0.3")
    assert source.recording.timebase.uniform
    assert source.recording.timebase.jitter_s == pytest.approx(np.std(stamps - EVEN), rel=0.01)
    np.testing.assert_allclose(source.recording.times_s, EVEN, atol=0.0005 / 10)


@pytest.mark.parametrize("apart_s", [0.0, 0.0001])
def test_bursts_of_a_driver(apart_s: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    looks = np.arange(0.0, EVEN[-1] + 0.05, 0.0183)
    looks += rng.exponential(0.0002, len(looks))
    look = np.searchsorted(looks, EVEN)
    within = np.arange(COUNT) - np.searchsorted(look, look)
    source = read_back(tmp_path, "time_s", seconds(looks[look] + apart_s * within))
    (note,) = source.layout.notes
    assert "come in bursts" in note
    np.testing.assert_allclose(source.recording.times_s, EVEN, atol=0.0005)


def test_a_rate_beats_stamps(tmp_path: Path) -> None:
    stamps = np.sort(EVEN + np.random.default_rng(3).normal(0.0, 0.0003, COUNT))
    source = read_back(tmp_path, "time_s", seconds(stamps), rate_hz=50.0)
    assert source.recording.rate_hz == 50.0
    assert source.layout.notes == ()


def test_random_times_stay_as_they_are(tmp_path: Path) -> None:
    stamps = np.round(np.cumsum(np.random.default_rng(3).exponential(0.01, COUNT)), 7)
    source = read_back(tmp_path, "time_s", seconds(stamps))
    assert source.layout.notes == ()
    np.testing.assert_allclose(source.recording.times_s, stamps, atol=1e-9)


def test_stamps_stay_as_written_where_a_person_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    stamps = np.round(np.sort(EVEN + rng.normal(0.0, 0.0003, COUNT)), 7)
    assert (
        read_back(tmp_path, "time_s", seconds(stamps))
        .layout.notes[0]
        .endswith("the rows are counted at that rate instead; keep them as written with --stamps as-written.")
    )
    source = read_back(tmp_path, "time_s", seconds(stamps), as_written=True)
    assert source.layout.notes == ()
    np.testing.assert_allclose(source.recording.times_s, stamps, atol=1e-9)
    with pytest.raises(UsageError, match="give one of them"):
        read_back(tmp_path, "time_s", seconds(stamps), rate_hz=200.0, as_written=True)
    np.testing.assert_allclose(read(tmp_path / "log.csv", as_written=True).times_s, stamps, atol=1e-9)


def test_an_hour_without_readings_stays_where_a_person_says_so(tmp_path: Path) -> None:
    since = np.round(EVEN * 1000).astype(int)
    local = np.datetime64("2024-03-31T01:59:50", "ms") + since + 3_600_000 * (since >= 10_000)
    source = read_back(tmp_path, "local time", [str(stamp) for stamp in local], as_written=True)
    assert source.layout.notes == ()
    assert source.layout.gaps == 1
    assert source.layout.duration_s == pytest.approx(EVEN[-1] + 3600)


@pytest.mark.parametrize("jitter_s", [0.0, 0.0003])
def test_rows_lost_in_periodic_drop_outs_stay_lost(jitter_s: float, tmp_path: Path) -> None:
    rows = np.arange(60_000)
    kept = rows[rows % 300.7 < 20.3] / 200.0
    stamps = np.sort(kept + np.random.default_rng(1).normal(0.0, jitter_s, len(kept)))
    source = read_back(tmp_path, "time_s", seconds(stamps))
    assert source.layout.notes == ()
    assert source.layout.gaps == np.count_nonzero(np.diff(kept) > 0.006)
    np.testing.assert_allclose(source.recording.times_s, stamps, atol=1e-6)


def test_bursts_of_one_size_are_used_as_they_are_and_a_rate_is_proposed(tmp_path: Path) -> None:
    late = np.random.default_rng(4).exponential(0.0002, COUNT // 8)
    stamps = np.repeat(EVEN[7::8] + late, 8) + np.tile(0.0001 * np.arange(8), COUNT // 8)
    source = read_back(tmp_path, "time_s", seconds(stamps))
    (note,) = source.layout.notes
    assert note.startswith("The stamps of 'time_s' come in bursts of 8 rows, and are used as they are;")
    rate_hz = float(note.rpartition("--rate ")[2].rstrip("."))
    assert rate_hz == pytest.approx(200.0, rel=1e-3)
    np.testing.assert_allclose(source.recording.times_s, stamps, atol=1e-6)
    assert read_back(tmp_path, "time_s", seconds(stamps), rate_hz=rate_hz).layout.notes == ()
    assert read_back(tmp_path, "time_s", seconds(stamps), as_written=True).layout.notes == ()


def test_rows_lost_among_stamps_of_a_digit_a_step_are_said(tmp_path: Path) -> None:
    """833 Hz in milliseconds is even; with a row lost it looks like 1 kHz with many, and the rate is asked for."""
    stamps = np.round(np.arange(COUNT) / 833, 3)
    even = read_back(tmp_path, "time_s", seconds(stamps))
    assert (even.layout.gaps, even.layout.notes) == (0, ())
    stamps[COUNT // 2 :] += 0.003
    (note,) = read_back(tmp_path, "time_s", seconds(stamps)).layout.notes
    assert note.startswith("The stamps of 'time_s' have one digit a step")
    assert note.endswith("count rows with --rate HZ.")
