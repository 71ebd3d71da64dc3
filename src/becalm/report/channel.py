"""Draw all figures of each channel, in the order of the report."""

from __future__ import annotations

from typing import NamedTuple

from becalm.cleaning.channels.report import ChannelReport, amount
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.steady.response import decibels
from becalm.identification.wishes.noise_against_lag import TradeOffCurve
from becalm.report.data.description import Figure
from becalm.report.gathering import Gathering
from becalm.report.innovation_figures import innovation_figures
from becalm.report.pictures import Title, closeup_figures, signal_figures, slug_of, spectrum_figure
from becalm.report.response_figures import Behaviour, behaviour_of, compute_trade_off, step_figure, trade_off_figure


class Pictured(NamedTuple):
    """The report and the figures of one channel."""

    report: ChannelReport
    words: str  # a sentence that describes its filter; empty if the channel passes unchanged
    wide: tuple[Figure, ...]  # figures over time
    narrow: tuple[Figure, ...]  # all other figures, which are placed side by side


class CleanedChannels(NamedTuple):
    """Cleaned channels that share one time axis, with the data gathered for their figures.

    Attributes
    ----------
    recipe : Recipe
        Recipe that the channels were cleaned with.
    reports : tuple of ChannelReport
        One report for each channel, in the order of the recipe's channels.
    gathering : Gathering
        Data for the figures, gathered during cleaning.
    step_s : float
        Time between two rows, in seconds.
    group : str
        Name of this time axis in the file; "" if the file has only one.
    """

    recipe: Recipe
    reports: tuple[ChannelReport, ...]
    gathering: Gathering
    step_s: float
    group: str = ""

    @property
    def lasts_s(self) -> float:
        """Return the duration from the first row to one step after the last row, in seconds, with gaps."""
        times = self.gathering.times
        return float(times.high[-1] - times.low[0]) + self.step_s


class Pictures:
    """The figures of a cleaned recording, which are drawn channel by channel.

    Parameters
    ----------
    *times : CleanedChannels
        Channels of each time axis, in the order of the report.
    """

    def __init__(self, *times: CleanedChannels) -> None:
        self.times = times
        self._trade_off_curves: dict[float, TradeOffCurve] = {
            step_s: compute_trade_off(step_s) for step_s in {time.step_s for time in times}
        }
        self._places = [(time, number) for time in times for number in range(len(time.reports))]

    def __len__(self) -> int:
        """Return the number of channels."""
        return len(self._places)

    @property
    def reports(self) -> tuple[ChannelReport, ...]:
        """Return the report of each channel."""
        return tuple(time.reports[number] for time, number in self._places)

    def channel(self, number: int) -> Pictured:
        """Draw one channel; the first channel has number 0."""
        (recipe, reports, gathering, step_s, _), own = self._places[number]
        report, gathered = reports[own], gathering.channels[own]
        title = Title(slug_of(number, report.name), report.name, report.unit)
        behaviour = behaviour_of(recipe.channel[own], report, recipe, step_s)
        close = closeup_figures(title, gathered) if gathering.rows_each > 1 else ()
        narrow = (
            spectrum_figure(title, gathered),
            trade_off_figure(title, behaviour, self._trade_off_curves[step_s], recipe.mode),
            step_figure(title, behaviour, recipe, step_s),
            *innovation_figures(title, gathering.nis_times, report.lagged, gathered.nis, 1 / step_s),
        )
        return Pictured(
            report,
            _words(behaviour, recipe.mode),
            (*signal_figures(title, gathering.times, gathered), *close),
            tuple(figure for figure in narrow if figure is not None),
        )


def _words(behaviour: Behaviour, mode: str) -> str:
    """Return a sentence that describes the filter.

    The text is empty if the filter passes all readings unchanged, has no steady state, or is unknown.
    """
    delay_s, noise_std = behaviour.report.delay_s, behaviour.report.noise_std
    if mode == "lagged" and delay_s is not None:
        left = behaviour.noise_left(delay_s)
        if left is None or not noise_std:
            return ""
        return f"With a delay of {amount(delay_s, 's')}, noise is down {-decibels((left / noise_std) ** 2):.1f} dB."
    if behaviour.response is None:
        return ""
    where = "In its most frequent mode, the filter" if behaviour.report.modes else "The filter"
    return f"{where} is {behaviour.response}."
