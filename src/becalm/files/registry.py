"""Which reader and which writer: by content first, by the ending of the name second."""

from __future__ import annotations

from pathlib import Path

from becalm.errors import OutputError
from becalm.files.csv_reader import read_csv
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable
from becalm.files.text import PARQUET, read_bytes

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
    """Read a file of any known format; its content decides, whatever it is called.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    data = read_bytes(path)
    if data.startswith(PARQUET):
        return read_parquet(path, data)
    return read_csv(path, data)


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
