"""A stream over a fleet whose processes are killed: what counts is what one tells that nobody killed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import becalm
import fleet_stream_kills
from fleet_stream_kills import FILE_ROWS, NAMES, RATE_HZ, RECIPE, SENSORS, killed
from fleet_stream_runs import KINDS, StreamRun, committed, told_in, write_rows
from live_runs import readings
from streaming_spark import until

pytestmark = [pytest.mark.slow, pytest.mark.spark, pytest.mark.usefixtures("quick_spark")]


def test_whoever_is_killed_nothing_is_lost_and_nothing_told_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet_stream_kills, "_MOST_FILES", 900)  # of which one comes every 0.7 s
    found = killed(tmp_path, len(KINDS))
    assert found.says == "the same to the bit, every row once, in order"
    assert found.kills == dict.fromkeys(KINDS, 1)
    orphan_beside(tmp_path / "out")
    sensor = tmp_path / "out" / "kind=readings" / f"sensor={SENSORS[0]}"
    recording = becalm.read(sensor)
    assert len(recording) == found.rows / len(SENSORS)
    assert recording.timebase.step_s == pytest.approx(1 / RATE_HZ)


def test_a_stream_that_is_killed_before_its_first_rows_count_can_be_begun_again(tmp_path: Path) -> None:
    """The engine says in its checkpoint what a micro-batch will take before it takes it."""
    rows = readings(FILE_ROWS, 2, RATE_HZ, 1)
    time_s = 1.764e9 + np.arange(FILE_ROWS) / RATE_HZ
    write_rows(tmp_path / "lake" / "sensor=1" / "0.parquet", time_s, {name: rows[:, c] for c, name in enumerate(NAMES)})
    (tmp_path / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    stream = StreamRun(tmp_path, master="local[2]")
    try:
        stream.begin()
        until((stream.output / "_checkpoint" / "offsets" / "0").exists)
        stream.end()
        assert not committed(stream.output)
        stream.begin()
        until(lambda: bool(committed(stream.output)), 180.0)  # two engines start, on a machine that may be busy
    finally:
        stream.end()
    assert told_in(stream.output, "1").num_rows == FILE_ROWS


def orphan_beside(out: Path) -> None:
    """Put a file there as a killed process leaves it by luck."""
    for whole in [path for path in committed(out) if "kind=readings" in path.parts]:
        whole.with_name(f"part-99999-{whole.name}").write_bytes(whole.read_bytes())
