"""Bad input ends in a sentence and an exit code, without a traceback and without a file."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


def column(values: list[str]) -> str:
    return "time_s,a\n" + "".join(f"{k / 100:.2f},{value}\n" for k, value in enumerate(values))


NOISE = [f"{value:.4f}" for value in np.random.default_rng(0).normal(size=200)]

REFUSED = {
    "empty": ("", 3),
    "blank lines": ("\n\n\n", 3),
    "header only": ("time_s,a\n", 3),
    "one row": ("time_s,a\n0.00,1.5\n", 3),
    "text among numbers": (column([*NOISE[:50], "broken", *NOISE[50:]]), 3),
    "time backwards": ("time_s,a\n0.00,1\n0.01,2\n0.02,3\n0.015,4\n0.03,5\n0.04,6\n", 3),
    "time stands": ("time_s,a\n" + "1.0,2.5\n" * 50, 3),
    "ragged": ("time_s,a\n0.00,1\n0.01\n0.02,3,4\n", 3),
    "only text": ("name,note\nx,y\nz,w\n", 3),
    "no time": ("a,b\n" + "\n".join(f"{x},{x}" for x in NOISE) + "\n", 3),
}


@pytest.mark.parametrize(("text", "code"), REFUSED.values(), ids=REFUSED)
def test_refused_with_a_sentence(text: str, code: int, run: Run, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(text, encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv")
    assert ran.returncode == code, ran.stderr
    assert "Traceback" not in ran.stderr
    assert len(ran.stderr.strip().splitlines()[-1]) > 30
    assert [path.name for path in tmp_path.iterdir()] == ["in.csv"]


SURVIVED = {
    "constant": (["2.5"] * 200, 0, "equal"),
    "all missing": (["NaN"] * 200, 4, "readings"),
    "three readings": (["1.0", "2.5", "3.0"], 4, "Fewer than"),
    "1e300": ([*NOISE[:99], "1e300", *NOISE[99:]], 0, "1e100"),
    "inf": ([*NOISE[:99], "inf", "-inf", *NOISE[99:]], 0, "Infinite"),
    "holes": ([*NOISE[:99], "", "NaN", *NOISE[99:]], 0, "Missing"),
}


@pytest.mark.parametrize(("values", "code", "says"), SURVIVED.values(), ids=SURVIVED)
def test_survived_and_said(values: list[str], code: int, says: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(column(values), encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv")
    assert ran.returncode == code, ran.stderr
    assert says in ran.stderr
    assert "Traceback" not in ran.stderr
    clean = np.array(pyarrow.csv.read_csv(tmp_path / "out.csv")["a"].to_pylist(), dtype=float)
    assert len(clean) == len(values)
    if values[0] != "NaN":
        assert np.isfinite(clean).all()
        assert np.abs(clean).max() < 10


WRONG_USE = {
    "no output": ["clean", "in.csv"],
    "unknown channel": ["clean", "in.csv", "-o", "out.csv", "--channels", "b"],
    "no channel": ["clean", "in.csv", "-o", "out.csv", "--channels", ""],
    "negative rate": ["clean", "in.csv", "-o", "out.csv", "--rate", "-5"],
    "rate nan": ["clean", "in.csv", "-o", "out.csv", "--rate", "nan"],
    "unknown time": ["clean", "in.csv", "-o", "out.csv", "--time", "when"],
    "unknown ending": ["clean", "in.csv", "-o", "out.xyz"],
    "folder missing": ["clean", "in.csv", "-o", "nowhere/out.csv"],
    "over itself": ["clean", "in.csv", "-o", "in.csv"],
    "no recipe": ["clean", "in.csv", "-o", "out.csv", "--recipe", "none.toml"],
    "recipe is data": ["clean", "in.csv", "-o", "out.csv", "--recipe", "in.csv"],
    "unknown command": ["polish", "in.csv"],
}


@pytest.mark.parametrize("words", WRONG_USE.values(), ids=WRONG_USE)
def test_wrong_use_is_said(words: list[str], run: Run, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(column(NOISE), encoding="utf-8")
    before = (tmp_path / "in.csv").read_bytes()
    ran = run(*words)
    assert ran.returncode in (2, 3), ran.stderr
    assert "Traceback" not in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["in.csv"]
    assert (tmp_path / "in.csv").read_bytes() == before


def test_input_missing_or_a_folder(run: Run, tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    for name in ("none.csv", "folder.csv"):
        ran = run("clean", name, "-o", "out.csv")
        assert ran.returncode == 3, ran.stderr
        assert "Traceback" not in ran.stderr


def test_a_folder_that_may_not_be_written(run: Run, drive: Path, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        target = Path("/proc/out.csv")  # nobody writes there, root neither
    else:
        (tmp_path / "locked").mkdir(mode=0o500)
        target = tmp_path / "locked" / "out.csv"
    ran = run("clean", drive, "-o", target)
    assert ran.returncode == 2, ran.stderr
    assert "Traceback" not in ran.stderr


def test_a_disk_that_fills_up_leaves_nothing(run: Run, drive: Path, tmp_path: Path) -> None:
    def small_files_only() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    ran = run("clean", drive, "-o", "out.csv", preexec_fn=small_files_only)
    assert ran.returncode == 2, ran.stderr
    assert "Traceback" not in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["drive.csv"]


def test_units_in_brackets_are_printed_and_do_not_break_the_table(run: Run, tmp_path: Path) -> None:
    text = column(NOISE).replace("time_s,a", "time_s,f [/s]")
    (tmp_path / "in.csv").write_text(text.replace("f [/s]", "f [rad]"), encoding="utf-8")
    (tmp_path / "odd.csv").write_text(text, encoding="utf-8")
    assert "f [rad]" in run("inspect", "in.csv").stdout
    for name in ("in.csv", "odd.csv"):
        ran = run("clean", name, "-o", "out.csv")
        assert ran.returncode == 0, ran.stderr
    assert "f [/s]" in ran.stderr


def test_what_is_replaced_or_passed_through_is_said(run: Run, tmp_path: Path) -> None:
    rows = "".join(f"{k / 100:.2f},{value},7.5,x\n" for k, value in enumerate(NOISE))
    (tmp_path / "in.csv").write_text("time_s,a,a_sigma,note\n" + rows, encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv")
    assert "Replaced by the new uncertainty: a_sigma" in ran.stderr
    assert "note (text)" in ran.stderr


IMPOSSIBLE = ["noise_std = 1e-300", "noise_std = 1e200", "process_noise_density = 1e300", "process_noise_density = -1"]


def test_an_impossible_recipe_is_refused(run: Run, drive: Path, tmp_path: Path) -> None:
    run("tune", drive, "-o", "r.toml")
    lines = (tmp_path / "r.toml").read_text(encoding="utf-8").splitlines()
    for line in IMPOSSIBLE:
        key = line.partition(" ")[0]
        edited = [line if text.startswith(key) else text for text in lines]
        (tmp_path / "r.toml").write_text("\ufeff" + "\n".join(edited), encoding="utf-8")
        ran = run("clean", drive, "-o", "out.csv", "--recipe", "r.toml")
        assert ran.returncode == 2, (line, ran.stderr)
        assert key in ran.stderr, line
        assert "Traceback" not in ran.stderr
        assert not (tmp_path / "out.csv").exists()


def test_a_recipe_that_passes_a_lively_channel_says_so(run: Run, drive: Path, tmp_path: Path) -> None:
    run("tune", drive, "-o", "r.toml")
    text = (tmp_path / "r.toml").read_text(encoding="utf-8").replace('"motion"', '"constant"')
    (tmp_path / "r.toml").write_text(text, encoding="utf-8")
    ran = run("clean", drive, "-o", "out.csv", "--recipe", "r.toml")
    assert ran.returncode == 4
    assert "readings vary" in ran.stderr


def test_a_recipe_is_not_overwritten_by_a_part_of_it(run: Run, drive: Path, tmp_path: Path) -> None:
    run("clean", drive, "-o", "out.csv")
    before = (tmp_path / "out.csv.recipe.toml").read_bytes()
    ran = run("clean", drive, "-o", "out.csv", "--recipe", "out.csv.recipe.toml", "--channels", "walk")
    assert ran.returncode == 2
    assert (tmp_path / "out.csv.recipe.toml").read_bytes() == before


def test_what_a_person_says_of_time_wins_over_the_recipe(run: Run, drive: Path, tmp_path: Path) -> None:
    run("tune", drive, "-o", "r.toml", "--rate", "50")
    assert run("clean", drive, "-o", "out.csv", "--recipe", "r.toml", "--rate", "0").returncode == 2
    told = run("clean", drive, "-o", "out.csv", "--recipe", "r.toml", "--time", "time_s", "--json").stdout
    assert '"rate_hz": 100.0' in told


def test_a_recipe_for_other_channels_is_said_to_be_one(run: Run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(column(NOISE), encoding="utf-8")
    run("tune", "in.csv", "-o", "r.toml")
    for words in ([drive, "-o", "x.csv"], ["in.csv", "-o", "x.csv", "--time", "a"]):
        ran = run("clean", *words, "--recipe", "r.toml")
        assert ran.returncode == 2, ran.stderr
        assert ran.stderr.startswith("becalm: The recipe names 'a', which is ")
        assert "with: becalm tune" in ran.stderr
    empty = (tmp_path / "r.toml").read_text(encoding="utf-8").partition("[[channel]]")[0]
    (tmp_path / "r.toml").write_text("channel = []\n" + empty, encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "x.csv", "--recipe", "r.toml")
    assert ran.returncode == 2
    assert ran.stderr.startswith("becalm: The recipe r.toml is not a valid recipe: channel: ")


@pytest.mark.parametrize("words", [["clean", "in.csv", "-o"], ["tune", "in.csv", "-o"]], ids=["clean", "tune"])
def test_a_name_that_is_too_long_is_said(words: list[str], run: Run, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(column(NOISE), encoding="utf-8")
    ran = run(*words, 260 * "n" + ".csv")
    assert ran.returncode == 2
    assert "is too long; choose a shorter one" in ran.stderr
    assert run("clean", "in.csv", "-o", 245 * "n" + ".csv").stderr == ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["in.csv"]


@pytest.mark.parametrize("stream", ["2", "1"])
def test_a_full_terminal_does_not_end_in_a_traceback(stream: str, drive: Path, tmp_path: Path) -> None:
    command = f"{sys.executable} -m becalm inspect {drive if stream == '1' else 'none.csv'} {stream}>/dev/full"
    ran = subprocess.run(command, shell=True, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert ran.returncode == (2 if stream == "1" else 3)
    assert "Traceback" not in ran.stderr
