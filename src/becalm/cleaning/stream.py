"""A stream through a recipe: rows come as they are measured, and the numbers are those of a file.

The results are those of a causal, or lagged, `clean` to 1e-12; wherever rows are cut, and wherever a stream is paused
and resumed, they are the same to the bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from becalm.cleaning.cleaner import ReadyRows
from becalm.cleaning.limits_entry import limits_of
from becalm.cleaning.live_channel import mean_power, open_live
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import lag_in_rows
from becalm.cleaning.stream_modes import NO_MODES, modes_in, modes_of, with_modes
from becalm.cleaning.together import open_together, runs_together
from becalm.core.arrays import Codes, Floats, input_of
from becalm.core.kernel_stream_layout import Out, Rows
from becalm.core.packing import packed, unpacked
from becalm.core.rhythm import Rhythm
from becalm.core.streams import new_block
from becalm.core.told import Told
from becalm.core.verdict import Verdict
from becalm.errors import ModelError, RecipeError

_VERSION = 2  # 1 knew no gross outliers
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
        joined = [c for c, one in enumerate(recipe.channel) if runs_together(one, self.lag_rows)]
        self._together = open_together([recipe.channel[c] for c in joined], joined, step_s)
        self._apart = {
            c: open_live(one, step_s, self.lag_rows) for c, one in enumerate(recipe.channel) if c not in joined
        }
        self._ready = {c: ReadyRows() for c in self._apart}
        self._rhythms = _rhythms(recipe, joined)
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
        rows, out = new_block(values, elapsed, self._step_s)
        if not len(values):
            return Streamed(*out, modes_of({}, self._modes))
        self._write_timing(out.verdicts, rows)
        for group in self._together:
            group.push(rows, out)
        for c, channel in self._apart.items():
            self._ready[c].add(channel.push(np.ascontiguousarray(values[:, c]), elapsed))
        self._rows += len(values)
        return self._answer(out)

    def finish(self) -> Streamed:
        """Return the rows that wait, with what there is after them; nothing changes by it: more rows may follow."""
        if not self.lag_rows:
            return self.push(np.empty((0, len(self._recipe.channel))), np.empty(0))
        other = type(self).resume(self.snapshot(), self._recipe)
        for c, channel in other._apart.items():
            other._ready[c].add(channel.finish())
        return other._answer(None)

    def health(self) -> tuple[ChannelHealth, ...]:
        """Say how each channel is."""
        found: dict[int, ChannelHealth] = {}
        names = [channel.name for channel in self._recipe.channel]
        for group in self._together:
            for place, c in enumerate(group.columns):
                counts = _in_words(group.counts(place))
                found[c] = ChannelHealth(
                    names[c], counts, mean_power(group.powers(place)), group.drift_since(place), group.is_silent(place)
                )
        for c, channel in self._apart.items():
            monitor, counts = channel.sensor.monitor, _in_words(channel.counts)
            nis = mean_power(monitor.powers)
            found[c] = ChannelHealth(names[c], counts, nis, monitor.drift_since, monitor.is_silent)
        return tuple(found[c] for c in range(len(names)))

    def snapshot(self) -> bytes:
        """Return all that is needed to go on later, as plain bytes; the same state gives the same bytes."""
        told = np.array([_VERSION, self._rows], np.int64)
        arrays: dict[str, Any] = {"told": told, "recipe": self._mark, "step_s": np.array([self._step_s])}
        arrays |= {f"rhythm{k}": rhythm.offsets for k, (rhythm, _) in enumerate(self._rhythms)}
        for k, group in enumerate(self._together):
            arrays |= {f"group{k}.{name}": array for name, array in group.saved().items()}
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
        for k, (rhythm, _) in enumerate(self._rhythms):
            rhythm.offsets[:] = arrays[f"rhythm{k}"]
        for k, group in enumerate(self._together):
            group.restore(**{name: arrays[f"group{k}.{name}"] for name in ("numbers", "marks", "known")})
        for c, channel in self._apart.items():
            channel.restore(_under(f"channel{c}.", arrays))
            if self.lag_rows:
                waiting = Told(**_under(f"ready{c}.", arrays))
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

    def _write_timing(self, verdicts: Codes, rows: Rows) -> None:
        """Write what is wrong with the time of rows, for the channels that run together."""
        for rhythm, columns in self._rhythms:
            if rows.is_even and rhythm.undisturbed:
                continue
            codes = np.zeros(len(verdicts), np.int8)
            rhythm.write(codes, rows.elapsed)
            verdicts[:, columns] = codes[:, np.newaxis]

    def _answer(self, out: Out | None) -> Streamed:
        """Return what is ready of all channels."""
        if not self._apart and out is not None:
            return Streamed(*out)
        count = min(ready.count for ready in self._ready.values())
        told = {c: ready.take(count) for c, ready in self._ready.items()}
        if self.lag_rows or out is None:
            fields = ([getattr(told[c], name) for c in range(len(told))] for name in Out._fields)
            joined = Out(*map(np.ascontiguousarray, map(np.column_stack, fields)))
            return Streamed(*joined, modes_of(told, self._modes))
        for c, one in told.items():
            out.signal[:, c], out.sigma[:, c], out.verdicts[:, c] = one.signal, one.sigma, one.verdicts
        return Streamed(*out, modes_of(told, self._modes))


def _numbers(name: str, given: object) -> Any:
    """Return numbers as they came, or say that these are none."""
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiub":
        return given
    raise ModelError(f"{name} is no array of numbers; give float64, as np.asarray(rows, float) does.")


def _rhythms(recipe: Recipe, columns: list[int]) -> list[tuple[Rhythm, list[int]]]:
    """Return what watches the time of rows, one for all channels that take the same for late and for a gap."""
    alike: dict[tuple[bool, float], tuple[Rhythm, list[int]]] = {}
    for c in columns:
        limits = limits_of(recipe.channel[c].limits)
        alike.setdefault((limits.even, limits.gap_steps), (Rhythm(limits), []))[1].append(c)
    return list(alike.values())


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
