"""Name sensors that columns identify. Names have the form of Hive's folders: `sensor=17`, `plant=3/sensor=a%2Fb`."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePath
from typing import NamedTuple
from urllib.parse import unquote

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Integers
from becalm.errors import InputError, UsageError
from becalm.files.lake.listing import is_partition

NULL = "__HIVE_DEFAULT_PARTITION__"
"""The value in a folder's name that means null."""

_SPECIAL = re.compile(  # characters that Hive and Spark escape; Windows has no names with those of the second class
    r"[\x00-\x1f\x7f\"#%'*/:=?\\{\[\]^]" + (r"|[ <>|]|\.$" if os.name == "nt" else "")
)
_MOST_LISTED = 20  # names in a message


class NamedSensors(NamedTuple):
    """The sensors of a block, and which of them each row belongs to.

    Attributes
    ----------
    names : list of str
        Names of the sensors, without repetition.
    codes : (n,) int array
        For each row, the index of its sensor in `names`.
    """

    names: list[str]
    codes: Integers


def folder_name(key: str, value: str | None) -> str:
    """Return the name of the folder for a value of a key; None means null."""
    return f"{_escape(key)}={NULL if value is None else _escape(value)}"


def values_in(place: PurePath) -> dict[str, str | None]:
    """Return, by key, the values in the folders of a path: {"sensor": "17"} for `sensor=17`; None means null."""
    parts = [part.partition("=") for part in place.parts if is_partition(part)]
    return {_unescape(key): None if value == NULL else _unescape(value) for key, _, value in parts}


def below(sensor: str, file: PurePath) -> str:
    """Return the path of a file without the folders that are part of its sensor's name."""
    own = set(values_in(PurePath(sensor)).items())
    parts = (part for part in file.parts if not own.intersection(values_in(PurePath(part)).items()))
    return PurePath(*parts).as_posix()


def keys_of(by: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the columns that identify sensors.

    Parameters
    ----------
    by : str
        The name of a column or key, or several names separated by commas.
    known : collection of str
        The columns of the files and the keys of the folders.

    Raises
    ------
    UsageError
        If a name does not exist, or occurs twice.
    """
    if by in known:
        return (by,)
    keys = tuple(key.strip() for key in by.split(","))
    for key in keys:
        if key not in known:
            there = listed(sorted(known))
            raise UsageError(
                f"--by names {key!r}, which is neither a column nor a key of the folders; there are {there}."
            )
    if twice := [key for key, count in Counter(keys).items() if count > 1]:
        raise UsageError(f"--by names {twice[0]!r} twice; once is enough.")
    return keys


def listed(names: Sequence[str]) -> str:
    """Return a text with the first names of a list, and the number of names left out."""
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return ", ".join(names[:_MOST_LISTED]) + more


def name_sensors(block: pa.Table, keys: Sequence[str], folder_values: Mapping[str, str | None]) -> NamedSensors:
    """Return the sensor of each row of a block.

    Parameters
    ----------
    block : pyarrow.Table
        Rows with a column for each key that is not in `folder_values`.
    keys : sequence of str
        Columns, or keys of folders, that identify sensors.
    folder_values : mapping of str to str or None
        Values from the names of folders, by key. They take precedence over a column of the same name.

    Raises
    ------
    InputError
        If a column has values that cannot be part of a folder's name.
    """
    sensors = _all_of("", block.num_rows)
    for key in keys:
        own = (
            _all_of(folder_name(key, folder_values[key]), block.num_rows)
            if key in folder_values
            else _of_column(key, block.column(key))
        )
        sensors = _combine(sensors, own)
    return sensors


def _all_of(name: str, rows: int) -> NamedSensors:
    return NamedSensors([name], np.zeros(rows, np.int64))


def _combine(first: NamedSensors, second: NamedSensors) -> NamedSensors:
    """Combine the sensors by two keys; combinations without rows are left out."""
    if len(first.names) == 1:
        return NamedSensors([_join_names(first.names[0], name) for name in second.names], second.codes)
    pairs, codes = np.unique(first.codes * len(second.names) + second.codes, return_inverse=True)
    split = zip(*np.divmod(pairs, max(1, len(second.names))), strict=True)
    return NamedSensors([_join_names(first.names[one], second.names[other]) for one, other in split], codes)


def _join_names(above: str, name: str) -> str:
    return f"{above}/{name}" if above else name


def _of_column(key: str, column: pa.ChunkedArray) -> NamedSensors:
    try:
        coded = column.cast(pa.string()).combine_chunks().dictionary_encode(null_encoding="encode")
    except pa.ArrowException as cause:
        raise InputError(
            f"{key!r} holds {column.type} that cannot name a folder; whole numbers or text can. Name another with --by."
        ) from cause
    names = [folder_name(key, value) for value in coded.dictionary.to_pylist()]
    return NamedSensors(names, np.asarray(coded.indices, np.int64))


def _unescape(text: str) -> str:
    return unquote(text, errors="surrogateescape")  # keeps bytes that are not UTF-8, so that names stay distinct


def _escape(text: str) -> str:
    if text == NULL:  # a text that equals the null marker is escaped, because it is not null
        return f"%{ord(text[0]):02X}{text[1:]}"
    return _SPECIAL.sub(lambda match: f"%{ord(match[0]):02X}", text)
