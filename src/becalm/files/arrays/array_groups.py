"""Group the arrays of a file into tables: those that share a vector of times, a rate, or a group of the file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.files.arrays.array_labels import NAME
from becalm.files.arrays.array_rates import Rates
from becalm.files.arrays.array_titles import is_alone, take_titles
from becalm.files.arrays.arrays import FileArrays, Leaf, Path
from becalm.files.column_statistics import Column
from becalm.files.groups import GROUP, START, TIME, Group
from becalm.files.source import FormatTime
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name
from becalm.files.unit_spelling import parse_header

_MOST_COLUMNS = 1024  # of one array; an array with more columns is an image
_STRAY, _SHORT = 50, 100  # a calibration has this factor fewer rows than the longest table, and at most so many rows
_UNITS = ("units", "unit", "Units", "Unit", "UNITS", "units_")
_NAMES = ("columns", "column_names", "names", "labels", "channels", "channel_names", "axes", "axis", "header")
_OWN_TIME = re.compile(
    r"(?:t|time|times|timestamp|timestamps)_(.+)|(.+)_(?:t|time|times|timestamp|timestamps)"
    r"|(.+_)(?:time|times|timestamp|timestamps)_(.+)"  # Data1_time_AI_1 of Data1_AI_1
)


class _Home(NamedTuple):
    """The properties that the arrays of one table share."""

    folder: Path
    time: Path  # path of the vector of times, or () if there is none
    rate_hz: float | None
    rows: int
    meant: int  # number of rows in a file that is not truncated


class Grouping:
    """A grouping of the arrays of a file into tables.

    Parameters
    ----------
    found : FileArrays
        The contents of the file.
    joint : str
        Separator between the parts of a path, in names.
    apart : bool
        Whether arrays without times form a table for each group of the file, and names omit the group.
    """

    def __init__(self, found: FileArrays, joint: str, apart: bool) -> None:
        take_titles(found)
        self._found, self._joint, self._apart = found, joint, apart
        self._rates = Rates(found)
        self._described = found.described_units()
        leaves = [leaf for leaf in found.leaves if self._fits(leaf)]
        self._written = {path[:-1] for path in found.words if path[-1] == GROUP}  # tables that becalm wrote
        others = [leaf for leaf in leaves if leaf.path[:-1] not in self._written]
        self._times = {leaf.path: leaf for leaf in others if len(leaf.shape) == 1 and self._may_be_time(leaf, others)}
        self._homes: dict[_Home, list[Leaf]] = {}
        for leaf in leaves:
            if leaf.path not in self._times:
                self._homes.setdefault(self._home(leaf), []).append(leaf)

    @property
    def notes(self) -> list[str]:
        """Return the notes for the user on the contents of the file."""
        return self._found.notes

    def groups(self) -> list[Group]:
        """Return the tables, in the order of the file."""
        self._leave_strays_out()
        used = {home.time for home in self._homes}
        for path, leaf in self._times.items():
            if path not in used and self._is_unused(leaf):
                self._found.notes.append(f"{self._shown(path)} has {leaf.length} times, but no channel belongs to it.")
        notes = tuple(self._found.notes)
        return [self._group(home, leaves, notes) for home, leaves in self._homes.items()]

    def _fits(self, leaf: Leaf) -> bool:
        """Return whether an array can be a table of channels, and not an image."""
        columns = int(np.prod(leaf.shape, dtype=object)) // leaf.length
        if columns > _MOST_COLUMNS:
            self._found.notes.append(
                f"{self._shown(leaf.path)} has the shape {leaf.shape}, which is not a table of channels; left out."
            )
        return columns <= _MOST_COLUMNS

    def _may_be_time(self, leaf: Leaf, leaves: Sequence[Leaf]) -> bool:
        folder, name = leaf.path[:-1], leaf.path[-1]
        if leaf.type.kind not in "iufMmO":
            return False
        if stem := _stem(name):
            neighbours = [one for one in leaves if one.path[:-1] == folder and one is not leaf]
            return any(_is_of(one.path[-1], stem) and leaf.meant[0] in one.meant for one in neighbours)
        label = self._found.word((*leaf.path, NAME))
        own = label if label != "/".join(leaf.path) else name  # if it is a whole path, only its last part counts
        return is_time_name(own or name) or leaf.type.kind == "M"

    def _home(self, leaf: Leaf) -> _Home:
        if leaf.path[:-1] in self._written:
            return _Home(leaf.path[:-1], (), None, leaf.length, leaf.meant[0])
        for depth in range(len(leaf.path) - 1, -1, -1):
            folder = leaf.path[:depth]
            fitting = [one for path, one in self._times.items() if path[:-1] == folder and one.meant[0] in leaf.meant]
            own = [one for one in fitting if (stem := _stem(one.path[-1])) and _is_of(leaf.path[-1], stem)]
            general = [one for one in fitting if not _stem(one.path[-1])]
            for times in (own, general):
                if times:
                    meant = times[0].meant[0]
                    return _Home(folder, times[0].path, None, min(times[0].length, _rows(leaf, meant)), meant)
        rate = self._rates.of(leaf)
        folder = leaf.path[:-1] if self._apart else rate[0] if rate and rate[0] != leaf.path else ()
        if rate and not self._apart and folder == leaf.path[:-1] and self._is_whole(leaf):
            folder = folder[:-1]
        meant = max(leaf.meant)
        return _Home(folder, (), rate[1] if rate else None, _rows(leaf, meant), meant)

    def _is_whole(self, leaf: Leaf) -> bool:
        """Return whether the array's struct holds a single channel, and has the same start as the group above it."""
        folder = leaf.path[:-1]
        alone = is_alone(leaf.path) and bool(self._found.word((*leaf.path, NAME)))
        return alone and self._rates.start(folder) == self._rates.start(folder[:-1])

    def _leave_strays_out(self) -> None:
        """Drop tables without times that hold only texts, or are far shorter than the longest, such as calibrations."""
        longest = max((home.rows for home in self._homes), default=0)
        loose = {home: leaves for home, leaves in self._homes.items() if home.folder not in self._written}
        for home, leaves in loose.items():
            if not home.time and len(self._homes) > 1 and all(leaf.type.kind == "O" for leaf in leaves):
                del self._homes[home]  # names and units of other arrays
        for home in loose:
            if home in self._homes and not home.time and home.rows <= _SHORT and home.rows * _STRAY < longest:
                for leaf in self._homes.pop(home):
                    if leaf.type.kind != "O":
                        self._found.notes.append(
                            f"{self._shown(leaf.path)} has only {home.rows} values; it is left out."
                        )

    def _is_unused(self, leaf: Leaf) -> bool:
        """Return whether no table uses times of the same group and length."""
        return not any(home.time[:-1] == leaf.path[:-1] and home.meant == leaf.meant[0] for home in self._homes)

    def _group(self, home: _Home, leaves: Sequence[Leaf], notes: tuple[str, ...]) -> Group:
        columns: list[tuple[str, Column]] = []
        if home.time:
            neighbours = (one for path, one in self._times.items() if path[:-1] == home.time[:-1])
            times = [one for one in neighbours if one.meant[0] == home.meant]
            for leaf in [self._times[home.time]] if _stem(home.time[-1]) else times:
                columns += self._columns(leaf, home)
        for leaf in leaves:
            columns += self._columns(leaf, home)
        names = unique_names([name for name, _ in columns])
        time = None
        if home.rate_hz is not None and not any(is_time_name(name) for name in names):
            time = FormatTime("", home.rate_hz, self._rates.start(home.folder))
        elif TIME in names and (start := self._found.word((*home.folder, START))):
            time = FormatTime(TIME, None, start)
        named = dict(zip(names, (column for _, column in columns), strict=True))
        return Group(self._title(home, leaves), named, home.rows, time, notes)

    def _title(self, home: _Home, leaves: Sequence[Leaf]) -> str:
        """Return the name of a table: that of its group, or of its first array if the group has several tables."""
        if stored := self._found.word((*home.folder, GROUP)):
            return stored
        rivals = [other for other in self._homes if other.folder == home.folder]
        if len(rivals) == 1:
            return self._joint.join(home.folder)
        if not self._apart and self._is_whole(leaves[0]):
            return self._joint.join(leaves[0].path[:-1])
        name = self._name(leaves[0], home)
        return self._joint.join((*home.folder, name)) if self._apart else name

    def _columns(self, leaf: Leaf, home: _Home) -> list[tuple[str, Column]]:
        rows = leaf.meant.index(home.meant)
        name = self._name(leaf, home)
        others = [range(size) for axis, size in enumerate(leaf.shape) if axis != rows]
        indices = list(product(*others))
        units = self._units(leaf, len(indices))
        columns = []
        for index, unit in zip(indices, units, strict=True):
            columns += _parts(leaf, rows, index, unit)
        if not others:
            names = [*self._found.words.get((*leaf.path, "columns"), ())]
            names = names if len(names) == 1 else [name]
        else:
            names = self._axes(leaf, name, len(indices)) or ["_".join((name, *map(str, index))) for index in indices]
        if leaf.type.kind == "c":
            names = [f"{one}_{part}" for one in names for part in ("real", "imag")]
        return list(zip(names, columns, strict=True))

    def _name(self, leaf: Leaf, home: _Home) -> str:
        """Return the name of an array: the one in its attributes, or its path."""
        if leaf.path == home.time and _stem(leaf.path[-1]):
            return "time"
        own = self._found.word((*leaf.path, NAME))
        if own:
            return own
        below = leaf.path[len(home.folder) :] if self._apart else leaf.path
        return self._joint.join(below)

    def _axes(self, leaf: Leaf, name: str, count: int) -> list[str]:
        """Return the names of an array's columns, if the file has a list of that length."""
        for texts in self._texts(leaf, _NAMES):
            if len(texts) == count and all(texts):
                return [f"{name}_{text}" for text in texts] if all(len(text) == 1 for text in texts) else list(texts)
        return []

    def _units(self, leaf: Leaf, count: int) -> Sequence[str]:
        """Return the units of an array's columns, "" where the file has none."""
        for texts in self._texts(leaf, _UNITS):
            if len(texts) == count:
                return texts
            if len(texts) == 1:
                return texts * count
        return [self._described.get(leaf.path[-1], "")] * count

    def _texts(self, leaf: Leaf, words: Sequence[str]) -> list[tuple[str, ...]]:
        """Return texts about an array: its attributes, those next to it, and, except for times, those of its group."""
        folder, name = leaf.path[:-1], leaf.path[-1]
        places = [(*leaf.path, word) for word in words]
        places += [(*folder, f"{name}_{word}") for word in words] + [(*folder, word, name) for word in words]
        if leaf.path not in self._times:
            places += [(*folder, word) for word in words]
        return [self._found.words[place] for place in places if place in self._found.words]

    def _shown(self, path: Path) -> str:
        return repr(self._joint.join(path))


def _rows(leaf: Leaf, meant: int) -> int:
    return leaf.shape[leaf.meant.index(meant)]


def _stem(name: str) -> str:
    """Return `force` for `force_time`, the time of one array only; "" for times of all arrays, and for other names."""
    match = None if is_time_name(name) else _OWN_TIME.fullmatch(parse_header(name)[0])
    return "".join(part for part in match.groups() if part) if match else ""


def _is_of(name: str, stem: str) -> bool:
    return name == stem or name.startswith(stem + "_") or name.endswith("_" + stem)


def _parts(leaf: Leaf, rows: int, index: tuple[int, ...], unit: str) -> list[Column]:
    """Return a column of an array, two for complex numbers: `rows` is its axis, `index` its place on the others."""

    def read(start: int, stop: int) -> NDArray[np.generic]:
        return leaf.take((*index[:rows], slice(start, stop), *index[rows:]))

    if leaf.type.kind == "c":
        return [
            Column(pa.float64(), lambda start, stop: read(start, stop).real.astype(np.float64), unit),
            Column(pa.float64(), lambda start, stop: read(start, stop).imag.astype(np.float64), unit),
        ]
    if leaf.type.kind == "O":
        return [Column(pa.string(), read, unit)]
    if leaf.type.kind == "f" and leaf.type.itemsize > 8:
        return [Column(pa.float64(), lambda start, stop: read(start, stop).astype(np.float64), unit)]
    native = leaf.type.newbyteorder("=")
    return [Column(pa.from_numpy_dtype(native), lambda start, stop: read(start, stop).astype(native), unit)]
