"""Which arrays of a file belong together: those that share a vector of times, a rate, or a folder."""

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
from becalm.files.columns import Column
from becalm.files.groups import GROUP, START, TIME, Group
from becalm.files.source import ToldTime
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name
from becalm.files.unit_spelling import parse_header

_MOST_COLUMNS = 1024  # of one array; more are a picture
_STRAY, _SHORT = 50, 100  # a matrix of calibration is so much shorter than a recording, and so short
_UNITS = ("units", "unit", "Units", "Unit", "UNITS", "units_")
_NAMES = ("columns", "column_names", "names", "labels", "channels", "channel_names", "axes", "axis", "header")
_OWN_TIME = re.compile(
    r"(?:t|time|times|timestamp|timestamps)_(.+)|(.+)_(?:t|time|times|timestamp|timestamps)"
    r"|(.+_)(?:time|times|timestamp|timestamps)_(.+)"  # Data1_time_AI_1 of Data1_AI_1
)


class _Home(NamedTuple):
    """What arrays of one group have in common."""

    folder: Path
    time: Path  # of the vector of times, () where there is none
    rate_hz: float | None
    rows: int
    meant: int  # rows, in a file that is not cut short


class Grouping:
    """Puts the arrays of a file into groups.

    Parameters
    ----------
    found : FileArrays
        All that the file holds.
    joint : str
        Between a folder and what is in it, in names.
    apart : bool
        Whether folders are groups even where no time tells them apart, and names begin below them.
    """

    def __init__(self, found: FileArrays, joint: str, apart: bool) -> None:
        take_titles(found)
        self._found, self._joint, self._apart = found, joint, apart
        self._rates = Rates(found)
        self._described = found.described_units()
        leaves = [leaf for leaf in found.leaves if self._fits(leaf)]
        self._written = {path[:-1] for path in found.words if path[-1] == GROUP}  # each by becalm, and one table
        others = [leaf for leaf in leaves if leaf.path[:-1] not in self._written]
        self._times = {leaf.path: leaf for leaf in others if len(leaf.shape) == 1 and self._may_be_time(leaf, others)}
        self._homes: dict[_Home, list[Leaf]] = {}
        for leaf in leaves:
            if leaf.path not in self._times:
                self._homes.setdefault(self._home(leaf), []).append(leaf)

    @property
    def notes(self) -> list[str]:
        """What a person must know, as sentences."""
        return self._found.notes

    def groups(self) -> list[Group]:
        """Return the groups, in the order of the file."""
        self._leave_strays_out()
        used = {home.time for home in self._homes}
        for path, leaf in self._times.items():
            if path not in used and self._is_worth_a_word(leaf):
                self._found.notes.append(f"{self._said(path)} is a time of {leaf.length} values, but of no channel.")
        notes = tuple(self._found.notes)
        return [self._group(home, leaves, notes) for home, leaves in self._homes.items()]

    def _fits(self, leaf: Leaf) -> bool:
        """Tell whether an array is a table of channels; a picture is none."""
        columns = int(np.prod(leaf.shape, dtype=object)) // leaf.length
        if columns > _MOST_COLUMNS:
            self._found.notes.append(
                f"{self._said(leaf.path)} has the shape {leaf.shape}, which is no table of channels; it is left out."
            )
        return columns <= _MOST_COLUMNS

    def _may_be_time(self, leaf: Leaf, leaves: Sequence[Leaf]) -> bool:
        folder, name = leaf.path[:-1], leaf.path[-1]
        if leaf.type.kind not in "iufMmO":
            return False
        if stem := _stem(name):
            beside = [one for one in leaves if one.path[:-1] == folder and one is not leaf]
            return any(_is_of(one.path[-1], stem) and leaf.meant[0] in one.meant for one in beside)
        told = self._found.word((*leaf.path, NAME))
        own = told if told != "/".join(leaf.path) else name  # a path says no more than its end
        return is_time_name(own or name) or leaf.type.kind == "M"

    def _home(self, leaf: Leaf) -> _Home:
        if leaf.path[:-1] in self._written:
            return _Home(leaf.path[:-1], (), None, leaf.length, leaf.meant[0])
        for depth in range(len(leaf.path) - 1, -1, -1):
            folder = leaf.path[:depth]
            beside = [one for path, one in self._times.items() if path[:-1] == folder and one.meant[0] in leaf.meant]
            own = [one for one in beside if (stem := _stem(one.path[-1])) and _is_of(leaf.path[-1], stem)]
            general = [one for one in beside if not _stem(one.path[-1])]
            for times in (own, general):
                if times:
                    meant = times[0].meant[0]
                    return _Home(folder, times[0].path, None, min(times[0].length, _rows(leaf, meant)), meant)
        told = self._rates.of(leaf)
        folder = leaf.path[:-1] if self._apart else told[0] if told and told[0] != leaf.path else ()
        if told and not self._apart and folder == leaf.path[:-1] and self._is_whole(leaf):
            folder = folder[:-1]
        meant = max(leaf.meant)
        return _Home(folder, (), told[1] if told else None, _rows(leaf, meant), meant)

    def _is_whole(self, leaf: Leaf) -> bool:
        """Tell whether its struct holds one channel, which begins when others do."""
        folder = leaf.path[:-1]
        alone = is_alone(leaf.path) and bool(self._found.word((*leaf.path, NAME)))
        return alone and self._rates.start(folder) == self._rates.start(folder[:-1])

    def _leave_strays_out(self) -> None:
        """Leave out what is far shorter than the rest and has no times: a matrix of calibration, a list of limits."""
        longest = max((home.rows for home in self._homes), default=0)
        loose = {home: leaves for home, leaves in self._homes.items() if home.folder not in self._written}
        for home, leaves in loose.items():
            if not home.time and len(self._homes) > 1 and all(leaf.type.kind == "O" for leaf in leaves):
                del self._homes[home]  # names and units of others
        for home in loose:
            if home in self._homes and not home.time and home.rows <= _SHORT and home.rows * _STRAY < longest:
                for leaf in self._homes.pop(home):
                    if leaf.type.kind != "O":
                        self._found.notes.append(f"{self._said(leaf.path)} has {home.rows} values only; left out.")

    def _is_worth_a_word(self, leaf: Leaf) -> bool:
        return not any(home.time[:-1] == leaf.path[:-1] and home.meant == leaf.meant[0] for home in self._homes)

    def _group(self, home: _Home, leaves: Sequence[Leaf], notes: tuple[str, ...]) -> Group:
        columns: list[tuple[str, Column]] = []
        if home.time:
            beside = (one for path, one in self._times.items() if path[:-1] == home.time[:-1])
            times = [one for one in beside if one.meant[0] == home.meant]
            for leaf in [self._times[home.time]] if _stem(home.time[-1]) else times:
                columns += self._columns(leaf, home)
        for leaf in leaves:
            columns += self._columns(leaf, home)
        names = unique_names([name for name, _ in columns])
        time = None
        if home.rate_hz is not None and not any(is_time_name(name) for name in names):
            time = ToldTime("", home.rate_hz, self._rates.start(home.folder))
        elif TIME in names and (start := self._found.word((*home.folder, START))):
            time = ToldTime(TIME, None, start)
        named = dict(zip(names, (column for _, column in columns), strict=True))
        return Group(self._title(home, leaves), named, home.rows, time, notes)

    def _title(self, home: _Home, leaves: Sequence[Leaf]) -> str:
        """Name a group as its folder is called; where that holds several, by its first array too."""
        if told := self._found.word((*home.folder, GROUP)):
            return told
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
        """Return the name of an array: the file's own for it, or where it is."""
        if leaf.path == home.time and _stem(leaf.path[-1]):
            return "time"
        own = self._found.word((*leaf.path, NAME))
        if own:
            return own
        below = leaf.path[len(home.folder) :] if self._apart else leaf.path
        return self._joint.join(below)

    def _axes(self, leaf: Leaf, name: str, count: int) -> list[str]:
        """Return the names of an array's columns, where the file gives as many."""
        for texts in self._texts(leaf, _NAMES):
            if len(texts) == count and all(texts):
                return [f"{name}_{text}" for text in texts] if all(len(text) == 1 for text in texts) else list(texts)
        return []

    def _units(self, leaf: Leaf, count: int) -> Sequence[str]:
        """Return the units of an array's columns, "" where the file gives none."""
        for texts in self._texts(leaf, _UNITS):
            if len(texts) == count:
                return texts
            if len(texts) == 1:
                return texts * count
        return [self._described.get(leaf.path[-1], "")] * count

    def _texts(self, leaf: Leaf, words: Sequence[str]) -> list[tuple[str, ...]]:
        """Find texts about an array: its own, beside it, and those of its folder, which are not about times."""
        folder, name = leaf.path[:-1], leaf.path[-1]
        places = [(*leaf.path, word) for word in words]
        places += [(*folder, f"{name}_{word}") for word in words] + [(*folder, word, name) for word in words]
        if leaf.path not in self._times:
            places += [(*folder, word) for word in words]
        return [self._found.words[place] for place in places if place in self._found.words]

    def _said(self, path: Path) -> str:
        return repr(self._joint.join(path))


def _rows(leaf: Leaf, meant: int) -> int:
    return leaf.shape[leaf.meant.index(meant)]


def _stem(name: str) -> str:
    """Return of what alone an array is the time, "" if it is of all beside it, or none."""
    found = None if is_time_name(name) else _OWN_TIME.fullmatch(parse_header(name)[0])
    return "".join(part for part in found.groups() if part) if found else ""


def _is_of(name: str, stem: str) -> bool:
    return name == stem or name.startswith(stem + "_") or name.endswith("_" + stem)


def _parts(leaf: Leaf, rows: int, index: tuple[int, ...], unit: str) -> list[Column]:
    """Return a column of an array, or the two of complex numbers."""

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
