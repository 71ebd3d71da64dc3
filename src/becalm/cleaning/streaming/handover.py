"""Change the recipe of a running stream without a jump: run both filters while the new one replaces the old one.

The new filter starts with the next readings. Until the effect of its start is negligible, the stream returns the
estimates of the old filter. Then, over the same number of rows, signal and sigma change linearly from the old filter to
the new one. This sigma is an upper bound: the standard deviation of a x + b y is at most a sigma_x + b sigma_y.
"""

from __future__ import annotations

import json
from typing import Self

import numpy as np

from becalm.cleaning.channels.figures import fixed_figures
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.cleaning.streaming.stream import ChannelHealth, StreamCleaner, Streamed
from becalm.cleaning.streaming.stream_modes import modes_in_handover
from becalm.core.arrays import Floats
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.errors import ModelError, RecipeError

_TIMES_INDEPENDENT = 3.0  # after this many times its `independence_s`, the effect of a filter's start is negligible
_FEWEST, _MOST = 32, 1 << 16  # limits of `rows_to_forget`
_DAMAGED = "These bytes are not a snapshot of a change between two filters."


class Handover:
    """Two stream filters that both run while the new one replaces the old one.

    Parameters
    ----------
    former : StreamCleaner
        The old filter.
    later : StreamCleaner
        The new filter, which has taken no row yet.
    rows : int
        Number of rows after which the effect of the new filter's start is negligible. The change begins then, and
        takes as many rows again.

    Raises
    ------
    RecipeError
        If the two filters have different lags.
    """

    def __init__(self, former: StreamCleaner, later: StreamCleaner, rows: int) -> None:
        if former.lag_rows != later.lag_rows:
            raise RecipeError(
                f"The recipe has a lag of {later.lag_rows} readings, and the stream one of {former.lag_rows}; a stream"
                " keeps its lag. Start another stream for this recipe."
            )
        self.former, self.later, self._rows, self._rows_done = former, later, rows, 0

    @property
    def lag_rows(self) -> int:
        """Return the lag in rows."""
        return self.later.lag_rows

    @property
    def has_begun(self) -> bool:
        """Return whether the next estimates contain a share of the new filter's estimates."""
        return self._rows_done >= self._rows

    @property
    def is_over(self) -> bool:
        """Return whether the next estimates are only those of the new filter."""
        return self._rows_done >= 2 * self._rows

    def push(self, values: Floats, elapsed: Floats) -> Streamed:
        """Take the next rows; see `StreamCleaner.push`.

        With a lag, the first estimates are of rows before the start of the new filter; they are the old filter's.
        """
        before, after = self.former.push(values, elapsed), self.later.push(values, elapsed)
        return self._mix(before, after)

    def finish(self) -> Streamed:
        """Return estimates of the waiting rows from the readings so far; the state does not change."""
        rows_done = self._rows_done
        estimates = self._mix(self.former.finish(), self.later.finish())
        self._rows_done = rows_done
        return estimates

    def health(self) -> tuple[ChannelHealth, ...]:
        """Return the health of each channel of the new filter."""
        return self.later.health()

    def _mix(self, before: Streamed, after: Streamed) -> Streamed:
        """Mix the estimates of the old filter (`before`) and of the new filter (`after`) for the next rows."""
        old_only = len(before.signal) - len(after.signal)  # number of rows before the start of the new filter
        share = (np.arange(self._rows_done, self._rows_done + len(after.signal)) + 1 - self._rows) / self._rows
        self._rows_done += len(after.signal)
        w = np.concatenate([np.zeros(old_only), np.clip(share, 0.0, 1.0)])[:, None]
        return Streamed(
            _weighted_mean(w, before.signal, np.concatenate([before.signal[:old_only], after.signal])),
            _weighted_mean(w, before.sigma, np.concatenate([before.sigma[:old_only], after.sigma])),
            np.where(w == 0, before.verdicts, np.concatenate([before.verdicts[:old_only], after.verdicts])),
            modes_in_handover(w, before.modes, after.modes),
        )

    def snapshot(self, former: Recipe) -> bytes:
        """Return the whole state as bytes, from which `resume` continues; `former` is the recipe that is replaced."""
        return packed(
            {
                "counts": np.array([self._rows, self._rows_done], np.int64),
                "recipe": np.frombuffer(former.model_dump_json().encode(), np.int8),
                "former": np.frombuffer(self.former.snapshot(), np.int8),
                "later": np.frombuffer(self.later.snapshot(), np.int8),
            }
        )

    @classmethod
    def resume(cls, blob: bytes, recipe: Recipe) -> tuple[Self, Recipe]:
        """Continue from a snapshot; return the handover and the recipe that is replaced.

        Raises
        ------
        ModelError
            If the bytes are damaged.
        RecipeError
            If the snapshot is of another recipe.
        """
        try:
            arrays = unpacked(blob)
            rows, rows_done = (int(count) for count in arrays["counts"])
            old = Recipe.model_validate(json.loads(arrays["recipe"].tobytes()))
            snapshots = arrays["former"].tobytes(), arrays["later"].tobytes()
        except (KeyError, TypeError, ValueError) as cause:
            raise ModelError(_DAMAGED) from cause
        former, later = (StreamCleaner.resume(blob, r) for blob, r in zip(snapshots, (old, recipe), strict=True))
        handover = cls(former, later, rows)
        handover._rows_done = rows_done
        return handover, old


def _weighted_mean(w: Floats, old: Floats, new: Floats) -> Floats:
    """Return (1 - w) old + w new; exactly `old` where w = 0 and `new` where w = 1, even if the other is NaN or inf."""
    with np.errstate(invalid="ignore"):
        return np.where(w == 0, old, np.where(w == 1, new, (1 - w) * old + w * new))


def rows_to_forget(recipe: Recipe, step_s: float) -> int:
    """Return the number of rows, 32 to 65 536, after which the effect of a start is negligible in all filters.

    For a channel with several modes only its fixed filter counts.
    """
    longest_s = 0.0
    for channel in recipe.channel:
        if channel.motion is not None:
            independent_s = fixed_figures(in_steps(channel.motion, step_s), step_s, 0).independence_s
            longest_s = max(longest_s, np.inf if independent_s is None else independent_s)
    return int(np.clip(_TIMES_INDEPENDENT * longest_s / step_s, _FEWEST, _MOST))
