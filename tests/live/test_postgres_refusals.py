"""postgres: what can never be kept is refused with a sentence, by a real server or before it."""

from __future__ import annotations

from pathlib import Path

import pytest

from becalm.errors import InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Head
from becalm.live.protocols import AwayError
from becalm.live.sinks.postgres import PostgresSink
from live_postgres import PASSWORD, USER, PostgresServer
from postgres_keepers import closed_keepers, keeper_of, running_postgres
from servers import free_port
from streams import checkpoint_at, head_of, outputs_of

server = pytest.fixture(scope="module")(running_postgres)
keepers = pytest.fixture(autouse=True)(closed_keepers)


def test_no_server_is_away_and_not_for_ever() -> None:
    keeper = PostgresSink(Address.parsed(f"postgres://u@127.0.0.1:{free_port()}/postgres?table=t"))
    with pytest.raises(AwayError, match="cannot be reached now"):
        keeper.last()
    keeper.close()


@pytest.mark.parametrize("password", ["mistaken", None])
def test_a_wrong_password_is_no_reason_to_wait(
    server: PostgresServer, monkeypatch: pytest.MonkeyPatch, password: str | None
) -> None:
    monkeypatch.delenv("PGPASSWORD")
    monkeypatch.setenv("PGPASSFILE", "/nowhere")
    if password:
        monkeypatch.setenv("PGPASSWORD", password)
    with pytest.raises(InputError, match="password") as told:
        keeper_of(server, "t").last()
    assert not isinstance(told.value, AwayError)
    assert "mistaken" not in str(told.value)


def test_a_password_may_stand_in_a_file(
    server: PostgresServer, monkeypatch: pytest.MonkeyPatch, keepers: list[PostgresSink], tmp_path: Path
) -> None:
    monkeypatch.setenv("PGPASSWORD", "wrong")
    file = tmp_path / "password"
    file.write_text(f"{PASSWORD}\n", encoding="utf-8")
    keepers.append(keeper_of(server, "t", f"&password_file={file}"))
    assert keepers[-1].last() is None
    with pytest.raises(InputError, match="cannot be read"):
        keeper_of(server, "t", f"&password_file={tmp_path}/none").last()
    file.write_text(f"{USER}\n{PASSWORD}\n", encoding="utf-8")
    address = f"postgres://127.0.0.1:{server.port}/postgres?table=u&password_file={file}"
    keepers.append(PostgresSink(Address.parsed(address)))
    assert keepers[-1].last() is None
    file.write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="0 lines"):
        keeper_of(server, "t", f"&password_file={file}").last()


def test_a_missing_database_is_no_reason_to_wait(server: PostgresServer) -> None:
    address = Address.parsed(f"postgres://{USER}@127.0.0.1:{server.port}/nothing?table=t")
    with pytest.raises(InputError, match="does not exist"):
        PostgresSink(address).last()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("postgres://u:hidden@h/d?table=t", "contains a password"),
        ("postgres://u@h/d", "a table"),
        ("postgres://u@h?table=t", "a database"),
        ("postgres:h/d?table=t", "write postgres://"),
        ("postgres://h:port/d?table=t", "host and port"),
        ("postgres://h/d?table=t&password=hidden", "no option 'password'"),
        ("postgres://h/d?table=t&sslmode=strong", "sslmode=strong"),
        (f"postgres://h/d?table={'t' * 60}", "63 bytes"),
    ],
)
def test_addresses_that_cannot_be_meant_are_refused(address: str, said: str) -> None:
    with pytest.raises(UsageError, match=said) as told:
        PostgresSink(Address.parsed(address))
    assert "hidden" not in str(told.value)


def test_the_second_writer_is_refused(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keepers += [keeper_of(server, "shared") for _ in range(2)]
    keepers[0].open(head_of("a"))
    with pytest.raises(UsageError, match="Another process writes"):
        keepers[1].last()
    keepers[0].commit(outputs_of([3]), checkpoint_at(3))
    keepers[0].close()
    keepers[0].close()
    assert keepers[1].last() == checkpoint_at(3)
    with pytest.raises(
        AwayError, match="the last connection ended"
    ):  # it may be its own, which the server did not miss yet
        keepers[0].last()


def test_other_channels_or_units_are_refused(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keeper = keeper_of(server, "settled")
    keepers.append(keeper)
    keeper.open(head_of("b"))
    keeper.open(head_of("a"))  # nothing was kept of the first
    keeper.commit(outputs_of([3]), checkpoint_at(3))
    keeper.open(head_of("a", recipe="version = 2\n"))  # tuned anew meanwhile
    for head in (head_of("b"), Head(("a",), ("mm",), 1000.0, ""), head_of("a", "b"), head_of()):
        with pytest.raises(UsageError, match=r"other channels \(a \[m\]\)"):
            keeper.open(head)


def test_units_may_be_told_later(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keeper = keeper_of(server, "later")
    keepers.append(keeper)
    for rows, unit in enumerate(("", "", "m", "")):
        keeper.open(Head(("a",), (unit,), 1000.0, ""))
        keeper.commit(outputs_of([1], first_row=rows), checkpoint_at(rows + 1))
    told = "select units[1], col_description('later'::regclass, 3) from later_checkpoint"
    assert server.asked(told) == [("m", "m")]
    with pytest.raises(UsageError, match="other channels"):
        keeper.open(Head(("a",), ("mm",), 1000.0, ""))


def test_a_table_of_someone_else_is_refused(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    server.do("create table theirs(a int)")
    keepers.append(keeper_of(server, "theirs"))
    with pytest.raises(UsageError, match="not made by becalm"):
        keepers[-1].last()


@pytest.mark.parametrize(
    ("names", "said"),
    [(("time",), "column of timestamps"), (tuple(f"c{i}" for i in range(301)), "301 channels"), (("n" * 56,), "63")],
)
def test_channels_that_postgres_cannot_hold_are_refused(
    server: PostgresServer, keepers: list[PostgresSink], names: tuple[str, ...], said: str
) -> None:
    keepers.append(keeper_of(server, "refused"))
    with pytest.raises(UsageError, match=said):
        keepers[-1].open(head_of(*names))
    assert keepers[-1].last() is None


def test_a_user_who_may_not_write_is_told(server: PostgresServer, monkeypatch: pytest.MonkeyPatch) -> None:
    server.do("create role reader login password 'r'")
    monkeypatch.setenv("PGPASSWORD", "r")
    keeper = PostgresSink(Address.parsed(f"postgres://reader@:{server.port}/postgres?table=unwritable"))
    assert keeper.last() is None
    with pytest.raises(OutputError, match="GRANT"):
        keeper.open(head_of("a"))
    keeper.close()


def test_rows_twice_are_refused(server: PostgresServer, keepers: list[PostgresSink]) -> None:
    keepers.append(keeper_of(server, "twice"))
    keepers[-1].open(head_of("a"))
    keepers[-1].commit(outputs_of([3]), checkpoint_at(3))
    with pytest.raises(OutputError, match="already"):
        keepers[-1].commit(outputs_of([3], first_row=2), checkpoint_at(5))
    assert keepers[-1].last() == checkpoint_at(3)
