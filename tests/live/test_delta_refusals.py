"""delta: what is not the stream's own is refused with a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import deltalake
import pytest

from becalm.errors import InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Head
from becalm.live.sinks.delta import DeltaSink
from becalm.live.tables import output_table
from delta_tables import checkpoint_files, close_all, keeper_of, last_of, opened, rows_of
from streams import checkpoint_at, head_of, outputs_of


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    close_all()


def test_a_damaged_checkpoint_is_told(tmp_path: Path) -> None:
    opened(tmp_path).commit(outputs_of([10]), checkpoint_at(10))
    (name,) = checkpoint_files(tmp_path)
    path = tmp_path / "_becalm" / name
    path.write_bytes(path.read_bytes().replace(b"replay", b"replaY"))
    with pytest.raises(InputError, match="damaged"):
        last_of(tmp_path)


def test_the_second_writer_is_refused(tmp_path: Path) -> None:
    first = opened(tmp_path)
    for opening in (lambda: keeper_of(tmp_path).last(), lambda: opened(tmp_path)):
        with pytest.raises(UsageError, match="another process"):
            opening()
    first.close()
    opened(tmp_path).close()


def test_behind_a_uri_the_second_writers_commit_fails(tmp_path: Path) -> None:
    first, second = opened(f"file://{tmp_path}"), opened(f"file://{tmp_path}")
    first.commit(outputs_of([10]), checkpoint_at(10))
    with pytest.raises(OutputError, match="another process"):
        second.commit(outputs_of([7]), checkpoint_at(7))
    first.commit(outputs_of([5], first_row=10), checkpoint_at(15))
    assert rows_of(tmp_path) == list(range(15))


def test_other_channels_or_units_are_refused(tmp_path: Path) -> None:
    keeper = opened(tmp_path, "b")
    keeper.open(head_of("a"))  # nothing was kept of the first
    keeper.commit(outputs_of([3]), checkpoint_at(3))
    keeper.open(head_of("a", recipe="version = 2\n"))  # tuned anew meanwhile
    keeper.open(Head(("a",), ("",), 1.0, ""))  # of which the unit is not told again
    keeper.commit(outputs_of([3], first_row=3), checkpoint_at(6))
    assert rows_of(tmp_path) == list(range(6))
    for head in (head_of("b"), Head(("a",), ("mm",), 1.0, ""), head_of("a", "b")):
        with pytest.raises(UsageError, match="other channels"):
            keeper.open(head)


def test_a_table_of_someone_else_is_refused(tmp_path: Path) -> None:
    deltalake.write_deltalake(str(tmp_path), output_table(head_of("a"), outputs_of([3])).select(["row"]))
    with pytest.raises(UsageError, match="not made by becalm"):
        keeper_of(tmp_path).last()


@pytest.mark.parametrize("address", ["delta:", "delta:somewhere?compact=1h"])
def test_addresses_that_cannot_be_meant_are_refused(address: str) -> None:
    with pytest.raises(UsageError):
        DeltaSink(Address.parsed(address))


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no table", encoding="utf-8")
    with pytest.raises(OutputError, match="cannot be written"):
        opened(tmp_path / "file" / "table")
