"""A stream over a fleet whose processes are killed: what counts is what one tells that nobody killed."""

from __future__ import annotations

from pathlib import Path

import pytest

import becalm
from fleet_stream_kills import RATE_HZ, SENSORS, killed
from fleet_stream_runs import KINDS, committed

pytestmark = [pytest.mark.slow, pytest.mark.spark]


def test_whoever_is_killed_nothing_is_lost_and_nothing_told_twice(tmp_path: Path) -> None:
    found = killed(tmp_path, len(KINDS))
    assert found.says == "the same to the bit, every row once, in order"
    assert found.kills == dict.fromkeys(KINDS, 1)
    orphan_beside(tmp_path / "out")
    sensor = tmp_path / "out" / "kind=readings" / f"sensor={SENSORS[0]}"
    recording = becalm.read(sensor)
    assert len(recording) == found.rows / len(SENSORS)
    assert recording.timebase.step_s == pytest.approx(1 / RATE_HZ)


def orphan_beside(out: Path) -> None:
    """Put a file there as a killed process leaves it by luck."""
    for whole in [path for path in committed(out) if "kind=readings" in path.parts]:
        whole.with_name(f"part-99999-{whole.name}").write_bytes(whole.read_bytes())
