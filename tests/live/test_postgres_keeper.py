"""postgres: against a real server that is killed and filled."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from becalm.live.block import Loss, LossKind
from becalm.live.protocols import AwayError, CheckpointSink, StorageFullError
from becalm.live.sinks.postgres import PostgresSink
from becalm.live.sinks.postgres_rows import BinaryRows
from live_postgres import PostgresServer, postgres_server
from postgres_keepers import closed_keepers, keeper_of, running_postgres
from servers import need
from streams import checkpoint_at, head_of, outputs_of

HOSTILE = ('a"; drop table x; --', "b%s", "C d", "ü" * 20)


server = pytest.fixture(scope="module")(running_postgres)
keepers = pytest.fixture(autouse=True)(closed_keepers)


def bits(values: object) -> list[int]:
    """Return floats as the whole numbers of their bits."""
    return [int(one) for one in np.asarray(values, dtype=np.float64).ravel().view(np.int64)]


def test_every_bit_comes_back(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keeper, head = keeper_of(server, "bits"), head_of("a", "b")
    keepers.append(keeper)
    assert isinstance(keeper, CheckpointSink)
    assert keeper.last() is None
    keeper.open(head)
    assert keeper.last() is None
    outputs = outputs_of([2000, 0, 1234], channels=2, begins_s=1.7e9)
    keeper.commit(outputs, checkpoint_at(3234))
    assert keeper.last() == checkpoint_at(3234)
    asked = "select row, time_s, a, a_raw, a_sigma, b, b_raw, b_sigma, a_verdict, b_verdict from bits order by row"
    rows = server.asked(asked)
    assert [row[0] for row in rows] == list(range(3234))
    assert bits([row[1] for row in rows]) == bits(np.concatenate([one.time_s for one in outputs]))
    for channel in range(2):
        for place, part in enumerate(("signal", "values", "sigma")):
            written = np.concatenate([getattr(one, part)[:, channel] for one in outputs])
            assert bits([row[2 + 3 * channel + place] for row in rows]) == bits(written)
    assert [row[8:] for row in rows] == [tuple(pair) for one in outputs for pair in one.verdicts.tolist()]


def test_instants_stand_beside_stamps_that_count_from_1970(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keeper = keeper_of(server, "instants")
    keepers.append(keeper)
    keeper.open(head_of("a"))
    early, late = outputs_of([1]), outputs_of([1], first_row=1, begins_s=1.7e9)
    wild = outputs_of([3], first_row=2)
    wild[0].time_s[:] = [1e300, np.nan, -np.inf]
    keeper.commit([*early, *late, *wild], checkpoint_at(5))
    asked = "select extract(epoch from time)::float8 from instants order by row"
    assert [row[0] for row in server.asked(asked)] == [None, pytest.approx(1.7e9 + 0.001), None, None, None]


def test_losses_stand_beside_their_rows(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keeper = keeper_of(server, "with_losses")
    keepers.append(keeper)
    keeper.open(head_of("a"))
    (output,) = outputs_of([0], first_row=17)
    lost = (Loss(LossKind.MISSING, 3, "Three \0 rows.", 1.7e9), Loss(LossKind.AWAY, None, "Away.", 1.7e9))
    told = type(output)(17, output.time_s, output.values, output.signal, output.sigma, output.verdicts, lost)
    keeper.commit([told], checkpoint_at(17))
    rows = server.asked("select row, kind, rows, says from with_losses_losses order by kind desc")
    assert rows == [(17, "missing", 3, "Three \ufffd rows."), (17, "away", None, "Away.")]


def test_hostile_names_are_only_names(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    server.do("create table x(a int)")
    keeper = keeper_of(server, "t%25s%22%3B%20drop%20table%20x%3B--")
    keepers.append(keeper)
    keeper.open(head_of(*HOSTILE))
    keeper.commit(outputs_of([5], channels=4), checkpoint_at(5))
    keeper.close()
    assert keeper.last() == checkpoint_at(5)
    keeper.open(head_of(*HOSTILE))
    assert server.asked("select count(*) from x") == [(0,)]
    columns = server.asked("select column_name from information_schema.columns where table_name like 't\\%s\";%--'")
    assert {*HOSTILE} <= {row[0] for row in columns}


def test_a_killed_server_keeps_all_or_nothing(keepers: list[PostgresSink]) -> None:
    """Twenty times it is killed at some moment of a transaction; the stream goes on from what it says was last."""
    need("initdb")
    random, channels = np.random.default_rng(8), 3
    with postgres_server() as server:
        keeper = keeper_of(server, "killed")
        keepers.append(keeper)
        kills, taken_back = 0, 0
        while kills < 20:
            last = keeper.last()
            stood = 0 if last is None else last.rows
            assert last is None or last == checkpoint_at(stood)
            keeper.open(head_of("a", "b", "c"))
            killer = threading.Timer(float(random.uniform(0.0, 0.08)), server.kill)
            killer.start()
            try:
                while True:
                    size = int(random.integers(1, 4000))
                    keeper.commit(
                        outputs_of([size // 2, size - size // 2], channels, stood), checkpoint_at(stood + size)
                    )
                    stood += size
            except AwayError:
                kills += 1
            killer.join()
            keeper.close()
            server.start()
            now = keeper.last()
            rows = 0 if now is None else now.rows
            assert rows in (stood, stood + size)  # the last call's rows, all or none
            taken_back += rows == stood
            assert server.asked("select count(*), coalesce(max(row) + 1, 0), count(distinct row) from killed")[0] == (
                (rows,) * 3
            )
        assert taken_back
        (signal,) = np.array([one.signal[:, 2] for one in outputs_of([rows], channels)])
        assert bits([row[0] for row in server.asked("select c from killed order by row")]) == bits(signal)


def test_three_hundred_channels_fit(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keepers.append(keeper_of(server, "wide"))
    keepers[-1].open(head_of(*(f"c{number}" for number in range(300))))
    keepers[-1].commit(outputs_of([40], channels=300, begins_s=1.7e9), checkpoint_at(40))
    assert server.asked("select count(*), min(c299_sigma), max(c299_sigma) from wide") == [(40, 0.1, 0.1)]


def test_a_full_disk_keeps_nothing_and_can_be_tried_again(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    """The server itself raises its code for it, from a trigger; making room takes the trigger away."""
    keepers.append(keeper_of(server, "full"))
    keepers[-1].open(head_of("a"))
    keepers[-1].commit(outputs_of([3]), checkpoint_at(3))
    server.do(
        "create function no_room() returns trigger language plpgsql as"
        " $$ begin raise exception using errcode = '53100', message = 'could not extend file'; end $$;"
        "create trigger no_room before update on full_checkpoint execute function no_room()"
    )
    more = outputs_of([4], first_row=3)
    with pytest.raises(StorageFullError, match="could not extend file"):
        keepers[-1].commit(more, checkpoint_at(7))
    assert server.asked('select count(*) from "full"') == [(3,)]
    server.do("drop trigger no_room on full_checkpoint")
    keepers[-1].commit(more, checkpoint_at(7))
    assert server.asked('select count(*) from "full"') == [(7,)]
    assert keepers[-1].last() == checkpoint_at(7)


@pytest.mark.parametrize("size", [0, 1, 9000, 20000])
def test_pieces_are_the_whole_whatever_the_cut(size: int) -> None:
    (whole,) = outputs_of([size], channels=2)
    pieces = [bytes(piece) for piece in BinaryRows(2).encode(whole)]
    halves = outputs_of([size // 2, size - size // 2], channels=2)
    assert b"".join(pieces) == b"".join(bytes(piece) for half in halves for piece in BinaryRows(2).encode(half))
