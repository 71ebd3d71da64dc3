"""A log of two rates, cleaned into every format that holds both."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from becalm.files.outputs.writing import open_output
from becalm.files.registry import ENDINGS, read_tables, stores_several_times

Run = Callable[..., subprocess.CompletedProcess[str]]
SEVERAL = sorted({form: ending for ending, form in ENDINGS.items() if stores_several_times(form)}.values())
RATES = {"imu/acc": 100.0, "temp (raw)": 10.0}
ROWS = 300

RECIPE = """
becalm_recipe = 1
[tuned_on]
rate_hz = 100.0
[[channel]]
name = "imu/acc/x"
model = "motion"
order = 1
process_noise_density = 1.0
noise_std = 1.0
[[channel]]
name = "temp (raw)/x"
model = "motion"
order = 1
process_noise_density = 1.0
noise_std = 1.0
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Write two noisy channels of one name, at 100 and at 10 Hz, each beside a word a row."""
    rng = np.random.default_rng(6)
    path = tmp_path / "log.h5"
    with open_output(path) as out:
        for group, rate_hz in RATES.items():
            times = pa.field("time_s", pa.float64(), metadata={b"unit": b"s"})
            told = {"becalm.group": group, "becalm.start": "2026-01-02T03:04:05Z"}
            fields = [times, pa.field("x", pa.float64()), pa.field(f"note of {group}", pa.string())]
            columns = [np.arange(ROWS) / rate_hz, np.cumsum(rng.normal(size=ROWS)), ["a", "b", "c"] * (ROWS // 3)]
            out.write(pa.table([pa.array(one) for one in columns], schema=pa.schema(fields, told)))
    return path


@pytest.mark.parametrize("ending", SEVERAL)
def test_each_group_is_cleaned_and_told_apart(ending: str, log: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(RECIPE, encoding="utf-8")
    ran = run("clean", log, "-o", f"out{ending}", "--recipe", "r.toml", "--verdicts")
    assert ran.returncode in (0, 4), ran.stderr
    tables = read_tables(tmp_path / f"out{ending}")
    assert [table.group for table in tables] == list(RATES)
    for table, (group, rate_hz) in zip(tables, RATES.items(), strict=True):
        x = f"{group}/x"
        assert table.names == ["time_s", x, f"{x}_sigma", f"{x}_verdict", f"note of {group}"]
        block = next(iter(table.blocks(table.names)))
        np.testing.assert_array_equal(block["time_s"].to_numpy(), np.arange(ROWS) / rate_hz)
        assert np.isfinite(block[f"{x}_sigma"].to_numpy()).all()
        assert "used" in block[f"{x}_verdict"].to_pylist()
        assert block[f"note of {group}"].to_pylist() == ["a", "b", "c"] * (ROWS // 3)
        assert table.time is not None
        assert table.time.start.startswith("2026-01-02T03:04:05")
        table.rows.close()


def test_a_report_shows_the_channels_of_all_times(log: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(RECIPE, encoding="utf-8")
    ran = run("clean", log, "-o", "out.h5", "--recipe", "r.toml", "--report", "r.html")
    assert ran.returncode in (0, 4), ran.stderr
    html = (tmp_path / "r.html").read_text(encoding="utf-8")
    for number, (group, rate_hz) in enumerate(RATES.items(), 1):
        assert f"<h2>{group}/x</h2>" in html
        assert f"<dt>{group}</dt><dd>{ROWS} rows at {rate_hz:g} Hz, lasts {ROWS / rate_hz:g} s</dd>" in html
        assert html.count(f'<section id="channel-{number}"') == 1


def test_an_output_that_holds_one_time_is_refused_with_those_that_hold_several(log: Path, run: Run) -> None:
    ran = run("clean", log, "-o", "out.csv")
    assert ran.returncode == 2
    assert all(ending in ran.stderr for ending in (".h5", ".mat", ".mf4", ".npz", ".tdms", "--group")), ran.stderr
