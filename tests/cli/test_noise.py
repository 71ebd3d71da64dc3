"""`becalm noise`: R from a file, stretches as said, one JSON object, and mistakes in sentences."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from becalm.cli import options
from becalm.cli.commands import noise
from becalm.errors import UsageError
from becalm.files.inputs import portions
from becalm.files.inputs.opening import open_source

Run = Callable[..., subprocess.CompletedProcess[str]]

RATE_HZ = 100
STD = 0.02  # of the acceleration, in g, before 40 s; five times that after


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Write a minute of an accelerometer and a gyroscope on a bench that shakes from 40 s on."""
    rng = np.random.default_rng(8)
    t = np.arange(60 * RATE_HZ) / RATE_HZ
    loud = np.where(t < 40, 1.0, 5.0)
    a, w = 1 + STD * loud * rng.normal(size=t.size), 0.3 * loud * rng.normal(size=t.size)
    rows = "".join(f"{t[k]:.2f},{a[k]:.8f},{w[k]:.8f},note\n" for k in range(t.size))
    path = tmp_path / "bench.csv"
    path.write_text(f"time_s,acc (g),gyro (rad/s),note\n{rows}", encoding="utf-8")
    return path


def channels(ran: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    assert ran.returncode == 0, ran.stderr
    found: list[dict[str, Any]] = json.loads(ran.stdout)["channels"]
    return found


def test_a_known_noise_comes_through_the_file(run: Run, bench: Path) -> None:
    ran = run("noise", bench, "--json")
    acc, gyro = channels(ran)
    for channel, std in ((acc, STD), (gyro, 0.3)):
        assert channel["noise_std"] == pytest.approx(std, abs=4 * channel["noise_std_error"])
        assert channel["noise_std_error"] == pytest.approx(std * np.sqrt(3 / 4000) / 2, rel=0.1)
        white = channel["allan"]["white_noise"]
        assert white["value"] == pytest.approx(std / 10, abs=4 * white["standard_error"])
        ((start_s, stop_s),) = channel["stretches_s"]
        assert start_s == 0
        assert stop_s == pytest.approx(40, abs=0.5)
    density, walk = acc["allan"]["white_noise"]["quoted"]
    assert (density["unit"], walk["unit"]) == ("ug/sqrt(Hz)", "m/s/sqrt(h)")
    assert density["value"] == pytest.approx(1e6 * STD / 10 * np.sqrt(2), rel=0.05)
    assert gyro["allan"]["white_noise"]["quoted"][1]["value"] == pytest.approx(np.degrees(0.3 / 10) * 60, rel=0.05)


def test_a_person_reads_it_on_stderr(bench: Path) -> None:
    """A terminal may be narrow: no figure is broken."""
    command = [sys.executable, "-m", "becalm", "noise", str(bench), "--channels", "acc"]
    environment = {**os.environ, "COLUMNS": "40"}
    ran = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert ran.returncode == 0
    assert ran.stdout == ""
    assert "\x1b" not in ran.stderr
    lines = ran.stderr.splitlines()
    (white,) = (line for line in lines if "N, white noise" in line)
    assert "ug/sqrt(Hz), " in white
    (bias,) = (line for line in lines if "B, bias instability" in line)
    assert bias.split()[3:5] == ["-", "-"]
    assert "below" in bias
    assert any(line.startswith("acc (g): The Allan deviation has no flat stretch") for line in lines)
    assert "gyro" not in ran.stderr


def test_what_is_said_to_be_still_beats_what_is_found(run: Run, bench: Path) -> None:
    acc, _ = channels(run("noise", bench, "--still", "42:50, 50s:1min", "--cutoff", "2Hz", "--json"))
    assert acc["stretches_s"] == [[42.0, pytest.approx(60.0)]]
    assert acc["noise_std"] == pytest.approx(5 * STD, abs=4 * acc["noise_std_error"])
    assert acc["cutoff_hz"] == 2.0


def test_a_file_without_rest_is_no_error(run: Run, tmp_path: Path) -> None:
    t = np.arange(3000) / RATE_HZ
    rows = "".join(f"{s:.2f},{np.sin(4 * s):.6f}\n" for s in t)
    (tmp_path / "wave.csv").write_text(f"time_s,a\n{rows}", encoding="utf-8")
    ran = run("noise", "wave.csv", "--json")
    (wave,) = channels(ran)
    assert (wave["stretches_s"], wave["noise_std"], wave["allan"]) == ([], None, None)
    assert "--still START:STOP" in ran.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--still", "30"], "--still 30 is not a stretch of time; write START:STOP in seconds"),
        (["--still", "30:0"], "--still 30:0 is not a stretch"),
        (["--still=-5:30"], "is not a stretch of time"),
        (["--still", "0:00:30"], "is not a stretch of time"),
        (["--still", "0:30,"], "is not a stretch of time"),
        (["--still", ""], "is not a stretch of time"),
        (["--still", "70:80"], "there are 0 samples; 32 are needed. The record lasts 59.99 s"),
        (["--still", "0:0.1"], "there are 10 samples"),
        (["--cutoff", "1"], "--cutoff 1 is not a frequency"),
        (["--cutoff", "0Hz"], "--cutoff 0Hz is not a frequency"),
        (["--cutoff", "50Hz"], "--cutoff 50Hz is too high for a rate of 100 Hz"),
        (["--channels", "nothing"], "nothing"),
    ],
)
def test_mistakes_end_in_a_sentence(run: Run, bench: Path, words: list[str], says: str) -> None:
    ran = run("noise", bench, *words)
    assert ran.returncode == 2, ran.stderr
    assert says in " ".join(ran.stderr.split())
    assert "Traceback" not in ran.stderr
    assert ran.stdout == ""


@pytest.mark.parametrize(("text", "code"), [("", 3), ("time_s,a\n0.00,1.5\n", 3), ("a,b\n1,2\n3,5\n", 3)])
def test_files_that_cannot_be_read_are_refused(run: Run, tmp_path: Path, text: str, code: int) -> None:
    (tmp_path / "in.csv").write_text(text, encoding="utf-8")
    ran = run("noise", "in.csv")
    assert ran.returncode == code, ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize("values", [["2.5"] * 200, ["NaN"] * 200, ["1.0", "2.5", "3.0"], ["inf", "1e300"] * 100])
def test_files_without_noise_are_survived(run: Run, tmp_path: Path, values: list[str]) -> None:
    rows = "".join(f"{k / 100:.2f},{value}\n" for k, value in enumerate(values))
    (tmp_path / "in.csv").write_text(f"time_s,a\n{rows}", encoding="utf-8")
    (found,) = channels(run("noise", "in.csv", "--json"))
    assert found["noise_std"] is None
    assert found["rest"].endswith(".")


SPANS = {
    "0:30": ((0.0, 30.0),),
    "0:30,60:90": ((0.0, 30.0), (60.0, 90.0)),
    " 0.5 : 1e2 ": ((0.5, 100.0),),
    "500ms:2s, 1min:1.5 h": ((0.5, 2.0), (60.0, 5400.0)),
}


@pytest.mark.parametrize("text", SPANS)
def test_stretches_are_read_as_people_write_them(text: str) -> None:
    assert options.still_of(text) == SPANS[text]
    assert options.still_of(None) is None


@pytest.mark.parametrize(("text", "cutoff_hz"), [("1Hz", 1.0), ("0.5 hz", 0.5), ("2kHz", 2000.0)])
def test_a_cutoff_is_read_with_its_unit(text: str, cutoff_hz: float) -> None:
    assert options.frequency_of("--cutoff", text) == cutoff_hz


def test_a_long_file_is_read_from_the_first_row_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(portions, "REST_ROWS", 6000)
    z = np.random.default_rng(2).normal(size=9000) * np.where(np.arange(9000) < 6000, 1.0, 7.0)
    path = tmp_path / "long.parquet"
    pyarrow.parquet.write_table(pa.table({"time_s": np.arange(9000) / 100, "a": z}), path)
    with open_source(path) as source:
        noise.run(source, [(0.0, 60.0)], None, True)
        shown = capsys.readouterr()
        with pytest.raises(UsageError, match="Only the first 6000 of 9000 rows"):
            noise.run(source, [(70.0, 80.0)], None, True)
    told = json.loads(shown.out)
    assert (told["rows"], told["rows_looked_at"]) == (9000, 6000)
    assert told["channels"][0]["noise_std"] == pytest.approx(1, rel=0.05)
    assert "Only the first 6000 of 9000 rows were used." in shown.err


@pytest.mark.parametrize(("width", "rows"), [(1, 1 << 22), (64, 1 << 20), (1 << 20, 1 << 16)])
def test_many_channels_still_fit_into_memory(width: int, rows: int) -> None:
    source: Any = SimpleNamespace(rows=1 << 30, names=range(width), stretches=lambda parts: parts)
    read: Any = portions.read_beginning(source)
    assert read == [(0, rows)]
