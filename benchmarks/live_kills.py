"""A stream is killed 200 times at random moments; no row may be lost or written twice.

*File to journal*: a recording of three channels at 1 kHz is replayed in real time into a journal, and becalm is
killed (SIGKILL) up to three seconds after each start. *JetStream to journal*: a sender publishes the same rows, ten per
message, through a real NATS server; becalm or the server is killed at random. *File to PostgreSQL*: becalm or a real
server, with all its child processes, is killed. In each case the rows at the end must be bitwise those of one
uninterrupted stream. *MQTT to journal*: a real mosquitto with the default settings of its package is killed; rows that
it acknowledged and lost cannot be recovered, but every row must be written or counted as missing.

Run: python benchmarks/live_kills.py [--kills 200] [--only file,jetstream,postgres,mosquitto] [-o docs/live-kills.md]
"""

from __future__ import annotations

import random
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.live.block import Block
from becalm.live.journal.reading import open_journal
from becalm.live.stream import Stream
from live_runs import Floats, LiveProcess, names_of, readings, recipe_of
from pages import page_parser, publish

CHANNELS, RATE_HZ, MESSAGE_ROWS = 3, 1000.0, 10
RECIPE = recipe_of(CHANNELS, RATE_HZ)
NAMES = tuple(names_of(CHANNELS))
_LONGEST_LIFE_S = 3.0
_ENOUGH_ROWS = 1 << 20


class Found(NamedTuple):
    """The result at the end."""

    rows: int
    says: str
    kills: str


@dataclass
class Killing:
    """Kills becalm, or the server that it is connected to, again and again."""

    folder: Path
    words: list[str]
    kills: int
    restart: Callable[[], None] | None = None  # function that kills the server and starts it again

    def run(self, last_words: list[str], is_done: Callable[[], bool]) -> str:
        """Kill processes, then run the stream with `last_words` until `is_done`; return the counts of kills."""
        dice, servers = random.Random(7), 0
        live = LiveProcess(self.folder, self.words)
        for _ in range(self.kills):
            time.sleep(dice.uniform(0, _LONGEST_LIFE_S))
            if live.process.poll() is not None:
                raise SystemExit(f"The stream ended with {live.process.returncode}: {live.said()}")
            if self.restart is not None and dice.random() < 0.5:
                servers += 1
                self.restart()
                continue
            live.kill()
            live = LiveProcess(self.folder, self.words)
        live.stop()
        live = LiveProcess(self.folder, last_words)
        while live.process.poll() is None and not is_done():
            time.sleep(0.5)
        if live.stop():
            raise SystemExit(f"The stream ended with {live.process.returncode}: {live.said()}")
        return f"{self.kills - servers} + {servers}"


def recording(folder: Path, rows: int) -> tuple[Path, Floats, Floats]:
    """Write a recording; return its path, its stamps and its readings."""
    stamps, values = np.arange(rows) / RATE_HZ, readings(rows, CHANNELS, RATE_HZ)
    path = folder / "recording.parquet"
    columns = {"time": stamps} | {name: values[:, number] for number, name in enumerate(NAMES)}
    units = {"time": "s"} | dict.fromkeys(NAMES, "m/s^2")
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in units.items()]
    pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), path)
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    return path, stamps, values


def uninterrupted(stamps: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return signal and sigma of an uninterrupted stream."""
    elapsed = np.ones(len(stamps))
    elapsed[0] = 0.0
    output = Stream(RECIPE, 1 / RATE_HZ).take(Block(NAMES, ("m/s^2",) * CHANNELS, stamps, values, "", elapsed))
    return output.signal, output.sigma


def compare(table: pa.Table, stamps: Floats, values: Floats) -> str:
    """Return a sentence on whether a table is bitwise the output of an uninterrupted stream, row by row."""
    rows = table["row"].to_numpy()
    if not np.array_equal(rows, np.arange(len(stamps))):
        return f"NOT all rows once: {len(rows)} of {len(stamps)}, {len(np.unique(rows))} different"
    signal, sigma = uninterrupted(stamps, values)
    for number, name in enumerate(NAMES):
        same = np.array_equal(table[name].to_numpy(), signal[:, number], equal_nan=True)
        if not same or not np.array_equal(table[f"{name}_sigma"].to_numpy(), sigma[:, number], equal_nan=True):
            return f"{name} is NOT the same"
    return "the same to the bit, every row once"


def kept(journal: Path) -> pa.Table:
    """Return all rows of a journal."""
    with open_journal(journal) as reader:
        return pa.concat_tables([*reader.tables()], promote_options="default")


def from_file(folder: Path, kills: int) -> Found:
    """Kill becalm between a file and a journal."""
    path, stamps, values = recording(folder, rows_for(kills))
    words = ["--recipe", "r.toml", "--sink", "journal:kept", "--commit", "0.2s"]
    killing = Killing(folder, [f"replay:{path}?speed=1", *words], kills)
    who = killing.run([f"replay:{path}", *words], lambda: False)
    return Found(len(stamps), compare(kept(folder / "kept"), stamps, values), who)


def into_postgres(folder: Path, kills: int) -> Found:
    """Kill becalm, or PostgreSQL, between a file and its tables."""
    from live_postgres import USER, postgres_server

    path, stamps, values = recording(folder, rows_for(kills))
    with postgres_server() as server:

        def restart() -> None:
            server.kill()
            server.start()

        sink = f"postgres://{USER}@127.0.0.1:{server.port}/postgres?table=kept&password_file={server.password_file}"
        words = ["--recipe", "r.toml", "--sink", sink, "--commit", "0.2s"]
        killing = Killing(folder, [f"replay:{path}?speed=1", *words], kills, restart)
        who = killing.run([f"replay:{path}", *words], lambda: False)
        columns = ["row", *NAMES, *(f"{name}_sigma" for name in NAMES)]
        rows = server.asked(f"SELECT {', '.join(columns)} FROM kept ORDER BY row")
        table = pa.table(dict(zip(columns, map(list, zip(*rows, strict=True)), strict=True)))
        return Found(len(stamps), compare(table, stamps, values), who)


def through_jetstream(folder: Path, kills: int) -> Found:
    """Kill becalm, or the NATS server, between a sender and a journal."""
    from live_brokers import nats_server
    from live_senders import JetStreamSender

    _, stamps, values = recording(folder, _ENOUGH_ROWS)
    with nats_server(folder / "nats") as broker:
        words = [f"nats://127.0.0.1:{broker.port}/drive", "--recipe", "r.toml", "--sink", "journal:kept"]
        words += ["--commit", "0.2s"]
        sender = JetStreamSender(broker.port, NAMES, stamps, values, MESSAGE_ROWS)

        def restart() -> None:
            broker.kill()
            broker.start()

        def is_done() -> bool:
            return bool(kept(folder / "kept").num_rows >= sender.rows)

        with sending(sender.run, sender.stop):
            killing = Killing(folder, words, kills, restart)
            who = killing.run(words, lambda: sender.finish() and is_done())
        sent = sender.rows
        return Found(sent, compare(kept(folder / "kept"), stamps[:sent], values[:sent]), who)


def through_mosquitto(folder: Path, kills: int) -> Found:
    """Kill mosquitto between a sender and a journal."""
    from live_brokers import mosquitto
    from live_senders import MqttSender

    _, stamps, values = recording(folder, _ENOUGH_ROWS)
    with mosquitto(folder / "mosquitto") as broker:
        words = [f"mqtt://127.0.0.1:{broker.port}/drive", "--recipe", "r.toml", "--sink", "journal:kept"]
        sender = MqttSender(broker.port, NAMES, stamps, values, MESSAGE_ROWS)
        live = LiveProcess(folder, words)
        live.wait_for("starting")
        dice = random.Random(7)
        with sending(sender.run, sender.stop):
            for _ in range(kills):
                time.sleep(dice.uniform(0, 1.0))
                broker.kill()
                broker.start()
            time.sleep(35.0)  # longer than the longest back-off: lost rows are noticed only when a later row arrives
            sender.finish()
            until = time.monotonic() + 35.0
            while accounted(folder / "kept")[0] < sender.rows and time.monotonic() < until:
                time.sleep(0.5)
        code = live.stop()
        end, rows, missing = accounted(folder / "kept")
        whole = "every row kept or counted" if end == sender.rows and not code else "NOT all are counted"
        return Found(rows + missing, f"{rows} kept + {missing} counted as missing: {whole}", f"0 + {kills}")


def accounted(journal: Path) -> tuple[int, int, int]:
    """Return the number of the row after the last accounted one, the number of rows, and the number of missing rows.

    The count starts with the first row in the journal, because becalm had not subscribed when earlier rows were sent.
    """
    with open_journal(journal) as reader:
        missing = sum(loss.rows or 0 for loss in reader.losses() if loss.kind == "missing")
    table = kept(journal)
    first = round(table["time_s"][0].as_py() * RATE_HZ)
    return first + table.num_rows + missing, table.num_rows, missing


def rows_for(kills: int) -> int:
    """Return a number of rows that is larger than the number replayed until the last kill."""
    return round(kills * _LONGEST_LIFE_S * RATE_HZ * 0.6) + 20_000


@contextmanager
def sending(run: Callable[[], None], stop: Callable[[], None]) -> Iterator[None]:
    """Run a sender in a thread until the block ends."""
    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop()
        thread.join()


CASES = {
    "file": ("file to journal", from_file),
    "jetstream": ("JetStream to journal", through_jetstream),
    "postgres": ("file to PostgreSQL", into_postgres),
    "mosquitto": ("MQTT (mosquitto) to journal", through_mosquitto),
}


def main() -> None:
    """Run all cases."""
    parser = page_parser(__doc__)
    parser.add_argument("--kills", type=int, default=200, help="how often each is killed")
    parser.add_argument("--only", default=",".join(CASES), help="cases, with commas")
    arguments = parser.parse_args()
    lines = ["stream | kills of becalm + of the server | rows | what was kept", "---|--:|--:|---"]
    for name in arguments.only.split(","):
        title, case = CASES[name]
        with tempfile.TemporaryDirectory() as folder:
            found = case(Path(folder), arguments.kills)
        lines.append(f"{title} | {found.kills} | {found.rows} | {found.says}")
        print(lines[-1], flush=True)
    publish("Killed streams", __doc__, "\n".join(lines) + "\n", arguments.output)


if __name__ == "__main__":
    main()
