"""Files that were cut, overwritten or taken away: what reads goes on, the rest is told, and never silently less."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from becalm.live.address import Address
from becalm.live.block import Loss
from becalm.live.journal.checking import faults, uncovered
from becalm.live.journal.database import JournalError
from becalm.live.journal.journal import Journal
from becalm.live.journal.mark import MarkFile
from becalm.live.journal.reading import open_journal
from becalm.live.protocols import StorageFullError
from journal_writer import writing
from journals import assert_rows, checkpoint_at, fill, journal_in, rows_of

DATABASE, LOG, MARK = "journal.sqlite", "journal.sqlite-wal", "journal.mark"
ROWS = 55_000


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Keep a stream, of which an hour has rolled, and half an hour is in the database, in a process that is killed."""
    folder = tmp_path_factory.mktemp("killed")
    with journal_in(folder) as journal:
        fill(journal, 30, 1000)
        assert journal.wait_until_rolled(30)
        fill(journal, 20, 1000)
    with writing(folder, "--rows", "1000") as process:
        assert process.stdout is not None
        while process.stdout.readline() != b"%d\n" % ROWS:
            pass
        process.kill()
    return folder


def copied(killed: Path, folder: Path) -> Path:
    shutil.copytree(killed, folder, dirs_exist_ok=True)
    (folder / "journal.sqlite-shm").unlink(missing_ok=True)
    return folder


def found_in(folder: Path) -> list[str]:
    """Return what `becalm journal verify` finds."""
    try:
        return list(faults(folder))
    except JournalError as cause:
        return [str(cause)]


def goes_on(folder: Path) -> tuple[Loss, ...]:
    """Open a damaged journal, let the stream go on, and return what was told as lost.

    No row is missing that is not told, all others are there to the bit, and verify told before, and is content after.
    """
    mark, found = MarkFile(folder).read(), found_in(folder)
    with journal_in(folder) as journal:
        checkpoint, mended = journal.last(), journal.repair_losses
        assert checkpoint is not None
        assert checkpoint == checkpoint_at(checkpoint.rows)
        with open_journal(folder) as reader:
            intact = checkpoint.rows - sum(end - first for first, end in reader.holes())
        if mark is not None:
            assert intact + sum(loss.rows or 0 for loss in mended) >= mark.checkpoint.rows
        rows = fill(journal, 3, 1000)
        assert journal.wait_until_rolled(30)
    assert bool(found) == bool(mended), (found, mended)
    assert list(faults(folder)) == []
    with open_journal(folder) as reader:
        holes = reader.holes()
        assert set(mended) <= {row.loss() for row in reader.losses()}
    lost = np.concatenate([np.zeros(0, np.int64), *(np.arange(first, end) for first, end in holes)])
    assert_rows(folder, rows, lost=lost)
    with journal_in(folder) as journal:
        assert journal.repair_losses == ()
    return mended


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("name", [DATABASE, LOG])
def test_a_file_that_is_cut_loses_what_is_told(name: str, seed: int, killed: Path, tmp_path: Path) -> None:
    path = copied(killed, tmp_path) / name
    whole = path.stat().st_size
    size = int(np.random.default_rng(seed).integers(whole))
    with path.open("r+b") as file:
        file.truncate(size)
    mended = goes_on(tmp_path)
    assert mended or size > whole / 2
    asides = sorted(path.name for path in tmp_path.glob("*.damaged*"))
    if name == DATABASE:
        assert asides == (["journal.sqlite.damaged-1", "journal.sqlite.damaged-1-wal"] if mended else [])


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("name", [DATABASE, LOG])
def test_bits_that_flipped_are_found(name: str, seed: int, killed: Path, tmp_path: Path) -> None:
    path, rng = copied(killed, tmp_path) / name, np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    for at in rng.integers(len(content), size=3):
        content[at] ^= 1 << int(rng.integers(8))
    path.write_bytes(content)
    goes_on(tmp_path)


@pytest.mark.parametrize("seed", range(16))
def test_sectors_of_noise_or_nothing_are_found(seed: int, killed: Path, tmp_path: Path) -> None:
    path, rng = copied(killed, tmp_path) / DATABASE, np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    for sector in rng.integers(len(content) // 4096, size=4):
        content[sector * 4096 : sector * 4096 + 4096] = rng.bytes(4096) if seed % 2 else bytes(4096)
    path.write_bytes(content)
    goes_on(tmp_path)


@pytest.mark.parametrize("log", [True, False])
@pytest.mark.parametrize("harm", ["zeros", "noise", "a root"])
def test_a_damaged_first_page_takes_no_rows_along(harm: str, log: bool, tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 40, 1000)
    if log:
        with writing(tmp_path, "--rows", "1000") as process:
            assert process.stdout is not None
            while process.stdout.readline() != b"43000\n":
                pass
            process.kill()
    path = tmp_path / DATABASE
    content = bytearray(path.read_bytes())
    if harm == "a root":
        at = content.index(b"CREATE TABLE blocks") - 1
        content[at] += 3
    else:
        content[:4096] = bytes(4096) if harm == "zeros" else np.random.default_rng(3).bytes(4096)
    path.write_bytes(content)
    mended = goes_on(tmp_path)
    assert len(mended) == 1 or log  # which may have another first page
    assert all(loss.says.startswith("No row is lost, but journal.sqlite was damaged") for loss in mended)


def overwrite(path: Path) -> None:
    path.write_bytes(b"this was a journal\n" * 5000)


@pytest.mark.parametrize("harm", [Path.unlink, overwrite, Path.touch], ids=["gone", "noise", "whole"])
@pytest.mark.parametrize("name", [DATABASE, LOG, MARK])
def test_a_file_that_is_gone_or_noise(name: str, harm: Callable[[Path], None], killed: Path, tmp_path: Path) -> None:
    harm(copied(killed, tmp_path) / name)
    mended = goes_on(tmp_path)
    if name == MARK or harm is Path.touch:
        assert mended == ()
    if name == DATABASE and harm is not Path.touch:
        says = " ".join(loss.says for loss in mended)
        assert "are lost: journal.sqlite was damaged (" in says


def test_a_database_without_rows_or_mark_that_is_damaged_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / DATABASE).write_bytes(b"noise" * 1000)
    journal = Journal(Address.parsed(f"journal:{tmp_path}"))
    with pytest.raises(JournalError, match=r"no checkpoint from which its stream could continue.*--sink journal:OTHER"):
        journal.last()
    assert (tmp_path / DATABASE).read_bytes() == b"noise" * 1000


@pytest.mark.parametrize("seed", range(8))
def test_without_a_mark_what_is_cut_is_refused_or_told_as_not_known(seed: int, killed: Path, tmp_path: Path) -> None:
    (copied(killed, tmp_path) / MARK).unlink()
    (tmp_path / LOG).unlink()
    whole = (tmp_path / DATABASE).stat().st_size
    with (tmp_path / DATABASE).open("r+b") as file:
        file.truncate(whole * (seed + 1) // 9)
    try:
        said = goes_on(tmp_path)[-1].says
    except JournalError as cause:
        said = str(cause)
    refused = "no checkpoint from which its stream could continue" in said
    assert refused or "It is unknown" in said
    assert refused != bool(list(tmp_path.glob("*.damaged*")))


def test_another_programs_database_is_refused(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        connection.execute("CREATE TABLE cooking (recipe)")
    with pytest.raises(JournalError, match="a database of another program"):
        Journal(Address.parsed(f"journal:{tmp_path}")).last()
    with pytest.raises(JournalError, match="a database of another program"):
        open_journal(tmp_path)


@pytest.mark.parametrize("has_mark", [True, False])
def test_a_newer_journal_is_refused_and_stays(has_mark: bool, tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
    if not has_mark:
        (tmp_path / MARK).unlink()
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        connection.execute("PRAGMA user_version = 2")
    with pytest.raises(JournalError, match="is of a newer becalm; update becalm"):
        Journal(Address.parsed(f"journal:{tmp_path}")).last()
    assert (tmp_path / DATABASE).exists()
    assert not list(tmp_path.glob("*damaged*"))


@pytest.mark.parametrize("torn", range(0, 400, 40))
def test_a_torn_mark_is_none(torn: int, tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
    content = (tmp_path / MARK).read_bytes()
    (tmp_path / MARK).write_bytes(content[:torn])
    assert MarkFile(tmp_path).read() is None
    with journal_in(tmp_path) as journal:
        assert journal.last() == checkpoint_at(100)
    assert (tmp_path / MARK).read_bytes() == content


@pytest.mark.parametrize("step", ["before the old one is aside", "before the new one is in its place"])
def test_a_crash_while_it_is_mended_is_mended_by_the_next_start(
    step: str, killed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (copied(killed, tmp_path) / DATABASE).open("r+b") as file:
        file.truncate(20_001)
    places = {"before the old one is aside": "rename", "before the new one is in its place": "unlink"}
    real, calls = getattr(Path, places[step]), []

    def crash(path: Path, *values: object, **named: object) -> object:
        calls.append(path)
        if step.startswith("before the new") and path.name != "journal.sqlite-shm":
            return real(path, *values, **named)
        raise InterruptedError

    with monkeypatch.context() as patch:
        patch.setattr(Path, places[step], crash)
        with pytest.raises(StorageFullError, match="Free disk space"):
            Journal(Address.parsed(f"journal:{tmp_path}")).last()
    assert calls
    with journal_in(tmp_path) as journal:
        fill(journal, 2, 1000)
    with open_journal(tmp_path) as reader:
        assert any("are lost" in row.says for row in reader.losses())
    assert list(faults(tmp_path)) == []
    assert len(list(tmp_path.glob(f"{DATABASE}.damaged-?"))) == 1
    assert not list(tmp_path.glob("*.salvaged*"))


def test_verify_finds_a_parquet_file_that_changed_or_is_gone(killed: Path, tmp_path: Path) -> None:
    with journal_in(copied(killed, tmp_path)) as journal:
        fill(journal, 30, 1000)
    first, second = sorted(tmp_path.glob("*/*.parquet"))[:2]
    content = bytearray(first.read_bytes())
    content[len(content) // 2] ^= 4
    first.write_bytes(content)
    second.unlink()
    said = found_in(tmp_path)
    assert len(said) == 2
    assert "differs from what was written" in said[0]
    assert "cannot be read: No such file" in said[1]
    with open_journal(tmp_path) as reader, pytest.raises(JournalError, match="cannot be read"):
        list(reader.tables())


def test_damage_that_shows_while_the_stream_runs_ends_it_in_a_sentence(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 3)
        journal._database.execute("PRAGMA writable_schema = ON")
        journal._database.execute("UPDATE sqlite_master SET rootpage = 4000 WHERE name = 'blocks'")
        journal._database.execute("PRAGMA writable_schema = RESET")
        with pytest.raises(JournalError, match="start the stream again"):
            fill_on(journal)


def fill_on(journal: Journal) -> None:
    journal.commit([rows_of(300, 100)], checkpoint_at(400))


@pytest.mark.parametrize(
    ("gap", "spans", "left"),
    [
        ((0, 10), [], [(0, 10)]),
        ((0, 10), [(2, 4), (4, 6)], [(0, 2), (6, 10)]),
        ((0, 10), [(5, 20), (-3, 2)], [(2, 5)]),
        ((5, 10), [(0, 20)], []),
        ((5, 10), [(0, 5), (10, 12)], [(5, 10)]),
        ((5, 5), [], []),
    ],
)
def test_what_is_left_of_a_gap(gap: tuple[int, int], spans: list[tuple[int, int]], left: list[tuple[int, int]]) -> None:
    assert uncovered(gap, spans) == left
