"""Write the report and the figures of a file that is being cleaned."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast, get_args

import typer

from becalm.cli.opened_file import is_same, recipe_path_of, shown_name
from becalm.errors import OutputError, UsageError

if TYPE_CHECKING:
    from becalm.cleaning.channels.report import ChannelReport
    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.files.inputs.opening import OpenSource
    from becalm.report.channel import Pictures
    from becalm.report.gathering import Gathering
    from becalm.report.printing import Kind


class CleanedSource(NamedTuple):
    """One time base of a file, its recipe, and the results of cleaning it."""

    source: OpenSource
    recipe: Recipe
    reports: tuple[ChannelReport, ...]
    gathering: Gathering | None  # data for figures; None if nothing is drawn


_PAGES = (".html", ".htm")


class ReportWriter:
    """A writer of the report and the figures of a file. It imports libraries only if they are needed.

    Parameters
    ----------
    output : Path
        The clean file; the folder of figures is next to it.
    page : Path or None
        Path of the page; None for no page.
    kind : str or None
        Format of the figures; None for no figures.

    Attributes
    ----------
    paths : tuple of Path
        The page, if one will be written; figures are not included.

    Raises
    ------
    UsageError
        If the page is not an HTML file or equals another output, the kind is unknown, or matplotlib is not installed.
    OutputError
        If a file has the name of the folder for figures.
    BecalmError
        If uPlot is absent, because becalm was never installed.
    """

    def __init__(self, output: Path, page: Path | None, kind: str | None) -> None:
        self._page, self._folder = page, Path(f"{output}.figures")
        self._kind = None if kind is None else _checked_kind(kind)
        self.paths = () if page is None else (page,)
        if page is not None:
            from becalm.report.vendor import uplot

            if page.suffix.lower() not in _PAGES:
                better = page.with_suffix(".html")
                raise UsageError(f"The report is an HTML page, but {page} is not; write --report {better}")
            for other, what in ((output, "output"), (recipe_path_of(output), "recipe")):
                if page.resolve() == other.resolve():
                    raise UsageError(f"{page} is the {what} too; give the report another name.")
            uplot()
        if kind is not None and self._folder.exists() and not self._folder.is_dir():
            raise OutputError(
                f"Figures go into the folder {self._folder}, which is a file; name another output with -o."
            )

    def refuse_overwriting(self, file: Path, recipe: Path | None) -> None:
        """Raise an error if the page would overwrite an input.

        Raises
        ------
        UsageError
            If the page is the input, or the given recipe, even by another path.
        """
        for read, what in ((file, "input"), (recipe, "recipe")):
            if self._page is not None and read is not None and is_same(self._page, read):
                raise UsageError(f"{self._page} is the {what} itself; name another page with --report.")

    def gatherings(self, sources: Sequence[OpenSource], recipes: Sequence[Recipe]) -> list[Gathering | None]:
        """Return, for each time base, an object that gathers the data of its figures; None if nothing is drawn."""
        if self._page is None and self._kind is None:
            return [None] * len(sources)
        from becalm.report.gathering import Gathering
        from becalm.report.printing import load_meanwhile

        load_meanwhile()
        if self._page is not None:
            self._sha256 = ThreadPoolExecutor(1).submit(sources[0].sha256)
        return [
            Gathering(source.rows, source.clock.step_s, len(recipe.channel))
            for source, recipe in zip(sources, recipes, strict=True)
        ]

    def draw(self, recipe: Recipe, done: Sequence[CleanedSource]) -> dict[str, str]:
        """Write the report and the figures of all time bases; print their paths, and return them for JSON.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        if self._page is None and self._kind is None:
            return {}
        from becalm.files.atomic_file import write_text
        from becalm.report.channel import CleanedChannels, Pictures
        from becalm.report.page import Facts, page_of

        times = [
            CleanedChannels(one.recipe, one.reports, one.gathering, one.source.clock.step_s, one.source.group)
            for one in done
            if one.gathering is not None
        ]
        pictures = Pictures(*times)
        drawn = {}
        if self._page is not None:
            facts = Facts(shown_name(done[0].source.path), self._sha256.result())
            write_text(self._page, page_of(facts, recipe, pictures))
            drawn["report"] = str(self._page)
            typer.echo(f"Wrote {self._page}.", err=True)
        if self._kind is not None:
            count = self._print(pictures, self._kind)
            drawn["figures"] = str(self._folder)
            typer.echo(f"Drew {count} figures into {self._folder}.", err=True)
        return drawn

    def _print(self, pictures: Pictures, kind: Kind) -> int:
        from becalm.files.atomic_file import make_folder, write_bytes
        from becalm.report.printing import printed

        make_folder(self._folder)
        older, count = {path.name for path in self._folder.iterdir()}, 0
        for number in range(len(pictures)):
            drawn = pictures.channel(number)
            for figure in (*drawn.wide, *drawn.narrow):
                name = f"{figure.name}.{kind}"
                write_bytes(self._folder / name, printed([figure], kind))
                older.discard(name)
                count += 1
        if older:
            typer.echo(f"{len(older)} more files in {self._folder} are not from this run; remove it first.", err=True)
        return count


def _checked_kind(kind: str) -> Kind:
    from becalm.report.printing import Kind, refuse_unprintable

    *others, last = get_args(Kind)
    if kind not in (*others, last):
        raise UsageError(f"--figures {kind} is unknown; write --figures {', '.join(others)} or {last}.")
    refuse_unprintable()
    return cast("Kind", kind)
