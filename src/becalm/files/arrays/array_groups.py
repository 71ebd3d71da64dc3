"""Group the arrays of a file into tables: arrays that share a vector of times, a rate, or a group."""

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
from becalm.files.arrays.array_titles import apply_titles, is_values_field
from becalm.files.arrays.arrays import FileArrays, Leaf, Path
from becalm.files.column_statistics import Column
from becalm.files.groups import GROUP, START, TIME, Group
from becalm.files.source import FormatTime
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import parse_header

_MOST_COLUMNS = 1024  # most columns of one array; an array with more is an image
_STRAY, _SHORT = 50, 100  # a stray table has at most _SHORT rows, and the longest table over _STRAY times as many
_UNITS = ("units", "unit", "Units", "Unit", "UNITS", "units_")
_NAMES = ("columns", "column_names", "names", "labels", "channels", "channel_names", "axes", "axis", "header")
_OWN_TIME = re.compile(
    r"(?:t|time|times|timestamp|timestamps)_(.+)|(.+)_(?:t|time|times|timestamp|timestamps)"
    r"|(.+_)(?:time|times|timestamp|timestamps)_(.+)"  # Data1_time_AI_1 of Data1_AI_1
)


class _TableKey(NamedTuple):
    """The properties that the arrays of one table share."""

    folder: Path
    time: Path  # path of the vector of times, or () if there is none
    rate_hz: float | None
    rows: int  # number of rows in the file
    full_rows: int  # number of rows in a file that is not truncated


class Grouping:
    """A grouping of the arrays of a file into tables.

    Parameters
    ----------
    contents : FileArrays
        The contents of the file.
    joint : str
        Separator between the parts of a path, in names.
    apart : bool
        Whether arrays without times form a table for each group of the file, and names omit the group.
    """

    def __init__(self, contents: FileArrays, joint: str, apart: bool) -> None:
        apply_titles(contents)
        self._contents, self._joint, self._apart = contents, joint, apart
        self._rates = Rates(contents)
        self._described = contents.described_units()
        leaves = [leaf for leaf in contents.leaves if self._fits(leaf)]
        self._written = {path[:-1] for path in contents.words if path[-1] == GROUP}  # tables that becalm wrote
        others = [leaf for leaf in leaves if leaf.path[:-1] not in self._written]
        self._times = {leaf.path: leaf for leaf in others if len(leaf.shape) == 1 and self._may_be_time(leaf, others)}
        self._tables: dict[_TableKey, list[Leaf]] = {}
        for leaf in leaves:
            if leaf.path not in self._times:
                self._tables.setdefault(self._key_of(leaf), []).append(leaf)

    @property
    def notes(self) -> list[str]:
        """Return the notes for the user on the contents of the file."""
        return self._contents.notes

    def groups(self) -> list[Group]:
        """Return the tables, in the order of the file."""
        self._leave_strays_out()
        used = {key.time for key in self._tables}
        for path, leaf in self._times.items():
            if path not in used and self._is_unused(leaf):
                self._contents.notes.append(
                    f"{self._shown(path)} has {leaf.length} times, but no channel belongs to it."
                )
        notes = tuple(self._contents.notes)
        return [self._group(key, leaves, notes) for key, leaves in self._tables.items()]

    def _fits(self, leaf: Leaf) -> bool:
        """Return whether an array can be a table of channels, and not an image."""
        columns = int(np.prod(leaf.shape, dtype=object)) // leaf.length
        if columns > _MOST_COLUMNS:
            self._contents.notes.append(
                f"{self._shown(leaf.path)} has the shape {leaf.shape}, which is not a table of channels; left out."
            )
        return columns <= _MOST_COLUMNS

    def _may_be_time(self, leaf: Leaf, leaves: Sequence[Leaf]) -> bool:
        folder, name = leaf.path[:-1], leaf.path[-1]
        if leaf.type.kind not in "iufMmO":
            return False
        if stem := _stem(name):
            neighbours = [one for one in leaves if one.path[:-1] == folder and one is not leaf]
            return any(_is_of(one.path[-1], stem) and leaf.full_shape[0] in one.full_shape for one in neighbours)
        label = self._contents.word((*leaf.path, NAME))
        own = label if label != "/".join(leaf.path) else name  # of a label that is the whole path, use the last part
        return is_time_name(own or name) or leaf.type.kind == "M"

    def _key_of(self, leaf: Leaf) -> _TableKey:
        if leaf.path[:-1] in self._written:
            return _TableKey(leaf.path[:-1], (), None, leaf.length, leaf.full_shape[0])
        for depth in range(len(leaf.path) - 1, -1, -1):
            folder = leaf.path[:depth]
            fitting = [
                one for path, one in self._times.items() if path[:-1] == folder and one.full_shape[0] in leaf.full_shape
            ]
            own = [one for one in fitting if (stem := _stem(one.path[-1])) and _is_of(leaf.path[-1], stem)]
            general = [one for one in fitting if not _stem(one.path[-1])]
            for times in (own, general):
                if times:
                    full_rows = times[0].full_shape[0]
                    return _TableKey(
                        folder, times[0].path, None, min(times[0].length, _rows(leaf, full_rows)), full_rows
                    )
        rate = self._rates.of(leaf)
        folder = leaf.path[:-1] if self._apart else rate[0] if rate and rate[0] != leaf.path else ()
        if rate and not self._apart and folder == leaf.path[:-1] and self._is_whole(leaf):
            folder = folder[:-1]
        full_rows = max(leaf.full_shape)
        return _TableKey(folder, (), rate[1] if rate else None, _rows(leaf, full_rows), full_rows)

    def _is_whole(self, leaf: Leaf) -> bool:
        """Return whether the array's struct holds a single channel, and has the same start as the group above it."""
        folder = leaf.path[:-1]
        alone = is_values_field(leaf.path) and bool(self._contents.word((*leaf.path, NAME)))
        return alone and self._rates.start(folder) == self._rates.start(folder[:-1])

    def _leave_strays_out(self) -> None:
        """Drop tables without times that hold only texts, or are far shorter than the longest, as calibrations are."""
        longest = max((key.rows for key in self._tables), default=0)
        loose = {key: leaves for key, leaves in self._tables.items() if key.folder not in self._written}
        for key, leaves in loose.items():
            if not key.time and len(self._tables) > 1 and all(leaf.type.kind == "O" for leaf in leaves):
                del self._tables[key]  # names and units of other arrays
        for key in loose:
            if key in self._tables and not key.time and key.rows <= _SHORT and key.rows * _STRAY < longest:
                for leaf in self._tables.pop(key):
                    if leaf.type.kind != "O":
                        self._contents.notes.append(
                            f"{self._shown(leaf.path)} has only {key.rows} values; it is left out."
                        )

    def _is_unused(self, leaf: Leaf) -> bool:
        """Return whether no table uses times of the same group and length."""
        return not any(key.time[:-1] == leaf.path[:-1] and key.full_rows == leaf.full_shape[0] for key in self._tables)

    def _group(self, key: _TableKey, leaves: Sequence[Leaf], notes: tuple[str, ...]) -> Group:
        columns: list[tuple[str, Column]] = []
        if key.time:
            neighbours = (one for path, one in self._times.items() if path[:-1] == key.time[:-1])
            times = [one for one in neighbours if one.full_shape[0] == key.full_rows]
            for leaf in [self._times[key.time]] if _stem(key.time[-1]) else times:
                columns += self._columns(leaf, key)
        for leaf in leaves:
            columns += self._columns(leaf, key)
        names = unique_names([name for name, _ in columns])
        time = None
        if key.rate_hz is not None and not any(is_time_name(name) for name in names):
            time = FormatTime("", key.rate_hz, self._rates.start(key.folder))
        elif TIME in names and (start := self._contents.word((*key.folder, START))):
            time = FormatTime(TIME, None, start)
        named = dict(zip(names, (column for _, column in columns), strict=True))
        return Group(self._title(key, leaves), named, key.rows, time, notes)

    def _title(self, key: _TableKey, leaves: Sequence[Leaf]) -> str:
        """Return the name of a table: that of its group, or of its first array if the group has several tables."""
        if stored := self._contents.word((*key.folder, GROUP)):
            return stored
        rivals = [other for other in self._tables if other.folder == key.folder]
        if len(rivals) == 1:
            return self._joint.join(key.folder)
        if not self._apart and self._is_whole(leaves[0]):
            return self._joint.join(leaves[0].path[:-1])
        name = self._name(leaves[0], key)
        return self._joint.join((*key.folder, name)) if self._apart else name

    def _columns(self, leaf: Leaf, key: _TableKey) -> list[tuple[str, Column]]:
        rows = leaf.full_shape.index(key.full_rows)
        name = self._name(leaf, key)
        others = [range(size) for axis, size in enumerate(leaf.shape) if axis != rows]
        indices = list(product(*others))
        units = self._units(leaf, len(indices))
        columns = []
        for index, unit in zip(indices, units, strict=True):
            columns += _parts(leaf, rows, index, unit)
        if not others:
            names = [*self._contents.words.get((*leaf.path, "columns"), ())]
            names = names if len(names) == 1 else [name]
        else:
            names = self._axes(leaf, name, len(indices)) or ["_".join((name, *map(str, index))) for index in indices]
        if leaf.type.kind == "c":
            names = [f"{one}_{part}" for one in names for part in ("real", "imag")]
        return list(zip(names, columns, strict=True))

    def _name(self, leaf: Leaf, key: _TableKey) -> str:
        """Return the name of an array: the one in its attributes, or its path."""
        if leaf.path == key.time and _stem(leaf.path[-1]):
            return "time"
        own = self._contents.word((*leaf.path, NAME))
        if own:
            return own
        below = leaf.path[len(key.folder) :] if self._apart else leaf.path
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
        return [self._contents.words[place] for place in places if place in self._contents.words]

    def _shown(self, path: Path) -> str:
        return repr(self._joint.join(path))


def _rows(leaf: Leaf, full_rows: int) -> int:
    """Return how many rows of an array are in the file, on the axis with `full_rows` rows in the complete array."""
    return leaf.shape[leaf.full_shape.index(full_rows)]


def _stem(name: str) -> str:
    """Return `force` for `force_time`, the time of one array only; "" for times of all arrays, and for other names."""
    match = None if is_time_name(name) else _OWN_TIME.fullmatch(parse_header(name)[0])
    return "".join(part for part in match.groups() if part) if match else ""


def _is_of(name: str, stem: str) -> bool:
    return name == stem or name.startswith(stem + "_") or name.endswith("_" + stem)


def _parts(leaf: Leaf, rows: int, index: tuple[int, ...], unit: str) -> list[Column]:
    """Return a column of an array, two for complex numbers: `rows` is its axis, `index` the indices on other axes."""

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
