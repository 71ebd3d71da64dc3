"""Reports and figures of a cleaned file: whole or not at all, where they were asked for, and told."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

RECIPE = """
becalm_recipe = 1
[tuned_on]
rate_hz = 100.0
[[channel]]
name = "ramp (m/s)"
unit = "m/s"
model = "motion"
order = 1
process_noise_density = 0.01
noise_std = 0.1
"""
BEGINS = {"png": b"\x89PNG\r\n", "svg": b"<?xml", "pdf": b"%PDF-"}
ENDS = {"png": b"IEND\xaeB`\x82", "svg": b"</svg>", "pdf": b"%%EOF"}


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """Write a recipe, so that nothing need be tuned."""
    path = tmp_path / "r.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return path


def refused(ran: subprocess.CompletedProcess[str], *words: str) -> None:
    assert ran.returncode == 2, ran.stderr
    assert "Traceback" not in ran.stderr
    told = ran.stderr.strip().splitlines()[-1]
    assert told.startswith("becalm: "), told
    assert all(word in told for word in words), told


def without_matplotlib(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which nothing finds matplotlib."""
    (tmp_path / "shadow").mkdir()
    hiding = """
import sys
class Hidden:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == "matplotlib":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden)
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name == "matplotlib" else found(name, package)
"""
    (tmp_path / "shadow" / "sitecustomize.py").write_text(hiding, encoding="utf-8")
    return {"PYTHONPATH": os.pathsep.join([str(tmp_path / "shadow"), os.environ.get("PYTHONPATH", "")])}


def test_a_report_is_written_and_told(run: Run, drive: Path, tmp_path: Path) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--report", "r.html", "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert told["report"] == "r.html"
    assert "figures" not in told
    assert "Wrote r.html." in ran.stderr
    html = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert html.startswith("<!doctype html>")
    assert html.rstrip().endswith("</html>")
    assert (tmp_path / "out.csv.recipe.toml").read_text(encoding="utf-8") in html.replace("&#34;", '"')
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.csv", "out.csv", "out.csv.recipe.toml", "r.html"]


@pytest.mark.parametrize("kind", BEGINS)
def test_figures_are_whole_files_of_their_kind(kind: str, run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="figures are drawn by matplotlib; install becalm[figures]")
    ran = run("clean", drive, "-o", "out.csv", "--recipe", recipe, "--figures", kind, "--json")
    assert ran.returncode in (0, 4), ran.stderr
    folder = tmp_path / json.loads(ran.stdout)["figures"]
    drawn = sorted(folder.iterdir())
    assert f"Drew {len(drawn)} figures into {folder.name}." in ran.stderr
    assert {f"1-ramp-m-s-{name}.{kind}" for name in ("signal", "spectrum", "nis", "step")} <= {
        one.name for one in drawn
    }
    for path in drawn:
        content = path.read_bytes().rstrip()
        assert content.startswith(BEGINS[kind]), path.name
        assert content.endswith(ENDS[kind]), path.name


def test_a_report_is_the_same_each_time_and_cleaning_too(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    written = [tmp_path / f"out.csv{ending}" for ending in ("", ".recipe.toml")]
    run("clean", drive, "-o", "out.csv", "--recipe", recipe)
    without = [path.read_bytes() for path in written]
    for name in ("one.html", "two.html"):
        run("clean", drive, "-o", "out.csv", "--recipe", recipe, "--report", name)
        assert [path.read_bytes() for path in written] == without
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_a_file_whose_name_is_no_text_has_a_report(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    strange = os.fsdecode(b"dr\xefve.csv")
    drive.rename(tmp_path / strange)
    ran = run("clean", strange, "-o", "out.csv", "--recipe", recipe, "--report", "r.html")
    assert ran.returncode in (0, 4), ran.stderr
    assert "Traceback" not in ran.stderr
    assert "<h1>dr" in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--report", "r.pdf"], "--report r.html"),
        (["--report", "report"], "--report report.html"),
        (["--figures", "jpeg"], "--figures png, svg or pdf"),
        (["--report", "none/r.html"], "none"),
        (["--report", "folder.html"], "directory"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_what_cannot_be_is_refused_before_the_work(
    words: list[str], says: str, run: Run, drive: Path, tmp_path: Path
) -> None:
    (tmp_path / "folder.html").mkdir()
    refused(run("clean", drive, "-o", "out.csv", *words), says)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.csv", "folder.html"]


@pytest.mark.parametrize("link", [False, True])
def test_a_report_over_the_input_is_refused(link: bool, run: Run, drive: Path, tmp_path: Path) -> None:
    raw = drive.read_bytes()
    if link:
        (tmp_path / "r.html").symlink_to(drive)
    else:
        drive = drive.rename(tmp_path / "r.html")
    refused(run("clean", drive, "-o", "out.csv", "--report", "r.html"), "r.html is the input itself", "--report")
    assert drive.read_bytes() == raw
    assert not (tmp_path / "out.csv").exists()


def test_a_report_over_the_output_is_refused(run: Run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "r.html").symlink_to("out.csv")
    refused(run("clean", drive, "-o", "out.csv", "--report", "r.html"), "is the output too")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("given", [True, False])
def test_a_report_over_a_recipe_is_refused(given: bool, run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    if given:
        recipe = recipe.rename(tmp_path / "r.html")
    else:
        (tmp_path / "r.html").symlink_to("out.csv.recipe.toml")
    refused(run("clean", drive, "-o", "out.csv", "--recipe", recipe, "--report", "r.html"), "r.html", "recipe")
    assert recipe.read_text(encoding="utf-8") == RECIPE
    assert not (tmp_path / "out.csv").exists()


def test_a_folder_that_may_not_be_written_to_is_named(run: Run, drive: Path) -> None:
    refused(run("clean", drive, "-o", "out.csv", "--report", "/proc/r.html"), "/proc")


def test_figures_where_a_file_is_are_refused_before_the_work(run: Run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "out.csv.figures").write_text("mine", encoding="utf-8")
    refused(run("clean", drive, "-o", "out.csv", "--figures", "svg"), "out.csv.figures", "-o")
    assert (tmp_path / "out.csv.figures").read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / "out.csv").exists()


def test_without_matplotlib_figures_are_refused_and_a_report_is_not(
    run: Run, drive: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in without_matplotlib(tmp_path).items():
        monkeypatch.setenv(name, value)
    refused(run("clean", drive, "-o", "out.csv", "--figures", "svg"), "pip install 'becalm[figures]'")
    assert not (tmp_path / "out.csv").exists()
    ran = run("clean", drive, "-o", "out.csv", "--recipe", recipe, "--report", "r.html")
    assert ran.returncode in (0, 4), ran.stderr
    html = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "data-svg=" not in html
    assert "1-ramp-m-s-signal" in html


def test_a_disk_too_full_for_the_report_leaves_no_half_of_it(
    run: Run, drive: Path, recipe: Path, tmp_path: Path
) -> None:
    def small_files_only() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    before = {"drive.csv", "r.toml"}
    ran = run("clean", drive, "-o", "out.csv", "--recipe", recipe, "--report", "r.html", preexec_fn=small_files_only)
    refused(ran, "r.html was not written")
    assert {path.name for path in tmp_path.iterdir()} == before | {"out.csv", "out.csv.recipe.toml"}
    assert "Wrote out.csv" in ran.stderr, "what was written before is told, and whole"


SLEEPY = """
import time
import becalm.report.page as page
from becalm.cli.main import main
def slowly(*words):
    print("drawing", flush=True)
    time.sleep(60)
page.page_of = slowly
main()
"""


def test_a_signal_while_drawing_leaves_no_half_of_a_report(drive: Path, recipe: Path, tmp_path: Path) -> None:
    """Other signals, and signals while cleaning, are in test_interruptions.py."""
    words = ["clean", str(drive), "-o", "out.csv", "--recipe", str(recipe), "--report", "r.html"]
    process = subprocess.Popen(
        [sys.executable, "-c", SLEEPY, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "drawing\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 128 + signal.SIGTERM, said
    assert said.endswith("becalm: Stopped; nothing half-written is left.\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.csv", "out.csv", "out.csv.recipe.toml", "r.toml"]


def test_figures_of_an_older_run_are_told(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    folder = tmp_path / "o.csv.figures"
    folder.mkdir()
    (folder / "9-other-signal.svg").write_text("old", encoding="utf-8")
    asked = ("clean", str(drive), "-o", str(tmp_path / "o.csv"), "--recipe", str(recipe), "--figures", "svg")
    ran = run(*asked)
    assert f"1 more files in {folder} are not from this run" in ran.stderr
    (folder / "9-other-signal.svg").unlink()
    assert "not from this run" not in run(*asked).stderr, "its own are written anew"
