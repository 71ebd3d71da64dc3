"""Libraries read in a process of their own: what a file does to it, becalm survives, and says."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import import_module
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pyarrow as pa
import pytest

from becalm.errors import InputError
from becalm.files.libraries import library_process
from becalm.files.libraries.library_process import read_in_subprocess
from becalm.files.libraries.library_server import _Server
from becalm.files.registry import read_tables
from mdf_logs import SIGNAL
from mdf_logs import signal as mdf_signal
from mdf_logs import written as mdf
from tdms_logs import channel
from tdms_logs import written as tdms
from test_damaged_logs import LOGS
from test_uff import one_set
from test_uff import written as uff

READER = '''
"""A reader whose library misbehaves in the way that the file says."""
import ctypes, os, sys, time
import numpy as np, pyarrow as pa
from becalm.files.column_statistics import Column
from becalm.files.groups import Group, tables
from becalm.files.library_reader import LibraryFile

def misbehave(how):
    print("a library prints", flush=True)
    print("and complains", file=sys.stderr, flush=True)
    if how == "crash":
        ctypes.string_at(0)
    if how == "exit":
        os._exit(7)
    if how == "hang":
        time.sleep(600)
    if how == "fill":
        np.ones(1 << 40)

def read(path):
    opening, reading = path.read_text().split()
    misbehave(opening)
    def rows(first, last):
        if first or not reading.startswith("later-"):
            misbehave(reading.removeprefix("later-"))
        return np.arange(first, last)
    foreign = LibraryFile(path, "TEST")
    return tables(foreign, "test", [Group("", {"a": Column(pa.int64(), rows), "b": Column.of(np.arange(10))}, 10)])
'''

SAYS = {
    "crash": "its library crashed (signal 11)",
    "exit": "its library crashed (exit code 7)",
    "hang": "was not read within 2 s",
    "fill": "needs too much memory",
}


def _array(path: Path, values: list[float]) -> Path:
    with h5py.File(path, "w") as file:
        file["x"] = values
    return path


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "misbehaving.py").write_text(READER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(library_process, "LONGEST_S", 2.0)
    monkeypatch.chdir(tmp_path)
    library_process._end_idle()  # a process that is kept does not know the folder
    return "misbehaving"


@pytest.mark.parametrize("how", SAYS)
def test_a_library_that_misbehaves_when_it_opens_a_file(how: str, reader: str) -> None:
    Path("a.test").write_text(f"{how} not")
    with pytest.raises(InputError) as caught:
        read_in_subprocess(reader, Path("a.test"))
    assert str(caught.value).startswith("a.test ")
    assert SAYS[how] in str(caught.value)
    assert caught.value.exit_code == 3
    Path("a.test").write_text("not not")
    assert len(read_in_subprocess(reader, Path("a.test"))) == 1


@pytest.mark.parametrize("how", SAYS)
def test_a_library_that_misbehaves_when_it_reads_rows(how: str, reader: str) -> None:
    Path("a.test").write_text(f"not {how}")
    (table,) = read_in_subprocess(reader, Path("a.test"))
    with pytest.raises(InputError) as caught:
        list(table.blocks(["a"]))
    assert SAYS[how] in str(caught.value)
    table.rows.close()


@pytest.mark.parametrize("how", ["crash", "hang"])
def test_the_next_file_is_not_blamed(how: str, reader: str) -> None:
    Path("bad.test").write_text(f"not later-{how}")
    (table,) = read_in_subprocess(reader, Path("bad.test"))
    assert next(iter(table.blocks(["a", "b"], 0, 5)))["a"].to_pylist() == [0, 1, 2, 3, 4]
    table.rows.close()  # while the process reads ahead
    Path("good.test").write_text("not not")
    (table,) = read_in_subprocess(reader, Path("good.test"))
    assert next(iter(table.blocks(["a"])))["a"].to_pylist() == list(range(10))
    table.rows.close()


def test_an_error_ahead_is_no_answer() -> None:
    def blocks(*_: object) -> Iterator[pa.Table]:
        yield pa.table({"a": [1]})
        raise RuntimeError

    answers = BytesIO()
    server = _Server(answers)
    server._tables = (SimpleNamespace(rows=SimpleNamespace(blocks=blocks)),)  # type: ignore[assignment]
    server.answer({"table": 0, "names": ["a"], "most": 1, "start": 0})
    assert b"error" not in answers.getvalue()


def test_an_interrupted_read_leaves_no_answer_for_the_next(reader: str) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    Path("slow.test").write_text("hang not")
    Path("good.test").write_text("not not")
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            read_in_subprocess(reader, Path("slow.test"))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    (table,) = read_in_subprocess(reader, Path("good.test"))
    table.rows.close()


def test_a_closed_table_is_refused(tmp_path: Path) -> None:
    (table,) = read_tables(_array(tmp_path / "a.h5", [1.0, 2.0]))
    table.rows.close()
    read_tables(_array(tmp_path / "b.h5", [3.0, 4.0]))[0].rows.close()
    with pytest.raises(InputError, match="is closed"):
        list(table.blocks(["x"]))


def test_what_a_library_prints_is_not_seen(reader: str, capfd: pytest.CaptureFixture[str]) -> None:
    Path("a.test").write_text("not not")
    (table,) = read_in_subprocess(reader, Path("a.test"))
    assert [value for block in table.blocks(["a"], 3, 2) for value in block["a"].to_pylist()] == list(range(3, 10))
    assert capfd.readouterr() == ("", "")


def test_files_that_are_open_together_and_closed_in_any_order(tmp_path: Path) -> None:
    paths = [_array(tmp_path / f"{number}.h5", [number] * 5) for number in range(4)]
    (first,), (second,) = read_tables(paths[0]), read_tables(paths[1])
    first.rows.close()
    first.rows.close()
    (third,) = read_tables(paths[2])
    for number, table in ((1, second), (2, third)):
        assert [block["x"].to_pylist() for block in table.blocks(["x"], 0, 3)] == [[number] * 3, [number] * 2]
        table.rows.close()


def test_the_same_process_reads_the_next_file(tmp_path: Path) -> None:
    used = set()
    for number in range(3):
        (table,) = read_tables(_array(tmp_path / f"{number}.h5", [1.0, 2.0]))
        used.add(table.rows._opened._process._process.pid)  # type: ignore[attr-defined]
        table.rows.close()
    assert len(used) == 1


def test_blocks_of_several_threads_do_not_mix(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for number in range(4):
            file[f"x{number}"] = number + np.zeros(5000)
    (table,) = read_tables(tmp_path / "a.h5")
    found: dict[int, set[float]] = {}

    def read(number: int) -> None:
        found[number] = {value for block in table.blocks([f"x{number}"], 0, 100) for value in block[0].to_pylist()}

    threads = [threading.Thread(target=read, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    table.rows.close()
    assert found == {number: {float(number)} for number in range(4)}


def test_a_process_that_forked_has_one_of_its_own(tmp_path: Path) -> None:
    (table,) = read_tables(_array(tmp_path / "a.h5", [1.0, 2.0, 3.0]))
    table.rows.close()
    (kept,) = read_tables(tmp_path / "a.h5")
    child = os.fork()
    if not child:
        with pytest.raises(InputError, match="forked"):
            list(kept.blocks(["x"]))
        (other,) = read_tables(tmp_path / "a.h5")
        right = next(iter(other.blocks(["x"])))["x"].to_pylist() == [1.0, 2.0, 3.0]
        other.rows.close()
        library_process._end_idle()
        os._exit(0 if right else 1)
    assert os.waitpid(child, 0)[1] == 0
    kept.rows.close()
    (again,) = read_tables(tmp_path / "a.h5")
    assert next(iter(again.blocks(["x"])))["x"].to_pylist() == [1.0, 2.0, 3.0]
    again.rows.close()


FILES: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "asammdf": ("recorders.mf4", lambda folder: mdf(folder, [mdf_signal("a", SIGNAL)])),
    "h5py": ("arrays.hdf5", lambda folder: _array(folder / "a.h5", [1.0, 2.0])),
    "idelib.importer": ("recorders.ide", lambda folder: LOGS["ide"](folder / "a.ide")),
    "mcap.stream_reader": ("robots.mcap", lambda folder: LOGS["json"](folder / "a.mcap")),
    "nptdms": ("recorders.tdms", lambda folder: tdms(folder, [channel("a", SIGNAL, wf_increment=0.01)])),
    "pyuff": ("recorders.uff", lambda folder: uff(folder, one_set())),
    "pyulog": ("robots.ulog", lambda folder: LOGS["ulog"](folder / "a.ulg")),
    "rosbags.typesys": ("robots.rosbag", lambda folder: LOGS["ros1"](folder / "a.bag")),
}


@pytest.mark.parametrize("library", FILES)
def test_a_missing_library_is_named(library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module, write = FILES[library]
    path = write(tmp_path)
    read = import_module(f"becalm.files.{module}").read
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=rf"is read by {library.partition('.')[0]}.*pip install 'becalm\[formats\]'"):
        read(path)
