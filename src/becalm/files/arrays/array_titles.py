"""Find names and units next to an array: in a struct that holds only this array, or in a separate header struct."""

from __future__ import annotations

import re

from becalm.files.arrays.array_labels import NAME
from becalm.files.arrays.arrays import FileArrays, Path

_VALUES = ("data", "value", "values", "samples", "signal", "y")  # the array in a struct of one channel
_NAMES = ("name", "label", "signalname", "channelname")
_UNITS = ("unit", "units", "unitstring")
_ABOUT_VALUES, _ABOUT_TIMES = "datainfo", "timeinfo"  # parts of MATLAB's timeseries
_ABOUT_ALL = ("meta", "metadata", "info", "header", "hdr", "properties", "props", "params", "parameters", "settings")
_HEADED = re.compile(r"(.+)_data", re.IGNORECASE)  # Channel_2_Data, which Channel_2_Header describes


def apply_titles(contents: FileArrays) -> None:
    """Copy names, units and numbers that describe an array into the entries of the array itself."""
    _copy_metadata_up(contents)
    folders: dict[Path, dict[str, Path]] = {}
    for path in (*contents.words, *contents.numbers):
        folders.setdefault(_lower(path[:-1]), {})[path[-1].lower()] = path
    for leaf in contents.leaves:
        folder, name = _lower(leaf.path[:-1]), leaf.path[-1].lower()
        if headed := _HEADED.fullmatch(name):
            head = folders.get((*folder, f"{headed[1]}_header"), {})
            _copy_texts(contents, leaf.path, head, _NAMES + _UNITS)
            for key, path in head.items():
                if path in contents.numbers:
                    contents.numbers.setdefault((*leaf.path, key), contents.numbers[path])
        elif is_values_field(leaf.path):
            _copy_texts(contents, leaf.path, folders.get(folder, {}), _NAMES + _UNITS)
            _copy_texts(contents, leaf.path, folders.get((*folder, _ABOUT_VALUES), {}), _UNITS)
        elif name == "time":
            _copy_texts(contents, leaf.path, folders.get((*folder, _ABOUT_TIMES), {}), _UNITS)


def is_values_field(path: Path) -> bool:
    """Return whether an array is called `data`, `value` or the like in a struct, such as `force.data`."""
    return len(path) > 1 and path[-1].lower() in _VALUES


def _copy_metadata_up(contents: FileArrays) -> None:
    """Copy `meta.fs` to `fs`, because it applies to all arrays next to `meta`; skip names, which may be of a person."""
    for path, texts in [(path, texts) for path, texts in contents.words.items() if _is_about_all(path)]:
        contents.words.setdefault((*path[:-2], path[-1]), texts)
    for path, number in [(path, number) for path, number in contents.numbers.items() if _is_about_all(path)]:
        contents.numbers.setdefault((*path[:-2], path[-1]), number)


def _is_about_all(path: Path) -> bool:
    return len(path) > 1 and path[-2].lower() in _ABOUT_ALL and path[-1].lower() not in _NAMES


def _lower(path: Path) -> Path:
    return tuple(part.lower() for part in path)


def _copy_texts(contents: FileArrays, leaf: Path, paths: dict[str, Path], keys: tuple[str, ...]) -> None:
    """Give an array a name and a unit if it has none yet."""
    for key in keys:
        if texts := contents.words.get(paths.get(key, ()), ()):
            if key in _UNITS:
                contents.words.setdefault((*leaf, "unit"), texts)
            elif len(texts) == 1 and texts[0]:
                contents.words.setdefault((*leaf, NAME), texts)
