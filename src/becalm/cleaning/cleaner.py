"""Clean all channels of a recording with a recipe, block by block."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Self

import numpy as np

from becalm.cleaning.channels.channels import ChannelCleaner, open_channel
from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History
from becalm.core.rows import EstimatedRows, Judge
from becalm.installation import load_scipy


class Cleaner:
    """Cleans a recording of any length in constant memory.

    Use it in a `with` statement, which ends its threads.

    Parameters
    ----------
    recipe : Recipe
        The recipe. `push` takes the columns in the order of the recipe's channels.
    step_s : float
        Length of one step, in seconds; elapsed time is counted in steps.
    split : bool
        Whether to estimate the parts of each signal as well, in the order of `ChannelRecipe.parts`.
    innovation_callbacks : sequence of callable, optional
        One function for each channel. It gets the innovations (B,) and their standard deviations (B,), one value for
        each row. It is not called for a channel that passes unchanged.

    Raises
    ------
    RecipeError
        If the parameters of a channel do not make a valid filter at this step.
    UsageError
        If the recipe's lag is shorter than one step, or too long.
    """

    def __init__(
        self, recipe: Recipe, step_s: float, *, split: bool = False, innovation_callbacks: Sequence[Judge] = ()
    ) -> None:
        lag = None if recipe.mode == "smoothed" else 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
        callbacks: Sequence[Judge | None] = innovation_callbacks or [None] * len(recipe.channel)
        self._channels: list[ChannelCleaner] = [
            open_channel(channel, step_s, lag, split, callback)
            for channel, callback in zip(recipe.channel, callbacks, strict=True)
        ]
        self._ready = [ReadyRows() for _ in self._channels]
        self._sizes: deque[int] = deque()  # number of rows of each push whose estimates are not returned yet
        load_scipy()
        self._pool = ThreadPoolExecutor(os.cpu_count())  # more threads would only wait for each other

    def push(self, columns: Sequence[Floats], elapsed: Floats) -> list[list[EstimatedRows]]:
        """Take the next rows of all channels.

        Parameters
        ----------
        columns : sequence of (B,) float arrays
            Readings of each channel, in its unit; NaN where missing.
        elapsed : (B,) float array
            Steps since the previous row.

        Returns
        -------
        list of list of EstimatedRows
            One element for each push whose estimates are now complete, in order: the estimates of each channel.
        """
        self._sizes.append(len(elapsed))
        estimates = self._pool.map(lambda channel, z: channel.push(z, elapsed), self._channels, columns)
        return self._complete_pushes(list(estimates))

    def finish(self) -> list[list[EstimatedRows]]:
        """End the recording; return the estimates of the remaining pushes."""
        return self._complete_pushes(list(self._pool.map(lambda channel: channel.finish(), self._channels)))

    def set_history(self, before: Sequence[History]) -> None:
        """Set the history of each channel before the first row, if that row is not the first of its recording."""
        for channel, own in zip(self._channels, before, strict=True):
            channel.set_history(own)

    def state_dict(self) -> list[dict[str, Any]] | None:
        """Return the state of each channel as arrays; None if that of any channel cannot be saved."""
        return _all_or_none([channel.state_dict() for channel in self._channels])

    def load_state_dict(self, arrays: Sequence[Mapping[str, Any]]) -> None:
        """Restore the state that `state_dict` returned."""
        for channel, own in zip(self._channels, arrays, strict=True):
            channel.load_state_dict(own)

    def comparable_state(self) -> list[dict[str, Floats]] | None:
        """Return the part of each channel's state that later rows depend on; None if `state_dict` returns None."""
        return _all_or_none([channel.comparable_state() for channel in self._channels])

    def surely_alive(self) -> list[bool]:
        """Return for each channel whether no window of its innovations looks dead; see `ChannelCleaner`."""
        return [channel.surely_alive for channel in self._channels]

    def reports(self) -> tuple[ChannelReport, ...]:
        """Return the report of each channel; call `finish` first."""
        return tuple(self._pool.map(lambda channel: channel.report(), self._channels))

    def _complete_pushes(self, estimates: list[list[EstimatedRows]]) -> list[list[EstimatedRows]]:
        for rows, parts in zip(self._ready, estimates, strict=True):
            rows.add(parts)
        complete = []
        while self._sizes and all(rows.count >= self._sizes[0] for rows in self._ready):
            size = self._sizes.popleft()
            complete.append([rows.take(size) for rows in self._ready])
        return complete

    def __enter__(self) -> Self:
        """Return the cleaner."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)


def _all_or_none(states: Sequence[dict[str, Any] | None]) -> list[dict[str, Any]] | None:
    complete = [state for state in states if state is not None]
    return complete if len(complete) == len(states) else None


class ReadyRows:
    """A queue of estimated rows of one channel; `count` is the number of rows in it."""

    def __init__(self) -> None:
        self.count = 0
        self._parts: deque[EstimatedRows] = deque()

    def add(self, parts: list[EstimatedRows]) -> None:
        """Append the estimates of the next rows."""
        self._parts.extend(parts)
        self.count += sum(len(part.signal) for part in parts)

    def peek(self) -> EstimatedRows:
        """Return all rows of the queue without removing them."""
        rows = self.take(self.count)
        if len(rows.signal):
            self.add([rows])
        return rows

    def take(self, count: int) -> EstimatedRows:
        """Remove the first `count` rows and return them; a stored block of exactly `count` rows is not copied."""
        taken: list[EstimatedRows] = []
        self.count -= count
        while count or not taken:
            part = self._parts.popleft() if self._parts else EstimatedRows.empty()
            if len(part.signal) > count:
                self._parts.appendleft(part.rows(slice(count, None)))
                part = part.rows(slice(count))
            count -= len(part.signal)
            taken.append(part)
        if len(taken) == 1:
            return taken[0]
        return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*taken, strict=True)))
