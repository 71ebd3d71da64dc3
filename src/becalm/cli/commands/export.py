"""Export the filters of a recipe: as a folder of C code, or as one file for other programs."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import typer

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cli.messages import stderr
from becalm.cli.opened_file import is_same, open_as, read_file_options
from becalm.cli.options import split_names
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.export.bundle import Bundle, ExportOptions, bundle_of
from becalm.export.channel.sources import own_files
from becalm.export.facts import cost_words
from becalm.export.kind import Span
from becalm.export.layouts import library_name
from becalm.export.shared_parts import FOLDER
from becalm.files.atomic_file import make_folder, refuse_unwritable, removed_afterwards, write_folder, write_text

if TYPE_CHECKING:
    from becalm.export.number_type import Precision
    from becalm.export.proof.verifying import RecordComparison

_FORMS = ("json", "sos", "scipy")
_CERTIFICATE = "certificate.md"
_SHOWN = 2000  # number of first rows of a recording that are in a test vector


class CExportOptions(NamedTuple):
    """The options of an export to C."""

    precision: str | None
    gain: str | None
    channels: str | None
    ranges: list[str] | None  # texts in the form that `spans_of` reads
    recording: Path | None
    verify: bool


def run(recipe: Path, output: Path, to: str, wanted: CExportOptions, *, as_json: bool) -> None:
    """Export the filters of a recipe.

    Raises
    ------
    UsageError
        If an option is invalid.
    BecalmError
        If the recipe cannot be read, a filter cannot be exported in this form, or the C code and becalm disagree.
    """
    if is_same(recipe, output):
        raise UsageError(f"{output} is the recipe itself; give another output with -o.")
    loaded = Recipe.load(recipe)
    if to == "c":
        summary = _to_c(loaded, recipe, output, wanted)
    elif to in _FORMS:
        summary = _to_form(loaded, to, output, wanted)
    else:
        raise UsageError(f"There is no export to {to!r}; write --to c, sos, json or scipy.")
    if as_json:
        print(json.dumps({"recipe": str(recipe), "output": str(output), **summary}, indent=2))  # noqa: T201


def _to_form(recipe: Recipe, to: str, output: Path, wanted: CExportOptions) -> dict[str, Any]:
    from becalm.export.forms import write_filters_as

    if any(value for name, value in wanted._asdict().items() if name != "channels"):
        raise UsageError(f"With --to {to} only --channels is possible; the other options are for --to c.")
    refuse_unwritable(output)
    channels = None if wanted.channels is None else split_names(wanted.channels)
    text, notes = write_filters_as(recipe, to, channels)
    write_text(output, text)
    for note in notes:
        stderr.print(note)
    typer.echo(f"Wrote {output}.", err=True)
    return {"to": to, "notes": notes}


def _to_c(recipe: Recipe, path: Path, output: Path, wanted: CExportOptions) -> dict[str, Any]:
    readings = {} if wanted.recording is None else _read_recording(recipe, wanted.recording, wanted.channels)
    bundle = bundle_of(recipe, path.stem.removesuffix(".recipe"), _export_options(recipe, wanted, readings))
    files, summary = dict(bundle.files), _summary(bundle)
    _refuse_foreign(output)
    if wanted.verify:
        from becalm.export.proof.certificate import certificate
        from becalm.export.proof.verifying import verify

        with stderr.status("compiling and comparing"), _scratch() as place:
            verified = verify(bundle, recipe, readings, place)
        files[_CERTIFICATE] = certificate(bundle, verified)
        summary["compared"] = [_comparison_dict(one) for one in verified.compared]
    write_folder(output, files)
    earlier = {_CERTIFICATE, *_library_in(output, bundle.stem)}
    for name in earlier - set(files):  # stale files of an earlier export
        (output / name).unlink(missing_ok=True)
    _print_summary(bundle, summary)
    typer.echo(f"Wrote {output}. Try it with: make -C {output} check", err=True)
    return summary


def _library_in(output: Path, stem: str) -> set[str]:
    """Return the library files that an earlier export with the name `stem` wrote."""
    folders = FOLDER, f"arduino/{library_name(stem)}/src/{FOLDER}"
    return {f"{folder}/{name}" for folder in folders for name in own_files() if (output / folder / name).exists()}


@contextmanager
def _scratch() -> Iterator[Path]:
    """Provide an empty temporary folder in a `with`; it is removed even if a signal stops the process."""
    place = Path(tempfile.mkdtemp(prefix="becalm-export-"))
    with removed_afterwards(place):
        yield place


def _refuse_foreign(output: Path) -> None:
    """Raise an error if a folder cannot be written to, or has foreign files.

    Raises
    ------
    UsageError
        If the folder has files, but no `becalm.h` of an earlier export.
    OutputError
        If the folder cannot be written to.
    """
    if not output.exists():
        return
    make_folder(output)  # raises an error if it is a file
    if any(output.iterdir()) and not (output / "becalm.h").exists():
        raise UsageError(f"The folder {output} has files that no export wrote; give another folder with -o.")
    refuse_unwritable(output / "becalm.h")


def _comparison_dict(one: RecordComparison) -> dict[str, Any]:
    """Return a comparison for JSON; an infinite `snr_db`, for identical outputs, becomes None."""
    return {**one._asdict(), "snr_db": one.snr_db if np.isfinite(one.snr_db) else None}


def _export_options(recipe: Recipe, wanted: CExportOptions, recorded: dict[str, Floats]) -> ExportOptions:
    channels = None if wanted.channels is None else split_names(wanted.channels)
    spans = spans_of(wanted.ranges or [], [channel.name for channel in recipe.channel])
    shown = {name: readings[:_SHOWN] for name, readings in recorded.items()}
    if wanted.precision != "q31":
        spans = {**_ranges_of(recipe, recorded), **spans}
    return ExportOptions(
        cast("Precision", wanted.precision or "float32"), wanted.gain or "auto", channels, spans, shown
    )


def _ranges_of(recipe: Recipe, recorded: dict[str, Floats]) -> dict[str, Span]:
    """Return twice the range of a recording's readings, for channels that lack a saturation limit."""
    ranges: dict[str, Span] = {}
    for channel in recipe.channel:
        finite = recorded.get(channel.name, np.empty(0))
        finite = finite[np.isfinite(finite)]
        if len(finite) and (channel.limits is None or None in (channel.limits.low, channel.limits.high)):
            more = float(np.ptp(finite)) / 2
            ranges[channel.name] = float(finite.min()) - more, float(finite.max()) + more
    return ranges


def spans_of(texts: list[str], names: list[str]) -> dict[str, Span]:
    """Return the ranges of channels from texts: NAME=LOW:HIGH, or LOW:HIGH for all channels that are not named.

    Raises
    ------
    UsageError
        If a text is not a range, names an unknown channel, or contradicts another text.
    """
    given: dict[str, Span] = {}
    for text in texts:
        name, _, limits = text.rpartition("=")
        low, _, high = limits.partition(":")
        try:
            span = float(low), float(high)
        except ValueError:
            span = np.nan, np.nan
        if not -np.inf < span[0] < span[1] < np.inf:
            raise UsageError(f"--range {text} is not a range; write NAME=LOW:HIGH in the channel's unit: ax=-20:20.")
        if name and name not in names:
            raise UsageError(f"--range {text}: the recipe has no channel {name!r}; it has {', '.join(names)}.")
        if given.setdefault(name, span) != span:
            raise UsageError(f"--range {text} differs from an earlier one for {name or 'every channel'}; give one.")
    return {each: given[each if each in given else ""] for each in names if each in given or "" in given}


def _read_recording(recipe: Recipe, file: Path, channels: str | None) -> dict[str, Floats]:
    """Return the readings of a recording by channel, in the recipe's units."""
    from becalm.cli.options import TimeOptions

    file_options = read_file_options(channels, TimeOptions(None, None, None, None), None, None).with_defaults_of(recipe)
    with open_as(file, file_options) as source:
        read = source.recording()
        step_s = read.timebase.step_s
        if abs(step_s * recipe.nominal_rate_hz - 1) > 1e-2:
            stderr.print(
                f"{file} has {1 / step_s:.6g} Hz, but the recipe {recipe.nominal_rate_hz:.6g} Hz: each reading counts"
                " as one step of the recipe."
            )
        if empty := [name for at, name in enumerate(read.names) if not np.isfinite(read.samples[:, at]).any()]:
            raise UsageError(f"{file} has no reading of {empty[0]}; choose other channels with --channels.")
        return {name: np.ascontiguousarray(read.samples[:, at]) for at, name in enumerate(read.names)}


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


def _print_summary(bundle: Bundle, summary: dict[str, Any]) -> None:
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
                f"  It stalls at most {word.stall:.2g}{unit} off, and rounding adds {word.noise:.2g}{unit}:"
                f" {word.share:.2g} of sigma; computed for a range of readings of {word.range:.6g}{unit}."
            )
    for one in summary.get("compared", []):
        decibels = "" if one["snr_db"] is None else f", {one['snr_db']:.0f} dB"
        stderr.print(
            f"  {one['channel']}, {one['record']}, against {one['beside']}: {one['rows']} rows, largest error"
            f" {one['error']:.2g} of the largest signal{decibels}{'' if one['kept'] else ', more than promised'}."
        )
