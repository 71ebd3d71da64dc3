"""The section on real files: times, channels and units by `becalm inspect`, and verdicts by `becalm clean`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from real_recordings import COUNTED_HZ, DATA, files

from becalm.errors import InputError


def files_table(words: Sequence[str]) -> str:
    """Return a table and a section for each file, or for each file whose path contains one of the words."""
    names = [path.relative_to(DATA) for path in files()]
    rows, sections = zip(*(_file(name) for name in names if not words or _has_any(name, words)), strict=True)
    heads = ["file", "format", "times", "channels", "rate (Hz)", "asked", "verdicts", "exit code"]
    return "\n".join([table(heads, rows), *sections])


def becalm(*words: object) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    command = [sys.executable, "-m", "becalm", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=DATA)


def _file(name: Path) -> tuple[list[str], str]:
    """Inspect and clean one file; return its row of the table, and its section."""
    print(name, file=sys.stderr)
    asked = ["--rate", f"{COUNTED_HZ[name.name]:g}"] if name.name in COUNTED_HZ else []
    seen = json.loads(becalm("inspect", name, *asked, "--json").stdout)
    times, passed = seen.get("times", [seen]), seen.get("passed", [])
    with TemporaryDirectory() as folder:
        ran = becalm("clean", name, "-o", Path(folder) / "out.h5", *asked, "--json")
    if ran.returncode not in (0, 4):
        raise InputError(f"`becalm clean {name}` ends with {ran.returncode}: {ran.stderr}")
    verdicts = Counter(one["verdict"] for one in json.loads(ran.stdout)["channels"])
    rates = sorted({f"{one['rate_hz']:.5g}" for one in times}, key=float)
    row = [
        str(name),
        times[0]["format"],
        str(len(times)),
        str(sum(len(_channels(one)) for one in times)),
        rates[0] if len(rates) == 1 else f"{rates[0]} to {rates[-1]}",
        " ".join(asked),
        ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()),
        str(ran.returncode),
    ]
    return row, _section(name, times, passed)


def _has_any(name: Path, words: Sequence[str]) -> bool:
    return any(word in str(name) for word in words)


def _channels(layout: dict[str, object]) -> list[dict[str, str]]:
    columns = layout["columns"]
    return [one for one in columns if one["role"] == "channel"] if isinstance(columns, list) else []


def _section(name: Path, times: Sequence[dict[str, object]], passed: Sequence[dict[str, object]]) -> str:
    notes = dict.fromkeys(str(note) for one in times for note in one["notes"])  # type: ignore[attr-defined]
    lines = [f"### {name}", "", *(f"> {note}\n" for note in notes)]
    rows = [
        [
            str(one.get("group") or ""),
            str(one["rows"]),
            f"{one['rate_hz']:.6g}",
            "even" if one["uniform"] else "stamped",
            str(one["gaps"]),
            _named([column["name"] for column in _channels(one)]),
            ", ".join(dict.fromkeys(column["unit"] for column in _channels(one) if column["unit"])),
        ]
        for one in times
    ]
    lines.append(table(["group", "rows", "rate (Hz)", "time", "gaps", "channels", "units"], rows))
    if passed:
        lines.append(f"Nothing to clean, passed through: {_named([str(one['group']) for one in passed])}.\n")
    return "\n".join(lines)


def _named(names: Sequence[str]) -> str:
    few = list(names) if len(names) <= 6 else [*names[:3], "…", names[-1]]
    return ", ".join(few).replace("|", "\\|") + (f" ({len(names)})" if len(names) > 6 else "")


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [" | ".join(heads), "|".join(["---"] * len(heads)), *(" | ".join(row) for row in rows)]
    return "".join(f"| {line} |\n" for line in lines)
