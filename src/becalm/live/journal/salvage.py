"""What is left of a damaged journal: what reads and is what was written goes on, the rest is told as lost."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from becalm.files.atomic_file import sync_folder
from becalm.live.block import Loss, LossKind
from becalm.live.journal.checking import Span, database_faults, told
from becalm.live.journal.database import NAME, JournalError, connect, connect_reading, put, transaction, writing
from becalm.live.journal.mark import Mark
from becalm.live.journal.records import LossRow
from becalm.live.journal.remains import HEADED, Plan, connect_damaged, moved, planned, remains_of

_PART, _NEW = f"{NAME}.part", f"{NAME}.salvaged"  # while it is written, and whole
_TOGETHER = 64  # blocks that are copied in one transaction


def mend(folder: Path, mark: Mark | None) -> tuple[Loss, ...]:
    """Make a journal one that can go on, and return what was lost; nothing, mostly.

    Parameters
    ----------
    folder : Path
        Of the journal; held by this process.
    mark : Mark or None
        Where its stream stood.

    Returns
    -------
    tuple of Loss
        As recorded in the journal. A damaged file is kept aside, as journal.sqlite.damaged-1 and so on.

    Raises
    ------
    JournalError
        If nothing tells any more where the stream stood; all files stay as they are.
    StorageFullError
        If there is no room for what is kept.
    """
    path = folder / NAME
    with writing(folder):
        _finish(folder)
    if not path.exists() and mark is None:
        return ()
    why = _damage(path, mark)
    if why is not None:
        return _salvage(folder, mark, why)
    return () if mark is None else _lost_at_the_end(folder, mark)


def _damage(path: Path, mark: Mark | None) -> str | None:
    """Return what is wrong with a database, None of one that is whole."""
    if not path.exists():
        return "it is gone"
    try:
        with closing(connect_reading(path)) as connection:
            if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                return next(database_faults(connection), None)
    except JournalError as cause:
        if mark is None:
            raise
        return str(cause)
    except sqlite3.Error as cause:
        return str(cause)
    return None if mark is None else "it is empty"


def _lost_at_the_end(folder: Path, mark: Mark) -> tuple[Loss, ...]:
    """Record where the mark tells of more rows than a database that is whole: its last commits are gone."""
    with writing(folder), closing(connect(folder / NAME)) as connection:
        (end,) = connection.execute("SELECT end_row FROM blocks ORDER BY number DESC LIMIT 1").fetchone() or (0,)
        if mark.checkpoint.rows <= end:
            return ()
        loss = _end_lost((end, mark.checkpoint.rows), "its last commits are gone")
        with transaction(connection, folder):
            put(connection, LossRow.of(end, loss))
    return (loss,)


def _salvage(folder: Path, mark: Mark | None, why: str) -> tuple[Loss, ...]:
    """Copy what is intact into a new database, and put that in the place of the old one."""
    old, aside = folder / NAME, _aside(folder)
    with writing(folder), closing(connect_damaged(old)) as connection:
        plan = planned(folder, remains_of(connection), mark)
        if plan is None:
            raise JournalError(
                f"{old} is damaged ({why.rstrip('.')}), and nothing tells where its stream stood; all files are left as"
                " they are. Give the stream another folder: --sink journal:OTHER."
            )
        losses = _losses(plan, mark, f"{NAME} was damaged ({why.rstrip('.')}), and is kept aside as {aside.name}")
        with closing(connect(folder / _PART)) as target:
            with transaction(target, folder):
                for row in (*plan.rows, *losses):
                    put(target, row)
            for first in range(0, len(plan.blocks), _TOGETHER):
                with transaction(target, folder):
                    for number, block in plan.blocks[first : first + _TOGETHER]:
                        put(target, block if number is None else moved(connection, number, block))
    with writing(folder):
        (folder / _PART).rename(folder / _NEW)
        if old.exists():
            old.rename(aside)
        _finish(folder)
    return tuple(row.loss() for row in losses)


def _losses(plan: Plan, mark: Mark | None, why: str) -> list[LossRow]:
    """Say which rows are lost; of the last ones nothing is known without a mark."""
    losses = [
        LossRow.of(gap[0], Loss(LossKind.STORAGE, gap[1] - gap[0], f"{told(gap).capitalize()} are lost: {why}."))
        for gap in plan.gaps
    ]
    if mark is None:
        says = f"Whether rows after {plan.end - 1} were kept is not known: {why}."
        losses.append(LossRow.of(plan.end, Loss(LossKind.STORAGE, None, says)))
    elif mark.checkpoint.rows > plan.end:
        losses.append(LossRow.of(plan.end, _end_lost((plan.end, mark.checkpoint.rows), why)))
    elif not plan.gaps:
        losses.append(LossRow.of(plan.end, Loss(LossKind.STORAGE, 0, f"No row is lost, but {why}.")))
    return losses


def _end_lost(rows: Span, why: str) -> Loss:
    first, end = rows
    says = f"{told(rows).capitalize()} were kept and are lost: {why}. A source that can go back tells them again."
    return Loss(LossKind.STORAGE, end - first, says)


def _finish(folder: Path) -> None:
    """Put a new database in its place, once the old one is aside; of one that was not finished nothing is left."""
    new, path, log = folder / _NEW, folder / NAME, folder / f"{NAME}-wal"
    if new.exists() and not path.exists():
        if log.exists():  # of the old one
            log.rename(_log_aside(folder))
        (folder / f"{NAME}-shm").unlink(missing_ok=True)
        new.rename(path)
        sync_folder(folder)
    for name in (_NEW, _PART, HEADED):
        for ending in ("", "-wal", "-shm"):
            (folder / f"{name}{ending}").unlink(missing_ok=True)


def _asides(folder: Path) -> list[Path]:
    """Return the damaged files that are kept aside, the last at the end."""
    found = [path for path in folder.glob(f"{NAME}.damaged-*") if path.suffix[9:].isdecimal()]
    return sorted(found, key=lambda path: int(path.suffix[9:]))


def _log_aside(folder: Path) -> str:
    """Return where the log of a damaged file goes, which is beside it, or alone where the file was gone."""
    there = _asides(folder)
    beside = f"{there[-1]}-wal" if there else ""
    return beside if there and not Path(beside).exists() else f"{_aside(folder)}-wal"


def _aside(folder: Path) -> Path:
    there = _asides(folder)
    return folder / f"{NAME}.damaged-{int(there[-1].suffix[9:]) + 1 if there else 1}"
