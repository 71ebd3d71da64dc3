"""Read bags of ROS 1 and ROS 2: a file, or the folder that ROS 2 records into."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath
from typing import Any

from becalm.errors import InputError
from becalm.files.groups import tables
from becalm.files.libraries.bounded_file import BoundedFile
from becalm.files.library_reader import LibraryFile
from becalm.files.registry import BAG
from becalm.files.robots import mcap, rosbag1, rosbag2
from becalm.files.robots.topics import Message, collect_groups, shorten_list
from becalm.files.source import RawTable

_MCAP = b"\x89MCAP0\r\n"  # the first bytes of an MCAP file
_BLOCK = 1 << 20  # bytes to unpack at a time


def read(path: Path) -> tuple[RawTable, ...]:
    """Read a bag: a table for each topic.

    Raises
    ------
    InputError
        If it is damaged, or holds no numbers.
    """
    library_file = LibraryFile(path, "ROS bag")
    library_file.library("rosbags.typesys")
    with library_file.explain_damage(), ExitStack() as held:
        parts = _parts(library_file, path, held) if path.is_dir() else [path]
        logs = [_log(library_file, part, held) for part in parts]
        groups = collect_groups(library_file, _all(logs), lambda: _notes(parts, logs))
    return tables(library_file, "rosbag", groups)


def _log(library_file: LibraryFile, part: Path, held: ExitStack) -> Any:
    """Open one file of a bag."""
    file = held.enter_context(part.open("rb"))
    head = file.read(len(_MCAP))
    file.seek(0)
    if head == _MCAP:
        return mcap.McapLog(library_file, BoundedFile(file))
    if head.startswith(b"#ROSBAG"):
        return rosbag1.RosBag1(library_file, BoundedFile(file))
    return held.enter_context(rosbag2.RosBag2(library_file, part))


def _all(logs: list[Any]) -> Iterator[Message]:
    for log in logs:
        yield from log.messages()


def _notes(parts: list[Path], logs: list[Any]) -> tuple[str, ...]:
    if len(parts) == 1:
        notes: tuple[str, ...] = logs[0].notes()
        return notes
    return tuple(f"{part.name}: {note}" for part, log in zip(parts, logs, strict=True) for note in log.notes())


def _parts(library_file: LibraryFile, folder: Path, held: ExitStack) -> list[Path]:
    """Return the files of a folder in the order of recording; compressed files are unpacked first."""
    try:
        listed = library_file.library("ruamel.yaml").YAML(typ="safe").load((folder / BAG).read_text("utf-8"))
        info = listed["rosbag2_bagfile_information"]
        names = [PurePath(name) for name in info["relative_file_paths"]]
    except InputError:
        raise
    except Exception as cause:
        raise InputError(
            f"{folder / BAG} does not list the files of a ROS 2 bag; name one file of the bag instead."
        ) from cause
    if outside := [str(name) for name in names if name.is_absolute() or ".." in name.parts]:
        raise InputError(
            f"{folder / BAG} names {outside[0]}, which is outside of the folder; name one file of the bag instead."
        )
    parts = [folder / name.name for name in names]
    if missing := [part.name for part in parts if not part.is_file()]:
        raise InputError(f"{folder} lacks {shorten_list(missing)}, which its {BAG} names; copy the whole folder.")
    if not parts:
        raise InputError(f"{folder} is a ROS 2 bag without files; copy the whole folder.")
    if str(info.get("compression_mode", "")).lower() == "file":
        return [_unpacked(library_file, part, held) for part in parts]
    return parts


def _unpacked(library_file: LibraryFile, part: Path, held: ExitStack) -> Path:
    """Unpack a file into a temporary folder, and return its path there."""
    plain = (
        Path(held.enter_context(tempfile.TemporaryDirectory(prefix="becalm.", ignore_cleanup_errors=True))) / part.stem
    )
    library = library_file.library("zstandard")
    own, written = LibraryFile(part, "zstd"), 0
    with part.open("rb") as packed, plain.open("wb") as file:
        for block in library.ZstdDecompressor().read_to_iter(packed, write_size=_BLOCK):
            written += len(block)
            own.refuse_claim(written)
            file.write(block)
    return plain
