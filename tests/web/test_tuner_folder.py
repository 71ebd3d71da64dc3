"""Which files a page may open: those of its folder, and no way leads out of it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from becalm.errors import InputError
from becalm.web.tuner.folder import Folder
from tuner_served import ROWS, drive_in, served


def names(folder: Folder) -> list[str]:
    return [str(one.as_dict()["name"]) for one in folder.openable_files()]


@pytest.fixture
def chosen(tmp_path: Path) -> Path:
    """A folder with recordings, and beside it what nobody may see."""
    folder = tmp_path / "folder"
    (folder / "inside").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("secret")
    for name in ("b.csv", "a.MF4", ".hidden.csv", "notes.md", "x.recipe.toml", "inside/c.csv"):
        (folder / name).write_text("1")
    (folder / "leads-out.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "round.csv").symlink_to(folder / "round.csv")
    (folder / "other-name.csv").symlink_to(folder / "b.csv")
    os.mkfifo(folder / "pipe.csv")
    (folder / "bag").mkdir()
    (folder / "bag" / "metadata.yaml").write_text("1")
    return folder


def test_a_folder_lists_recordings_only(chosen: Path) -> None:
    assert names(Folder(chosen, None)) == ["a.MF4", "b.csv", "bag", "other-name.csv"]


@pytest.mark.parametrize(
    "asked",
    [
        "folder/leads-out.csv",
        "folder/../secret.csv",
        "folder/inside/c.csv",
        "folder/.hidden.csv",
        "folder/pipe.csv",
        "folder/",
        "folder/.",
        "../secret.csv",
        "given/b.csv",
        "brought/b.csv",
        "b.csv",
        "folder/b.csv\0",
        "folder//etc/passwd",
        "folder/\0.csv",
        "folder/\ud800.csv",
        "folder/inside/../b.csv",
        "folder/./b.csv",
    ],
)
def test_no_name_leads_out(chosen: Path, asked: str) -> None:
    with pytest.raises(InputError, match="no longer exists"):
        Folder(chosen, None).path_of(asked)


def test_one_file_is_found_without_a_look_at_the_others(chosen: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Folder(chosen, None)

    def listed(_: Path) -> None:
        raise AssertionError("the whole folder was listed")

    monkeypatch.setattr(Path, "iterdir", listed)
    assert folder.path_of("folder/b.csv") == chosen / "b.csv"
    assert folder.path_of("folder/bag") == chosen / "bag"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are texts")
def test_a_name_that_is_no_text_is_found(chosen: Path) -> None:
    odd = chosen / os.fsdecode(b"\xff.csv")
    odd.write_text("1")
    assert Folder(chosen, None).path_of("folder/\ufffd.csv") == odd


def test_a_link_that_is_changed_meanwhile_leads_nowhere(chosen: Path, tmp_path: Path) -> None:
    folder = Folder(chosen, None)
    assert folder.path_of("folder/b.csv") == chosen / "b.csv"
    (chosen / "b.csv").unlink()
    (chosen / "b.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError):
        folder.path_of("folder/b.csv")


def test_the_file_that_was_named_comes_first_wherever_it_is(chosen: Path, tmp_path: Path) -> None:
    folder = Folder(chosen, tmp_path / "secret.csv")
    assert names(folder)[0] == "secret.csv"
    assert folder.first is not None
    assert folder.path_of(folder.first) == tmp_path / "secret.csv"
    inside = Folder(chosen, chosen / "b.csv")
    assert names(inside).count("b.csv") == 1


def test_what_is_brought_is_kept_apart(chosen: Path, tmp_path: Path) -> None:
    folder = Folder(chosen, None)
    for room in ("one", "two"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "b.csv").write_text(room)
    first, second = (folder.add_uploaded(tmp_path / room / "b.csv") for room in ("one", "two"))
    assert folder.path_of(first).read_text() == "one"
    assert folder.path_of(second).read_text() == "two"
    assert folder.path_of("folder/b.csv").read_text() == "1"


@pytest.mark.parametrize("name", ["..%2fout.csv", "%2e%2e/out.csv", "a%2fb.csv", "%00.csv", "a%5cb.csv", "x" * 300])
def test_what_is_brought_under_a_name_that_leads_elsewhere_is_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    content = drive_in(tmp_path).read_bytes()
    before = sorted(tmp_path.rglob("*"))
    with served(folder) as tuner, tuner.client() as client:
        assert client.put(f"/files/{name}", content=content).status_code in (400, 404, 405)
        assert tuner.tuner._shared.folder.openable_files() == []
        assert list(tuner.tuner._shared.uploads.folder.rglob("*")) == []
    assert sorted(tmp_path.rglob("*")) == before


def test_files_that_came_meanwhile_are_told_and_refused_by_name(tmp_path: Path) -> None:
    with served(tmp_path) as tuner, tuner.talk() as page:
        assert page.hear().told["files"] == []
        (tmp_path / "broken.csv").write_bytes(b"\x00\x01 nothing")
        page.ask("files")
        files = page.until("files").told["files"]
        assert [one["name"] for one in files] == ["broken.csv"]
        with tuner.talk() as other:
            other.ask("files")
            other.until("files")  # from here on it is told what others do
            number = page.ask("open", file=files[0]["id"])
            told = [other.until("working").told["says"]]
            while told[-1]:  # a page that hears late hears only the newest
                told.append(other.until("working").told["says"])
            assert told in (["Reading broken.csv ...", ""], [""]), "it does not wait for what will not come"
        trouble = page.until("trouble").told
        assert trouble["answers"] == number
        assert trouble["says"].startswith("broken.csv")
        assert str(tmp_path) not in trouble["says"]


def test_what_was_opened_and_is_another_file_now_is_opened_anew(tmp_path: Path) -> None:
    file = drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as page:
        assert page.opened("folder/drive.csv")["rows"] == ROWS
        written = file.stat().st_mtime_ns
        file.write_text("".join(file.read_text().splitlines(keepends=True)[: ROWS // 2 + 1]))
        os.utime(file, ns=(written, written))
        assert page.opened("folder/drive.csv")["rows"] == ROWS // 2


def test_nothing_is_open_at_first(tmp_path: Path) -> None:
    with served(tmp_path) as tuner, tuner.talk() as page:
        page.ask("look", channel=0, width=10)
        assert "Nothing is open" in page.until("trouble").told["says"]
