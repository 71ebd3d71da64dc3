"""All channels of a recording on their way through a recipe, some rows at a time."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Self

import numpy as np

from becalm.cleaning.channels import ChannelCleaner, open_channel
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.report import ChannelReport
from becalm.cleaning.steps import lag_in_rows
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History
from becalm.core.rows import EstimatedRows, Judge
from becalm.installation import load_scipy


class Cleaner:
    """Cleans a recording of any length in constant memory; use it in a `with`, which ends its threads.

    Parameters
    ----------
    recipe : Recipe
        What to do; its channels are those of every push, in this order.
    step_s : float
        The step that elapsed steps are counted in, in seconds.
    split : bool
        Whether to tell the parts of each channel as well, in the order of `ChannelRecipe.parts`.
    looks : sequence of callable, optional
        One a channel, which is given its innovations (B,) and their standard deviations, a value a row; of a channel
        that passes unchanged nothing.

    Raises
    ------
    RecipeError
        If a channel's numbers make no filter at this step.
    UsageError
        If no later reading comes within the recipe's lag.
    """

    def __init__(self, recipe: Recipe, step_s: float, *, split: bool = False, looks: Sequence[Judge] = ()) -> None:
        lag = None if recipe.mode == "smoothed" else 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
        seen_by: Sequence[Judge | None] = looks or [None] * len(recipe.channel)
        self._channels: list[ChannelCleaner] = [
            open_channel(channel, step_s, lag, split, look)
            for channel, look in zip(recipe.channel, seen_by, strict=True)
        ]
        self._ready = [ReadyRows() for _ in self._channels]
        self._sizes: deque[int] = deque()  # of pushes that were not answered yet
        load_scipy()
        self._pool = ThreadPoolExecutor(os.cpu_count())  # more would wait for each other at every small step

    def push(self, columns: Sequence[Floats], elapsed: Floats) -> list[list[EstimatedRows]]:
        """Take the next rows of all channels.

        Parameters
        ----------
        columns : sequence of (B,) float arrays
            One a channel, NaN where missing.
        elapsed : (B,) float array
            Steps since the row before.

        Returns
        -------
        list of list of EstimatedRows
            One for each push that is answered now, in order: what each channel says of its rows.
        """
        self._sizes.append(len(elapsed))
        told = self._pool.map(lambda channel, z: channel.push(z, elapsed), self._channels, columns)
        return self._answers(list(told))

    def finish(self) -> list[list[EstimatedRows]]:
        """Say that no more rows will come; answer the pushes that are left."""
        return self._answers(list(self._pool.map(lambda channel: channel.finish(), self._channels)))

    def begin_after(self, before: Sequence[History]) -> None:
        """Say what went before the rows that will be pushed, of each channel: they begin amid a recording."""
        for channel, own in zip(self._channels, before, strict=True):
            channel.begin_after(own)

    def saved(self) -> list[dict[str, Any]] | None:
        """Return what later rows of causal filters depend on, of each channel; None where rows wait in one."""
        return _of_all([channel.saved() for channel in self._channels])

    def restore(self, arrays: Sequence[Mapping[str, Any]]) -> None:
        """Take over what `saved` returned."""
        for channel, own in zip(self._channels, arrays, strict=True):
            channel.restore(own)

    def comparable_state(self) -> list[dict[str, Floats]] | None:
        """Return what later rows depend on and nothing else, of each channel; None where `saved` is."""
        return _of_all([channel.comparable_state() for channel in self._channels])

    def surely_alive(self) -> list[bool]:
        """Say of each channel whether where its hops began does not matter: see `core.health.aliveness`."""
        return [channel.surely_alive for channel in self._channels]

    def reports(self) -> tuple[ChannelReport, ...]:
        """Say what was found for each channel, once finished."""
        return tuple(self._pool.map(lambda channel: channel.report(), self._channels))

    def _answers(self, told: list[list[EstimatedRows]]) -> list[list[EstimatedRows]]:
        for rows, parts in zip(self._ready, told, strict=True):
            rows.add(parts)
        answers = []
        while self._sizes and all(rows.count >= self._sizes[0] for rows in self._ready):
            size = self._sizes.popleft()
            answers.append([rows.take(size) for rows in self._ready])
        return answers

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)


def _of_all(told: Sequence[dict[str, Any] | None]) -> list[dict[str, Any]] | None:
    known = [one for one in told if one is not None]
    return known if len(known) == len(told) else None


class ReadyRows:
    """Clean rows of a channel that were not asked for yet."""

    def __init__(self) -> None:
        self.count = 0
        self._parts: deque[EstimatedRows] = deque()

    def add(self, parts: list[EstimatedRows]) -> None:
        """Take what was told of the next rows."""
        self._parts.extend(parts)
        self.count += sum(len(part.signal) for part in parts)

    def held(self) -> EstimatedRows:
        """Return all rows that are held; they stay."""
        told = self.take(self.count)
        if len(told.signal):
            self.add([told])
        return told

    def take(self, count: int) -> EstimatedRows:
        """Return the first `count` rows; a part of that length as it is."""
        taken: list[EstimatedRows] = []
        self.count -= count
        while count or not taken:
            part = self._parts.popleft() if self._parts else EstimatedRows.nothing()
            if len(part.signal) > count:
                self._parts.appendleft(part.rows(slice(count, None)))
                part = part.rows(slice(count))
            count -= len(part.signal)
            taken.append(part)
        if len(taken) == 1:
            return taken[0]
        return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*taken, strict=True)))
