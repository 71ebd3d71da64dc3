"""`clean --verdicts`: what became of each reading, in words, beside its channel."""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]
ROWS = 3000


@pytest.fixture
def spiky(tmp_path: Path) -> Path:
    """Write 3000 rows at 100 Hz of a walk in noise, every hundredth a spike, one lacking, and a column of text."""
    rng = np.random.default_rng(4)
    z = np.cumsum(rng.normal(0, 0.05, ROWS)) + rng.normal(0, 1.0, ROWS)
    z[50::100] += 20.0
    cells = [f"{value:.6f}" for value in z]
    cells[17] = ""
    path = tmp_path / "spiky.csv"
    lines = [f"{k / 100:.2f},{cells[k]},n{k % 3}" for k in range(ROWS)]
    path.write_text("time_s,strain (um/m),note\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_words_stand_beside_the_channel(ending: str, spiky: Path, run: Run, tmp_path: Path) -> None:
    ran = run("clean", spiky, "-o", f"out.{ending}", "--verdicts", "--json")
    assert ran.returncode == 0, ran.stderr
    path = tmp_path / f"out.{ending}"
    table = pyarrow.csv.read_csv(path) if ending == "csv" else pyarrow.parquet.read_table(path)
    name = "strain (um/m)"
    assert table.column_names == ["time_s", name, f"{name}_sigma", f"{name}_verdict", "note"]
    words = table[f"{name}_verdict"].to_pylist()
    assert words[17] == "missing"
    assert set(words[50::100]) == {"spike"}
    (channel,) = json.loads(ran.stdout)["channels"]
    assert Counter(words) == {word: count for word, count in channel["verdicts"].items() if count}
    assert len(channel["advice"]) == 2
    assert "Spikes were left out" in ran.stderr
    if ending == "parquet":
        assert pa.types.is_dictionary(table.schema.field(f"{name}_verdict").type)
    assert "[channel.gate]" in (tmp_path / f"out.{ending}.recipe.toml").read_text(encoding="utf-8")


def test_a_column_of_that_name_is_not_written_over(run: Run, tmp_path: Path) -> None:
    rows = "".join(f"{k / 100:.2f},{np.sin(k):.4f},ok\n" for k in range(100))
    (tmp_path / "in.csv").write_text(f"time_s,a,a_verdict\n{rows}", encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv", "--verdicts")
    assert ran.returncode == 2
    assert "The file has a column 'a_verdict', which --verdicts would write" in ran.stderr
    assert not (tmp_path / "out.csv").exists()


def test_a_channel_that_passes_unchanged_has_verdicts_too(run: Run, tmp_path: Path) -> None:
    rows = "".join(f"{k / 100:.2f},{'' if k == 3 else 5}\n" for k in range(100))
    (tmp_path / "in.csv").write_text(f"time_s,a\n{rows}", encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv", "--verdicts")
    assert ran.returncode == 0, ran.stderr
    words = pyarrow.csv.read_csv(tmp_path / "out.csv")["a_verdict"].to_pylist()
    assert [k for k, word in enumerate(words) if word != "used"] == [3]
