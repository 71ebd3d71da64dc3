"""A recipe's filters with their clock: blocks of readings in, what is told of them out, in order and once."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from becalm.cleaning.handover import Handover, rows_to_forget
from becalm.cleaning.pipeline import fitted
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.stream import ChannelHealth, StreamCleaner, Streamed
from becalm.core.arrays import Booleans, Codes, Floats, Integers
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.core.time.clock import GAP_STEPS
from becalm.core.time.live_clock import FAR, LATE, REPEATED, RESET, TAKEN, UNTIMED, LiveClock
from becalm.errors import BecalmError, ModelError, RecipeError
from becalm.files.unit_spelling import parse_header
from becalm.live.block import Block, Checkpoint, Head, Loss, LossKind, Output
from becalm.live.delayed_rows import Waiting

_VERSION = 1
_COUNTABLE = 2.0**52  # steps; a stamp that claims more tells nothing of rows
_LEFT_OUT = {
    LATE: (LossKind.LATE, "came with stamps before that of a row already taken"),
    REPEATED: (LossKind.REPEATED, "came with the stamp of the row before"),
    FAR: (LossKind.CLOCK, "came with stamps more than a day ahead"),
    UNTIMED: (LossKind.GARBLED, "came without a stamp that is a number"),
}


class Prepared(NamedTuple):
    """Filters that may take over."""

    recipe: Recipe
    toml: str
    later: StreamCleaner
    rows: int  # until they have forgotten their start


class Stream:
    """What a stream is made of, but for its wires.

    Parameters
    ----------
    recipe : Recipe
        What to do; a smoothing one filters here, for no stream knows what comes later.
    step_s : float
        One step in seconds.
    resolution_s : float
        Last digit that stamps are rounded to, in seconds; 0 where none is known.
    """

    def __init__(self, recipe: Recipe, step_s: float, resolution_s: float = 0.0) -> None:
        self.recipe = recipe
        self.rows = 0
        """Rows told so far."""
        self._clock = LiveClock(step_s, resolution_s)
        self._cleaner: StreamCleaner | Handover = StreamCleaner(recipe, step_s)
        self._former = recipe  # that gives way, in a handover
        self._written = recipe, ""  # the recipe as it was written last
        self._waiting = Waiting(len(recipe.channel))
        self._numbers: list[int] | None = None
        self._before = np.empty(0)  # stamp and readings of the row that came last, whatever became of it
        self._step_s = step_s

    @property
    def head(self) -> Head:
        """What every row shares."""
        names, units = zip(*((one.name, one.unit) for one in self.recipe.channel), strict=True)
        return Head(names, units, 1 / self._step_s, self._toml())

    @property
    def gives_way(self) -> bool:
        """Whether the signal is on its way from one filter to another; a third one would make it jump."""
        return isinstance(self._cleaner, Handover) and self._cleaner.has_begun

    @property
    def taken_to_s(self) -> float:
        """The stamp of the row that was taken last, in seconds; -inf before the first."""
        return self._clock.last_s

    def opened(self) -> None:
        """Hear that the source was opened anew."""
        self._clock.opened()

    def take(self, block: Block) -> Output:
        """Take a block; return what can be told now, perhaps of no rows.

        Raises
        ------
        RecipeError
            If the recipe names a channel that the source does not have, or in another unit.
        """
        if any(loss.kind is LossKind.AWAY for loss in block.losses):
            self._clock.opened()
        if not len(block):
            return self._output(*_nothing(len(self.recipe.channel)), block.losses, 0.0)
        values = self._chosen(block)
        stamps, losses = block.time_s, list(block.losses)
        if block.elapsed is not None:
            elapsed = block.elapsed
        else:
            elapsed, codes = self._clock.passed(stamps, self._doubled(stamps, values))
            taken = (codes == TAKEN) | (codes == RESET)
            losses += _left_out(codes)
            if not taken.all():
                stamps, values, elapsed, codes = stamps[taken], values[taken], elapsed[taken], codes[taken]
            losses += _jumps(stamps, elapsed, codes == RESET, any(one.kind is LossKind.MISSING for one in losses))
        told = self._cleaner.push(values, elapsed)
        if isinstance(self._cleaner, Handover) and self._cleaner.is_over:
            self._cleaner = self._cleaner.later
        return self._told(stamps, values, told, tuple(losses), block.arrived_s)

    def finish(self) -> Output:
        """Tell what still waits for later rows; the stream goes on from there if more come after all."""
        told, done = self._cleaner.finish(), self._waiting.told
        self._waiting.told = self._waiting.count
        return self._output(*self._waiting.rows(done), _after(told, done), (), 0.0)

    def health(self) -> tuple[ChannelHealth, ...]:
        """Say how each channel is."""
        return self._cleaner.health()

    def _doubled(self, stamps: Floats, values: Floats) -> Booleans:
        """Say which rows have the stamp and the readings of the row before."""
        doubled = np.zeros(len(stamps), np.bool_)
        before, self._before = self._before, np.array([stamps[-1], *values[-1]])
        if len(before) and stamps[0] == before[0]:
            doubled[0] = np.array_equal(values[0], before[1:], equal_nan=True)
        for k in np.flatnonzero(stamps[1:] == stamps[:-1]) + 1:
            doubled[k] = np.array_equal(values[k], values[k - 1], equal_nan=True)
        return doubled

    def _chosen(self, block: Block) -> Floats:
        if self._numbers is None:
            names = [self._called(name) for name in block.names]
            told = block.units or ("",) * len(names)
            units = [unit or self._unit_of(name) for unit, name in zip(told, names, strict=True)]
            self.recipe = fitted(self.recipe, names, units)
            self._numbers = [names.index(channel.name) for channel in self.recipe.channel]
        if self._numbers == list(range(block.values.shape[1])):
            return block.values
        return np.ascontiguousarray(block.values[:, self._numbers])

    def _called(self, name: str) -> str:
        """Return what the recipe calls a channel: a file's "load (N)" may come as "load", in N, from a message."""
        own = [channel.name for channel in self.recipe.channel]
        bare = parse_header(name)[0]
        alike = [one for one in own if parse_header(one)[0] == bare]
        return alike[0] if name not in own and len(alike) == 1 else name

    def _unit_of(self, name: str) -> str:
        return next((channel.unit for channel in self.recipe.channel if channel.name == name), "")

    def _told(
        self, stamps: Floats, values: Floats, told: Streamed, losses: tuple[Loss, ...], arrived_s: float
    ) -> Output:
        if self._cleaner.lag_rows:
            stamps, values, again = self._waiting.through(stamps, values, len(told.signal))
            told = _after(told, again)
        return self._output(stamps, values, told, losses, arrived_s)

    def _output(
        self, stamps: Floats, values: Floats, told: Streamed, losses: tuple[Loss, ...], arrived_s: float
    ) -> Output:
        first, self.rows = self.rows, self.rows + len(told.signal)
        return Output(first, stamps, values, *told[:3], losses, arrived_s, told.modes)

    def checkpoint(self, position: str, source: str) -> Checkpoint:
        """Return where the stream stands, once all told so far is kept."""
        cleaner = self._cleaner
        between = isinstance(cleaner, Handover)
        blob = cleaner.snapshot(self._former) if isinstance(cleaner, Handover) else cleaner.snapshot()
        moving: dict[str, Floats | Codes | Integers] = {
            "step_s": np.array([self._step_s]),
            "told": np.array([_VERSION, between, self._waiting.told], np.int64),
            "clock": self._clock.state,
            "before": self._before,
            "cleaner": np.frombuffer(blob, np.int8),
            "waiting_s": self._waiting.time_s,
            "waiting": self._waiting.values,
        }
        return Checkpoint(self.rows, position, packed(moving), self._toml(), source)

    def _toml(self) -> str:
        """Write the recipe, once for all commits: each would take a millisecond a channel."""
        if not self._written[1] or self._written[0] is not self.recipe:
            self._written = self.recipe, self.recipe.to_toml()
        return self._written[1]

    @classmethod
    def resumed(cls, checkpoint: Checkpoint) -> Self:
        """Go on from a checkpoint; what is told is what a stream tells that was never stopped.

        Raises
        ------
        ModelError
            If the checkpoint is damaged, or of another version.
        """
        recipe = Recipe.from_toml(checkpoint.recipe, "The recipe of the stream")
        try:
            arrays = unpacked(checkpoint.snapshot)
            version, between, waiting_told = (int(number) for number in arrays["told"])
            if version != _VERSION:
                raise ModelError(f"The stream's snapshot has version {version}; this becalm reads {_VERSION}.")
            stream = cls(recipe, float(arrays["step_s"][0]))
            stream._clock = LiveClock.resumed(arrays["clock"])
            stream._before = arrays["before"]
            blob = arrays["cleaner"].tobytes()
            if between:
                stream._cleaner, stream._former = Handover.resume(blob, recipe)
            else:
                stream._cleaner = StreamCleaner.resume(blob, recipe)
            stream._waiting.restore(arrays["waiting_s"], arrays["waiting"], waiting_told)
        except BecalmError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as cause:
            raise ModelError("The stream's snapshot is damaged; begin a new stream in another folder.") from cause
        stream.rows = checkpoint.rows
        return stream

    def retuned(self, recipe: Recipe) -> None:
        """Take another recipe for the same channels from the next row on, without a jump of the signal.

        Raises
        ------
        RecipeError
            If it has other channels, or another lag.
        """
        self.take_over(self.prepared(recipe))

    def prepared(self, recipe: Recipe) -> Prepared:
        """Make the filters of another recipe, which takes some tenths of a second; any thread may.

        Raises
        ------
        RecipeError
            If it has other channels.
        """
        names, units = zip(*((one.name, one.unit) for one in self.recipe.channel), strict=True)
        recipe = fitted(recipe, names, units)
        if [one.name for one in recipe.channel] != list(names):
            raise RecipeError("The recipe has other channels than the stream, which keeps those it began with.")
        cleaner = StreamCleaner(recipe, self._step_s)
        return Prepared(recipe, recipe.to_toml(), cleaner, rows_to_forget(recipe, self._step_s))

    def take_over(self, prepared: Prepared) -> None:
        """Let filters that are made take over from the next row on.

        Raises
        ------
        RecipeError
            If they have another lag.
        """
        if isinstance(self._cleaner, Handover) and not self._cleaner.has_begun:
            former = self._cleaner.former  # what is between told nothing
            self._cleaner = Handover(former, prepared.later, prepared.rows)
        else:
            former = self._cleaner.later if isinstance(self._cleaner, Handover) else self._cleaner
            self._cleaner, self._former = Handover(former, prepared.later, prepared.rows), self.recipe
        self.recipe, self._written = prepared.recipe, (prepared.recipe, prepared.toml)


def _after(told: Streamed, rows: int) -> Streamed:
    return Streamed(told.signal[rows:], told.sigma[rows:], told.verdicts[rows:], told.modes[rows:])


def _nothing(channels: int) -> tuple[Floats, Floats, Streamed]:
    none = np.empty((0, channels))
    return np.empty(0), none, Streamed(none, none, np.empty((0, channels), np.int8))


def _left_out(codes: Codes) -> list[Loss]:
    """Say which rows were not taken for their stamps."""
    if not codes.any():
        return []
    counts = {code: int(np.count_nonzero(codes == code)) for code in _LEFT_OUT}
    return [
        Loss(kind, counts[code], f"{counts[code]} rows {says}; they were left out.")
        for code, (kind, says) in _LEFT_OUT.items()
        if counts[code]
    ]


def _jumps(stamps: Floats, elapsed: Floats, reset: Booleans, explained: bool) -> list[Loss]:
    """Say where time stood open, or the sender's clock jumped."""
    losses = [
        Loss(LossKind.CLOCK, None, f"The sender's clock jumped to {stamps[k]:.9g} s; the stream goes on from there.")
        for k in np.flatnonzero(reset)
    ]
    gaps = np.flatnonzero((elapsed > GAP_STEPS) & ~reset & (not explained))
    return losses + [
        Loss(
            LossKind.GAP,
            round(elapsed[k] - 1) if elapsed[k] < _COUNTABLE else None,
            f"{elapsed[k]:.6g} steps passed before {stamps[k]:.15g} s.",
        )
        for k in gaps
    ]
