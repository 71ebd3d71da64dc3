"""Recording: an unchangeable set of samples, channel names, units and times, which all parts of becalm exchange."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, frozen, real
from becalm.core.time.timebase import Timebase
from becalm.errors import RecordingError


class Recording:
    """Samples of one or more channels that share one time base.

    Parameters
    ----------
    samples : (N, m) or (N,) array_like
        One row per sample, one column per channel, each in its own unit; NaN where a channel has no
        reading. The array is copied.
    names : sequence of m str, optional
        Channel names, all different; `channel_0`, `channel_1`, ... by default.
    units : sequence of m str, optional
        Units as text, "" where unknown.
    rate_hz : float, optional
        Samples per second of an even time base.
    times_s : (N,) array_like, optional
        Time of each sample in seconds, not decreasing.
    timebase : Timebase, optional
        An existing time base. Give exactly one of `rate_hz`, `times_s` and `timebase`.

    Raises
    ------
    RecordingError
        If shapes, names or units do not agree, or not exactly one kind of time was given.
    TimeError
        If the times are not valid.
    """

    def __init__(  # noqa: PLR0913  (the fields of a recording, by keyword)
        self,
        samples: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        rate_hz: float | None = None,
        times_s: ArrayLike | None = None,
        timebase: Timebase | None = None,
    ) -> None:
        self.samples: Floats = _checked_samples(samples)
        count, width = self.samples.shape
        self.names: tuple[str, ...] = _checked_names(names, width)
        self.units: tuple[str, ...] = _checked_units(units, width)
        if sum(given is not None for given in (rate_hz, times_s, timebase)) != 1:
            raise RecordingError("Give exactly one of rate_hz, times_s and timebase.")
        if rate_hz is not None:
            timebase = Timebase.even(count, rate_hz)
        elif times_s is not None:
            timebase = Timebase.from_stamps(times_s)
        if timebase is None or timebase.count != count:
            raise RecordingError(f"{count} samples need {count} times; {timebase and timebase.count} came.")
        self.timebase: Timebase = timebase

    @property
    def rate_hz(self) -> float:
        """Return the samples per second, 1 over the step."""
        return self.timebase.rate_hz

    @property
    def times_s(self) -> Floats:
        """Return the time of each sample, (N,), in seconds."""
        return self.timebase.times_s

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __repr__(self) -> str:
        """Return a text with the number of samples, the rate and the channel names."""
        return f"Recording({len(self)} samples at {self.rate_hz:.6g} Hz: {', '.join(self.names)})"

    def channel(self, name: str) -> Floats:
        """Return the samples of one channel, (N,).

        Raises
        ------
        RecordingError
            If there is no channel of that name.
        """
        if name not in self.names:
            raise RecordingError(f"There is no channel {name!r}; there are {', '.join(map(repr, self.names))}.")
        return self.samples[:, self.names.index(name)]

    def select(self, names: Sequence[str]) -> Recording:
        """Return a recording of the named channels, in the given order.

        Raises
        ------
        RecordingError
            If there is no channel of one of these names, or two of them are equal.
        """
        columns = [self.channel(name) for name in names]
        units = [self.units[self.names.index(name)] for name in names]
        samples = np.column_stack(columns) if columns else np.empty((len(self), 0))
        return Recording(samples, names=names, units=units, timebase=self.timebase)

    def with_samples(self, samples: ArrayLike) -> Recording:
        """Return the same channels and times with other samples, (N, m)."""
        return Recording(samples, names=self.names, units=self.units, timebase=self.timebase)


def _checked_samples(samples: ArrayLike) -> Floats:
    try:
        own = frozen(real(samples))
    except (TypeError, ValueError, OverflowError) as cause:
        raise RecordingError(f"The samples are not an array of numbers ({cause}).") from cause
    if own.ndim == 1:
        own = own[:, np.newaxis]
    if own.ndim != 2:
        raise RecordingError(f"samples has shape {own.shape}; (N, channels) or (N,) is needed.")
    return own


def _texts(name: str, given: Sequence[str]) -> tuple[str, ...]:
    try:
        return tuple(map(str, given))
    except TypeError as cause:
        raise RecordingError(f"{name} = {given!r:.60} is not a list of texts; give one for each channel.") from cause


def _checked_names(names: Sequence[str] | None, width: int) -> tuple[str, ...]:
    if isinstance(names, str):
        names = (names,)
    own = tuple(f"channel_{i}" for i in range(width)) if names is None else _texts("names", names)
    if len(own) != width:
        raise RecordingError(f"{len(own)} names came for {width} channels: {own}.")
    if not all(own):
        raise RecordingError(f"A channel needs a name; these came: {own}.")
    if len(set(own)) != width:
        raise RecordingError(f"Channel names must differ; these came: {own}.")
    return own


def _checked_units(units: Sequence[str] | None, width: int) -> tuple[str, ...]:
    if isinstance(units, str):
        units = (units,)
    own = ("",) * width if units is None else _texts("units", units)
    if len(own) != width:
        raise RecordingError(f"{len(own)} units came for {width} channels: {own}.")
    return own
