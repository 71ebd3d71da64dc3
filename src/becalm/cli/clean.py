"""Clean a file: check all options first, then write all outputs or none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cleaning.pipeline import fitted, in_mode, joined
from becalm.cleaning.tuning import with_new_tares
from becalm.cli.messages import print_bands, print_not_removed, print_reports, progress
from becalm.cli.opened_file import is_same, load, open_every, recipe_path_of, refuse_overwriting, refuse_taken, tuned
from becalm.cli.report_files import Done, Picturing
from becalm.cli.times import pass_through, print_times, refuse_times, timed
from becalm.errors import UsageError
from becalm.files.atomic_file import refuse_unwritable, staged_text
from becalm.files.chunked_cleaning import clean_chunks
from becalm.files.registry import format_to_write
from becalm.files.writing import open_output, refuse_columns

if TYPE_CHECKING:
    from becalm.cleaning.recipe import Recipe
    from becalm.cli.opened_file import FileOptions
    from becalm.cli.options import FilterOptions
    from becalm.files.opening import OpenSource


class CleanOptions(NamedTuple):
    """The options for the filters."""

    recipe: Path | None
    causal: bool
    lag_s: float | None
    asked: FilterOptions


class Outputs(NamedTuple):
    """The options for the outputs."""

    output: Path
    split: bool
    verdicts: bool
    report: Path | None
    figures: str | None

    @property
    def recipe(self) -> Path:
        """Return the path of the recipe."""
        return recipe_path_of(self.output)


def run(file: Path, said: FileOptions, asking: CleanOptions, outputs: Outputs, *, as_json: bool) -> bool:
    """Clean a file; return whether the model of every channel describes its signal."""
    output, recipe_path, filters = outputs.output, outputs.recipe, asking.asked
    if asking.recipe is not None and filters.anything:
        raise UsageError("A recipe already has its filters; give either --recipe, or options for new filters.")
    picturing = Picturing(output, outputs.report, outputs.figures)
    format_to_write(output)
    refuse_overwriting(file, output, recipe_path)
    picturing.refuse_overwriting(file, asking.recipe)
    refuse_unwritable(output, recipe_path, *picturing.paths)
    given = load(asking.recipe)
    said = said if given is None else said.or_as(given)
    with open_every(file, said) as opened:
        sources = opened.sources
        refuse_times(output, [source.group for source in sources])
        for source in sources:
            refuse_columns(output, source.schema)
        recipes = [_recipe_for(source, said, asking, given) for source in sources]
        recipe = joined(recipes)
        for source in sources:
            refuse_taken(recipe, source.schema.names, split=outputs.split, verdicts=outputs.verdicts)
        if asking.recipe is not None and is_same(recipe_path, asking.recipe) and recipe != given:
            raise UsageError(f"{recipe_path} is the given recipe and would change; give another output with -o.")
        text, gatherings = recipe.to_toml(), picturing.gatherings(sources, recipes)
        done: list[Done] = []
        with (
            staged_text(recipe_path, text),
            open_output(output, {"becalm.recipe": text}) as out,
            progress("cleaning", sum(source.rows for source in sources)) as step,
        ):
            for source, part, gathering in zip(sources, recipes, gatherings, strict=True):
                part_reports = clean_chunks(
                    source,
                    part,
                    timed(output, source, out.write),
                    step,
                    split=outputs.split,
                    verdicts=outputs.verdicts,
                    gathering=gathering,
                )
                done.append(Done(source, part, part_reports, gathering))
            pass_through(output, opened, out.write)
        reports = tuple(report for one in done for report in one.reports)
        print_reports(reports, recipe.mode == "causal")
        print_not_removed(reports, filters.removed_hz)
        print_times(output, opened)
        for source in sources:
            print_bands(source, reports)
        times = [{"group": one.group, "rows": one.rows, "rate_hz": one.rate_hz} for one in sources]
        typer.echo(f"Wrote {output} and {recipe_path}.", err=True)
        drawn = picturing.draw(recipe, done)
    describes = all(report.describes for report in reports)
    if as_json:
        summary = {
            "file": str(file),
            "output": str(output),
            "recipe": str(recipe_path),
            **drawn,
            **({"rows": times[0]["rows"], "rate_hz": times[0]["rate_hz"]} if len(times) == 1 else {"times": times}),
            "mode": recipe.mode,
            "describes": describes,
            "channels": [report.as_dict() for report in reports],
        }
        print(json.dumps(summary, indent=2))  # noqa: T201
    if not describes:
        typer.echo(
            "The output is written, but some models do not describe their channels: leave those channels out with"
            f" --channels, or look at them with: becalm inspect {file}",
            err=True,
        )
    return describes


def _recipe_for(source: OpenSource, file_options: FileOptions, options: CleanOptions, given: Recipe | None) -> Recipe:
    """Return the recipe for a file: the given one, or one that is tuned on the file."""
    recipe = tuned(source, options.causal, options.asked, options.lag_s) if given is None else given
    wanted = in_mode(recipe, options.causal or None, options.lag_s)
    names = source.names if file_options.channels or source.group else None
    chosen = fitted(wanted, source.names, source.units, channels=names)
    return file_options.with_time_options(
        chosen.model_copy(update={"channel": with_new_tares(chosen.channel, source.calibrations)})
    )
