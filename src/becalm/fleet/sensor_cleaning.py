"""Clean one sensor in one task, chunk by chunk; `batch` gives the tasks to Spark through `spark_tasks`."""

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
from becalm.files.atomic_file import explain_write_errors
from becalm.files.chunked_cleaning import clean_chunks
from becalm.files.lake.folder import FolderRows
from becalm.files.opening import OpenSource, open_table, select_table
from becalm.files.read_options import asked_by
from becalm.files.tables import VERDICT
from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark, came_of
from becalm.fleet.outcome import SHOWN, Outcome, noted, refused
from becalm.fleet.pieces import OutputFile, Pieces, put_in_place, staging
from becalm.report.fleet_rows import row_of

Done = TypeVar("Done")


class OpenedSensor(NamedTuple):
    """A sensor whose files are open and whose columns match its recipe."""

    source: OpenSource
    recipe: Recipe  # fitted to the sensor's channels
    pieces: tuple[OutputFile, ...]  # the output files, one for each input file, in order
    paths: tuple[Path, ...]  # the input files, in the same order
    as_stored: bool  # whether columns are read exactly as they are stored


def clean_whole(job: Job, sensor: Sensor) -> Outcome:
    """Clean a sensor unless it is finished; an error is returned as the reason of a refusal, never raised.

    Parameters
    ----------
    job : Job
        The job over the lake.
    sensor : Sensor
        One sensor of the lake.
    """
    return refuse_on_error(sensor, lambda: _cleaned(job, sensor))


def refuse_on_error(sensor: Sensor, work: Callable[[], Done]) -> Done | Outcome:
    """Run a function on a sensor; if it fails, return a refusal with the reason, so that the job continues."""
    began = monotonic()
    try:
        return work()
    except BecalmError as cause:
        return refused(sensor.name, str(cause), monotonic() - began)
    except Exception as cause:  # damage that no check expects
        return refused(sensor.name, f"{type(cause).__name__}: {cause}", monotonic() - began)


def all_died(sensor: Sensor, why: str) -> Outcome:
    """Return the outcome of a sensor on which every worker died."""
    return refused(sensor.name, why)


def finished(job: Job, sensor: Sensor, hashed: str) -> Outcome | None:
    """Return the outcome of a sensor whose output exists and has the same input hash; otherwise None."""
    mark = CompletionMark.of(job.mark_of(sensor))
    if mark is None or mark.came_of != hashed or not mark.is_whole(job.output_folder(sensor)):
        return None
    if mark.job == job.own:  # finished in this job, in a stage that Spark gave up because of another sensor
        return mark.outcome
    channels = tuple(replace(row, state="kept") for row in mark.outcome.channels)
    return replace(mark.outcome, state="kept", channels=channels, took_s=0.0)


def hash_of(job: Job, sensor: Sensor) -> str:
    """Return the hash of everything that determines a sensor's output: files, recipe and options.

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
    """Open a sensor with the options of its recipe. The caller closes the source.

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
    raw, options = select_table(place, tables, options)
    source = open_table(place, raw, options)
    try:
        for name in options.channels or ():
            if name + VERDICT in source.schema.names:
                raise InputError(f"{place} has a column {name + VERDICT!r}, which becalm writes; rename that column.")
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
    parts = opened(job, sensor)
    names = tuple(piece.name for piece in parts.pieces)
    with parts.source as source:
        refuse_foreign(job, sensor, names)
        with staging(job.output_folder(sensor)) as staged:
            with Pieces(staged, parts.pieces, metadata_of(parts.recipe)) as out:
                reports = clean_chunks(source, parts.recipe, out.write, lambda *_: None, verdicts=True)
            outcome = outcome_of(sensor, reports, source, monotonic() - began)
            commit(job, sensor, staged, CompletionMark(hashed, names, outcome, job=job.own))
    return outcome


def refuse_foreign(job: Job, sensor: Sensor, names: Sequence[str]) -> None:
    """Raise an error if a sensor's output would replace foreign files or leave the output folder.

    Raises
    ------
    OutputError
        If a file exists that becalm did not write, two output files have one name, or a link leads out of the output.
    """
    folder, mark = job.output_folder(sensor), CompletionMark.of(job.mark_of(sensor))
    if not folder.resolve().is_relative_to(Path(job.output).resolve()):
        raise OutputError(f"{folder} leads to {folder.resolve()}, out of the output; remove that link.")
    for name in names:
        place = (folder / name).parent
        if place.resolve() != folder.resolve() / Path(name).parent:
            raise OutputError(f"{place} leads to {place.resolve()}, out of the output; remove that link.")
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise OutputError(
            f"Two files of the sensor would both be written to {folder / twice[0]}; rename one of them in the lake."
        )
    own = set() if mark is None else mark.own
    if foreign := [name for name in names if name not in own and os.path.lexists(folder / name)]:
        raise OutputError(
            f"{folder / foreign[0]} exists already, and no mark shows that becalm wrote it; remove it, or name another"
            " output with -o."
        )


def metadata_of(recipe: Recipe) -> dict[str, str]:
    """Return the metadata of every output file: the recipe that made it."""
    return {"becalm.recipe": recipe.to_toml()}


def outcome_of(sensor: Sensor, reports: tuple[ChannelReport, ...], source: OpenSource, took_s: float) -> Outcome:
    """Return the outcome of a sensor that was cleaned."""
    shown = sensor.recipe[:SHOWN]
    rows = tuple(row_of(sensor.name, report, recipe=shown, rate_hz=source.rate_hz) for report in reports)
    return Outcome(sensor.name, "cleaned", noted(rows, notes_of(source)), took_s)


def notes_of(source: OpenSource) -> tuple[str, ...]:
    """Return sentences about a sensor's files and columns that its user must know."""
    replaced = ", ".join(source.replaced)
    return (*source.notes, *((f"Replaced by the new uncertainty: {replaced}.",) if replaced else ()))


def commit(job: Job, sensor: Sensor, staged: Path, mark: CompletionMark) -> None:
    """Move the files of a sensor into place, remove files of an older output, and write its completion mark last.

    Raises
    ------
    InputError
        If the input has changed since the work began.
    OutputError
        If a file cannot be moved or written, or is not one of becalm; the sensor is not finished then.
    """
    if hash_of(job, sensor) != mark.came_of:
        raise InputError(
            f"The files of {sensor.name} changed while they were read; wait until all have arrived, and repeat."
        )
    refuse_foreign(job, sensor, mark.files)
    path, folder = job.mark_of(sensor), job.output_folder(sensor)
    older = CompletionMark.of(path)
    own = {*mark.files, *(() if older is None else older.own)}
    with explain_write_errors(staged):
        sizes = tuple((staged / name).stat().st_size for name in mark.files)
    unfinished = replace(mark, came_of="", files=(), held=tuple(sorted(own)))  # until all files are in place
    unfinished.write(path)
    put_in_place(staged, folder, mark.files)
    for name in own - set(mark.files):
        with explain_write_errors(folder / name):
            (folder / name).unlink(missing_ok=True)
    replace(mark, sizes=sizes).write(path)
