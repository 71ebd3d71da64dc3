"""Find sample rates in files of arrays: `fs`, `sampling_rate`, `dt`, next to the arrays or as their attributes."""

from __future__ import annotations

import re

import numpy as np

from becalm.files.arrays.arrays import FileArrays, Leaf, Path
from becalm.files.units.named_rates import hertz_of

_TOO_SHORT = ("rate", "sr", "ts")  # not used as part of a longer name: heart_rate is not a sample rate
_WRITTEN = re.compile(r"([-+.\deE]+)\s*([a-zA-Z/]*)")  # a number and a unit: "100 Hz"
_STARTS = ("start", "start_time", "starttime", "start_date", "t0", "wf_start_time", "measurement_start")
_AGREE = 1e-3  # largest relative difference of rates that count as equal


class Rates:
    """The sample rates in a file.

    Parameters
    ----------
    contents : FileArrays
        The contents of the file.
    """

    def __init__(self, contents: FileArrays) -> None:
        self._contents = contents
        self._numbers: dict[Path, list[tuple[str, float, str]]] = {}
        for path, number, written in [*((*one, "") for one in contents.numbers.items()), *_written(contents)]:
            unit = written or next((word for name in ("units", "unit") if (word := contents.word((*path, name)))), "")
            self._numbers.setdefault(path[:-1], []).append((path[-1], number, unit))

    def of(self, leaf: Leaf) -> tuple[Path, float] | None:
        """Return the path and the value in Hz of an array's rate: its own, or that of the nearest group above it."""
        own = _common_rate(self._contents, leaf.path, [hertz_of(*named) for named in self._numbers.get(leaf.path, [])])
        if own is not None:
            return leaf.path, own
        for depth in range(len(leaf.path) - 1, -1, -1):
            folder = leaf.path[:depth]
            numbers = self._numbers.get(folder, [])
            for rates in ([_specific(leaf.path[-1], *one) for one in numbers], [hertz_of(*one) for one in numbers]):
                if (rate := _common_rate(self._contents, folder, rates)) is not None:
                    return folder, rate
        return None

    def start(self, folder: Path) -> str:
        """Return the start of the recording in a group or in one above it as ISO 8601 text, "" if there is none."""
        for depth in range(len(folder), -1, -1):
            for path, texts in self._contents.words.items():
                if path[:-1] == folder[:depth] and path[-1].lower() in _STARTS and (instant := _instant(texts[0])):
                    return instant
        return ""


def _written(contents: FileArrays) -> list[tuple[Path, float, str]]:
    """Return the paths, numbers and units of rates and steps that are written as texts, such as "100 Hz"."""
    out = []
    for path, texts in contents.words.items():
        if len(texts) == 1 and hertz_of(path[-1], 1.0) and (match := _WRITTEN.fullmatch(texts[0])):
            try:
                out.append((path, float(match[1]), match[2]))
            except ValueError:
                continue
    return out


def _specific(leaf: str, name: str, number: float, unit: str) -> float | None:
    """Return the rate for an array such as `imu` or `imu_acc` from a number such as `imu_fs` or `fs_imu`."""
    parts = name.split("_")
    for cut in range(1, len(parts)):
        first, last = "_".join(parts[:cut]), "_".join(parts[cut:])
        for stem, word in ((first, last), (last, first)):
            its = word.lower() not in _TOO_SHORT and (leaf == stem or leaf.startswith(stem + "_"))
            if its and (rate := hertz_of(word, number, unit)):
                return rate
    return None


def _common_rate(contents: FileArrays, where: Path, rates: list[float | None]) -> float | None:
    """Return the common value of several rates; add a note and return None if they differ."""
    present = [rate for rate in rates if rate]
    if present and max(present) > min(present) * (1.0 + _AGREE):
        low, high = min(present), max(present)
        note = f"{'/'.join(where) or 'The file'} has two rates, {low:g} and {high:g} Hz; neither is used."
        if note not in contents.notes:
            contents.notes.append(note)
        return None
    return present[0] if present else None


def _instant(text: str) -> str:
    """Return a date and time as ISO 8601 text, "" for other texts."""
    plain = text.strip().replace(" ", "T", 1)
    zone = "Z" if plain.endswith("Z") else ""
    try:
        return str(np.datetime64(plain.removesuffix("Z"))) + zone if len(plain) >= len("2024-01-01T00:00") else ""
    except ValueError:
        return ""
