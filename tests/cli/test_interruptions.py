"""What comes in between: signals, full disks, pipes, files that change; nothing half-written is left."""

from __future__ import annotations

import hashlib
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

RECIPE = """
becalm_recipe = 1
[tuned_on]
rate_hz = 100.0
[[channel]]
name = "walk"
model = "constant"
"""

SLEEPY = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # who runs this may ignore it
import becalm.files.outputs.chunked_cleaning as chunked_cleaning
from becalm.cli.main import main
chunked_cleaning.clean_chunks = lambda *_, **__: time.sleep(60)
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_stop_leaves_nothing(number: signal.Signals, drive: Path, tmp_path: Path) -> None:
    recipe = tmp_path / "r.toml"
    recipe.write_text(RECIPE, encoding="utf-8")
    folder = tmp_path / "out"
    folder.mkdir()
    words = ["clean", str(drive), "-o", str(folder / "out.csv"), "--recipe", str(recipe)]
    process = subprocess.Popen([sys.executable, "-c", SLEEPY, *words], stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while len(list(folder.glob("*.part"))) < 2 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    process.send_signal(number)
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 128 + number, said
    assert said == "becalm: Stopped; nothing half-written is left.\n"
    assert list(folder.iterdir()) == []


def test_a_signal_that_is_ignored_stays_so() -> None:
    code = """
import signal
from becalm.cli.stopping import stop_cleanly
signal.signal(signal.SIGHUP, signal.SIG_IGN)
stop_cleanly()
assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
assert callable(signal.getsignal(signal.SIGTERM))
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_disk_too_full_for_the_recipe_leaves_no_table(run: Run, tmp_path: Path) -> None:
    def small_files_only() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))

    (tmp_path / "in.csv").write_text("time_s,a\n0.0,1.5\n0.1,2.5\n0.2,1.5\n", encoding="utf-8")
    assert run("clean", "in.csv", "-o", "fits.csv").returncode == 4
    assert (tmp_path / "fits.csv").stat().st_size < 300 < (tmp_path / "fits.csv.recipe.toml").stat().st_size
    ran = run("clean", "in.csv", "-o", "out.csv", preexec_fn=small_files_only)
    assert ran.returncode == 2, ran.stderr
    assert "was not written" in ran.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fits.csv", "fits.csv.recipe.toml", "in.csv"]


def test_a_recipe_tells_which_file_it_was_tuned_on(run: Run, drive: Path, tmp_path: Path) -> None:
    assert run("tune", drive, "-o", "r.toml").returncode == 0
    digest = hashlib.sha256(drive.read_bytes()).hexdigest()
    assert f'sha256 = "{digest}"' in (tmp_path / "r.toml").read_text(encoding="utf-8")


def test_a_pipe_is_read_once_and_has_no_hash(run: Run, drive: Path, tmp_path: Path) -> None:
    text = drive.read_text(encoding="utf-8")
    assert run("tune", "/dev/stdin", "-o", "r.toml", input=text).returncode == 0
    assert 'sha256 = ""' in (tmp_path / "r.toml").read_text(encoding="utf-8")


def test_a_named_pipe_does_not_hang(run: Run, drive: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=lambda: (tmp_path / "pipe").write_bytes(drive.read_bytes()), daemon=True)
    writer.start()
    ran = run("clean", "pipe", "-o", "out.csv", timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert 'sha256 = ""' in (tmp_path / "out.csv.recipe.toml").read_text(encoding="utf-8")


def test_a_column_that_csv_cannot_hold_is_refused_before_the_work(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    columns = {"time_s": np.arange(300) / 100, "a": rng.normal(size=300), "raw": [b"\xff"] * 300}
    pq.write_table(pa.table(columns), tmp_path / "in.parquet")
    (tmp_path / "r.toml").write_text(RECIPE, encoding="utf-8")  # of another channel, which is said when work begins
    ran = run("clean", "in.parquet", "-o", "out.csv", "--recipe", "r.toml", "--channels", "a")
    assert ran.returncode == 2, ran.stderr
    assert ran.stderr.startswith("becalm: Column 'raw' holds binary, which CSV cannot hold")
    assert run("clean", "in.parquet", "-o", "out.parquet").returncode in (0, 4)
