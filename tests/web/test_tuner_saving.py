"""What a page saves is what the command line gives, to the byte."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from becalm.cleaning.recipe import Recipe
from becalm.files.opening import open_source
from becalm.files.portions import rows_to_tune_on
from becalm.web.tuner.saving import stem_of
from served import PATIENCE_S
from tuner_served import Served, drive_in, served


def becalm(folder: Path, *words: str) -> None:
    found = subprocess.run(
        [sys.executable, "-m", "becalm", *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert found.returncode in (0, 4), found.stderr


def opened(tuner: Served) -> str:
    """Open the test drive, and change a dial; return the recipe."""
    with tuner.talk() as page:
        page.opened("folder/drive.csv")
        page.ask("turn", channel=1, settings={"process_noise_density": 0.25})
        return str(page.until("state", lambda heard: heard.told["changed"]).told["recipe"])


def test_saved_files_are_those_of_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    private = tmp_path / "private"
    private.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(private))
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        told = opened(tuner)
        recipe = client.get("/save/recipe")
        assert recipe.text == told
        assert recipe.headers["content-disposition"] == "attachment; filename*=UTF-8''drive.recipe.toml"
        assert Recipe.from_toml(recipe.text).channel[1].process_noise_density == 0.25
        clean = {ending: client.get(f"/save/clean?format={ending}") for ending in ("csv", "npz")}
        report = client.get("/save/report")
        until = time.monotonic() + PATIENCE_S
        while [path.name for path in private.iterdir()] != [tuner.tuner._shared.uploads.folder.name]:
            assert time.monotonic() < until, "what was made for a download is still there"
            time.sleep(0.01)
    assert not any(private.iterdir())
    (tmp_path / "drive.recipe.toml").write_text(recipe.text)
    words = ["clean", "drive.csv", "--recipe", "drive.recipe.toml", "-o"]
    becalm(tmp_path, *words, "clean.csv")
    assert clean["csv"].content == (tmp_path / "clean.csv").read_bytes()
    assert clean["csv"].headers["content-disposition"].endswith("drive-clean.csv")
    becalm(tmp_path, *words, "clean.npz", "--report", "report.html")
    assert clean["npz"].content == (tmp_path / "clean.npz").read_bytes()
    assert report.content == (tmp_path / "report.html").read_bytes()


def test_an_untouched_recipe_is_that_of_becalm_tune(tmp_path: Path) -> None:
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        with tuner.talk() as page:
            page.opened("folder/drive.csv")
        saved = client.get("/save/recipe").text
    becalm(tmp_path, "tune", "drive.csv", "-o", "R.toml")
    assert saved == (tmp_path / "R.toml").read_text()


def test_what_cannot_be_saved_is_said_in_a_sentence(tmp_path: Path) -> None:
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        for what in ("recipe", "clean", "report"):
            answer = client.get(f"/save/{what}")
            assert answer.status_code == 400
            assert "Nothing is open" in answer.text
        opened(tuner)
        assert "no format 'exe'" in client.get("/save/clean?format=exe").text
        assert "no format './csv'" in client.get("/save/clean?format=../csv").text
        (tmp_path / "drive.csv").unlink()
        answer = client.get("/save/clean?format=csv")
        assert answer.status_code == 400
        assert "drive.csv" in answer.text
        assert "Traceback" not in answer.text


@pytest.mark.parametrize("module", ["becalm", "typer", "csv"])
def test_nothing_in_the_folder_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    drive_in(tmp_path)
    (tmp_path / f"{module}.py").write_text("raise SystemExit('run from the folder')")
    monkeypatch.chdir(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        saved = client.get("/save/clean?format=csv")
    assert saved.text.startswith("time_s,ax,ax_sigma")


def test_a_file_is_brought_opened_and_saved(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "folder", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    content = drive_in(elsewhere).read_bytes()
    with served(folder) as tuner, tuner.client() as client:
        brought = client.put("/files/my drive.csv", content=content).json()["file"]
        with tuner.talk() as page:
            assert [one["name"] for one in page.hear().told["files"]] == ["my drive.csv"]
            assert page.opened(brought)["name"] == "my drive.csv"
        saved = client.get("/save/clean?format=csv")
        assert saved.headers["content-disposition"].endswith("my%20drive-clean.csv")
        assert saved.text.startswith("time_s,ax,ax_sigma")
    assert list(folder.iterdir()) == []


def test_as_much_is_tuned_on_as_the_command_line_does(tmp_path: Path) -> None:
    with open_source(drive_in(tmp_path)) as source:
        assert rows_to_tune_on(source) >= source.rows


@pytest.mark.parametrize(
    ("name", "stem"),
    [("drive.csv", "drive"), ("a.b.mf4", "a.b"), ("drive.csv.gz", "drive"), ("plain", "plain"), (".csv", "recording")],
)
def test_names_are_kept_without_their_format(name: str, stem: str) -> None:
    assert stem_of(Path(name)) == stem
