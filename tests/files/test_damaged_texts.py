"""Tables with texts in them, damaged at random: read or refused in a sentence, never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import BecalmError
from robot_logs import mutant, read_through

ROWS = 40
MUTANTS = 120
TIMES = np.arange(ROWS) / 10
VALUES = np.random.default_rng(4).normal(size=ROWS)
WORDS = [f"état {row % 3}" * (row % 4) for row in range(ROWS)]


def _parquet(path: Path, **how: object) -> None:
    columns = {"time_s": TIMES, "a": VALUES, "note": WORDS, "day": pa.array(WORDS).dictionary_encode()}
    pq.write_table(pa.table(columns), path, row_group_size=16, **how)


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["time_s"], file["a"] = TIMES, VALUES
        file["a"].attrs["unit"] = "m/s^2"
        file.create_dataset("long", data=WORDS, dtype=h5py.string_dtype(), chunks=(8,))
        file.create_dataset("short", data=[word.encode()[:8] for word in WORDS], dtype="S8", compression="gzip")


def _mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        kept = file.create_group("#refs#")
        for name, word in (("p", "left"), ("q", "right")):
            kept[name] = np.array([[ord(letter)] for letter in word], np.uint16)
            kept[name].attrs["MATLAB_class"] = np.bytes_("char")
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        log["t"], log["acc"] = TIMES[None], np.stack([VALUES, -VALUES])
        log["acc_names"] = np.array([[kept["p"].ref, kept["q"].ref]], h5py.ref_dtype).T
        for name, kind in (("t", "double"), ("acc", "double"), ("acc_names", "cell")):
            log[name].attrs["MATLAB_class"] = np.bytes_(kind)
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)


WRITTEN: dict[str, Callable[[Path], None]] = {
    "parquet": lambda path: _parquet(path),
    "plain.parquet": lambda path: _parquet(path, compression="none", use_dictionary=False),
    "h5": _hdf5,
    "mat73": _mat73,
}


def _readable(path: Path) -> bool:
    """Read a file, or be told which it is that cannot be read."""
    try:
        return all(table.num_rows for table in read_through(path))
    except BecalmError as told:
        if not str(told).startswith(str(path)):
            raise
        return False


@pytest.mark.parametrize("name", WRITTEN)
def test_damaged_texts_are_read_or_told(name: str, tmp_path: Path) -> None:
    path = tmp_path / "table.bin"
    WRITTEN[name](path)
    data = path.read_bytes()
    readable = 0
    for seed in range(MUTANTS):
        path.write_bytes(mutant(data, seed))
        readable += _readable(path)
    assert 0 < readable < MUTANTS
