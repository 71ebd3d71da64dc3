"""A file cleaned: what is asked is checked first, then all of it is written, or nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cleaning.calibrating import tared_anew
from becalm.cleaning.pipeline import fitted, in_mode, joined
from becalm.cli.messages import progress, tell, tell_bands, tell_not_removed
from becalm.cli.opened_file import is_same, load, open_every, recipe_beside, refuse_overwriting, refuse_taken, tuned
from becalm.cli.report_files import Done, Picturing
from becalm.cli.times import pass_through, refuse_times, tell_times, timed
from becalm.errors import UsageError
from becalm.files.chunked_cleaning import clean_chunks
from becalm.files.registry import format_to_write
from becalm.files.text_file import refuse_unwritable, text_in_waiting
from becalm.files.writing import open_output, refuse_columns

if TYPE_CHECKING:
    from becalm.cleaning.recipe import Recipe
    from becalm.cli.opened_file import Said
    from becalm.cli.options import FilterOptions
    from becalm.files.opening import OpenSource


class CleanOptions(NamedTuple):
    """What is asked of the filters."""

    recipe: Path | None
    causal: bool
    lag_s: float | None
    asked: FilterOptions


class Outputs(NamedTuple):
    """What is to be written."""

    output: Path
    split: bool
    verdicts: bool
    report: Path | None
    figures: str | None

    @property
    def recipe(self) -> Path:
        """Where the recipe goes."""
        return recipe_beside(self.output)


def run(file: Path, said: Said, asking: CleanOptions, outputs: Outputs, *, as_json: bool) -> bool:
    """Clean a file; return whether every channel is described by its model."""
    output, beside, asked = outputs.output, outputs.recipe, asking.asked
    if asking.recipe is not None and asked.anything:
        raise UsageError("A recipe has its filters already; leave --recipe out to ask for others, or ask for nothing.")
    picturing = Picturing(output, outputs.report, outputs.figures)
    format_to_write(output)
    refuse_overwriting(file, output, beside)
    picturing.refuse_overwriting(file, asking.recipe)
    refuse_unwritable(output, beside, *picturing.paths)
    given = load(asking.recipe)
    said = said if given is None else said.or_as(given)
    with open_every(file, said) as opened:
        sources = opened.sources
        refuse_times(output, [source.group for source in sources])
        for source in sources:
            refuse_columns(output, source.schema)
        recipes = [_decided(source, said, asking, given) for source in sources]
        recipe = joined(recipes)
        for source in sources:
            refuse_taken(recipe, source.schema.names, split=outputs.split, verdicts=outputs.verdicts)
        if asking.recipe is not None and is_same(beside, asking.recipe) and recipe != given:
            raise UsageError(f"{beside} is the recipe itself and would change; name another output with -o.")
        text, gatherings = recipe.to_toml(), picturing.gatherings(sources, recipes)
        done: list[Done] = []
        with (
            text_in_waiting(beside, text),
            open_output(output, {"becalm.recipe": text}) as out,
            progress("cleaning", sum(source.rows for source in sources)) as step,
        ):
            for source, part, gathering in zip(sources, recipes, gatherings, strict=True):
                found = clean_chunks(
                    source,
                    part,
                    timed(output, source, out.write),
                    step,
                    split=outputs.split,
                    verdicts=outputs.verdicts,
                    gathering=gathering,
                )
                done.append(Done(source, part, found, gathering))
            pass_through(output, opened, out.write)
        reports = tuple(report for one in done for report in one.reports)
        tell(reports, recipe.mode == "causal")
        tell_not_removed(reports, asked.removed_hz)
        tell_times(output, opened)
        for source in sources:
            tell_bands(source, reports)
        times = [{"group": one.group, "rows": one.rows, "rate_hz": one.rate_hz} for one in sources]
        typer.echo(f"Wrote {output} and {beside}.", err=True)
        drawn = picturing.draw(recipe, done)
    describes = all(report.describes for report in reports)
    if as_json:
        summary = {
            "file": str(file),
            "output": str(output),
            "recipe": str(beside),
            **drawn,
            **({"rows": times[0]["rows"], "rate_hz": times[0]["rate_hz"]} if len(times) == 1 else {"times": times}),
            "mode": recipe.mode,
            "describes": describes,
            "channels": [report.as_dict() for report in reports],
        }
        print(json.dumps(summary, indent=2))  # noqa: T201
    if not describes:
        typer.echo(
            "The output is written, but not every channel is described by its model: leave those out with"
            f" --channels, or look at them with: becalm inspect {file}",
            err=True,
        )
    return describes


def _decided(source: OpenSource, said: Said, asking: CleanOptions, given: Recipe | None) -> Recipe:
    """Return what to do with a file: as the recipe says that was given, or as one says that is found."""
    found = tuned(source, asking.causal, asking.asked, asking.lag_s) if given is None else given
    decided = in_mode(found, asking.causal or None, asking.lag_s)
    named = source.names if said.channels or source.group else None
    fit = fitted(decided, source.names, source.units, channels=named)
    return said.kept_in(fit.model_copy(update={"channel": tared_anew(fit.channel, source.calibrations)}))
