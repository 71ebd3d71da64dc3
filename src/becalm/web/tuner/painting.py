"""Compute the frames for a page: pictures, dial positions, a classic filter, cost maps."""

from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.dial_positions import density_unit, dial, summary_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import Integers
from becalm.core.reading_verdicts import Verdict
from becalm.report.data.envelope import Envelope
from becalm.web.frames import frame, relative
from becalm.web.tuner.comparing import run_classic
from becalm.web.tuner.costs import cost_map
from becalm.web.tuner.opened import OpenRecording
from becalm.web.tuner.picture import LONG, CleanCurve, RawCurve, View, clean_of, raw_of, view_of

_MOST_RAW = 8  # number of views whose readings are cached
_DECIBEL = 10.0  # decibels of a factor of 10 in power


class PictureRequest(NamedTuple):
    """A request for a picture: the channel, its recipe and the span of time that a page shows."""

    opened: OpenRecording
    channel: int
    recipe: ChannelRecipe
    lag: int | None
    span_s: tuple[float, float]
    width: int
    answers: int
    classic: str | None = None
    hurried: bool = False  # whether to be fast, see `Painter.picture`
    setting: list[object] | None = None  # the setting in the form for a page

    @property
    def dial_key(self) -> tuple[object, ...]:
        """Return the key of the dial: a frame with its positions is sent when the key changes."""
        recipe = self.recipe
        return self.channel, recipe.order, recipe.noise_std, self.lag, recipe.model, recipe.limits

    @property
    def judged_key(self) -> tuple[object, ...]:
        """Return the key of the figures of the whole record: they are computed and sent again when the key changes."""
        return self.channel, self.recipe, self.lag, self.setting


class PaintedPicture(NamedTuple):
    """A finished picture, with the data for adding the curve of a classic filter."""

    header: dict[str, Any]
    view: View
    raw: RawCurve
    clean: CleanCurve

    def framed(self, classic: Envelope | None = None) -> bytes:
        """Return the picture as a frame, with the output of a classic filter if there is one."""
        drawn = {"raw": self.raw.readings, "clean": self.clean.signal, "band": self.clean.band}
        drawn |= {} if classic is None else {"classic": classic}
        arrays: dict[str, Any] = {"t": self.raw.times_s}
        for name, of in drawn.items():
            arrays |= {f"{name}_low": relative(of.low), f"{name}_high": relative(of.high)}
        return frame(self.header, arrays | {"verdicts": self.clean.verdicts})


class _Gated(NamedTuple):
    """The rows of a channel without the spikes that its gate rejected in the whole record."""

    spikes: Integers
    limits: LimitsRecipe | None
    rows: ChannelRows


class Painter:
    """Computes pictures, and caches data that the next pictures need.

    Parameters
    ----------
    pool : Executor
        Two threads that filter the halves of a long view in parallel.
    """

    def __init__(self, pool: Executor) -> None:
        self._pool = pool
        self._recording: OpenRecording | None = None  # the recording that the caches belong to
        self._raw: OrderedDict[tuple[int, View], RawCurve] = OrderedDict()
        self._gated: dict[int, _Gated] = {}  # at most one channel

    def picture(self, wanted: PictureRequest) -> PaintedPicture:
        """Compute a picture.

        A hurried picture is faster: instead of running the gate, it leaves out the spikes that the gate rejected
        earlier, in a picture of the whole record. The result is the same unless the gate would now decide differently.

        Raises
        ------
        BecalmError
            If the parameters of the recipe do not make a valid filter.
        """
        opened, recipe = wanted.opened, wanted.recipe
        if opened is not self._recording:
            self._recording = opened
            self._raw.clear()
            self._gated.clear()
        rows = opened.rows(wanted.channel)
        view = view_of(rows, opened.times_s, wanted.span_s, wanted.width)
        raw = self._raw_of(wanted, view)
        hurried = wanted.hurried and self._knows_spikes(wanted)
        if hurried:
            ungated = recipe.model_copy(update={"gate": None})
            clean = clean_of(self._gated[wanted.channel].rows, ungated, wanted.lag, view, self._pool)
        else:
            clean = clean_of(rows, recipe, wanted.lag, view, self._pool)
        description = summary_of(recipe, rows.step_s, wanted.lag)
        header = {
            "kind": "picture",
            "answers": wanted.answers,
            "channel": wanted.channel,
            "from_s": float(raw.times_s[0]),
            "to_s": self._second_of(wanted, view.stop - 1),
            "rows_each": view.rows_each,
            "filter": description._asdict(),
            "classic": None,
            "hurried": hurried,
        }
        return PaintedPicture(header, view, raw, clean)

    def hurries(self, wanted: PictureRequest) -> bool:
        """Return whether to send a hurried picture first: the full picture takes long, and the spikes are known."""
        rows = wanted.opened.rows(wanted.channel)
        view = view_of(rows, wanted.opened.times_s, wanted.span_s, wanted.width)
        return self._knows_spikes(wanted) and view.stop - view.first >= LONG

    def remember(self, wanted: PictureRequest, painted: PaintedPicture) -> None:
        """Remember the spikes in a picture of the whole record, for later hurried pictures."""
        rows = wanted.opened.rows(wanted.channel)
        view, gate = painted.view, wanted.recipe.gate
        if gate is None or wanted.hurried or view.stop - view.first < max(len(rows), LONG):
            return
        if (painted.clean.verdicts & (1 << Verdict.STEP)).any():  # the gate restarts the filter at a step
            self._gated.clear()
            return
        spikes, limits, before = painted.clean.spikes, wanted.recipe.limits, self._gated.get(wanted.channel)
        if before is None or before.limits != limits or not np.array_equal(before.spikes, spikes):
            self._gated = {wanted.channel: _Gated(spikes, limits, rows.without_spikes(spikes, limits, wanted.lag))}

    def classic(self, wanted: PictureRequest, painted: PaintedPicture) -> bytes:
        """Return the frame of a picture with a classic filter that has the noise gain of the channel's filter.

        Raises
        ------
        UsageError
            If there is no such filter.
        """
        assert wanted.classic is not None, "a picture without a classic filter is finished already"
        gain_db = painted.header["filter"]["noise_gain_db"]
        gain = None if gain_db is None else 10.0 ** (gain_db / _DECIBEL)
        output = run_classic(wanted.opened.rows(wanted.channel), painted.view, wanted.classic, gain)
        return painted._replace(header={**painted.header, "classic": wanted.classic}).framed(output)

    def _knows_spikes(self, wanted: PictureRequest) -> bool:
        return wanted.opened is self._recording and wanted.recipe.gate is not None and wanted.channel in self._gated

    def _raw_of(self, wanted: PictureRequest, view: View) -> RawCurve:
        key = wanted.channel, view
        if key not in self._raw:
            self._raw[key] = raw_of(wanted.opened.rows(wanted.channel), wanted.opened.times_s, view)
            while len(self._raw) > _MOST_RAW:
                self._raw.popitem(last=False)
        return self._raw[key]

    @staticmethod
    def _second_of(wanted: PictureRequest, row: int) -> float:
        times = wanted.opened.times_s
        return row * wanted.opened.step_s if times is None else float(times()[row])


def dial_frame(wanted: PictureRequest) -> bytes:
    """Return a frame with the figures of the filter at each position of a channel's dial."""
    opened = wanted.opened
    arrays = dial(wanted.recipe, opened.step_s, wanted.lag, len(opened.recording))
    return frame({"kind": "dial", "channel": wanted.channel, "order": wanted.recipe.order}, arrays)


def map_frame(wanted: PictureRequest) -> bytes:
    """Return a frame with the map of how well each pair of noise and density predicts readings.

    Raises
    ------
    UsageError
        If the channel has no kinematic model, or too few readings.
    """
    costs = cost_map(wanted.opened.rows(wanted.channel), wanted.recipe)
    header = {
        "kind": "map",
        "answers": wanted.answers,
        "channel": wanted.channel,
        "noise_std": costs.noise_std.tolist(),
        "process_noise_density": costs.process_noise_density.tolist(),
        "best": list(costs.best),
        "here": list(costs.here),
        "density_unit": density_unit(wanted.opened.recording.units[wanted.channel], wanted.recipe.order or 1),
    }
    return frame(header, {"cost": costs.cost.astype(np.float32)})
