"""Real recordings are understood rightly, or refused with the option that helps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.errors import TimeError
from becalm.files import ReadOptions, output_table, read, read_source, write_table

DATA = Path(__file__).parents[2].parent / "shared" / "data"


def real(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    return path


FILES = {
    "comma2k19/accelerometer.csv": (6256, 3, 104.35, "m/s^2"),
    "comma2k19/gyroscope.csv": (6256, 3, 104.35, "rad/s"),
    "comma2k19/can_speed.csv": (4974, 1, 89.19, "m/s"),
    "fusion/sensor_data.csv": (13514, 9, 99.21, "deg/s"),
    "munich_bridge/reference_state_strain.csv.gz": (60000, 1, 100.0, "um/m"),
    "munich_bridge/support_load_strain.csv.gz": (72000, 1, 100.0, "um/m"),
    "imu_tk/xsens_acc.mat.txt.gz": (51175, 3, 100.0, ""),
}


@pytest.mark.parametrize(("name", "expected"), FILES.items(), ids=FILES.keys())
def test_real_file(name: str, expected: tuple[int, int, float, str], tmp_path: Path) -> None:
    source = read_source(real(name))
    rows, channels, rate, unit = expected
    assert source.recording.samples.shape == (rows, channels)
    assert source.recording.rate_hz == pytest.approx(rate, abs=0.01)
    assert source.recording.units[0] == unit
    assert np.isfinite(source.recording.samples).all()
    write_table(tmp_path / "out.csv", output_table(source, source.recording, source.recording))
    again = read_source(tmp_path / "out.csv")
    np.testing.assert_array_equal(again.recording.samples, source.recording.samples)
    np.testing.assert_array_equal(again.recording.times_s, source.recording.times_s)


@pytest.mark.parametrize(("name", "channels"), [("imu_sample.csv", 12), ("mocap_sample.csv", 18)])
def test_gaitmap_needs_a_rate(name: str, channels: int) -> None:
    path = real(f"gaitmap/{name}")
    with pytest.raises(TimeError, match="--rate HZ"):
        read(path)
    assert read_source(path, ReadOptions(rate_hz=204.8)).recording.samples.shape[1] == channels


def test_a_hundred_thousand_rows_are_read_as_written(tmp_path: Path) -> None:
    path = tmp_path / "big.csv"
    values = np.random.default_rng(0).normal(size=(100_000, 5))
    lines = [f"{i / 1000!r}," + ",".join(map(repr, row)) for i, row in enumerate(values.tolist())]
    path.write_text("time_s,a,b,c,d,e\n" + "\n".join(lines))
    np.testing.assert_array_equal(read(path).samples, values)
