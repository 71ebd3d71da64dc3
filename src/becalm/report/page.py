"""Make the report on a recording: one self-contained HTML page that needs no network."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import NamedTuple

from jinja2 import Environment

from becalm.cleaning.channels.report import ChannelReport, amount, cells
from becalm.cleaning.recipes.recipe import Recipe
from becalm.installation import version
from becalm.report.channel import CleanedChannels, Pictured, Pictures
from becalm.report.data.description import Figure
from becalm.report.data.payload import payload
from becalm.report.embedding import asset, packed, script
from becalm.report.printing import can_print, printed
from becalm.report.vendor import uplot

MOST_PICTURED = 8
"""Largest number of channels with figures, so that a page stays small; the table lists all channels."""

_HEADINGS = ("model", "noise", "bandwidth", "lag", "described by its model")
_TONES = {"fits": "fits", "fits except": "except", "does not fit": "not"}
_HASH_SHOWN = 16  # hexadecimal digits


@dataclass(frozen=True)
class Facts:
    """Facts about a recording for the head of its report.

    Attributes
    ----------
    name : str
        Name of the file, or of the recording if it is not a file.
    sha256 : str
        Hash of the file; empty if the recording is not a file.
    """

    name: str
    sha256: str = ""


class Cells(NamedTuple):
    """A table of text."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class Addition(NamedTuple):
    """Additional tables and figures in the section of a channel."""

    tables: tuple[Cells, ...] = ()
    wide: tuple[Figure, ...] = ()
    narrow: tuple[Figure, ...] = ()


class _Line(NamedTuple):
    """A row of the table of channels."""

    anchor: str  # id of the channel's section; "" if it has none
    name: str
    cells: tuple[str, ...]
    tone: str  # CSS class of the verdict; "" for none


class _Section(NamedTuple):
    """The section of the page about one channel."""

    anchor: str  # id of its element
    name: str
    tone: str  # CSS class of the verdict; "" for none
    says: str  # the judgement
    words: str  # a sentence that describes the filter
    tables: tuple[Cells, ...]
    numbers: tuple[tuple[str, str], ...]  # names and values
    figures: tuple[tuple[Figure, str, str], ...]  # each with "wide" or "narrow", and its zoom group
    printed: tuple[str, ...]  # SVG figures for print, packed


def page_of(
    facts: Facts,
    recipe: Recipe,
    pictures: Pictures,
    additions: Sequence[Addition] = (),
) -> str:
    """Return the report on a cleaned recording, as HTML.

    Parameters
    ----------
    facts : Facts
        Facts about the recording.
    recipe : Recipe
        Recipe that the recording was cleaned with.
    pictures : Pictures
        Figures of the channels.
    additions : sequence of Addition
        Additional tables and figures, one item for each channel; none by default.

    Raises
    ------
    BecalmError
        If uPlot is absent, because becalm was never installed.
    """
    reports = pictures.reports
    numbers = _channels_to_draw(reports)
    drawn = {number: pictures.channel(number) for number in numbers}
    sections = [_section(drawn[number], number, additions[number] if additions else Addition()) for number in numbers]
    uplot_js, uplot_css = uplot()
    template = Environment(autoescape=True).from_string(asset("page.html"))
    return template.render(
        facts=facts,
        version=version(),
        lead=_lead(reports),
        fact_lines=_fact_lines(facts, recipe, pictures.times),
        headings=_HEADINGS,
        lines=[_line(report, number, number in drawn, recipe.mode) for number, report in enumerate(reports)],
        left_out=_left_out(len(reports) - len(numbers)),
        sections=sections,
        recipe=recipe.model_copy(update={"channel": tuple(recipe.channel[number] for number in numbers)}).to_toml(),
        versions=_versions(),
        payload=payload([figure for section in sections for figure, _, _ in section.figures]),
        uplot_css=uplot_css,
        uplot_js=uplot_js,
        css=asset("figures.css") + asset("page.css"),
        js=script("colours.js", "numbers.js", "axes.js", "figures.js", "page.js"),
    )


def _channels_to_draw(reports: Sequence[ChannelReport]) -> list[int]:
    """Return the indices of the channels to draw, in order; prefer channels that their models do not describe."""
    first = sorted(range(len(reports)), key=lambda number: reports[number].describes)
    return sorted(first[:MOST_PICTURED])


def _lead(reports: Sequence[ChannelReport]) -> str:
    described = sum(report.describes for report in reports)
    constant = sum(report.verdict == "constant" for report in reports)
    narrow = sum(report.verdict == "fits except" for report in reports)
    if constant == len(reports):
        return "Every channel is constant: its sigma is unknown."
    if described == len(reports):
        but = f" {constant} of {len(reports)} channels are constant; their sigma is unknown." if constant else ""
        near = f", except near some frequency in {narrow} of {len(reports)}: look at these" if narrow else ""
        return f"Every channel that changes is described by its model, as far as its readings show{near}.{but}"
    return (
        f"{len(reports) - described} of {len(reports)} channels are not described by their models: look at these"
        " before you trust their signal and sigma."
    )


def _fact_lines(facts: Facts, recipe: Recipe, times: Sequence[CleanedChannels]) -> list[tuple[str, str]]:
    mode = {
        "causal": "a filter: each estimate uses only the past",
        "smoothed": "a smoother: each estimate uses the whole record",
        "lagged": f"each estimate waits {amount(recipe.lag_s, 's')} for later readings",
    }
    lines = [*_time_lines(times), ("mode", mode[recipe.mode])]
    return [*lines, ("SHA-256 of the file", f"{facts.sha256[:_HASH_SHOWN]}…")] if facts.sha256 else lines


def _time_lines(times: Sequence[CleanedChannels]) -> list[tuple[str, str]]:
    values = [(f"{one.gathering.rows}", amount(1 / one.step_s, "Hz"), amount(one.lasts_s, "s")) for one in times]
    if len(values) == 1:
        return list(zip(("rows", "rate", "lasts"), values[0], strict=True))
    return [
        (one.group, f"{rows} rows at {rate}, lasts {lasts}")
        for one, (rows, rate, lasts) in zip(times, values, strict=True)
    ]


def _line(report: ChannelReport, number: int, is_drawn: bool, mode: str) -> _Line:
    anchor = _anchor(number) if is_drawn else ""
    return _Line(anchor, report.name, cells(report, mode == "causal"), _tone(report))


def _tone(report: ChannelReport) -> str:
    return _TONES.get(report.verdict, "")


def _anchor(number: int) -> str:
    return f"channel-{number + 1}"


def _left_out(count: int) -> str:
    if not count:
        return ""
    return f"Only the {MOST_PICTURED} channels that most need a look are drawn; the table lists {count} more."


def _section(drawn: Pictured, number: int, extra: Addition) -> _Section:
    report = drawn.report
    together = f"{_anchor(number)}-time"
    placed = [
        *((figure, "wide", together if _at_once(figure) else "") for figure in (*drawn.wide, *extra.wide)),
        *((figure, "narrow", "") for figure in (*drawn.narrow, *extra.narrow)),
    ]
    return _Section(
        _anchor(number),
        report.name,
        _tone(report),
        report.says,
        drawn.words,
        extra.tables,
        _numbers(report),
        tuple(placed),
        _draw_for_print(drawn, extra),
    )


def _at_once(figure: Figure) -> bool:
    """Return whether a figure shows the whole record over time; such figures of a channel zoom together."""
    return figure.name.endswith(("-signal", "-verdicts"))


def _numbers(report: ChannelReport) -> tuple[tuple[str, str], ...]:
    """Return the known numbers of a channel's report as text, each with its name."""
    values: list[tuple[str, float | None, str]] = [
        ("noise of a reading", report.noise_std, report.unit),
        ("bandwidth", report.bandwidth_hz, "Hz"),
        ("errors count as independent after", report.independence_s, "s"),
        ("innovations still predictable", _percent(report.predictable_share), "%"),
        ("which costs in rms error", _percent(report.excess_error), "%"),
        ("p-value of whiteness (Ljung-Box)", report.whiteness_p, ""),
        ("mean NIS, 1 is right", report.nis_mean, ""),
        ("sigma wrong by more than a factor of two", _percent(report.uneven_share), "% of the record"),
        ("calibration adds", report.calibration_std, report.unit),
        ("uncertain time widens sigma by up to", _percent(report.timing_share), "%"),
        ("log-likelihood", report.log_likelihood, ""),
    ]
    counts = ", ".join(f"{count} {name}" for name, count in report.verdicts.items() if count)
    numbers = [(term, amount(value, unit)) for term, value, unit in values if value is not None]
    return (*numbers, ("readings", counts))


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _draw_for_print(drawn: Pictured, extra: Addition) -> tuple[str, ...]:
    """Draw the same figures for print, if matplotlib is installed."""
    if not can_print():
        return ()
    sheets = (((*drawn.wide, *extra.wide), 1), ((*drawn.narrow, *extra.narrow), 2))
    return tuple(packed(_element(printed(figures, "svg", columns))) for figures, columns in sheets if figures)


def _element(svg: bytes) -> bytes:
    """Return the svg element of an SVG file, without the XML header."""
    return svg[svg.index(b"<svg") :]


def _versions() -> str:
    libraries = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "scipy"))
    return f"Made with becalm {version()}, {libraries}, Python {platform.python_version()}."
