"""Which reader and which writer: by content first, by the ending of the name second."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from becalm.errors import OutputError
from becalm.files.csv_reader import read_csv
from becalm.files.csv_spool import spool_csv
from becalm.files.identity import Original
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable
from becalm.files.text import PARQUET, read_bytes, told
from becalm.files.text_blocks import is_large

CSV, CSV_GZ, PARQUET_FORMAT = "csv", "csv.gz", "parquet"

ENDINGS: dict[str, str] = {
    ".csv": CSV,
    ".txt": CSV,
    ".csv.gz": CSV_GZ,
    ".txt.gz": CSV_GZ,
    ".parquet": PARQUET_FORMAT,
    ".pq": PARQUET_FORMAT,
}
"""What the ending of an output's name asks for."""


def read_raw(path: Path) -> RawTable:
    """Look into a file of any known format; its content decides, whatever it is called.

    Raises
    ------
    InputError
        If it cannot be read, or changes meanwhile.
    """
    with told(path):
        once = not path.is_file()  # a pipe; or nothing
    if once:
        data = read_bytes(path)
        return read_parquet(path, data) if data.startswith(PARQUET) else read_csv(path, data)
    original = Original(path)
    try:
        return replace(_read_again_and_again(path, original), original=original)
    finally:
        original.refuse_changed()


def _read_again_and_again(path: Path, original: Original) -> RawTable:
    head = read_bytes(path, len(PARQUET))
    if head.startswith(PARQUET):
        return read_parquet(path, original)
    return spool_csv(path) if is_large(path, head) else read_csv(path, read_bytes(path))


def format_to_write(path: Path) -> str:
    """Return the format that an output's name asks for.

    Raises
    ------
    OutputError
        If no format has that ending.
    """
    name = path.name.lower()
    for ending in sorted(ENDINGS, key=len, reverse=True):
        if name.endswith(ending):
            return ENDINGS[ending]
    raise OutputError(f"{path} has an unknown ending {path.suffix!r}; end the name in .csv, .csv.gz or .parquet.")
