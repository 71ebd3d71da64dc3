"""Write lakes for benchmarks of a fleet: many sensors of usual length, or a very long one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

EACH, RATE_HZ = 200_000, 100.0
GROUP = 1 << 20


def make_lake(root: Path, sensors: int) -> None:
    """Write sensors of two files each."""
    for sensor in range(sensors):
        rng = np.random.default_rng(sensor)
        times_s, z = np.arange(EACH) / RATE_HZ, _noisy(rng, EACH, 0.0)[0]
        if sensor % 3 == 0:
            z[1000:1300] = np.nan
        if sensor % 5 == 0:
            times_s[EACH // 2 :] += 5.0
        place = root / f"sensor={sensor:03d}"
        place.mkdir(parents=True)
        _write(place / "a.parquet", times_s[EACH // 2 :], z[EACH // 2 :])
        _write(place / "b.parquet", times_s[: EACH // 2], z[: EACH // 2])


def make_endless(root: Path, rows: int) -> None:
    """Write one sensor with a number of rows, in four files."""
    rng, level, each = np.random.default_rng(1), 0.0, rows // 4
    for part in range(4):
        place = root / "sensor=endless" / f"date=2026-01-{part + 1:02d}"
        place.mkdir(parents=True)
        z, level = _noisy(rng, each, level)
        for hole in rng.integers(0, each, 25):
            z[hole : hole + rng.integers(1, 3000)] = np.nan
        _write(place / f"part-{9 - part}.parquet", (np.arange(each) + part * each) / RATE_HZ + 50.0 * (part > 1), z)


def _noisy(rng: np.random.Generator, rows: int, level: float) -> tuple[np.ndarray, float]:
    walk = level + 0.05 * np.cumsum(rng.normal(size=rows))
    return walk + rng.normal(size=rows), float(walk[-1])


def _write(path: Path, times_s: np.ndarray, z: np.ndarray) -> None:
    pq.write_table(pa.table({"time (s)": times_s, "x": z}), path, row_group_size=GROUP, use_dictionary=False)
