"""Filter a live stream: take blocks of readings, return estimates in order, each row exactly once."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from becalm.cleaning.pipeline import fit_to_recording
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.handover import Handover, rows_to_forget
from becalm.cleaning.streaming.stream import ChannelHealth, StreamCleaner, Streamed
from becalm.core.arrays import Booleans, Codes, Floats, Integers
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.core.time.clock import GAP_STEPS
from becalm.core.time.live_clock import FAR, LATE, REPEATED, RESET, TAKEN, UNTIMED, LiveClock
from becalm.errors import BecalmError, ModelError, RecipeError
from becalm.files.units.unit_spelling import parse_header
from becalm.live.block import Block, Checkpoint, Head, Loss, LossKind, Output
from becalm.live.delayed_rows import DelayedRows

_VERSION = 1  # of the snapshot
_COUNTABLE = 2.0**52  # in steps; the lost rows of a longer gap are not counted
_LEFT_OUT = {  # rows that the clock leaves out: kind and text of the loss
    LATE: (LossKind.LATE, "have a stamp earlier than a row that was already processed"),
    REPEATED: (LossKind.REPEATED, "repeat the stamp of the previous row"),
    FAR: (LossKind.CLOCK, "have a stamp more than a day ahead"),
    UNTIMED: (LossKind.GARBLED, "have no numeric stamp"),
}


class PreparedFilters(NamedTuple):
    """Filters of another recipe (`later`), ready to take over a running stream."""

    recipe: Recipe
    toml: str
    later: StreamCleaner
    rows: int  # rows after which the filters no longer depend on their initial state


class Stream:
    """The filters and the clock of a stream, without its source and sinks.

    Parameters
    ----------
    recipe : Recipe
        The channels and their filters. A smoothing recipe is used as a filter, because later rows are not available.
    step_s : float
        Time step in seconds.
    resolution_s : float
        Resolution to which stamps are rounded, in seconds; 0 if unknown.
    """

    def __init__(self, recipe: Recipe, step_s: float, resolution_s: float = 0.0) -> None:
        self.recipe = recipe
        self.rows = 0
        """Number of rows returned so far."""
        self._clock = LiveClock(step_s, resolution_s)
        self._cleaner: StreamCleaner | Handover = StreamCleaner(recipe, step_s)
        self._former = recipe  # recipe of the outgoing filters during a handover
        self._cached_toml = recipe, ""  # the recipe that was serialized last, with its TOML
        self._waiting = DelayedRows(len(recipe.channel))
        self._columns: list[int] | None = None
        self._last_row = np.empty(0)  # stamp and readings of the last row received, used or left out
        self._step_s = step_s

    @property
    def head(self) -> Head:
        """Return names, units, rate and current recipe."""
        names, units = zip(*((one.name, one.unit) for one in self.recipe.channel), strict=True)
        return Head(names, units, 1 / self._step_s, self._toml())

    @property
    def is_handing_over(self) -> bool:
        """Return whether a handover between two filters is running; a third filter would make the signal jump."""
        return isinstance(self._cleaner, Handover) and self._cleaner.has_begun

    @property
    def last_stamp_s(self) -> float:
        """Return the stamp of the last accepted row in seconds; -inf before the first."""
        return self._clock.last_s

    def notify_source_opened(self) -> None:
        """Notify the clock that the source was opened again."""
        self._clock.mark_interruption()

    def take(self, block: Block) -> Output:
        """Filter a block; return the rows whose estimates are ready, possibly none.

        Raises
        ------
        RecipeError
            If the recipe names a channel that the source does not have, or in another unit.
        """
        if any(loss.kind is LossKind.AWAY for loss in block.losses):
            self._clock.mark_interruption()
        if not len(block):
            return self._output(*_no_rows(len(self.recipe.channel)), block.losses, 0.0)
        values = self._recipe_columns(block)
        stamps, losses = block.time_s, list(block.losses)
        if block.elapsed is not None:
            elapsed = block.elapsed
        else:
            elapsed, codes = self._clock.process_stamps(stamps, self._duplicates(stamps, values))
            taken = (codes == TAKEN) | (codes == RESET)
            losses += _losses_of_left_out_rows(codes)
            if not taken.all():
                stamps, values, elapsed, codes = stamps[taken], values[taken], elapsed[taken], codes[taken]
            missing = sum(
                np.inf if loss.rows is None else loss.rows for loss in losses if loss.kind is LossKind.MISSING
            )
            losses += _losses_of_gaps(stamps, elapsed, codes == RESET, missing)
        estimates = self._cleaner.push(values, elapsed)
        if isinstance(self._cleaner, Handover) and self._cleaner.is_over:
            self._cleaner = self._cleaner.later
        return self._delayed_output(stamps, values, estimates, tuple(losses), block.arrived_s)

    def finish(self) -> Output:
        """Return the rows that are still delayed by the filter's lag; more rows may follow."""
        estimates, done = self._cleaner.finish(), self._waiting.returned
        self._waiting.returned = self._waiting.count
        return self._output(*self._waiting.rows(done), _from_row(estimates, done), (), 0.0)

    def health(self) -> tuple[ChannelHealth, ...]:
        """Return the health of each channel."""
        return self._cleaner.health()

    def _duplicates(self, stamps: Floats, values: Floats) -> Booleans:
        """Return which rows have the same stamp and readings as the previous row."""
        duplicates = np.zeros(len(stamps), np.bool_)
        previous, self._last_row = self._last_row, np.array([stamps[-1], *values[-1]])
        if len(previous) and stamps[0] == previous[0]:
            duplicates[0] = np.array_equal(values[0], previous[1:], equal_nan=True)
        for k in np.flatnonzero(stamps[1:] == stamps[:-1]) + 1:
            duplicates[k] = np.array_equal(values[k], values[k - 1], equal_nan=True)
        return duplicates

    def _recipe_columns(self, block: Block) -> Floats:
        """Return a block's values with the recipe's channels, in the recipe's order."""
        if self._columns is None:
            names = [self._recipe_name(name) for name in block.names]
            block_units = block.units or ("",) * len(names)
            units = [unit or self._unit_of(name) for unit, name in zip(block_units, names, strict=True)]
            self.recipe = fit_to_recording(self.recipe, names, units)
            self._columns = [names.index(channel.name) for channel in self.recipe.channel]
        if self._columns == list(range(block.values.shape[1])):
            return block.values
        return np.ascontiguousarray(block.values[:, self._columns])

    def _recipe_name(self, name: str) -> str:
        """Return the recipe's name for a channel: "load (N)" in a file may be "load", with unit N, in a message."""
        recipe_names = [channel.name for channel in self.recipe.channel]
        bare = parse_header(name)[0]
        matches = [one for one in recipe_names if parse_header(one)[0] == bare]
        return matches[0] if name not in recipe_names and len(matches) == 1 else name

    def _unit_of(self, name: str) -> str:
        return next((channel.unit for channel in self.recipe.channel if channel.name == name), "")

    def _delayed_output(
        self, stamps: Floats, values: Floats, estimates: Streamed, losses: tuple[Loss, ...], arrived_s: float
    ) -> Output:
        if self._cleaner.lag_rows:
            stamps, values, already_returned = self._waiting.push_and_pop(stamps, values, len(estimates.signal))
            estimates = _from_row(estimates, already_returned)
        return self._output(stamps, values, estimates, losses, arrived_s)

    def _output(
        self, stamps: Floats, values: Floats, estimates: Streamed, losses: tuple[Loss, ...], arrived_s: float
    ) -> Output:
        first, self.rows = self.rows, self.rows + len(estimates.signal)
        return Output(first, stamps, values, *estimates[:3], losses, arrived_s, estimates.modes)

    def checkpoint(self, position: str, source: str) -> Checkpoint:
        """Return the checkpoint to commit with the rows returned so far."""
        cleaner = self._cleaner
        is_handover = isinstance(cleaner, Handover)
        blob = cleaner.snapshot(self._former) if isinstance(cleaner, Handover) else cleaner.snapshot()
        state: dict[str, Floats | Codes | Integers] = {
            "step_s": np.array([self._step_s]),
            "told": np.array([_VERSION, is_handover, self._waiting.returned], np.int64),
            "clock": self._clock.state,
            "before": self._last_row,
            "cleaner": np.frombuffer(blob, np.int8),
            "waiting_s": self._waiting.time_s,
            "waiting": self._waiting.values,
        }
        return Checkpoint(self.rows, position, packed(state), self._toml(), source)

    def _toml(self) -> str:
        """Return the recipe as TOML. It is cached, because writing takes a millisecond per channel."""
        if not self._cached_toml[1] or self._cached_toml[0] is not self.recipe:
            self._cached_toml = self.recipe, self.recipe.to_toml()
        return self._cached_toml[1]

    @classmethod
    def resumed(cls, checkpoint: Checkpoint) -> Self:
        """Return the stream of a checkpoint; its estimates equal those of a stream that was never stopped.

        Raises
        ------
        ModelError
            If the snapshot is damaged or has another version.
        RecipeError
            If the checkpoint's recipe cannot be read.
        """
        recipe = Recipe.from_toml(checkpoint.recipe, "The recipe of the stream")
        try:
            arrays = unpacked(checkpoint.snapshot)
            version, is_handover, waiting_returned = (int(number) for number in arrays["told"])
            if version != _VERSION:
                raise ModelError(f"The stream's snapshot has version {version}; this becalm reads {_VERSION}.")
            stream = cls(recipe, float(arrays["step_s"][0]))
            stream._clock = LiveClock.from_state(arrays["clock"])
            stream._last_row = arrays["before"]
            blob = arrays["cleaner"].tobytes()
            if is_handover:
                stream._cleaner, stream._former = Handover.resume(blob, recipe)
            else:
                stream._cleaner = StreamCleaner.resume(blob, recipe)
            stream._waiting.restore(arrays["waiting_s"], arrays["waiting"], waiting_returned)
        except BecalmError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as cause:
            raise ModelError("The stream's snapshot is damaged; start a new stream in another folder.") from cause
        stream.rows = checkpoint.rows
        return stream

    def retune(self, recipe: Recipe) -> None:
        """Use another recipe for the same channels from the next row on, without a jump of the signal.

        Raises
        ------
        RecipeError
            If the recipe has other channels or another lag.
        """
        self.take_over(self.prepare_filters(recipe))

    def prepare_filters(self, recipe: Recipe) -> PreparedFilters:
        """Make the filters of another recipe. This takes some tenths of a second; any thread may call it.

        Raises
        ------
        RecipeError
            If the recipe has other channels.
        """
        names, units = zip(*((one.name, one.unit) for one in self.recipe.channel), strict=True)
        recipe = fit_to_recording(recipe, names, units)
        if [one.name for one in recipe.channel] != list(names):
            raise RecipeError("The recipe has other channels than the stream; give a recipe for the stream's channels.")
        cleaner = StreamCleaner(recipe, self._step_s)
        return PreparedFilters(recipe, recipe.to_toml(), cleaner, rows_to_forget(recipe, self._step_s))

    def take_over(self, prepared: PreparedFilters) -> None:
        """Hand over to prepared filters from the next row on.

        Raises
        ------
        RecipeError
            If the prepared filters have another lag.
        """
        if isinstance(self._cleaner, Handover) and not self._cleaner.has_begun:
            former = self._cleaner.former  # the filters of the last request have not returned a row yet: drop them
            self._cleaner = Handover(former, prepared.later, prepared.rows)
        else:
            former = self._cleaner.later if isinstance(self._cleaner, Handover) else self._cleaner
            self._cleaner, self._former = Handover(former, prepared.later, prepared.rows), self.recipe
        self.recipe, self._cached_toml = prepared.recipe, (prepared.recipe, prepared.toml)


def _from_row(estimates: Streamed, row: int) -> Streamed:
    return Streamed(estimates.signal[row:], estimates.sigma[row:], estimates.verdicts[row:], estimates.modes[row:])


def _no_rows(channels: int) -> tuple[Floats, Floats, Streamed]:
    none = np.empty((0, channels))
    return np.empty(0), none, Streamed(none, none, np.empty((0, channels), np.int8))


def _losses_of_left_out_rows(codes: Codes) -> list[Loss]:
    """Return a loss for each kind of row that the clock left out because of its stamp."""
    if not codes.any():
        return []
    counts = {code: int(np.count_nonzero(codes == code)) for code in _LEFT_OUT}
    return [
        Loss(kind, counts[code], f"{counts[code]} rows {text}; they were left out.")
        for code, (kind, text) in _LEFT_OUT.items()
        if counts[code]
    ]


def _losses_of_gaps(stamps: Floats, elapsed: Floats, reset: Booleans, missing: float) -> list[Loss]:
    """Return a loss for each jump of the sender's clock, and for each gap that `missing` rows do not explain."""
    losses = [
        Loss(LossKind.CLOCK, None, f"The sender's clock jumped to {stamps[k]:.9g} s; the stream continues there.")
        for k in np.flatnonzero(reset)
    ]
    for k in np.flatnonzero((elapsed > GAP_STEPS) & ~reset):
        if elapsed[k] <= missing + GAP_STEPS:
            missing -= elapsed[k] - 1
            continue
        rows = round(elapsed[k] - 1) if elapsed[k] < _COUNTABLE else None
        losses.append(Loss(LossKind.GAP, rows, f"There is a gap of {elapsed[k]:.6g} steps before {stamps[k]:.15g} s."))
    return losses
