"""A recipe's filters elsewhere: C in a folder, or one file for other programs."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import typer

from becalm.cleaning.recipe import Recipe
from becalm.cli.messages import stderr
from becalm.cli.opened_file import is_same, open_as, said_of
from becalm.cli.options import split_names
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.export.bundle import Bundle, ExportOptions, bundle_of
from becalm.export.channel.sources import own_files
from becalm.export.facts import cost_words
from becalm.export.kind import Span
from becalm.export.layouts import library_name
from becalm.export.written import FOLDER
from becalm.files.temporary_files import in_waiting
from becalm.files.text_file import make_folder, refuse_unwritable, write_folder, write_text

if TYPE_CHECKING:
    from becalm.export.number_type import Precision
    from becalm.export.proof.verifying import Compared

_FORMS = ("json", "sos", "scipy")
_CERTIFICATE = "certificate.md"
_SHOWN = 2000  # rows of a recording that go into a golden vector


class CExportOptions(NamedTuple):
    """What a person asks of an export to C."""

    precision: str | None
    gain: str | None
    channels: str | None
    ranges: list[str] | None
    recording: Path | None
    verify: bool


def run(recipe: Path, output: Path, to: str, wanted: CExportOptions, *, as_json: bool) -> None:
    """Write a recipe's filters.

    Raises
    ------
    UsageError
        If it is asked for what cannot be.
    BecalmError
        If the recipe cannot be read, a filter cannot be written so, or C does not do what becalm does.
    """
    if is_same(recipe, output):
        raise UsageError(f"{output} is the recipe itself; name another output with -o.")
    found = Recipe.load(recipe)
    if to == "c":
        told = _to_c(found, recipe, output, wanted)
    elif to in _FORMS:
        told = _to_form(found, to, output, wanted)
    else:
        raise UsageError(f"There is no export to {to!r}; write --to c, sos, json or scipy.")
    if as_json:
        print(json.dumps({"recipe": str(recipe), "output": str(output), **told}, indent=2))  # noqa: T201


def _to_form(recipe: Recipe, to: str, output: Path, wanted: CExportOptions) -> dict[str, Any]:
    from becalm.export.forms import written_as

    if any(value for name, value in wanted._asdict().items() if name != "channels"):
        raise UsageError(f"Only --channels goes with --to {to}; the others are of --to c.")
    refuse_unwritable(output)
    channels = None if wanted.channels is None else split_names(wanted.channels)
    text, notes = written_as(recipe, to, channels)
    write_text(output, text)
    for note in notes:
        stderr.print(note)
    typer.echo(f"Wrote {output}.", err=True)
    return {"to": to, "notes": notes}


def _to_c(recipe: Recipe, path: Path, output: Path, wanted: CExportOptions) -> dict[str, Any]:
    recorded = {} if wanted.recording is None else _recorded(recipe, wanted.recording, wanted.channels)
    bundle = bundle_of(recipe, path.stem.removesuffix(".recipe"), _asked(recipe, wanted, recorded))
    files, told = dict(bundle.files), _summary(bundle)
    _refuse_foreign(output)
    if wanted.verify:
        from becalm.export.proof.certificate import certificate
        from becalm.export.proof.verifying import verify

        with stderr.status("compiling and comparing"), _scratch() as place:
            verified = verify(bundle, recipe, recorded, place)
        files[_CERTIFICATE] = certificate(bundle, verified)
        told["compared"] = [_told(one) for one in verified.compared]
    write_folder(output, files)
    stood = {_CERTIFICATE, *_library_in(output, bundle.stem)}
    for name in stood - set(files):  # of an export that stood here before
        (output / name).unlink(missing_ok=True)
    _say(bundle, told)
    typer.echo(f"Wrote {output}. Try it with: make -C {output} check", err=True)
    return told


def _library_in(output: Path, stem: str) -> set[str]:
    """Return the library's files in an export of this name, wherever a compiler would find them."""
    folders = FOLDER, f"arduino/{library_name(stem)}/src/{FOLDER}"
    return {f"{folder}/{name}" for folder in folders for name in own_files() if (output / folder / name).exists()}


@contextmanager
def _scratch() -> Iterator[Path]:
    """Give an empty folder that is gone in the end, whatever stops the process."""
    place = Path(tempfile.mkdtemp(prefix="becalm-export-"))
    with in_waiting(place):
        yield place


def _refuse_foreign(output: Path) -> None:
    """Refuse a folder that cannot be written to, or that holds files which no export wrote.

    Raises
    ------
    UsageError
        If there are such files.
    OutputError
        If it cannot be written to.
    """
    if not output.exists():
        return
    make_folder(output)  # which refuses a file
    if any(output.iterdir()) and not (output / "becalm.h").exists():
        raise UsageError(f"The folder {output} holds files that no export wrote; name another, or a new one, with -o.")
    refuse_unwritable(output / "becalm.h")


def _told(one: Compared) -> dict[str, Any]:
    """Return what JSON can hold: no difference has no decibels."""
    return {**one._asdict(), "snr_db": one.snr_db if np.isfinite(one.snr_db) else None}


def _asked(recipe: Recipe, wanted: CExportOptions, recorded: dict[str, Floats]) -> ExportOptions:
    channels = None if wanted.channels is None else split_names(wanted.channels)
    spans = spans_of(wanted.ranges or [], [channel.name for channel in recipe.channel])
    shown = {name: readings[:_SHOWN] for name, readings in recorded.items()}
    if wanted.precision != "q31":
        spans = {**_seen(recipe, recorded), **spans}
    return ExportOptions(
        cast("Precision", wanted.precision or "float32"), wanted.gain or "auto", channels, spans, shown
    )


def _seen(recipe: Recipe, recorded: dict[str, Floats]) -> dict[str, Span]:
    """Return how far readings of a recording went, and as much again, of channels whose rails nobody knows."""
    found: dict[str, Span] = {}
    for channel in recipe.channel:
        seen = recorded.get(channel.name, np.empty(0))
        seen = seen[np.isfinite(seen)]
        if len(seen) and (channel.limits is None or None in (channel.limits.low, channel.limits.high)):
            more = float(np.ptp(seen)) / 2
            found[channel.name] = float(seen.min()) - more, float(seen.max()) + more
    return found


def spans_of(texts: list[str], names: list[str]) -> dict[str, Span]:
    """Read how far readings reach: `NAME=LOW:HIGH`, or LOW:HIGH for every channel.

    Raises
    ------
    UsageError
        If one cannot be read, is of no channel, or says otherwise than one before.
    """
    said: dict[str, Span] = {}
    for text in texts:
        name, _, reach = text.rpartition("=")
        low, _, high = reach.partition(":")
        try:
            span = float(low), float(high)
        except ValueError:
            span = np.nan, np.nan
        if not -np.inf < span[0] < span[1] < np.inf:
            raise UsageError(f"--range {text} is no range; write NAME=LOW:HIGH in the channel's unit, as ax=-20:20.")
        if name and name not in names:
            raise UsageError(f"--range {text}: the recipe has no channel {name!r}; it has {', '.join(names)}.")
        if said.setdefault(name, span) != span:
            raise UsageError(f"--range {text} comes after another for {name or 'every channel'}; give one of them.")
    return {each: said[each if each in said else ""] for each in names if each in said or "" in said}


def _recorded(recipe: Recipe, file: Path, channels: str | None) -> dict[str, Floats]:
    """Read the channels of a recording, in the recipe's units."""
    from becalm.cli.options import When

    said = said_of(channels, When(None, None, None, None), None, None).or_as(recipe)
    with open_as(file, said) as source:
        found = source.recording()
        step_s = found.timebase.step_s
        if abs(step_s * recipe.nominal_rate_hz - 1) > 1e-2:
            stderr.print(
                f"{file} has {1 / step_s:.6g} Hz, and the recipe {recipe.nominal_rate_hz:.6g} Hz: its readings are"
                " taken as they come, one a step."
            )
        if empty := [name for at, name in enumerate(found.names) if not np.isfinite(found.samples[:, at]).any()]:
            raise UsageError(f"{file} has no reading of {empty[0]}; choose other channels with --channels.")
        return {name: np.ascontiguousarray(found.samples[:, at]) for at, name in enumerate(found.names)}


def _summary(bundle: Bundle) -> dict[str, Any]:
    return {
        "to": "c",
        "notes": bundle.notes,
        "channels": [
            {
                "name": one.name,
                "functions": f"{one.prefix}_*",
                "state_bytes": one.written.state_bytes,
                "table_bytes": one.written.table_bytes,
                "cost": cost_words(one.written),
                "word": None if one.written.word is None else one.written.word._asdict(),
            }
            for one in bundle.channels
        ],
    }


def _say(bundle: Bundle, told: dict[str, Any]) -> None:
    for note in bundle.notes:
        stderr.print(note)
    for one in bundle.channels:
        word, unit = one.written.word, one.design.unit_after
        stderr.print(
            f"{one.name}: {one.prefix}_*, state {one.written.state_bytes} bytes, tables"
            f" {one.written.table_bytes} bytes, {cost_words(one.written)}."
        )
        if word is not None:
            stderr.print(
                f"  It stalls {word.stall:.2g}{unit} off at the most, and rounding adds {word.noise:.2g}{unit}:"
                f" {word.share:.2g} of sigma; computed for readings {word.range:.6g}{unit} apart."
            )
    for one in told.get("compared", []):
        decibels = "" if one["snr_db"] is None else f", {one['snr_db']:.0f} dB"
        stderr.print(
            f"  {one['channel']}, {one['record']}, beside {one['beside']}: {one['rows']} rows, {one['error']:.2g} of"
            f" the greatest signal off at the most{decibels}{'' if one['kept'] else ', which is less than promised'}."
        )
