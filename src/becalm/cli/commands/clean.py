"""Clean a file: check all options, write the clean file and its recipe together, then the report and the figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cleaning.pipeline import fit_to_recording, in_mode, join_recipes
from becalm.cleaning.tuning import with_new_tares
from becalm.cli.messages import print_bands, print_not_removed, print_reports, progress
from becalm.cli.opened_file import (
    is_same,
    load,
    open_every,
    recipe_path_of,
    refuse_existing_columns,
    refuse_overwriting,
    tuned,
)
from becalm.cli.report_files import CleanedSource, ReportWriter
from becalm.cli.times import copy_other_groups, print_time_bases, refuse_several_time_bases, with_time_column
from becalm.errors import UsageError
from becalm.files.atomic_file import refuse_unwritable, staged_text
from becalm.files.outputs.chunked_cleaning import clean_chunks
from becalm.files.outputs.writing import open_output, refuse_columns
from becalm.files.registry import format_to_write

if TYPE_CHECKING:
    from collections.abc import Sequence

    from becalm.cleaning.channels.report import ChannelReport
    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.cli.opened_file import FileOptions
    from becalm.cli.options import FilterOptions
    from becalm.files.inputs.opening import OpenSource


class CleanOptions(NamedTuple):
    """The given recipe, or the options for tuning one."""

    recipe: Path | None
    causal: bool
    lag_s: float | None
    filters: FilterOptions


class Outputs(NamedTuple):
    """The options for the outputs."""

    output: Path
    split: bool
    verdicts: bool
    report: Path | None
    figures: str | None

    @property
    def recipe_path(self) -> Path:
        """Return the path of the recipe that is written next to the output."""
        return recipe_path_of(self.output)


def run(file: Path, file_options: FileOptions, options: CleanOptions, outputs: Outputs, *, as_json: bool) -> bool:
    """Clean a file; return whether the model of every channel describes its signal."""
    output, recipe_path, filters = outputs.output, outputs.recipe_path, options.filters
    if options.recipe is not None and filters.anything:
        raise UsageError("A recipe already has its filters; give either --recipe, or options for new filters.")
    reporting = ReportWriter(output, outputs.report, outputs.figures)
    format_to_write(output)
    refuse_overwriting(file, output, recipe_path)
    reporting.refuse_overwriting(file, options.recipe)
    refuse_unwritable(output, recipe_path, *reporting.paths)
    given = load(options.recipe)
    if given is not None:
        file_options = file_options.with_defaults_of(given)
    with open_every(file, file_options) as opened:
        sources = opened.sources
        refuse_several_time_bases(output, [source.group for source in sources])
        for source in sources:
            refuse_columns(output, source.schema)
        source_recipes = [_recipe_for(source, file_options, options, given) for source in sources]
        recipe = join_recipes(source_recipes)
        for source in sources:
            refuse_existing_columns(recipe, source.schema.names, split=outputs.split, verdicts=outputs.verdicts)
        if options.recipe is not None and is_same(recipe_path, options.recipe) and recipe != given:
            raise UsageError(f"{recipe_path} is the given recipe and would change; give another output with -o.")
        text, gatherings = recipe.to_toml(), reporting.gatherings(sources, source_recipes)
        done: list[CleanedSource] = []
        with (
            staged_text(recipe_path, text),
            open_output(output, {"becalm.recipe": text}) as out,
            progress("cleaning", sum(source.rows for source in sources)) as step,
        ):
            for source, part, gathering in zip(sources, source_recipes, gatherings, strict=True):
                part_reports = clean_chunks(
                    source,
                    part,
                    with_time_column(output, source, out.write),
                    step,
                    split=outputs.split,
                    verdicts=outputs.verdicts,
                    gathering=gathering,
                )
                done.append(CleanedSource(source, part, part_reports, gathering))
            copy_other_groups(output, opened, out.write)
        reports = tuple(report for one in done for report in one.reports)
        print_reports(reports, recipe.mode == "causal")
        print_not_removed(reports, filters.removed_hz)
        print_time_bases(output, opened)
        for source in sources:
            print_bands(source, reports)
        typer.echo(f"Wrote {output} and {recipe_path}.", err=True)
        drawn = reporting.draw(recipe, done)
    describes = all(report.describes for report in reports)
    if as_json:
        files = {"file": str(file), "output": str(output), "recipe": str(recipe_path), **drawn}
        print(json.dumps(files | _summary(recipe, sources, reports), indent=2))  # noqa: T201
    if not describes:
        typer.echo(
            "The output is written, but some models do not describe their channels: leave those channels out with"
            f" --channels, or look at them with: becalm inspect {file}",
            err=True,
        )
    return describes


def _summary(recipe: Recipe, sources: Sequence[OpenSource], reports: Sequence[ChannelReport]) -> dict[str, object]:
    """Return the facts about the recording and the reports of its channels, for JSON."""
    times = [{"group": one.group, "rows": one.rows, "rate_hz": one.rate_hz} for one in sources]
    return {
        **({"rows": times[0]["rows"], "rate_hz": times[0]["rate_hz"]} if len(times) == 1 else {"times": times}),
        "mode": recipe.mode,
        "describes": all(report.describes for report in reports),
        "channels": [report.as_dict() for report in reports],
    }


def _recipe_for(source: OpenSource, file_options: FileOptions, options: CleanOptions, given: Recipe | None) -> Recipe:
    """Return the recipe for one time base: the given recipe, or a recipe tuned on this time base."""
    recipe = tuned(source, options.causal, options.filters, options.lag_s) if given is None else given
    wanted = in_mode(recipe, options.causal or None, options.lag_s)  # without --causal, the recipe's mode is used
    # A recipe may have channels of other time bases; `names` selects those of this one.
    names = source.names if file_options.channels or source.group else None
    chosen = fit_to_recording(wanted, source.names, source.units, channels=names)
    return file_options.with_time_options(
        chosen.model_copy(update={"channel": with_new_tares(chosen.channel, source.calibrations)})
    )
