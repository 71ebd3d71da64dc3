"""From one recipe to another amid a stream, without a jump: both filters run, and the one gives way to the other.

The new filter starts from the next readings alone. Until it has forgotten that start the old one is told; then, over as
many rows again, what is told goes from the old signal to the new along a straight line, and so does sigma, which is
never less than that of either mixture: |a x + b y| deviates by a sigma_x + b sigma_y at the most.
"""

from __future__ import annotations

import json
from typing import Self

import numpy as np

from becalm.cleaning.figures import fixed_figures
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import in_steps
from becalm.cleaning.stream import ChannelHealth, StreamCleaner, Streamed
from becalm.cleaning.stream_modes import handed_over
from becalm.core.arrays import Floats
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.errors import ModelError, RecipeError

_TIMES_INDEPENDENT = 3.0
_FEWEST, _MOST = 32, 1 << 16  # rows
_DAMAGED = "These bytes are no snapshot of a handover between two filters."


class Handover:
    """Two streams' filters, of which the former gives way to the later.

    Parameters
    ----------
    former : StreamCleaner
        Goes on for a while.
    later : StreamCleaner
        Has seen no row yet.
    rows : int
        How long it takes until the later one has forgotten its start, and as long again to hand over.

    Raises
    ------
    RecipeError
        If they wait for different lags.
    """

    def __init__(self, former: StreamCleaner, later: StreamCleaner, rows: int) -> None:
        if former.lag_rows != later.lag_rows:
            raise RecipeError(
                f"The recipe waits for {later.lag_rows} readings, and the stream's for {former.lag_rows}; a stream"
                " keeps its lag. Begin another stream for this recipe."
            )
        self.former, self.later, self._rows, self._told = former, later, rows, 0

    @property
    def lag_rows(self) -> int:
        """Later rows that each row waits for."""
        return self.later.lag_rows

    @property
    def has_begun(self) -> bool:
        """Whether the later filter has a share in what is told."""
        return self._told >= self._rows

    @property
    def is_over(self) -> bool:
        """Whether only the later filter is told by now."""
        return self._told >= 2 * self._rows

    def push(self, values: Floats, elapsed: Floats) -> Streamed:
        """Take the next rows; see `StreamCleaner.push`. The former one answers for rows that it alone has seen."""
        before, after = self.former.push(values, elapsed), self.later.push(values, elapsed)
        return self._joined(before, after)

    def finish(self) -> Streamed:
        """Return the rows that wait; nothing changes by it."""
        told = self._told
        answer = self._joined(self.former.finish(), self.later.finish())
        self._told = told
        return answer

    def health(self) -> tuple[ChannelHealth, ...]:
        """Say how each channel of the later filter is."""
        return self.later.health()

    def _joined(self, before: Streamed, after: Streamed) -> Streamed:
        alone = len(before.signal) - len(after.signal)  # rows that came before the later one began
        share = (np.arange(self._told, self._told + len(after.signal)) + 1 - self._rows) / self._rows
        self._told += len(after.signal)
        w = np.concatenate([np.zeros(alone), np.clip(share, 0.0, 1.0)])[:, None]
        return Streamed(
            _mixed(w, before.signal, np.concatenate([before.signal[:alone], after.signal])),
            _mixed(w, before.sigma, np.concatenate([before.sigma[:alone], after.sigma])),
            np.where(w == 0, before.verdicts, np.concatenate([before.verdicts[:alone], after.verdicts])),
            handed_over(w, before.modes, after.modes),
        )

    def snapshot(self, former: Recipe) -> bytes:
        """Return all that is needed to go on later, as plain bytes; `former` is the recipe that gives way."""
        return packed(
            {
                "counts": np.array([self._rows, self._told], np.int64),
                "recipe": np.frombuffer(former.model_dump_json().encode(), np.int8),
                "former": np.frombuffer(self.former.snapshot(), np.int8),
                "later": np.frombuffer(self.later.snapshot(), np.int8),
            }
        )

    @classmethod
    def resume(cls, blob: bytes, recipe: Recipe) -> tuple[Self, Recipe]:
        """Go on from a snapshot; return the handover and the recipe that gives way.

        Raises
        ------
        ModelError
            If the bytes are damaged.
        RecipeError
            If they are of another recipe.
        """
        try:
            arrays = unpacked(blob)
            rows, told = (int(count) for count in arrays["counts"])
            old = Recipe.model_validate(json.loads(arrays["recipe"].tobytes()))
            halves = arrays["former"].tobytes(), arrays["later"].tobytes()
        except (KeyError, TypeError, ValueError) as cause:
            raise ModelError(_DAMAGED) from cause
        former, later = (StreamCleaner.resume(half, r) for half, r in zip(halves, (old, recipe), strict=True))
        handover = cls(former, later, rows)
        handover._told = told
        return handover, old


def _mixed(w: Floats, old: Floats, new: Floats) -> Floats:
    """Go from old to new; at the ends exactly, where the other may be NaN or inf."""
    with np.errstate(invalid="ignore"):
        return np.where(w == 0, old, np.where(w == 1, new, (1 - w) * old + w * new))


def rows_to_forget(recipe: Recipe, step_s: float) -> int:
    """Return after how many rows each filter of a recipe has forgotten how it began; at most 65 536."""
    longest_s = 0.0
    for channel in recipe.channel:
        if channel.motion is not None:
            independent_s = fixed_figures(in_steps(channel.motion, step_s), step_s, 0).independence_s
            longest_s = max(longest_s, np.inf if independent_s is None else independent_s)
    return int(np.clip(_TIMES_INDEPENDENT * longest_s / step_s, _FEWEST, _MOST))
