"""`becalm study`: a paper re-run from the command line; sentences for what cannot be."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_a_paper_that_there_is_not_is_said(run: Run, tmp_path: Path) -> None:
    ran = run("study", "ship")
    assert ran.returncode == 2
    assert "write becalm study car or imu or strain" in ran.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_said(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    ran = run("study", "imu", "-o", "file/study")
    assert ran.returncode == 2
    assert "name another with -o" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_a_page_that_cannot_be_written_is_said_before_the_work(run: Run, tmp_path: Path) -> None:
    (tmp_path / "study" / "imu.md").mkdir(parents=True)
    ran = run("study", "imu")
    assert ran.returncode == 2
    assert "imu.md is a directory" in ran.stderr
    assert [path.name for path in (tmp_path / "study").iterdir()] == ["imu.md"]


@pytest.mark.slow
def test_the_page_is_printed_and_written_with_its_figures(run: Run, tmp_path: Path) -> None:
    ran = run("study", "car", "-o", "study")
    assert ran.returncode == 0, ran.stderr
    page = (tmp_path / "study" / "car.md").read_text(encoding="utf-8")
    assert ran.stdout.strip() == page.strip()
    assert "985.6" in page
    assert "channel by channel" in page
    drawn = {path.name for path in (tmp_path / "study").glob("*.svg")}
    assert len(drawn) >= (6 if find_spec("matplotlib") else 0)
    assert all(f"]({name})" in page for name in drawn)
