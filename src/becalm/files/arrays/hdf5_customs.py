"""Apply conventions of HDF5 writers: tables of pandas, and scales, fill values and times of netCDF."""

from __future__ import annotations

import pickletools
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.files.arrays.array_labels import FLAG
from becalm.files.arrays.arrays import FileArrays, Key, Leaf, Path

_FILLS = ("_FillValue", "missing_value")  # attributes whose value marks missing values
_SINCE = re.compile(r"(\w+) since (.+)")
_STEPS = {
    "ns": ("nanosecond", "nanoseconds", "ns"),
    "us": ("microsecond", "microseconds", "us"),
    "ms": ("millisecond", "milliseconds", "msec", "ms"),
    "s": ("second", "seconds", "sec", "secs", "s"),
    "m": ("minute", "minutes", "min", "mins"),
    "h": ("hour", "hours", "h", "hr"),
    "D": ("day", "days", "d"),
}
"""NumPy's units of time, and their names in netCDF."""

_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""The attribute NAME of a dataset that is only a dimension, and has no values, begins with this text."""


def apply_conventions(contents: FileArrays) -> None:
    """Give arrays the names, types and values that their writer's conventions define."""
    contents.leaves = [
        _pandas(contents, _netcdf(contents, leaf))
        for leaf in contents.leaves
        if not contents.word((*leaf.path, "NAME")).startswith(_NO_VARIABLE)
    ]


def _netcdf(contents: FileArrays, leaf: Leaf) -> Leaf:
    if (*leaf.path, FLAG) in contents.numbers and leaf.type.kind == "u":
        flags = leaf.take
        return leaf._replace(type=np.dtype(bool), take=lambda key: flags(key).astype(np.bool_))
    fills = [contents.numbers[path] for name in _FILLS if (path := (*leaf.path, name)) in contents.numbers]
    scale, offset = (contents.numbers.get((*leaf.path, name)) for name in ("scale_factor", "add_offset"))
    if leaf.type.kind in "iuf" and (fills or scale is not None or offset is not None):
        leaf = _scaled(leaf, fills, 1.0 if scale is None else scale, offset or 0.0)
    for name in ("units", "unit"):
        if leaf.type.kind in "iuf" and (match := _SINCE.fullmatch(contents.word((*leaf.path, name)))):
            return _since(contents, leaf, match[1], match[2], (*leaf.path, name))
    return leaf


def _scaled(leaf: Leaf, fills: list[float], scale: float, offset: float) -> Leaf:
    def take(key: Key) -> NDArray[Any]:
        raw = leaf.take(key)
        values = np.asarray(raw, np.float64) * scale + offset
        return np.where(np.isin(np.asarray(raw, np.float64), fills), np.nan, values)

    return leaf._replace(type=np.dtype(np.float64), take=take)


def _since(contents: FileArrays, leaf: Leaf, word: str, text: str, unit: Path) -> Leaf:
    """Convert a count since a date, such as "days since 2000-01-01", to instants; leave other arrays unchanged."""
    step = next((step for step, words in _STEPS.items() if word.lower() in words), None)
    plain = re.sub(r"(?:\s*UTC|Z|[+-]00:?00|\s*\+0:00)$", "", text.strip()).replace(" ", "T", 1)
    try:
        first = np.datetime64(plain, "ns") if step else None
    except ValueError:
        first = None
    if first is None or step is None:
        return leaf
    del contents.words[unit]
    ns = np.array(1, f"m8[{step}]").astype("m8[ns]").astype(np.int64)

    def take(key: Key) -> NDArray[Any]:
        raw = leaf.take(key)
        if raw.dtype.kind == "f":
            finite = np.isfinite(raw)
            ticks = np.round(np.where(finite, raw, 0.0) * float(ns)).astype(np.int64).astype("m8[ns]")
            return np.where(finite, first + ticks, np.datetime64("NaT", "ns"))
        return np.asarray(first + (raw.astype(np.int64) * ns).astype("m8[ns]"))

    return leaf._replace(type=np.dtype("M8[ns]"), take=take)


def _pandas(contents: FileArrays, leaf: Leaf) -> Leaf:
    folder, name = leaf.path[:-1], leaf.path[-1]
    kind = contents.word((*leaf.path, "kind")) or contents.word((*folder, f"{name}_kind"))
    columns = _pickled_names(kind)
    if name.startswith("block") and name.endswith("_values"):
        columns = contents.words.get((*folder, name.removesuffix("_values") + "_items"), ())
    if columns:
        contents.words[(*leaf.path, "columns")] = columns
    if contents.word((*folder, "pandas_type")) and name == "axis1":
        leaf = leaf._replace(path=(*folder, "index"))
    if kind.startswith("datetime64") and leaf.type.kind == "i":
        unit = kind.removeprefix("datetime64").strip("[]").partition(",")[0] or "ns"
        typed = np.dtype(f"M8[{unit}]" if unit in ("s", "ms", "us", "ns") else "M8[ns]")
        plain = leaf.take
        leaf = leaf._replace(type=typed, take=lambda key: plain(key).astype(typed))
    return leaf


def _pickled_names(text: str) -> tuple[str, ...]:
    """Return the names in a pickled list, () for other texts; no code in it runs."""
    if not text.startswith("(lp"):
        return ()
    try:
        operations = [(code.name, value) for code, value, _ in pickletools.genops(text.encode("latin-1"))]
    except (ValueError, UnicodeError):
        return ()
    return tuple(str(value) for name, value in operations if name in ("UNICODE", "STRING"))
