"""A stream through a recipe: rows come as they are measured, and the numbers are those of a file.

The results are those of a causal `clean` to the bit, and of a lagged one to 1e-12; wherever rows are cut, and wherever
a stream is paused and resumed, they are the same to the bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from becalm.cleaning.causal_channel import CausalChannel, is_causal
from becalm.cleaning.cleaner import ReadyRows
from becalm.cleaning.live_channel import mean_power, open_live
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import lag_in_rows
from becalm.cleaning.stream_modes import NO_MODES, modes_in, modes_of, with_modes
from becalm.core.arrays import Codes, Floats, input_of
from becalm.core.rows import EstimatedRows
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.core.verdict import Verdict
from becalm.errors import ModelError, RecipeError

_VERSION = 8  # 1 knew no gross outliers, 2 was of other filters, 3 to 6 laid states out otherwise, 7 judged at once
_LONGEST = 2.0**52  # steps: more than a clock can count
_NO_SNAPSHOT = "These bytes are no snapshot of a stream"


class Streamed(NamedTuple):
    """What is told of some rows."""

    signal: Floats  # (R, m)
    sigma: Floats  # (R, m) inf where nothing is known yet, NaN where none can be told
    verdicts: Codes  # (R, m) values of `becalm.core.verdict.Verdict`
    modes: Floats = NO_MODES  # (R, K) how probable each mode is of each channel that switches; (0, 0) where none does


@dataclass(frozen=True)
class ChannelHealth:
    """How a channel of a stream is.

    Attributes
    ----------
    name : str
        The channel.
    counts : dict of str to int
        How often each verdict was given, over the whole life of the stream.
    nis : float or None
        Mean squared normalised innovation of the last 512 readings, each counted up to 6 sigma; 1 is right. None before
        the first sixteen, and of a channel that passes unchanged.
    drift_since_row : int or None
        In which row the first drift that was told began, counted from 0; None where none was.
    dead : bool
        Whether its innovations are, now, those of a dead sensor.
    """

    name: str
    counts: dict[str, int]
    nis: float | None
    drift_since_row: int | None
    dead: bool


class StreamCleaner:
    """Cleans rows as they come.

    Parameters
    ----------
    recipe : Recipe
        What to do; its channels are the columns of every push, in this order. "smoothed" runs as "causal".
    step_s : float
        The step that elapsed steps are counted in, in seconds.

    Attributes
    ----------
    lag_rows : int
        Later rows that each row waits for; 0 where each is told at once.

    Raises
    ------
    RecipeError
        If a channel's numbers make no filter at this step.
    UsageError
        If no later reading comes within the recipe's lag.
    """

    def __init__(self, recipe: Recipe, step_s: float) -> None:
        self.lag_rows = 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
        self._recipe, self._step_s, self._rows = recipe, step_s, 0
        self._mark = _mark_of(recipe)
        channels = dict(enumerate(recipe.channel))
        self._causal = {c: CausalChannel(one, step_s) for c, one in channels.items() if is_causal(one, self.lag_rows)}
        self._apart = {c: open_live(one, step_s, self.lag_rows) for c, one in channels.items() if c not in self._causal}
        self._ready = {c: ReadyRows() for c in self._apart}
        self._modes = [modes_in(one) for one in recipe.channel]

    def push(self, values: Floats, elapsed: Floats) -> Streamed:
        """Take the next rows.

        Parameters
        ----------
        values : (B, m) float array
            Readings in the channels' units, NaN where missing.
        elapsed : (B,) float array
            Steps since the row before, whole or not; of the very first row it is not looked at.

        Returns
        -------
        Streamed
            Of these rows; with a lag, of those that have waited, perhaps none.

        Raises
        ------
        ModelError
            If the shapes do not fit each other or the recipe, or time goes backwards.
        """
        values, elapsed = self._checked(values, elapsed)
        if not len(values):
            return self._nothing()
        columns = np.ascontiguousarray(values.T)
        found = {c: channel.process(columns[c], elapsed).told() for c, channel in self._causal.items()}
        for c, channel in self._apart.items():
            self._ready[c].add(channel.push(columns[c], elapsed))
        self._rows += len(values)
        return self._answer(found)

    def finish(self) -> Streamed:
        """Return the rows that wait, with what there is after them; nothing changes by it: more rows may follow."""
        if not self.lag_rows:
            return self.push(np.empty((0, len(self._recipe.channel))), np.empty(0))
        other = type(self).resume(self.snapshot(), self._recipe)
        for c, channel in other._apart.items():
            other._ready[c].add(channel.finish())
        return other._answer({})

    def health(self) -> tuple[ChannelHealth, ...]:
        """Say how each channel is."""
        found: dict[int, ChannelHealth] = {}
        names = [channel.name for channel in self._recipe.channel]
        for c, causal in self._causal.items():
            now = causal.filter
            nis = mean_power(now.powers)
            found[c] = ChannelHealth(names[c], _in_words(now.counts), nis, now.drift_since, now.is_silent)
        for c, channel in self._apart.items():
            monitor, counts = channel.sensor.monitor, _in_words(channel.counts)
            nis = mean_power(monitor.powers)
            found[c] = ChannelHealth(names[c], counts, nis, monitor.drift_since, monitor.is_silent)
        return tuple(found[c] for c in range(len(names)))

    def snapshot(self) -> bytes:
        """Return all that is needed to go on later, as plain bytes; the same state gives the same bytes."""
        told = np.array([_VERSION, self._rows], np.int64)
        arrays: dict[str, Any] = {"told": told, "recipe": self._mark, "step_s": np.array([self._step_s])}
        for c, causal in self._causal.items():
            arrays |= {f"channel{c}.{name}": array for name, array in causal.state_dict().items()}
        for c, channel in self._apart.items():
            arrays |= {f"channel{c}.{name}": array for name, array in channel.saved().items()}
            if self.lag_rows:
                arrays |= {f"ready{c}.{name}": array for name, array in self._ready[c].held()._asdict().items()}
        return packed(arrays)

    @classmethod
    def resume(cls, blob: bytes, recipe: Recipe) -> Self:
        """Go on from a snapshot; the results are those of a stream that was never stopped.

        Parameters
        ----------
        blob : bytes
            What `snapshot` returned.
        recipe : Recipe
            The one that the stream had.

        Raises
        ------
        ModelError
            If the bytes are damaged, no snapshot at all, or of another version.
        RecipeError
            If they are of another recipe.
        """
        arrays = _read(blob)
        if not np.array_equal(arrays["recipe"], _mark_of(recipe)):
            raise RecipeError(
                "The snapshot is of a stream with another recipe. Go on with that one, or begin a new stream with this."
            )
        try:
            stream = cls(recipe, float(arrays["step_s"][0]))
            stream._restore(arrays)
        except ModelError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as cause:
            raise ModelError(f"{_NO_SNAPSHOT} of this recipe: {cause}. Begin a new stream.") from cause
        return stream

    def _restore(self, arrays: Mapping[str, Any]) -> None:
        self._rows = int(arrays["told"][1])
        for c, causal in self._causal.items():
            causal.load_state_dict(_under(f"channel{c}.", arrays))
        for c, channel in self._apart.items():
            channel.restore(_under(f"channel{c}.", arrays))
            if self.lag_rows:
                waiting = EstimatedRows(**_under(f"ready{c}.", arrays))
                self._ready[c].add(with_modes(waiting, self._modes[c]))

    def _checked(self, values: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
        """Return what was pushed as kernels take it."""
        values, elapsed = input_of(_numbers("values", values)), input_of(_numbers("elapsed", elapsed))
        wanted = len(self._recipe.channel)
        if values.ndim != 2 or values.shape[1] != wanted or elapsed.shape != (len(values),):
            raise ModelError(
                f"values has shape {values.shape} and elapsed {elapsed.shape}; rows of {wanted} channels need"
                f" (B, {wanted}) and (B,)."
            )
        if not self._rows and len(elapsed):
            elapsed = np.append(1.0, elapsed[1:])  # the first row comes when it is due
        if not (elapsed >= 0.0).all():
            raise ModelError(f"elapsed has {elapsed[~(elapsed >= 0.0)][0]:.6g} steps; time only goes on: 0 or more.")
        return values, np.minimum(elapsed, _LONGEST)

    def _answer(self, causal: Mapping[int, EstimatedRows]) -> Streamed:
        """Return what is ready of all channels, given what is told of those that wait for nothing."""
        found = dict(causal)
        if self._apart:
            count = min(ready.count for ready in self._ready.values())
            found |= {c: ready.take(count) for c, ready in self._ready.items()}
        channels = [found[c] for c in range(len(found))]
        return Streamed(
            np.column_stack([one.signal for one in channels]),
            np.column_stack([one.sigma for one in channels]),
            np.column_stack([one.verdicts for one in channels]),
            modes_of(found, self._modes),
        )

    def _nothing(self) -> Streamed:
        shape = 0, len(self._recipe.channel)
        return Streamed(np.empty(shape), np.empty(shape), np.empty(shape, np.int8), modes_of({}, self._modes))


def _numbers(name: str, given: object) -> Any:
    """Return numbers as they came, or say that these are none."""
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiub":
        return given
    raise ModelError(f"{name} is no array of numbers; give float64, as np.asarray(rows, float) does.")


def _mark_of(recipe: Recipe) -> Codes:
    """Return a hash that tells recipes apart."""
    return np.frombuffer(hashlib.sha256(recipe.model_dump_json().encode()).digest(), np.int8)


def _read(blob: bytes) -> dict[str, Any]:
    """Return the arrays of a snapshot."""
    try:
        arrays = unpacked(blob)
        version = int(arrays["told"][0])
    except (ValueError, KeyError, IndexError) as cause:
        raise ModelError(f"{_NO_SNAPSHOT}, or they are damaged: {cause}. Begin a new stream.") from cause
    if version != _VERSION:
        raise ModelError(f"The snapshot has version {version}; this becalm reads {_VERSION}. Begin a new stream.")
    return arrays


def _under(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _in_words(counts: Mapping[Verdict, int]) -> dict[str, int]:
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}
