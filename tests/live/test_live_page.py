"""The page about live says what there is: options, kinds of losses, keys of the status, names of metrics."""

from __future__ import annotations

import re
from pathlib import Path

import typer
from prometheus_client.metrics_core import Metric

from becalm.cli import main
from becalm.live.block import LossKind
from becalm.live.messages.stream import MessageStream
from becalm.live.sources.mqtt import MqttSource
from becalm.live.sources.nats import NatsSource
from becalm.live.watching.metrics import Counts
from metered import metered, used

PAGE = (Path(__file__).parents[2] / "docs/live.md").read_text(encoding="utf-8")


def table_after(line: str) -> list[str]:
    """Return the first cells of the first table after a line."""
    behind = PAGE.partition(line)[2]
    table = re.search(r"(?:^\|.*\n)+", behind, re.M)
    assert table is not None, line
    return [row.split("|")[1].strip() for row in table[0].splitlines()[2:]]


def named(metric: Metric) -> str:
    return metric.name + ("_total" if metric.type == "counter" else "")


def test_it_names_all_options() -> None:
    command = getattr(typer.main.get_command(main.app), "commands", {})["live"]
    there = {option for each in command.params for option in each.opts if option.startswith("--")}
    assert {cell.strip("`").split()[0] for cell in table_after("## Options")} == there


def test_it_names_all_kinds_of_losses() -> None:
    assert [cell.strip("`") for cell in table_after("Every loss is one of these")] == [kind.value for kind in LossKind]


def test_it_names_all_keys_of_a_status() -> None:
    told = [key for cell in table_after("## Watching it") for key in re.findall(r"`(\w+)`", cell)]
    assert sorted(told) == sorted(metered().status())


def test_it_names_all_metrics() -> None:
    meter = metered()
    meter.record(used(1, 0.0))
    meter.count_commit(1, 0.1)
    there = {named(metric) for metric in Counts(meter).collect()}
    assert set(re.findall(r"`(becalm_\w+)", PAGE)) == there


def test_it_names_the_options_of_brokers() -> None:
    told: dict[str, set[str]] = {}
    kind = ""
    for row in PAGE.partition("| options of |")[2].partition("\n\n")[0].splitlines():
        cells = [cell.strip() for cell in row.split("|")]
        kind = cells[1] or kind
        told.setdefault(kind, set()).update(re.findall(r"`([a-z]\w*)(?==|`)", cells[2]))
    assert told["`mqtt:`"] == set(MqttSource.OWN_OPTIONS)
    assert told["`nats:`"] - {"now"} == set(NatsSource.OWN_OPTIONS)
    assert told["`mqtt:`, `nats:`, `udp:`"] == set(MessageStream.OPTIONS)
