"""Clean one sensor in one task, chunk by chunk; `fleet.batch` runs these tasks on Spark."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import NamedTuple, TypeVar

from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.pipeline import fit_to_recording
from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import BecalmError, InputError, OutputError
from becalm.files.atomic_file import explain_write_errors
from becalm.files.inputs.opening import OpenSource, open_table, select_table
from becalm.files.lake.folder import FolderRows
from becalm.files.outputs.chunked_cleaning import clean_chunks
from becalm.files.outputs.tables import VERDICT
from becalm.files.read_options import options_of_recipe
from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark, hash_input
from becalm.fleet.outcome import SHOWN, Outcome, noted, refused
from becalm.fleet.pieces import OutputFile, Pieces, put_in_place, staging
from becalm.report.fleet.fleet_rows import row_of

Done = TypeVar("Done")


class OpenedSensor(NamedTuple):
    """A sensor whose files are open and whose columns match its recipe."""

    source: OpenSource
    recipe: Recipe  # fitted to the sensor's channels
    pieces: tuple[OutputFile, ...]  # the output files, one for each input file, in order
    paths: tuple[Path, ...]  # the input files, in the same order
    as_stored: bool  # whether columns are read exactly as they are stored


def clean_whole(job: Job, sensor: Sensor) -> Outcome:
    """Clean a sensor unless its output is up to date; return a refusal with the reason after an error, raise nothing.

    Parameters
    ----------
    job : Job
        The job over the lake.
    sensor : Sensor
        One sensor of the lake.
    """
    return refuse_on_error(sensor, lambda: _clean(job, sensor))


def refuse_on_error(sensor: Sensor, work: Callable[[], Done]) -> Done | Outcome:
    """Call `work`, which processes a sensor; after an error, return a refusal with the reason; the job continues."""
    began = monotonic()
    try:
        return work()
    except BecalmError as cause:
        return refused(sensor.name, str(cause), monotonic() - began)
    except Exception as cause:  # file damage that no check detects
        return refused(sensor.name, f"{type(cause).__name__}: {cause}", monotonic() - began)


def report_lost_sensor(sensor: Sensor, why: str) -> Outcome:
    """Return the refusal of a sensor on which every worker died."""
    return refused(sensor.name, why)


def finished(job: Job, sensor: Sensor, hashed: str) -> Outcome | None:
    """Return the outcome of a sensor whose output exists and was made from the same input; otherwise None."""
    mark = CompletionMark.of(job.mark_of(sensor))
    if mark is None or mark.input_hash != hashed or not mark.is_whole(job.output_folder(sensor)):
        return None
    if mark.job == job.job_id:  # finished by this job, in an attempt that failed because of another sensor
        return mark.outcome
    channels = tuple(replace(row, state="kept") for row in mark.outcome.channels)
    return replace(mark.outcome, state="kept", channels=channels, took_s=0.0)


def hash_of(job: Job, sensor: Sensor) -> str:
    """Return the hash of everything that determines a sensor's output: files, recipe and options.

    Raises
    ------
    InputError
        If the sensor's files cannot be listed or read.
    """
    if sensor.input_hash:
        return sensor.input_hash
    files = [(job.name_of(sensor, path), path) for path in job.files_of(sensor)]
    return hash_input(files, job.recipes[sensor.recipe], job.asked)


def open_sensor(job: Job, sensor: Sensor) -> OpenedSensor:
    """Open a sensor with the options of its recipe. The caller closes the source.

    Raises
    ------
    BecalmError
        If the sensor cannot be read, or its recipe does not match its channels.
    """
    place, recipe = job.input_of(sensor), job.recipe_of(sensor)
    options = options_of_recipe(recipe, job.tune_command)
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
        return OpenedSensor(
            source, fit_to_recording(recipe, source.names, source.units), pieces, paths, raw.rows is rows
        )
    except BaseException:
        source.close()
        raise


def _clean(job: Job, sensor: Sensor) -> Outcome:
    began, hashed = monotonic(), hash_of(job, sensor)
    kept = finished(job, sensor, hashed)
    if kept is not None:
        return kept
    parts = open_sensor(job, sensor)
    names = tuple(piece.name for piece in parts.pieces)
    with parts.source as source:
        refuse_foreign(job, sensor, names)
        with staging(job.output_folder(sensor)) as staged:
            with Pieces(staged, parts.pieces, metadata_of(parts.recipe)) as out:
                reports = clean_chunks(source, parts.recipe, out.write, lambda *_: None, verdicts=True)
            outcome = outcome_of(sensor, reports, source, monotonic() - began)
            commit(job, sensor, staged, CompletionMark(hashed, names, outcome, job=job.job_id))
    return outcome


def refuse_foreign(job: Job, sensor: Sensor, names: Sequence[str]) -> None:
    """Raise an error if a sensor's output would replace foreign files or leave the output folder.

    Raises
    ------
    OutputError
        If an output file already exists and becalm did not write it, two output files have the same name, or a link
        leads out of the output.
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
    # Where names differ in case only, the folder may be another sensor's.
    own = mark.own if mark is not None and mark.outcome.sensor == sensor.name else set()
    if foreign := [name for name in names if name not in own and os.path.lexists(folder / name)]:
        raise OutputError(
            f"{folder / foreign[0]} exists already, and no mark shows that becalm wrote it; remove it, or name another"
            " output with -o."
        )


def metadata_of(recipe: Recipe) -> dict[str, str]:
    """Return the metadata of every output file: the recipe that it was cleaned with."""
    return {"becalm.recipe": recipe.to_toml()}


def outcome_of(sensor: Sensor, reports: tuple[ChannelReport, ...], source: OpenSource, took_s: float) -> Outcome:
    """Return the outcome of a cleaned sensor."""
    shown = sensor.recipe[:SHOWN]
    rows = tuple(row_of(sensor.name, report, recipe=shown, rate_hz=source.rate_hz) for report in reports)
    return Outcome(sensor.name, "cleaned", noted(rows, notes_of(source)), took_s)


def notes_of(source: OpenSource) -> tuple[str, ...]:
    """Return sentences for the report about a sensor's files and replaced columns."""
    replaced = ", ".join(source.replaced)
    return (*source.notes, *((f"Replaced by the new uncertainty: {replaced}.",) if replaced else ()))


def commit(job: Job, sensor: Sensor, staged: Path, mark: CompletionMark) -> None:
    """Move the files of a sensor into its output folder, remove files of an older output, and write its mark last.

    Raises
    ------
    InputError
        If the input has changed since it was hashed.
    OutputError
        If a file cannot be moved or written, or a foreign file has its name; the sensor then has no valid mark.
    """
    if hash_of(job, sensor) != mark.input_hash:
        raise InputError(
            f"The files of {sensor.name} changed while they were read; wait until all have arrived, and repeat."
        )
    refuse_foreign(job, sensor, mark.files)
    path, folder = job.mark_of(sensor), job.output_folder(sensor)
    older = CompletionMark.of(path)
    own = {*mark.files, *(() if older is None else older.own)}
    with explain_write_errors(staged):
        sizes = tuple((staged / name).stat().st_size for name in mark.files)
    unfinished = replace(mark, input_hash="", files=(), held=tuple(sorted(own)))  # the mark while files are moved
    unfinished.write(path)
    put_in_place(staged, folder, mark.files)
    for name in own - set(mark.files):
        with explain_write_errors(folder / name):
            (folder / name).unlink(missing_ok=True)
    replace(mark, sizes=sizes).write(path)
