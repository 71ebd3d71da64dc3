"""Clean one sensor in one task: the worker reads, filters and writes it chunk by chunk."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import NamedTuple, TypeVar

from becalm.cleaning.pipeline import fitted
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.report import ChannelReport
from becalm.errors import BecalmError, InputError, OutputError
from becalm.files.atomic_file import sentences
from becalm.files.chunked_cleaning import clean_chunks
from becalm.files.lake.folder import FolderRows
from becalm.files.opening import OpenSource, as_asked, understood
from becalm.files.read_options import asked_by
from becalm.files.tables import VERDICT
from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark, came_of
from becalm.fleet.outcome import SHOWN, Outcome, noted, refused
from becalm.fleet.pieces import OutputFile, Pieces, put_in_place, staging
from becalm.report.fleet_rows import row_of

Done = TypeVar("Done")


class OpenedSensor(NamedTuple):
    """A sensor that was understood."""

    source: OpenSource
    recipe: Recipe  # fitted to it
    pieces: tuple[OutputFile, ...]  # a file of the output for each that it came in, in order
    paths: tuple[Path, ...]  # of these, where they came from
    as_stored: bool  # whether its columns are read as they are in these


def clean_whole(job: Job, sensor: Sensor) -> Outcome:
    """Clean a sensor, unless it was finished before; whatever is wrong with it is told, and raised nowhere.

    Parameters
    ----------
    job : Job
        What is to be done.
    sensor : Sensor
        One of the lake.
    """
    return told_by(sensor, lambda: _cleaned(job, sensor))


def told_by(sensor: Sensor, work: Callable[[], Done]) -> Done | Outcome:
    """Do some work on a sensor; where it fails, the outcome has the reason, so that no sensor stops the others."""
    began = monotonic()
    try:
        return work()
    except BecalmError as cause:
        return refused(sensor.name, str(cause), monotonic() - began)
    except Exception as cause:  # rubbish of a kind that nobody has thought of
        return refused(sensor.name, f"{type(cause).__name__}: {cause}", monotonic() - began)


def all_died(sensor: Sensor, why: str) -> Outcome:
    """Return the outcome of a sensor whose workers died one after the other."""
    return refused(sensor.name, why)


def finished(job: Job, sensor: Sensor, hashed: str) -> Outcome | None:
    """Return the outcome of a sensor whose output is there and came of the same; None where it has to be made."""
    mark = CompletionMark.of(job.mark_of(sensor))
    if mark is None or mark.came_of != hashed or not mark.is_whole(job.output_folder(sensor)):
        return None
    if mark.job == job.own:  # in a stage that Spark gave up for another sensor
        return mark.outcome
    channels = tuple(replace(row, state="kept") for row in mark.outcome.channels)
    return replace(mark.outcome, state="kept", channels=channels, took_s=0.0)


def hash_of(job: Job, sensor: Sensor) -> str:
    """Return the hash of all that the output of a sensor comes of.

    Raises
    ------
    InputError
        If its files cannot be listed or read.
    """
    if sensor.came_of:
        return sensor.came_of
    files = [(job.name_of(sensor, path), path) for path in job.files_of(sensor)]
    return came_of(files, job.recipes[sensor.recipe], job.asked)


def opened(job: Job, sensor: Sensor) -> OpenedSensor:
    """Open a sensor as its recipe says; its source is to be closed after use.

    Raises
    ------
    BecalmError
        If it cannot be read, or its recipe does not fit.
    """
    place, recipe = job.input_of(sensor), job.recipe_of(sensor)
    options = asked_by(recipe, job.another)
    tables = job.tables_of(sensor)
    rows = tables[0].rows
    files = tuple(rows.pieces) if isinstance(rows, FolderRows) else ((place, rows.count),)
    pieces = tuple(OutputFile(job.name_of(sensor, path), count) for path, count in files)
    raw, options = as_asked(place, tables, options)
    source = understood(place, raw, options)
    try:
        for name in options.channels or ():
            if name + VERDICT in source.schema.names:
                raise InputError(f"{place} has a column {name + VERDICT!r}, which is to be written; rename it.")
        paths = tuple(path for path, _ in files)
        return OpenedSensor(source, fitted(recipe, source.names, source.units), pieces, paths, raw.rows is rows)
    except BaseException:
        source.close()
        raise


def _cleaned(job: Job, sensor: Sensor) -> Outcome:
    began, hashed = monotonic(), hash_of(job, sensor)
    kept = finished(job, sensor, hashed)
    if kept is not None:
        return kept
    found = opened(job, sensor)
    names = tuple(piece.name for piece in found.pieces)
    with found.source as source:
        refuse_foreign(job, sensor, names)
        with staging(job.output_folder(sensor)) as staged:
            with Pieces(staged, found.pieces, metadata_of(found.recipe)) as out:
                reports = clean_chunks(source, found.recipe, out.write, lambda *_: None, verdicts=True)
            outcome = outcome_of(sensor, reports, source, monotonic() - began)
            commit(job, sensor, staged, CompletionMark(hashed, names, outcome, job=job.own))
    return outcome


def refuse_foreign(job: Job, sensor: Sensor, names: Sequence[str]) -> None:
    """Refuse to write a sensor's output over files that no job of becalm wrote, or out of the folder of all output.

    Raises
    ------
    OutputError
        If one of them is there, two of them have one name, or a link leads elsewhere.
    """
    folder, mark = job.output_folder(sensor), CompletionMark.of(job.mark_of(sensor))
    if not folder.resolve().is_relative_to(Path(job.output).resolve()):
        raise OutputError(f"{folder} leads to {folder.resolve()}, out of the output; remove that link.")
    for name in names:
        place = (folder / name).parent
        if place.resolve() != folder.resolve() / Path(name).parent:
            raise OutputError(f"{place} leads to {place.resolve()}, out of the output; remove that link.")
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise OutputError(f"Two files of the sensor would be {folder / twice[0]}; rename one of them in the lake.")
    own = set() if mark is None else mark.own
    if foreign := [name for name in names if name not in own and os.path.lexists(folder / name)]:
        raise OutputError(
            f"{folder / foreign[0]} is there already, and no mark says that becalm wrote it; remove it, or name another"
            " output with -o."
        )


def metadata_of(recipe: Recipe) -> dict[str, str]:
    """Return what every file of an output says of how it was made."""
    return {"becalm.recipe": recipe.to_toml()}


def outcome_of(sensor: Sensor, reports: tuple[ChannelReport, ...], source: OpenSource, took_s: float) -> Outcome:
    """Return what became of a sensor that was cleaned."""
    shown = sensor.recipe[:SHOWN]
    rows = tuple(row_of(sensor.name, report, recipe=shown, rate_hz=source.rate_hz) for report in reports)
    return Outcome(sensor.name, "cleaned", noted(rows, notes_of(source)), took_s)


def notes_of(source: OpenSource) -> tuple[str, ...]:
    """Return what a person must know of a sensor's files and columns, as sentences."""
    replaced = ", ".join(source.replaced)
    return (*source.notes, *((f"Replaced by the new uncertainty: {replaced}.",) if replaced else ()))


def commit(job: Job, sensor: Sensor, staged: Path, mark: CompletionMark) -> None:
    """Let the files of a sensor appear, and then the mark that says so; files of an older output go.

    Raises
    ------
    InputError
        If what came in is not what it was when the work began.
    OutputError
        If that cannot be done; the sensor is not finished then.
    """
    if hash_of(job, sensor) != mark.came_of:
        raise InputError(f"The files of {sensor.name} changed while they were read; wait until all came, and repeat.")
    refuse_foreign(job, sensor, mark.files)
    path, folder = job.mark_of(sensor), job.output_folder(sensor)
    older = CompletionMark.of(path)
    own = {*mark.files, *(() if older is None else older.own)}
    with sentences(staged):
        sizes = tuple((staged / name).stat().st_size for name in mark.files)
    replace(mark, came_of="", files=(), held=tuple(sorted(own))).write(path)  # until all are in place, none counts
    put_in_place(staged, folder, mark.files)
    for name in own - set(mark.files):
        with sentences(folder / name):
            (folder / name).unlink(missing_ok=True)
    replace(mark, sizes=sizes).write(path)
