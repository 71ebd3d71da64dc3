"""What a page saves is what the command line gives, to the byte."""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from pathlib import Path

import pytest

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import OutputError
from becalm.files import registry
from becalm.files.outputs.writing import write
from becalm.files.read_options import ReadOptions
from becalm.web.access import LOOPBACK
from becalm.web.tuner import saving
from forked import command
from served import PATIENCE_S, TOKEN, until
from tuner_served import Served, drive, drive_in, served


def becalm(folder: Path, *words: str) -> None:
    found = command(words, folder, dict(os.environ))
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
        kept = [tuner.tuner._shared.uploads.folder.name]
        until(lambda: [path.name for path in private.iterdir()] == kept)  # what was made for a download goes
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


@pytest.mark.parametrize("said", ["on the page", "at the command line"])
def test_a_file_without_times_has_the_rate_that_is_said(said: str, tmp_path: Path) -> None:
    file = tmp_path / "timeless.csv"
    file.write_text("ax\n" + "".join(f"{0.5 + value:.4f}\n" for value in drive().samples[:800, 0]), encoding="utf-8")
    first = (file, ReadOptions(rate_hz=250.0)) if said == "at the command line" else (None, ReadOptions())
    with served(tmp_path, *first) as tuner, tuner.client() as client:
        with tuner.talk() as page:
            if said == "on the page":
                page.ask("open", file="folder/timeless.csv")
                assert "the rate (Hz) below to count rows" in page.until("trouble").told["says"]
                page.ask("open", file="folder/timeless.csv", rate_hz=250)
            recording = page.until("recording").told
            assert (recording["rate_hz"], recording["rate_said_hz"]) == (250.0, 250.0)
            page.until("picture")
        saved, clean = client.get("/save/recipe").text, client.get("/save/clean").content
    becalm(tmp_path, "tune", "timeless.csv", "--rate", "250", "-o", "R.toml")
    assert saved == (tmp_path / "R.toml").read_text()
    becalm(tmp_path, "clean", "timeless.csv", "--recipe", "R.toml", "-o", "clean.csv")
    assert clean == (tmp_path / "clean.csv").read_bytes()


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


def test_what_changed_since_it_was_opened_is_not_saved(tmp_path: Path) -> None:
    path = drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        written = path.stat().st_mtime
        write(path, drive(seed=2))
        os.utime(path, (written + 1, written + 1))
        for what in ("clean", "report"):
            answer = client.get(f"/save/{what}")
            assert answer.status_code == 400
            assert answer.text == "drive.csv changed since it was opened; open it again."
        with tuner.talk() as page:
            page.opened("folder/drive.csv")
            until(lambda: client.get("/save/clean").status_code == 200)  # it is told first of what was open before


def test_a_report_needs_no_library_of_other_formats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    for name in registry._WRITTEN_BY.values():
        (blocked / f"{name}.py").write_text("raise ModuleNotFoundError(name=__name__)")
    monkeypatch.setattr(registry, "find_spec", lambda name: None)
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        monkeypatch.setenv("PYTHONPATH", f"{blocked}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        assert client.get("/save/report").status_code == 200
        told = client.get("/save/clean?format=h5").text
        assert told == "becalm: Writing HDF5 needs h5py. Type: pip install 'becalm[formats]'"
        with tuner.talk() as page:
            saves = page.hear().told["saves"]
    assert set(saves) == {".csv", ".txt", ".csv.gz", ".txt.gz", ".mat", ".npz", ".parquet", ".pq"}


NEVER_ENDS = (
    "import os, time; open('pid.new', 'w').write(str(os.getpid())); os.rename('pid.new', 'pid'); time.sleep(600)"
)


def test_saves_go_one_after_another_and_end_when_nobody_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    private = tmp_path / "private"
    private.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(private))
    monkeypatch.setattr(saving, "MODULE", (sys.executable, "-P", "-c", NEVER_ENDS))
    drive_in(tmp_path)

    def ask(tuner: Served) -> socket.socket:
        link = socket.create_connection((LOOPBACK, tuner.access.port), PATIENCE_S)
        asked = f"GET /save/clean HTTP/1.1\r\nHost: {LOOPBACK}:{tuner.access.port}\r\n"
        link.sendall(f"{asked}Cookie: {tuner.access.cookie}={TOKEN}\r\n\r\n".encode())
        return link

    def written(path: Path) -> str:
        try:
            return path.read_text()
        except FileNotFoundError:
            return ""

    def is_gone(process: int) -> bool:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        return False

    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        processes = []
        with ask(tuner) as first:
            until(lambda: len([*private.glob("*/pid")]) == 1)
            with ask(tuner) as second:
                assert client.get("/save/recipe").status_code == 200  # which is answered after the second came
                assert len([*private.glob("*/recipe.toml")]) == 1
                processes.append(int(next(private.glob("*/pid")).read_text()))
                first.close()
                until(lambda: is_gone(processes[0]))
                until(lambda: any(written(path) not in ("", str(processes[0])) for path in private.glob("*/pid")))
                until(lambda: len([*private.glob("*/pid")]) == 1)  # that of the first goes a moment after it
                processes.append(int(next(private.glob("*/pid")).read_text()))
                second.close()
        until(lambda: is_gone(processes[1]) and not any(private.glob("*/recipe.toml")))
    assert processes[0] != processes[1]


def test_a_save_without_a_place_for_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
        answer = client.get("/save/report")
    assert answer.status_code == 400
    assert answer.text.startswith("drive-report.html cannot be made (No such file or directory); free space")
    assert caplog.text == ""


def test_why_a_file_that_changed_while_it_was_saved_is_not_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def change(*_: object) -> None:
        (tmp_path / "drive.csv").write_text("time,x\n0,0\n1,1\n")
        raise OutputError("The recipe names 'ax', which is not a column.")

    monkeypatch.setattr(saving, "_run", change)
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        assert client.get("/save/clean").text == "drive.csv changed since it was opened; open it again."


def test_what_is_told_of_a_save_names_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuses = "import sys; sys.exit(f'{sys.argv[3]} and {sys.argv[5]} are none')"
    monkeypatch.setattr(saving, "MODULE", (sys.executable, "-P", "-c", refuses))
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.client() as client:
        opened(tuner)
        assert client.get("/save/clean").text == "drive.csv and drive-clean.csv are none"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are texts")
def test_a_name_that_is_no_text_is_saved_as_it_is(tmp_path: Path) -> None:
    name = os.fsdecode(b"m\xfcll.csv")
    drive_in(tmp_path, name)
    with served(tmp_path) as tuner, tuner.client() as client:
        with tuner.talk() as page:
            page.opened("folder/m\ufffdll.csv")
        for what, called in (("recipe", "m%FCll.recipe.toml"), ("clean", "m%FCll-clean.csv")):
            answer = client.get(f"/save/{what}")
            assert answer.status_code == 200, answer.text
            assert answer.headers["content-disposition"].endswith(called)
