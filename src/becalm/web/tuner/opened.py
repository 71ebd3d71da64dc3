"""Read the recording that the tuner shows, and identify its filters, as the command line does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.recipes.recipe import Origin
from becalm.cleaning.tuning import Tuned, Wishes, calibrated, explore, tuned_as_filter
from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.inputs.opening import OpenSource
from becalm.files.inputs.portions import rows_to_tune_on
from becalm.files.inputs.time_bases import open_file
from becalm.files.read_options import ReadOptions
from becalm.web.tuner.settings import Options

Progress = Callable[[str], None]

AS_IT_IS = ReadOptions()
"""Options that read a file with its own times."""

MOST_SAMPLES = 1 << 28
"""Largest number of samples in memory (2 GiB); each channel that a page shows takes memory for two more copies."""


class OpenRecording:
    """The channels of a file that share one time axis, in memory.

    Parameters
    ----------
    id : str
        Name of the file in messages to and from a page.
    path : Path
        Path of the file.
    group : str or None
        Name of the time axis, for a file with several time axes; None means the first one.
    progress : callable
        Function that gets a sentence on the work in progress.
    read_options : ReadOptions
        Options for the file's time base.

    Attributes
    ----------
    recording : Recording
        All rows.
    group : str
        Name of this time axis in the file; "" if the file has only one time axis.
    groups : list of str
        Names of all time axes of the file.
    remarks : list of str
        Notes on the file that a person should read.

    Raises
    ------
    InputError
        If the file cannot be read, or is too large.
    UsageError
        If the file has no such time axis, or the options do not fit the file.
    """

    def __init__(
        self, id: str, path: Path, group: str | None, progress: Progress, read_options: ReadOptions = AS_IT_IS
    ) -> None:
        self.id, self.path, self._progress, self.read_options = id, path, progress, read_options
        progress(f"Reading {path.name} ...")
        self._fingerprint = _fingerprint(path)
        with open_file(path, read_options) as opened:
            source = _chosen(opened.sources, group)
            self.groups = [one.group for one in opened.sources]
            if source.rows * len(source.names) > MOST_SAMPLES:
                raise InputError(
                    f"{path.name} has {source.rows} rows of {len(source.names)} channels, more than fit into memory"
                    f" ({MOST_SAMPLES} samples); clean it with: becalm clean {path.name} -o OUT"
                )
            self.recording = source.recording()
            most = rows_to_tune_on(source)
            self._sample = self.recording if source.rows <= most else source.sample(most)
            self.group, self._calibrations = source.group, source.calibrations
            self._sha256 = source.sha256()
            self.remarks = list(source.notes)
            self.has_several_groups = len(opened.sources) > 1
        self._explored: dict[bool, tuple[Tuned, tuple[Options, ...]]] = {}
        self._exploration = threading.Lock()  # two pages may need the result at once
        self._times: Floats | None = None
        self._rows: dict[int, ChannelRows] = {}

    @property
    def step_s(self) -> float:
        """Return the sampling interval, in seconds."""
        return self.recording.timebase.step_s

    @property
    def lasts_s(self) -> float:
        """Return the time from the first row to the last, in seconds."""
        return self.recording.timebase.duration_s

    @property
    def times_s(self) -> Callable[[], Floats] | None:
        """Return a function that gives the time of each row since the first, (N,), in seconds.

        None if the rows are evenly spaced and none is missing.
        """
        time = self.recording.timebase
        even = time.uniform and round(time.duration_s / time.step_s) == len(self.recording) - 1 and not len(time.gaps)
        return None if even and not len(time.repeats) else self._row_times

    def is_unchanged(self, path: Path) -> bool:
        """Return whether the file, now at `path`, is unchanged since it was read."""
        return bool(self._fingerprint) and _fingerprint(path) == self._fingerprint

    def as_filter(self, mode: str, lag_s: float | None) -> bool:
        """Return whether a mode is tuned as a filter, not as a smoother; raise a UsageError for an impossible lag."""
        return tuned_as_filter(mode == "causal", lag_s, self.step_s)

    def options(self, as_filter: bool) -> tuple[Options, ...]:
        """Return the possible settings of each channel; the first call identifies all filters, which takes a while."""
        return self._identify_once(as_filter)[1]

    def origin(self, as_filter: bool) -> Origin:
        """Return the origin of the identified parameters, for a recipe."""
        return self._identify_once(as_filter)[0].recipe.tuned_on.model_copy(update={"sha256": self._sha256})

    def check_channel(self, channel: int) -> None:
        """Raise a UsageError if there is no such channel."""
        if not channel < len(self.recording.names):
            raise UsageError(f"There is no channel {channel + 1}; there are {len(self.recording.names)}.")

    def rows(self, channel: int) -> ChannelRows:
        """Return a copy of a channel's rows, which is cached; raise a UsageError if there is no such channel."""
        self.check_channel(channel)
        if channel not in self._rows:
            limits = next(iter(self._explored.values()))[1][channel].channel.limits if self._explored else None
            z = np.ascontiguousarray(self.recording.samples[:, channel])
            self._rows[channel] = ChannelRows(z, self.recording.timebase.elapsed_steps, self.step_s, limits)
        return self._rows[channel]

    def _row_times(self) -> Floats:
        if self._times is None:
            time = self.recording.timebase
            self._times = np.cumsum(time.elapsed_steps) * time.step_s
        return self._times

    def _identify_once(self, as_filter: bool) -> tuple[Tuned, tuple[Options, ...]]:
        if as_filter not in self._explored:
            with self._exploration:
                if as_filter not in self._explored:
                    self._explored[as_filter] = self._explore(as_filter)
        return self._explored[as_filter]

    def _explore(self, as_filter: bool) -> tuple[Tuned, tuple[Options, ...]]:
        count, done = len(self.recording.names), list[str]()
        self._progress(f"Finding the noise of {count} channel{'s' * (count > 1)} ...")

        def report(name: str) -> None:
            done.append(name)
            self._progress(f"Found the filter of {name} ({len(done)} of {count}).")

        tuned = explore(self._sample, causal=as_filter, wishes=Wishes(), progress=report)
        channels = calibrated(tuned.recipe.channel, self._calibrations)
        pairs = zip(tuned.found, channels, strict=True)
        return tuned, tuple(Options(found, channel, self.step_s, as_filter) for found, channel in pairs)


def _fingerprint(path: Path) -> list[tuple[int, ...]]:
    """Return a fingerprint of a file, or of a folder and its files; empty if it cannot be examined."""
    try:
        entries = [one.stat() for one in (path, *(sorted(path.iterdir()) if path.is_dir() else ()))]
    except OSError:
        return []
    return [(one.st_dev, one.st_ino, one.st_size, one.st_mtime_ns) for one in entries]


def _chosen(sources: Sequence[OpenSource], group: str | None) -> OpenSource:
    matching = [source for source in sources if group in (None, source.group)]
    if not matching:
        raise UsageError(f"The file has no channels at the time {group!r}; choose another one.")
    return matching[0]
