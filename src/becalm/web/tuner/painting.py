"""What a page looks at, painted in a thread: a picture, its dial, a classic filter beside it."""

from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.dial_positions import density_unit, dial, told_of
from becalm.cleaning.excerpt import ChannelRows
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Integers
from becalm.core.verdict import Verdict
from becalm.report.envelope import Envelope
from becalm.web.frames import frame, relative
from becalm.web.tuner.comparing import classic_beside
from becalm.web.tuner.costs import cost_map
from becalm.web.tuner.opened import Opened
from becalm.web.tuner.picture import LONG, Clean, Raw, View, clean_of, raw_of, view_of

_MOST_RAW = 8  # views whose readings are kept
_DECIBEL = 10.0


class PictureRequest(NamedTuple):
    """What a page looks at."""

    opened: Opened
    channel: int
    recipe: ChannelRecipe
    lag: int | None
    span_s: tuple[float, float]
    width: int
    answers: int
    classic: str | None = None
    hurried: bool = False
    setting: list[object] | None = None  # as pages are told of it

    @property
    def dial_key(self) -> tuple[object, ...]:
        """What a dial depends on."""
        return self.channel, self.recipe.order, self.recipe.noise_std, self.lag, self.recipe.model

    @property
    def judged_key(self) -> tuple[object, ...]:
        """What the verdict on the whole record depends on, or how a page knows that it has come."""
        return self.channel, self.recipe, self.lag, self.setting


class Painted(NamedTuple):
    """A picture, and what else is drawn into it."""

    header: dict[str, Any]
    view: View
    raw: Raw
    clean: Clean

    def framed(self, classic: Envelope | None = None) -> bytes:
        """Return it as a frame, with a classic filter beside it."""
        drawn = {"raw": self.raw.readings, "clean": self.clean.signal, "band": self.clean.band}
        drawn |= {} if classic is None else {"classic": classic}
        arrays: dict[str, Any] = {"t": self.raw.times_s}
        for name, of in drawn.items():
            arrays |= {f"{name}_low": relative(of.low), f"{name}_high": relative(of.high)}
        return frame(self.header, arrays | {"verdicts": self.clean.verdicts})


class _Gated(NamedTuple):
    """The rows of a channel, without what its gate left out."""

    spikes: Integers
    limits: LimitsRecipe | None
    rows: ChannelRows


class Painter:
    """Paints what pages look at.

    Parameters
    ----------
    pool : Executor
        Two threads, in which the halves of a long view run side by side.
    """

    def __init__(self, pool: Executor) -> None:
        self._pool = pool
        self._of: Opened | None = None  # whose these are
        self._raw: OrderedDict[tuple[int, View], Raw] = OrderedDict()
        self._gated: dict[int, _Gated] = {}  # of one channel

    def picture(self, wanted: PictureRequest) -> Painted:
        """Paint a picture; a hurried one leaves out the spikes that the gate left out of the whole record before.

        It then is that of the gate, unless the gate would judge otherwise now, and is there sooner.

        Raises
        ------
        BecalmError
            If the recipe's numbers make no filter.
        """
        opened, recipe = wanted.opened, wanted.recipe
        if opened is not self._of:
            self._of = opened
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
        told = told_of(recipe, rows.step_s, wanted.lag)
        header = {
            "kind": "picture",
            "answers": wanted.answers,
            "channel": wanted.channel,
            "from_s": float(raw.times_s[0]),
            "to_s": self._second_of(wanted, view.stop - 1),
            "rows_each": view.rows_each,
            "filter": told._asdict(),
            "classic": None,
            "hurried": hurried,
        }
        return Painted(header, view, raw, clean)

    def hurries(self, wanted: PictureRequest) -> bool:
        """Whether a picture is worth painting in a hurry first, for it takes long and can be."""
        rows = wanted.opened.rows(wanted.channel)
        view = view_of(rows, wanted.opened.times_s, wanted.span_s, wanted.width)
        return self._knows_spikes(wanted) and view.stop - view.first >= LONG

    def remember(self, wanted: PictureRequest, painted: Painted) -> None:
        """Make ready for pictures in a hurry, where a gate makes those of the whole record slow."""
        rows = wanted.opened.rows(wanted.channel)
        view, gate = painted.view, wanted.recipe.gate
        if gate is None or wanted.hurried or view.stop - view.first < max(len(rows), LONG):
            return
        if (painted.clean.verdicts & (1 << Verdict.STEP)).any():  # behind which the gate begins anew
            self._gated.clear()
            return
        spikes, limits, before = painted.clean.spikes, wanted.recipe.limits, self._gated.get(wanted.channel)
        if before is None or before.limits != limits or not np.array_equal(before.spikes, spikes):
            self._gated = {wanted.channel: _Gated(spikes, limits, rows.without(spikes, limits, wanted.lag))}

    def classic(self, wanted: PictureRequest, painted: Painted) -> bytes:
        """Paint a classic filter into a picture, as calm as the channel's own.

        Raises
        ------
        UsageError
            If there is no such filter.
        """
        assert wanted.classic is not None, "a picture without one is painted already"
        gain_db = painted.header["filter"]["noise_gain_db"]
        gain = None if gain_db is None else 10.0 ** (gain_db / _DECIBEL)
        found = classic_beside(wanted.opened.rows(wanted.channel), painted.view, wanted.classic, gain)
        return painted._replace(header={**painted.header, "classic": wanted.classic}).framed(found)

    def _knows_spikes(self, wanted: PictureRequest) -> bool:
        return wanted.opened is self._of and wanted.recipe.gate is not None and wanted.channel in self._gated

    def _raw_of(self, wanted: PictureRequest, view: View) -> Raw:
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
    """Tell what each position of a channel's dial is."""
    opened = wanted.opened
    arrays = dial(wanted.recipe, opened.step_s, wanted.lag, len(opened.recording))
    return frame({"kind": "dial", "channel": wanted.channel, "order": wanted.recipe.order}, arrays)


def map_frame(wanted: PictureRequest) -> bytes:
    """Tell how well every noise and density foretells readings.

    Raises
    ------
    UsageError
        If the channel has no motion to tell it of.
    """
    found = cost_map(wanted.opened.rows(wanted.channel), wanted.recipe)
    header = {
        "kind": "map",
        "answers": wanted.answers,
        "channel": wanted.channel,
        "noise_std": found.noise_std.tolist(),
        "process_noise_density": found.process_noise_density.tolist(),
        "best": list(found.best),
        "here": list(found.here),
        "density_unit": density_unit(wanted.opened.recording.units[wanted.channel], wanted.recipe.order or 1),
    }
    return frame(header, {"cost": found.cost.astype(np.float32)})
