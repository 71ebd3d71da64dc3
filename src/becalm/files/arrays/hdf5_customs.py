"""Apply conventions of HDF5 writers: tables of pandas, and scales, fill values and times of netCDF."""

from __future__ import annotations

import pickletools
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.files.arrays.array_labels import FLAG
from becalm.files.arrays.arrays import FileArrays, Key, Leaf, Path
from becalm.files.units.unit_spelling import TIME_UNITS

_FILLS = ("_FillValue", "missing_value")  # attributes whose values mark missing values
_SIGNS = {"true": "u", "false": "i"}  # kinds of whole numbers by the attribute _Unsigned
_SINCE = re.compile(r"(\w+) since (.+)")
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
    if leaf.type.kind in "iuf":
        leaf = _scaled(contents, leaf)
    for name in ("units", "unit"):
        if leaf.type.kind in "iuf" and (match := _SINCE.fullmatch(contents.word((*leaf.path, name)))):
            return _since(contents, leaf, match[1], match[2], (*leaf.path, name))
    return leaf


def _scaled(contents: FileArrays, leaf: Leaf) -> Leaf:
    """Apply the sign, the scale, the fill values and the limits in an array's attributes.

    Whole numbers without a scale stay whole numbers, because float64 would round long ones; missing ones are masked.
    """
    stored = leaf.type.newbyteorder("=")
    kind = stored
    if stored.kind in "iu" and (sign := _SIGNS.get(contents.word((*leaf.path, "_Unsigned")).lower())):
        kind = np.dtype(f"{sign}{stored.itemsize}")
    fills = [fill for name in _FILLS for fill in _in_type(contents.lists.get((*leaf.path, name), ()), stored)]
    scale, offset = (contents.numbers.get((*leaf.path, name)) for name in ("scale_factor", "add_offset"))
    limits = _limits(contents, leaf.path)
    plain = scale is None and offset is None
    if plain and not fills and not limits and kind == stored:
        return leaf

    def take(key: Key) -> NDArray[Any]:
        held = leaf.take(key)  # masked where it was never written
        raw = np.ma.getdata(held).astype(stored, copy=False)
        values = raw.astype(kind, copy=False)
        scaled = values if plain else values.astype(np.float64) * (1.0 if scale is None else scale) + (offset or 0.0)
        missing = np.isin(raw, fills) | np.ma.getmaskarray(held)
        for beyond, limit in limits:
            if limit.dtype.kind == "f" and stored.kind in "iu":  # a limit of scaled values
                missing |= beyond(scaled, limit)
            else:
                missing |= beyond(values, limit.astype(stored).astype(kind))
        if plain and kind.kind in "iu":
            return np.ma.masked_array(values, missing) if missing.any() else values
        return np.where(missing, np.nan, scaled.astype(np.float64, copy=False))

    return leaf._replace(type=kind if plain and kind.kind in "iu" else np.dtype(np.float64), take=take)


def _in_type(values: Sequence[Any] | NDArray[Any], kind: np.dtype[Any]) -> Iterator[Any]:
    """Yield the values that an array of a type can hold, in this type: -999.9 in float64 is no float32."""
    for value in values:
        with np.errstate(invalid="ignore", over="ignore"):
            cast = value.astype(kind)
            if kind.kind == "f" or cast.astype(value.dtype) == value:
                yield cast


def _limits(contents: FileArrays, path: Path) -> list[tuple[np.ufunc, Any]]:
    """Return the limits in an array's attributes, each with the comparison that tells values beyond it."""
    listed: Any = contents.lists.get((*path, "valid_range"), ())
    limits: list[tuple[np.ufunc, Any]] = []
    if len(listed) == 2:
        limits += [(np.less, listed[0]), (np.greater, listed[1])]
    for name, beyond in (("valid_min", np.less), ("valid_max", np.greater)):
        limits += [(beyond, limit) for limit in contents.lists.get((*path, name), ())]
    return limits


def _since(contents: FileArrays, leaf: Leaf, word: str, text: str, unit: Path) -> Leaf:
    """Convert a count since a date, such as "days since 2000-01-01", to instants; leave other arrays unchanged."""
    unit_of_time = TIME_UNITS.get(word.lower(), "")
    step = {"min": "m", "d": "D"}.get(unit_of_time, unit_of_time)
    plain = re.sub(r"(?:\s*UTC|Z|[+-]00:?00|\s*\+0:00)$", "", text.strip()).replace(" ", "T", 1)
    try:
        first = np.datetime64(plain, "ns") if step else None
    except ValueError:
        first = None
    if first is None:
        return leaf
    del contents.words[unit]
    ns = np.array(1, f"m8[{step}]").astype("m8[ns]").astype(np.int64)

    def take(key: Key) -> NDArray[Any]:
        raw = leaf.take(key)
        if raw.dtype.kind == "f":
            finite = np.isfinite(raw)
            ticks = np.round(np.where(finite, raw, 0.0) * float(ns)).astype(np.int64).astype("m8[ns]")
            return np.where(finite, first + ticks, np.datetime64("NaT", "ns"))
        ticks = (np.ma.getdata(raw).astype(np.int64) * ns).astype("m8[ns]")
        return np.where(np.ma.getmaskarray(raw), np.datetime64("NaT", "ns"), first + ticks)

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
