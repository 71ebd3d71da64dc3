"""List, verify, export or prune a journal."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from math import inf, isfinite
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from becalm.cli.messages import stderr
from becalm.errors import UsageError
from becalm.files.outputs.writing import open_output
from becalm.files.registry import format_to_write
from becalm.live.address import seconds_of
from becalm.live.journal.checking import faults, rows_text
from becalm.live.journal.parquet_files import prune
from becalm.live.journal.reading import JournalReader, JournalStretch, open_journal
from becalm.live.tables import table_schema

DAMAGED = 3
"""Exit code for a damaged journal."""

_BARE_DATE = re.compile(r"(?:19|20)[0-9]{2}(?:(?:0[1-9]|1[0-2])(?:0[1-9]|[12][0-9]|3[01]))?")  # 2026, 20260501

_stdout = Console(highlight=False, soft_wrap=True, markup=False, width=1000)


class JournalOptions(NamedTuple):
    """The options besides the folder and the action."""

    output: Path | None
    start: str | None
    stop: str | None
    older: str | None


def run(folder: Path, action: str, asked: JournalOptions, as_json: bool) -> bool:
    """Run an action; return False if the action found damage.

    Raises
    ------
    UsageError
        If the action is unknown, or an option that it needs is missing or invalid.
    JournalError
        If the journal cannot be read.
    """
    actions: dict[str, Callable[[], bool]] = {
        "list": lambda: _list(folder, as_json),
        "verify": lambda: _verify(folder, as_json),
        "export": lambda: _export(folder, asked),
        "prune": lambda: _prune(folder, asked.older),
    }
    if action not in actions and str(folder) in actions:
        raise UsageError(f"The folder comes first: becalm journal {action} {folder}")
    if action not in actions:
        raise UsageError(f"becalm journal cannot {action}; it can {', '.join(actions)}.")
    return actions[action]()


def _list(folder: Path, as_json: bool) -> bool:
    with open_journal(folder) as journal:
        summary = _summary(journal)
        stretches = journal.stretches()
    if as_json:
        hours = [{**one._asdict(), "rate_hz": one.rate_hz} for one in stretches]
        print(json.dumps({**summary, "hours": hours}, indent=2))  # noqa: T201
        return True
    table = Table(box=None, pad_edge=False)
    for heading in ("where", "rows", "from", "to", "rows/s", "MB"):
        table.add_column(heading, justify="left" if heading == "where" else "right")
    for one in stretches:
        rate = "-" if one.rate_hz is None else f"{one.rate_hz:.6g}"
        where = f"{one.where} (pruned)" if one.pruned else one.where
        table.add_row(where, f"{one.rows:,}", *_first_and_last(one), rate, f"{one.size / 1e6:.1f}")
    _stdout.print(table)
    channels = ", ".join(
        one["name"] if not one["unit"] or one["unit"] in one["name"] else f"{one['name']} ({one['unit']})"
        for one in summary["channels"]
    )
    _stdout.print(f"{summary['rows']:,} rows of {channels or 'no channels yet'} from {summary['source'] or 'nowhere'}")
    for kind, number in summary["losses"].items():
        _stdout.print(f"{kind}: {number} reported; the last: {summary['last_losses'][kind]}")
    if summary["position"]:
        _stdout.print(f"The source continues after {summary['position']}")
    return True


def _summary(journal: JournalReader) -> dict[str, Any]:
    head, checkpoint, losses = journal.head(), journal.checkpoint(), journal.losses()
    return {
        "folder": str(journal.folder),
        "rows": 0 if checkpoint is None else checkpoint.rows,
        "channels": []
        if head is None
        else [{"name": name, "unit": unit} for name, unit in zip(head.names, head.units, strict=True)],
        "source": "" if checkpoint is None else checkpoint.source,
        "position": "" if checkpoint is None else checkpoint.position,
        "losses": dict(Counter(loss.kind for loss in losses)),
        "last_losses": {loss.kind: loss.says for loss in losses},
    }


def _verify(folder: Path, as_json: bool) -> bool:
    """Print all faults of a journal, and the rows recorded as lost, which are no fault; return True without faults."""
    damage = list(faults(folder))
    holes, rows = ([], None) if damage else _holes_and_rows(folder)
    if as_json:
        lost = [{"first_row": first, "end_row": end} for first, end in holes]
        summary = {"folder": str(folder), "whole": not damage, "rows": rows, "wrong": damage, "lost": lost}
        print(json.dumps(summary, indent=2))  # noqa: T201
    for hole in holes:
        stderr.print(f"{rows_text(hole).capitalize()} are known to be lost.")
    for sentence in damage:
        stderr.print(sentence)
    if rows is None:
        stderr.print(
            f"The journal in {folder} is damaged. Its stream can be restarted: it keeps the readable part of the"
            " database, and does not change files."
        )
    else:
        stderr.print(f"The journal in {folder} is intact: {rows:,} rows are as they were written.")
    return not damage


def _export(folder: Path, options: JournalOptions) -> bool:
    if options.output is None:
        raise UsageError("becalm journal DIR export needs an output: -o rows.parquet.")
    format_to_write(options.output)
    from_s, to_s = moment_of("--from", options.start, -inf), moment_of("--to", options.stop, inf)
    rows = 0
    with open_journal(folder) as journal:
        if options.output.resolve().is_relative_to(folder.resolve()):
            raise UsageError(f"{options.output} is in the journal {folder}; write elsewhere: -o {options.output.name}")
        head = journal.head()
        if head is None:
            raise UsageError(f"The journal in {folder} has no rows yet; there is nothing to export.")
        schema = table_schema(head)
        metadata = {key.decode(): value.decode() for key, value in (schema.metadata or {}).items()}
        with open_output(options.output, metadata) as output:
            output.write(schema.empty_table())
            for table in journal.tables(from_s=from_s, to_s=to_s):
                output.write(table.replace_schema_metadata(schema.metadata))
                rows += table.num_rows
    stderr.print(f"Wrote {rows:,} rows to {options.output}.")
    return True


def _prune(folder: Path, older: str | None) -> bool:
    if older is None:
        raise UsageError("becalm journal DIR prune needs the age of the files to remove: --older 30d.")
    with open_journal(folder):  # raises an error if there is no journal; `prune` would create one
        pass
    removed = prune(folder, seconds_of("--older", older))
    rows = sum(roll.rows for roll in removed)
    stderr.print(f"Removed {len(removed)} files with {rows:,} rows; rows that are not in files yet stay.")
    return True


def moment_of(option: str, text: str | None, default: float) -> float:
    """Return a time stamp in seconds from a text: a number of seconds, or a date (UTC if it has no time zone).

    Raises
    ------
    UsageError
        If the text is not a date or a finite number, or could be both.
    """
    if text is None:
        return default
    if _BARE_DATE.fullmatch(text):
        year, day = text[:4], f"{text[4:6] or '01'}-{text[6:8] or '01'}"
        raise UsageError(f"{option} {text} could be seconds or a date; write {text}.0 for seconds, or {year}-{day}.")
    try:
        seconds = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            seconds = inf
        else:
            seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if not isfinite(seconds):
        raise UsageError(f"{option} {text} is not a time; write seconds as in the rows, or a date: 2026-05-01T12:00.")
    return seconds


def _first_and_last(one: JournalStretch) -> tuple[str, str]:
    first_s, last_s = (_stamp(stamp_s, one.dated) for stamp_s in (one.first_s, one.last_s))
    return first_s, last_s


def _stamp(stamp_s: float | None, dated: bool) -> str:
    if stamp_s is None:
        return "-"
    return f"{datetime.fromtimestamp(stamp_s, UTC):%Y-%m-%d %H:%M:%S}" if dated else f"{stamp_s:.10g} s"


def _holes_and_rows(folder: Path) -> tuple[list[tuple[int, int]], int]:
    """Return the spans of rows recorded as lost, and the number of rows in the journal."""
    with open_journal(folder) as journal:
        return journal.holes(), sum(one.rows for one in journal.stretches() if not one.pruned)
