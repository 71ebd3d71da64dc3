"""Folders of texts: whole, over what was there, beside what is another's, and never half of a new one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from becalm.errors import OutputError
from becalm.files.atomic_file import write_folder

TEXTS = {"one.txt": "one\n", "sub/two.txt": "two\n", "sub/deeper/three.txt": "dreißig\n"}


def found(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes().decode("utf-8")
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_texts_lie_in_their_folders(tmp_path: Path) -> None:
    write_folder(tmp_path / "new" / "out", TEXTS)
    assert found(tmp_path / "new" / "out") == TEXTS


def test_files_of_these_names_are_replaced_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "two.txt").write_text("old, and much longer than what comes\n")
    (tmp_path / "sub" / "mine.txt").write_text("mine\n")
    (tmp_path / "notes").write_text("mine too\n")
    write_folder(tmp_path, TEXTS)
    assert found(tmp_path) == {**TEXTS, "sub/mine.txt": "mine\n", "notes": "mine too\n"}
    write_folder(tmp_path, {"one.txt": "again\n"})
    assert found(tmp_path)["one.txt"] == "again\n"


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine\n")
    with pytest.raises(OutputError, match="cannot be made"):
        write_folder(tmp_path / "taken", TEXTS)
    with pytest.raises(OutputError, match="cannot be made"):
        write_folder(tmp_path, {"one.txt": "one\n", "taken/two.txt": "two\n"})
    assert found(tmp_path) == {"taken": "mine\n"}


def test_where_one_cannot_be_written_none_is_and_none_is_left_half(tmp_path: Path) -> None:
    """A folder has the name of the last of them; those before it keep what was in them."""
    (tmp_path / "one.txt").write_text("old\n")
    (tmp_path / "sub" / "deeper" / "three.txt").mkdir(parents=True)
    with pytest.raises(OutputError, match="is a directory"):
        write_folder(tmp_path, TEXTS)
    assert found(tmp_path) == {"one.txt": "old\n"}


@pytest.mark.parametrize("place", ["", "sub"])
def test_an_unwritable_folder_is_said_and_nothing_is_left(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that refuses new files, which those who run as root cannot make: opening one fails as it would."""
    unwritable, opened = tmp_path / place, Path.open

    def refusing(path: Path, mode: str = "r", *words: object, **more: object) -> object:
        if "x" in mode and path.parent == unwritable:
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, mode, *words, **more)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", refusing)
    with pytest.raises(OutputError, match="may not be written to; choose another folder with -o"):
        write_folder(tmp_path, TEXTS)
    assert found(tmp_path) == {}


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []

    def full(handle: int) -> None:
        synced.append(handle)
        if len(synced) == len(TEXTS):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="is full"):
        write_folder(tmp_path, TEXTS)
    assert found(tmp_path) == {}
