"""What becalm reads and writes: every format, every real file, and the units that it understands.

Run: python docs/formats.py [-o docs/formats.md] [FILE ...]   (needs Linux, and `pip install 'becalm[formats]'`)
The recordings are in ../shared/data; with arguments, only files whose path contains one of them are processed.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import NamedTuple
from unittest.mock import patch

import pyarrow as pa
from format_files import files_table, table
from format_samples import SAMPLES, UNIT, Sample
from format_units import units_table
from real_recordings import DATA

from becalm.errors import BecalmError
from becalm.files import registry
from becalm.files.inputs.time_bases import open_file
from becalm.files.libraries import library_process
from becalm.files.library_reader import LibraryFile
from becalm.files.source import RawTable

IDE = "endaq/test1.IDE"

_FEW = 20_000  # rows of a small file
_VALUE = 8  # bytes of a value in float64
_KEPT = 0.4  # share of the bytes that remain of a truncated file


class ReadResult(NamedTuple):
    """The result of reading a file: number of values, first unit, kind of time, notes, and the libraries used."""

    values: int
    unit: str
    time: str
    notes: tuple[str, ...]
    libraries: tuple[str, ...]


def read(path: Path) -> ReadResult:
    """Open a file, and record which libraries becalm loads for it."""
    with _recorded_libraries() as loaded, open_file(path) as opened:
        sources = opened.sources
        notes = dict.fromkeys(note for source in sources for note in source.notes)
        kind = sources[0].layout.as_dict()["time_kind"]
        return ReadResult(
            sum(source.rows * len(source.names) for source in sources),
            sources[0].units[0],
            "its own rate" if kind == "rate in the file" else "stamps",
            tuple(notes),
            tuple(dict.fromkeys(loaded)),
        )


@contextmanager
def _recorded_libraries() -> Iterator[list[str]]:
    """Record the names of the libraries that becalm loads."""
    loaded: list[str] = []
    theirs = LibraryFile.library

    def library(self: LibraryFile, module: str) -> ModuleType:
        loaded.append(module.partition(".")[0])
        return theirs(self, module)

    with patch.object(LibraryFile, "library", library), _in_this_process():
        yield loaded


@contextmanager
def _in_this_process() -> Iterator[None]:
    """Read formats of other libraries in this process, to measure its memory and to record the libraries."""

    def read_here(module: str, path: Path) -> tuple[RawTable, ...]:
        tables: tuple[RawTable, ...] = import_module(module).read(path)
        return tables

    with patch.object(library_process, "read_in_subprocess", read_here):
        yield


def held_bytes(small: Path, large: Path) -> int:
    """Return by how many bytes memory grows when a large file is opened; reading a small file first loads libraries."""
    read(small)
    before = _memory_bytes()
    with _in_this_process(), open_file(large):
        return _memory_bytes() - before


def _memory_bytes() -> int:
    """Return the anonymous memory of the process in bytes, after it has released memory that it does not use."""
    gc.collect()
    pa.default_memory_pool().release_unused()
    ctypes.CDLL(None).malloc_trim(0)
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(re.search(r"RssAnon:\s+(\d+)", status)[1])  # type: ignore[index]


def format_row(sample: Sample) -> list[str]:
    """Return the row of the table for one format."""
    print(sample.name, file=sys.stderr)
    with TemporaryDirectory() as folder:
        small = sample.make(Path(folder) / f"small{sample.endings[0]}", _FEW)
        found = read(small)
        large = sample.make(Path(folder) / f"large{sample.endings[0]}", sample.many)
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            share = executor.submit(held_bytes, small, large).result() / (_VALUE * 4 * sample.many)
        cut = _cut(small, found)
    return [
        sample.name,
        ", ".join(sample.endings),
        ", ".join(found.libraries),
        _written(sample),
        found.time,
        "yes" if found.unit == UNIT else "no",
        f"{'in blocks' if share < 0.5 else 'in memory'} ({max(share, 0.0):.0%})",
        cut,
    ]


def _written(sample: Sample) -> str:
    """Return whether becalm writes the format, and several sampling rates in one file."""
    form = registry.ENDINGS.get(sample.endings[0])
    if form is None or sample.name == "MAT 7.3":
        return "no"
    return "yes, several rates" if registry.stores_several_times(form) else "yes"


def _cut(path: Path, before: ReadResult) -> str:
    """Truncate a file, and return a sentence on what is read of it."""
    whole = path.read_bytes()
    path.write_bytes(whole[: int(_KEPT * len(whole))])
    try:
        found = read(path)
    except BecalmError as refusal:
        return f"refused: {_plain(str(refusal), path)}"
    notes = [text for text in found.notes if text not in before.notes]
    return f"{found.values / before.values:.0%} of the values: {_plain(notes[0], path) if notes else 'nothing said'}"


def _plain(text: str, path: Path) -> str:
    return text.replace(f"{path}: ", "").replace(str(path), "it").replace("|", "\\|")


def formats() -> str:
    """Return the table of formats."""
    rows = [format_row(sample) for sample in SAMPLES]
    with TemporaryDirectory() as folder:
        real = Path(folder) / "real.ide"
        real.write_bytes((DATA / IDE).read_bytes())
        found = read(real)
        unit = "yes" if found.unit else "no"
        cut = _cut(real, found)
        rows.append(["enDAQ IDE", ".ide", ", ".join(found.libraries), "no", found.time, unit, "not measured", cut])
    heads = ["format", "names end in", "libraries", "written", "time", "unit", "held", "cut off"]
    return table(heads, rows)


def page(words: list[str]) -> str:
    """Return the whole page."""
    measured = formats()
    texts = [_FORMATS, measured, _UNITS, units_table(), _FILES, files_table(words)]
    return "\n".join(text.rstrip() + "\n" for text in texts)


def main() -> None:
    """Print the page; with -o, write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("-o", "--output", type=Path, help="page to write")
    parser.add_argument("words", nargs="*", help="part of a path; all files by default")
    arguments = parser.parse_args()
    output: Path | None = arguments.output
    text = page(arguments.words)
    print(text)
    if output:
        output.write_text(text, encoding="utf-8")


_FORMATS = f"""# Formats and units

Written by `docs/formats.py`. The first bytes of a file decide its format, whatever its name. CSV, Parquet, MAT (except
7.3), NPZ and WAV need no further library; the other formats need `pip install 'becalm[formats]'`. Channels with
different times form groups: `becalm clean` cleans all groups of a file into one `.h5`, `.mat`, `.mf4`, `.npz` or
`.tdms`, and `--group NAME` chooses one group for a `.csv` or `.parquet`. A folder of Parquet files is one recording, in
the order of time ([over a fleet](fleet.md#the-lake) has the rules).

Each format holds the same recording here: four channels in {UNIT} at 1000 Hz. *libraries* are those that becalm
loaded to read it, besides NumPy and pyarrow; *time* is a sampling rate in the file, or stamps; *unit* is whether the
file contains the unit. *held* is the growth of memory when a large file is opened, as a share of the size of its
values in float64: if the share is below one half, the format is read in blocks, and values stay in the file until
they are needed. *cut off* is what becalm reads of the first {_KEPT:.0%} of the file's bytes, and its first note.
"""

_UNITS = """## Units

The unit of a channel comes from its header, from a row below the header, or from the metadata of the file;
`--unit NAME=UNIT` converts the channel to another unit, or gives the unit if the file does not. `--sensors S.toml`
converts volts to units, with the calibration's uncertainty ([conventions](conventions.md)).
"""

_FILES = """## Real files

Real recordings, inspected by `becalm inspect` and cleaned by `becalm clean FILE -o out.h5`, with no other options than
those in the column *asked*. *verdicts* counts the verdicts on the channels; if the model of one does not fit, the exit
code is 4, but the output is written.
"""


if __name__ == "__main__":
    main()
