"""Clean the rows of a stream as they are measured, with a recipe and with the same results as for a file.

The results are bitwise equal to those of a causal `clean`, and equal within 1e-12 to those of `clean` with a lag. They
depend neither on the division of the rows into blocks nor on interruptions of the stream, bit for bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from becalm.cleaning.channels.causal_channel import CausalChannel, is_causal
from becalm.cleaning.channels.live_channel import mean_nis_of_hops, open_live
from becalm.cleaning.cleaner import ReadyRows
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.cleaning.streaming.stream_modes import NO_MODES, count_modes, mode_probabilities, with_modes
from becalm.core.arrays import Codes, Floats, input_of, real
from becalm.core.model.parts import checked_step
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.errors import ModelError, RecipeError

# Version of snapshots. Version 2 added gross outliers, 3 changed the filters, 4 to 7 changed the states, and 8 changed
# how long the outlier test waits.
_VERSION = 8
_LONGEST = 2.0**52  # largest number of steps between two rows; no clock runs so long
_NOT_A_SNAPSHOT = "These bytes are not a snapshot of a stream"


class Streamed(NamedTuple):
    """The estimates of R rows of m channels."""

    signal: Floats  # (R, m) in the channels' units
    sigma: Floats  # (R, m) in the same units; inf before the first reading, NaN where it is unknown
    verdicts: Codes  # (R, m) values of `becalm.core.reading_verdicts.Verdict`
    modes: Floats = NO_MODES  # (R, K) probability of each mode of each channel with modes; (0, 0) without modes


@dataclass(frozen=True)
class ChannelHealth:
    """The health of one channel of a stream.

    Attributes
    ----------
    name : str
        Name of the channel.
    counts : dict of str to int
        How often each verdict was given since the stream began, by the name of the verdict.
    nis : float or None
        Mean squared normalised innovation of the last 512 readings, each limited to 6 sigma; 1 is expected. None for
        fewer than sixteen readings, and for a channel that passes unchanged.
    drift_since_row : int or None
        Row in which the first reported drift began, counted from 0; None without a drift.
    dead : bool
        Whether the latest window of innovations is as quiet as that of a dead sensor.
    """

    name: str
    counts: dict[str, int]
    nis: float | None
    drift_since_row: int | None
    dead: bool


class StreamCleaner:
    """A cleaner of a stream's rows, as they arrive.

    Parameters
    ----------
    recipe : Recipe
        The recipe. Each push has the recipe's channels as columns, in the same order. The mode "smoothed" is run as
        "causal".
    step_s : float
        Length of one step, in seconds; elapsed time is counted in steps.

    Attributes
    ----------
    lag_rows : int
        Lag in rows; 0 if each push returns the estimates of the rows pushed.

    Raises
    ------
    RecipeError
        If the parameters of a channel do not make a valid filter at this step.
    UsageError
        If the recipe's lag is shorter than one step, or too long.
    """

    def __init__(self, recipe: Recipe, step_s: float) -> None:
        if not isinstance(recipe, Recipe):
            raise RecipeError(f"A Recipe is needed; {recipe!r:.60} came. Load one: becalm.Recipe.load('recipe.toml').")
        step_s = checked_step(step_s)
        self.lag_rows = 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
        self._recipe, self._step_s, self._rows = recipe, step_s, 0
        self._recipe_hash = _hash_of(recipe)
        channels = dict(enumerate(recipe.channel))
        self._causal = {c: CausalChannel(one, step_s) for c, one in channels.items() if is_causal(one, self.lag_rows)}
        self._others = {
            c: open_live(one, step_s, self.lag_rows) for c, one in channels.items() if c not in self._causal
        }
        self._ready = {c: ReadyRows() for c in self._others}
        self._modes = [count_modes(one) for one in recipe.channel]

    def push(self, values: Floats, elapsed: Floats) -> Streamed:
        """Take the next rows.

        Parameters
        ----------
        values : (B, m) float array
            Readings in the channels' units, NaN where missing.
        elapsed : (B,) float array
            Steps since the previous row, 0 or more, not necessarily whole; ignored for the first row of the stream.

        Returns
        -------
        Streamed
            Estimates of the rows pushed; with a lag, estimates of the rows that are now ready, perhaps of none.

        Raises
        ------
        ModelError
            If an argument is not an array of numbers, the shapes do not fit each other or the recipe, or a value of
            `elapsed` is negative.
        """
        values, elapsed = self._checked(values, elapsed)
        if not len(values):
            return self._no_rows()
        columns = np.ascontiguousarray(values.T)
        found = {c: channel.process(columns[c], elapsed).to_rows() for c, channel in self._causal.items()}
        for c, channel in self._others.items():
            self._ready[c].add(channel.push(columns[c], elapsed))
        self._rows += len(values)
        return self._ready_rows(found)

    def finish(self) -> Streamed:
        """Return estimates of the waiting rows from the readings so far; the state does not change."""
        if not self.lag_rows:
            return self.push(np.empty((0, len(self._recipe.channel))), np.empty(0))
        other = type(self).resume(self.snapshot(), self._recipe)
        for c, channel in other._others.items():
            other._ready[c].add(channel.finish())
        return other._ready_rows({})

    def health(self) -> tuple[ChannelHealth, ...]:
        """Return the health of each channel."""
        found: dict[int, ChannelHealth] = {}
        names = [channel.name for channel in self._recipe.channel]
        for c, causal in self._causal.items():
            now = causal.filter
            nis = mean_nis_of_hops(now.powers)
            found[c] = ChannelHealth(names[c], _by_name(now.counts), nis, now.drift_since, now.is_silent)
        for c, channel in self._others.items():
            monitor, counts = channel.sensor.monitor, _by_name(channel.counts)
            nis = mean_nis_of_hops(monitor.powers)
            found[c] = ChannelHealth(names[c], counts, nis, monitor.drift_since, monitor.is_silent)
        return tuple(found[c] for c in range(len(names)))

    def snapshot(self) -> bytes:
        """Return the whole state as bytes, from which `resume` continues; equal states have equal bytes."""
        head = np.array([_VERSION, self._rows], np.int64)
        arrays: dict[str, Any] = {"told": head, "recipe": self._recipe_hash, "step_s": np.array([self._step_s])}
        for c, causal in self._causal.items():
            arrays |= {f"channel{c}.{name}": array for name, array in causal.state_dict().items()}
        for c, channel in self._others.items():
            arrays |= {f"channel{c}.{name}": array for name, array in channel.state_dict().items()}
            if self.lag_rows:
                arrays |= {f"ready{c}.{name}": array for name, array in self._ready[c].peek()._asdict().items()}
        return packed(arrays)

    @classmethod
    def resume(cls, blob: bytes, recipe: Recipe) -> Self:
        """Continue from a snapshot; the results are those of an uninterrupted stream.

        Parameters
        ----------
        blob : bytes
            A snapshot from `snapshot`.
        recipe : Recipe
            The recipe of the stream.

        Raises
        ------
        ModelError
            If the bytes are damaged, not a snapshot, or of another version.
        RecipeError
            If the snapshot is of a stream with another recipe.
        """
        arrays = _read(blob)
        if not np.array_equal(arrays["recipe"], _hash_of(recipe)):
            raise RecipeError(
                "The snapshot is of a stream with another recipe. Use that recipe, or start a new stream with this one."
            )
        try:
            stream = cls(recipe, float(arrays["step_s"][0]))
            stream._restore(arrays)
        except ModelError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as cause:
            raise ModelError(f"{_NOT_A_SNAPSHOT} of this recipe: {cause}. Start a new stream.") from cause
        return stream

    def _restore(self, arrays: Mapping[str, Any]) -> None:
        self._rows = int(arrays["told"][1])
        for c, causal in self._causal.items():
            causal.load_state_dict(_without_prefix(f"channel{c}.", arrays))
        for c, channel in self._others.items():
            channel.load_state_dict(_without_prefix(f"channel{c}.", arrays))
            if self.lag_rows:
                waiting = EstimatedRows(**_without_prefix(f"ready{c}.", arrays))
                self._ready[c].add(with_modes(waiting, self._modes[c]))

    def _checked(self, values: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
        """Return the pushed arrays in the form that the filters need; raise a ModelError if they are not valid."""
        values, elapsed = input_of(_numbers("values", values)), input_of(_numbers("elapsed", elapsed))
        wanted = len(self._recipe.channel)
        if values.ndim != 2 or values.shape[1] != wanted or elapsed.shape != (len(values),):
            raise ModelError(
                f"values has shape {values.shape} and elapsed {elapsed.shape}; rows of {wanted} channels need"
                f" (B, {wanted}) and (B,)."
            )
        if not self._rows and len(elapsed):
            elapsed = np.append(1.0, elapsed[1:])  # the first row is on time
        if not (elapsed >= 0.0).all():
            raise ModelError(
                f"elapsed has {elapsed[~(elapsed >= 0.0)][0]:.6g} steps; time cannot go back: give 0 or more."
            )
        return values, np.minimum(elapsed, _LONGEST)

    def _ready_rows(self, causal: Mapping[int, EstimatedRows]) -> Streamed:
        """Return the rows that are ready in all channels; `causal` has the estimates of the channels in `_causal`."""
        found = dict(causal)
        if self._others:
            count = min(ready.count for ready in self._ready.values())
            found |= {c: ready.take(count) for c, ready in self._ready.items()}
        channels = [found[c] for c in range(len(found))]
        return Streamed(
            np.column_stack([one.signal for one in channels]),
            np.column_stack([one.sigma for one in channels]),
            np.column_stack([one.verdicts for one in channels]),
            mode_probabilities(found, self._modes),
        )

    def _no_rows(self) -> Streamed:
        shape = 0, len(self._recipe.channel)
        return Streamed(np.empty(shape), np.empty(shape), np.empty(shape, np.int8), mode_probabilities({}, self._modes))


def _numbers(name: str, given: object) -> Any:
    """Return an array of numbers, with NaN where it is masked; raise a ModelError for anything else."""
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiub":
        return real(given)
    raise ModelError(f"{name} is not an array of numbers; give float64, as np.asarray(rows, float) does.")


def _hash_of(recipe: Recipe) -> Codes:
    """Return a hash of the recipe, to compare recipes."""
    return np.frombuffer(hashlib.sha256(recipe.model_dump_json().encode()).digest(), np.int8)


def _read(blob: bytes) -> dict[str, Any]:
    """Return the arrays of a snapshot; raise a ModelError if it is damaged or of another version."""
    if not isinstance(blob, bytes):
        raise ModelError(f"{_NOT_A_SNAPSHOT}: {type(blob).__name__} came; give what `snapshot` returned.")
    try:
        arrays = unpacked(blob)
        version = int(arrays["told"][0])
    except (ValueError, KeyError, IndexError) as cause:
        raise ModelError(f"{_NOT_A_SNAPSHOT}, or they are damaged: {cause}. Start a new stream.") from cause
    if version != _VERSION:
        raise ModelError(f"The snapshot has version {version}; this becalm reads {_VERSION}. Start a new stream.")
    return arrays


def _without_prefix(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _by_name(counts: Mapping[Verdict, int]) -> dict[str, int]:
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}
