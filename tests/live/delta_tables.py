"""What tests of delta: share: keepers of a folder, and what others find in it."""

from __future__ import annotations

from pathlib import Path

import deltalake

from becalm.live.address import Address
from becalm.live.block import Checkpoint
from becalm.live.sinks.delta import DeltaSink
from streams import head_of

MADE: list[DeltaSink] = []


def keeper_of(place: Path | str) -> DeltaSink:
    """Return a keeper of a folder or URI."""
    MADE.append(DeltaSink(Address.parsed(f"delta:{place}")))
    return MADE[-1]


def opened(place: Path | str, *names: str) -> DeltaSink:
    """Return a keeper that is ready."""
    keeper = keeper_of(place)
    keeper.open(head_of(*(names or ("a",))))
    return keeper


def last_of(place: Path) -> Checkpoint | None:
    """Return what another process would find."""
    close_all()
    keeper = keeper_of(place)
    last = keeper.last()
    keeper.close()
    return last


def rows_of(place: Path | str) -> list[int]:
    """Return the rows that a reader finds, in their order."""
    table = deltalake.DeltaTable(str(place)).to_pyarrow_table()
    return sorted(table["row"].to_pylist())


def checkpoint_files(place: Path) -> dict[str, bytes]:
    """Return what is beside a table."""
    return {path.name: path.read_bytes() for path in (place / "_becalm").glob("*.json")}


def close_all() -> None:
    """Close what was made."""
    while MADE:
        MADE.pop().close()
