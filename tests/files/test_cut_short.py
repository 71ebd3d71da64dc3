"""Files of every format that end too early: what is left is the beginning of the whole, and said to be."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from becalm.errors import BecalmError, InputError
from becalm.files.outputs.writing import open_output
from becalm.files.registry import read_tables
from tdms_logs import SIGNAL, WAVE, channel
from tdms_logs import written as tdms
from test_array_dangers import MAKERS
from test_arrays import save_mat73
from test_damaged_logs import LOGS
from test_mf4_damage import rearranged
from test_uff import one_set
from test_uff import written as uff
from test_wav import wav

ROWS = 600
VALUES = 1.5 + np.random.default_rng(2).random((ROWS, 3))
CUTS = (0.03, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.85, 0.9, 0.97, -9, -2, -1)
"""Where files end: after a share of their bytes, or so many before their end."""

Columns = dict[str, list[object]]


def _parquet(path: Path) -> Path:
    pq.write_table(pa.table({"t": np.arange(ROWS) / 10, "a": VALUES[:, 0]}), path, row_group_size=100)
    return path


def _csv(path: Path, packed: bool) -> Path:
    text = "time_s,a,b\n" + "".join(f"{i / 10:.1f},{a:.6f},{b:.6f}\n" for i, (a, b, _) in enumerate(VALUES))
    path.write_bytes(gzip.compress(text.encode(), mtime=0) if packed else text.encode())
    return path


def _mat(path: Path, packed: bool) -> Path:
    arrays = {"t": np.arange(ROWS) / 10, "a": VALUES, "b": VALUES[:, 0]}
    savemat(path, arrays, appendmat=False, do_compression=packed)
    return path


def _mat73(path: Path) -> Path:
    save_mat73(path, {"t": np.arange(ROWS) / 10, "a": VALUES, "b": VALUES[:, 0]})
    return path


def _sound(path: Path) -> Path:
    path.write_bytes(wav((VALUES[:, :2] / 4).astype(np.float32)))
    return path


def _segments(path: Path) -> Path:
    return tdms(path.parent, *[[channel("a", SIGNAL + k, **WAVE), channel("b", SIGNAL - k, **WAVE)] for k in range(7)])


def _made(make: Callable[[Path], object]) -> Callable[[Path], Path]:
    def made(path: Path) -> Path:
        make(path)
        return path

    return made


WRITTEN: dict[str, Callable[[Path], Path]] = {
    **{name: make for name, make in LOGS.items() if name != "json"},
    "mcap-json": LOGS["json"],
    **{name: _made(make) for name, make in MAKERS.items() if not name.endswith(".mat")},
    "plain.mat": lambda path: _mat(path, packed=False),
    "packed.mat": lambda path: _mat(path, packed=True),
    "seven.mat": _mat73,
    "mf4": lambda path: rearranged(path.parent),
    "tdms": _segments,
    "uff-text": lambda path: uff(path.parent, one_set(), one_set(id1="rear", abscissa_spacing=0)),
    "uff-binary": lambda path: uff(path.parent, one_set(binary=1), one_set(binary=1, id1="rear", abscissa_spacing=0)),
    "wav": _sound,
    "plain.csv": lambda path: _csv(path, packed=False),
    "packed.csv": lambda path: _csv(path, packed=True),
    "parquet": _parquet,
}

ENOUGH = {
    "parquet": 1,
    "packed.mat": 1,
    "new.h5": 1,
    "plain.npz": 1,
    "packed.npz": 1,
    "plain.mat": 0.8,
    "ros1-lz4": 0.8,
    "mf4": 0.7,
    "ros2": 0.65,
    "old.h5": 0.6,
}
"""From which share of their bytes on they can be read, of those that hold a thing in one, or tell late where it is."""


def _read(path: Path) -> tuple[list[Columns], str]:
    tables = read_tables(path)
    try:
        said = " ".join(note for table in tables for note in table.notes)
        return [
            {
                name.rpartition("/")[2]: [value for block in table.blocks([name]) for value in block[name].to_pylist()]
                for name in table.names
            }
            for table in tables
        ], said
    finally:
        for table in tables:
            table.rows.close()


def _is_beginning(part: Columns, whole: Columns) -> bool:
    rows = len(next(iter(part.values())))
    return part.keys() <= whole.keys() and all(
        np.array_equal(np.array(values), np.array(whole[name][:rows]), equal_nan=isinstance(values[0], float))
        for name, values in part.items()
    )


def _without_some(part: Columns, whole: Columns) -> bool:
    """Tell whether rows are rows of the whole: SQLite's are not in the order of the file."""
    if part.keys() != whole.keys():
        return False
    rows, all_rows = (zip(*(one[name] for name in part if name != "time_s"), strict=True) for one in (part, whole))
    return set(rows) <= set(all_rows)


@pytest.fixture(scope="module", params=WRITTEN)
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, bytes, list[Columns]]:
    """Return a format, a file in it, and what is in that file."""
    name: str = request.param
    path = WRITTEN[name](tmp_path_factory.mktemp("whole") / f"log.{name.rpartition('.')[2]}")
    return name, path.read_bytes(), _read(path)[0]


@pytest.mark.parametrize("cut", CUTS)
def test_what_is_left_is_the_beginning_and_said_to_be(
    log: tuple[str, bytes, list[Columns]], cut: float, tmp_path: Path
) -> None:
    name, data, whole = log
    path = tmp_path / f"log.{name.rpartition('.')[2]}"
    path.write_bytes(data[: int(len(data) * cut if cut > 0 else cut)])
    if path.stat().st_size <= ENOUGH.get(name, 0.5) * len(data):
        with suppress(BecalmError):
            _expect_the_beginning(path, whole, name)
    elif name == "plain.csv" and data[path.stat().st_size - 1 :][:2].count(b"\n"):
        assert _is_beginning(_read(path)[0][0], whole[0])  # nothing shows that a text had more lines
    else:
        _expect_the_beginning(path, whole, name)


def _expect_the_beginning(path: Path, whole: list[Columns], name: str) -> None:
    parts, said = _read(path)
    for part in parts:
        fits = _without_some if name == "ros2" else _is_beginning
        assert any(fits(part, one) for one in whole), part.keys()
    if parts != whole:
        assert said


@pytest.mark.parametrize("ending", [".h5", ".mf4"])
def test_where_nothing_is_left_the_cut_is_said(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{ending}"
    with open_output(path) as out:
        out.write(pa.table({"time_s": np.arange(ROWS) / 10, "a": VALUES[:, 0]}))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="is cut short, and no rows in it can be read"):
        read_tables(path)
