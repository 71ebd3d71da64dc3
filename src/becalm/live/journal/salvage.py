"""Repair a damaged journal: copy the intact rows to a new database, and record the others as lost."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from becalm.files.atomic_file import sync_folder
from becalm.live.block import Loss, LossKind
from becalm.live.journal.checking import Span, database_faults, rows_text
from becalm.live.journal.database import (
    NAME,
    JournalError,
    NewerJournalError,
    connect,
    connect_reading,
    put,
    transaction,
    writing,
)
from becalm.live.journal.intact_rows import HEADED, Plan, connect_damaged, plan_repair, read_intact_rows, with_data
from becalm.live.journal.mark import Mark
from becalm.live.journal.records import LossRow

_PART, _NEW = (
    f"{NAME}.part",
    f"{NAME}.salvaged",
)  # names of the new database, while it is written and once it is complete
_COPIED_BLOCKS = 64  # blocks copied in one transaction


def repair(folder: Path, mark: Mark | None) -> tuple[Loss, ...]:
    """Repair a journal if it is damaged, and return the losses; an intact journal is left as it is.

    Parameters
    ----------
    folder : Path
        Folder of the journal, locked by this process.
    mark : Mark or None
        Last checkpoint outside the database, if any.

    Returns
    -------
    tuple of Loss
        The losses, as recorded in the journal. A damaged file is renamed to journal.sqlite.damaged-1 and so on.

    Raises
    ------
    JournalError
        If no checkpoint is left from which the stream could continue, the database is of a newer becalm, or it is of
        another program and there is no mark; all files are left as they are.
    StorageFullError
        If the disk has no room for the new database.
    """
    path = folder / NAME
    with writing(folder):
        _finish(folder)
    if not path.exists() and mark is None:
        return ()
    why = _damage(path, mark)
    if why is not None:
        return _salvage(folder, mark, why)
    return () if mark is None else _record_lost_end(folder, mark)


def _damage(path: Path, mark: Mark | None) -> str | None:
    """Return what is wrong with a database; None if it is intact."""
    if not path.exists():
        return "it is missing"
    try:
        with closing(connect_reading(path)) as connection:
            if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                return next(database_faults(connection), None)
    except JournalError as cause:
        if mark is None or isinstance(cause, NewerJournalError):
            raise
        return str(cause)
    except sqlite3.Error as cause:
        return str(cause)
    return None if mark is None else "it is empty"


def _record_lost_end(folder: Path, mark: Mark) -> tuple[Loss, ...]:
    """Record the loss of the last commits, if an intact database has fewer rows than the mark."""
    with writing(folder), closing(connect(folder / NAME)) as connection:
        (end,) = connection.execute("SELECT end_row FROM blocks ORDER BY number DESC LIMIT 1").fetchone() or (0,)
        if mark.checkpoint.rows <= end:
            return ()
        loss = _loss_at_end((end, mark.checkpoint.rows), "its last commits are missing")
        with transaction(connection, folder):
            put(connection, LossRow.of(end, loss))
    return (loss,)


def _salvage(folder: Path, mark: Mark | None, why: str) -> tuple[Loss, ...]:
    """Copy the intact rows into a new database, and put it in the place of the damaged one."""
    old, renamed = folder / NAME, _damaged_path(folder)
    with writing(folder), closing(connect_damaged(old)) as connection:
        plan = plan_repair(folder, read_intact_rows(connection), mark)
        if plan is None:
            raise JournalError(
                f"{old} is damaged ({why.rstrip('.')}), and it has no checkpoint from which its stream could continue;"
                " all files are left as they are. Give the stream another folder: --sink journal:OTHER."
            )
        losses = _losses(plan, mark, f"{NAME} was damaged ({why.rstrip('.')}), and was renamed to {renamed.name}")
        with closing(connect(folder / _PART)) as target:
            with transaction(target, folder):
                for row in (*plan.rows, *losses):
                    put(target, row)
            for first in range(0, len(plan.blocks), _COPIED_BLOCKS):
                with transaction(target, folder):
                    for number, block in plan.blocks[first : first + _COPIED_BLOCKS]:
                        put(target, block if number is None else with_data(connection, number, block))
    with writing(folder):
        (folder / _PART).rename(folder / _NEW)
        if old.exists():
            old.rename(renamed)
        _finish(folder)
    return tuple(row.loss() for row in losses)


def _losses(plan: Plan, mark: Mark | None, why: str) -> list[LossRow]:
    """Return the losses of a repair; without a mark it is unknown whether the last rows are lost."""
    losses = [
        LossRow.of(gap[0], Loss(LossKind.STORAGE, gap[1] - gap[0], f"{rows_text(gap).capitalize()} are lost: {why}."))
        for gap in plan.gaps
    ]
    if mark is None:
        text = f"It is unknown whether rows after row {plan.end - 1} were committed: {why}."
        losses.append(LossRow.of(plan.end, Loss(LossKind.STORAGE, None, text)))
    elif mark.checkpoint.rows > plan.end:
        losses.append(LossRow.of(plan.end, _loss_at_end((plan.end, mark.checkpoint.rows), why)))
    elif not plan.gaps:
        losses.append(LossRow.of(plan.end, Loss(LossKind.STORAGE, 0, f"No row is lost, but {why}.")))
    return losses


def _loss_at_end(rows: Span, why: str) -> Loss:
    first, end = rows
    text = (
        f"{rows_text(rows).capitalize()} were committed and are lost: {why}. A source that can replay sends them again."
    )
    return Loss(LossKind.STORAGE, end - first, text)


def _finish(folder: Path) -> None:
    """Move a complete new database into place once the damaged one is renamed; remove an incomplete new database."""
    new, path, log = folder / _NEW, folder / NAME, folder / f"{NAME}-wal"
    if new.exists() and not path.exists():
        if log.exists():  # the write-ahead log of the damaged database
            log.rename(_log_path(folder))
        (folder / f"{NAME}-shm").unlink(missing_ok=True)
        new.rename(path)
        sync_folder(folder)
    for name in (_NEW, _PART, HEADED):
        for ending in ("", "-wal", "-shm"):
            (folder / f"{name}{ending}").unlink(missing_ok=True)


def _damaged_files(folder: Path) -> list[Path]:
    """Return the damaged files that were renamed, in the order of their numbers."""
    paths = [path for path in folder.glob(f"{NAME}.damaged-*") if path.suffix[9:].isdecimal()]
    return sorted(paths, key=lambda path: int(path.suffix[9:]))


def _log_path(folder: Path) -> str:
    """Return the new name of a damaged write-ahead log: that of the last damaged file plus -wal, or a free name."""
    damaged = _damaged_files(folder)
    last_log = f"{damaged[-1]}-wal" if damaged else ""
    return last_log if damaged and not Path(last_log).exists() else f"{_damaged_path(folder)}-wal"


def _damaged_path(folder: Path) -> Path:
    damaged = _damaged_files(folder)
    return folder / f"{NAME}.damaged-{int(damaged[-1].suffix[9:]) + 1 if damaged else 1}"
