"""Rates that files of arrays tell: `fs`, `sampling_rate`, `dt`, beside the arrays or as their attributes."""

from __future__ import annotations

import re

import numpy as np

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.files.arrays.arrays import FileArrays, Leaf, Path
from becalm.files.unit_spelling import parse_header, tidy_unit

_RATES = re.compile(r"fs|fsample|sr|srate|rate|sampl(?:e|ing)(?:rate|freq|frequency)|samplespersecond|freqsampling")
_STEPS = re.compile(
    r"dt|ts|deltat|timestep|timeincrement|wfincrement|tinterval|xspacing|sampl(?:e|ing)(?:interval|period|time|step)"
)
_TOO_SHORT = ("rate", "sr", "ts")  # to be part of a longer name: a heart_rate is none
_HERTZ = {"Hz": 1.0, "hz": 1.0, "HZ": 1.0, "kHz": 1e3, "MHz": 1e6, "S/s": 1.0, "Sa/s": 1.0, "1/s": 1.0, "": 1.0}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "": 1.0}
_WRITTEN = re.compile(r"([-+.\deE]+)\s*([a-zA-Z/]*)")
_STARTS = ("start", "start_time", "starttime", "start_date", "t0", "wf_start_time", "measurement_start")
_AGREE = 1e-3


class Rates:
    """The rates in a file.

    Parameters
    ----------
    found : FileArrays
        All that it holds.
    """

    def __init__(self, found: FileArrays) -> None:
        self._found = found
        self._told: dict[Path, list[tuple[str, float]]] = {}
        for path, number in [*found.numbers.items(), *_written(found)]:
            unit = next((word for name in ("units", "unit") if (word := found.word((*path, name)))), "")
            told = (path[-1], _in_unit(path, number, unit) if unit else number)
            self._told.setdefault(path[:-1], []).append(told)

    def of(self, leaf: Leaf) -> tuple[Path, float] | None:
        """Return the rate of an array in Hz and where it is told: by itself, or by the nearest folder that does."""
        own = _one(self._found, leaf.path, [_hertz(*told) for told in self._told.get(leaf.path, [])])
        if own is not None:
            return leaf.path, own
        for depth in range(len(leaf.path) - 1, -1, -1):
            folder = leaf.path[:depth]
            beside = self._told.get(folder, [])
            for rates in ([_specific(leaf.path[-1], *told) for told in beside], [_hertz(*told) for told in beside]):
                if (rate := _one(self._found, folder, rates)) is not None:
                    return folder, rate
        return None

    def start(self, folder: Path) -> str:
        """Return the first instant as ISO 8601 text, "" where the file does not tell it."""
        for depth in range(len(folder), -1, -1):
            for path, texts in self._found.words.items():
                if path[:-1] == folder[:depth] and path[-1].lower() in _STARTS and (instant := _instant(texts[0])):
                    return instant
        return ""


def hertz_of(name: str, number: float, unit: str) -> float | None:
    """Return the rate in Hz that a number of this name tells, in its unit or, where that is "", in Hz or seconds."""
    return _hertz(name, _in_unit((name,), number, unit) if unit else number)


def _written(found: FileArrays) -> list[tuple[Path, float]]:
    """Numbers that are written as texts: "100 Hz"."""
    out = []
    for path, texts in found.words.items():
        if len(texts) == 1 and _hertz(path[-1], 1.0) and (match := _WRITTEN.fullmatch(texts[0])):
            try:
                out.append((path, _in_unit(path, float(match[1]), match[2])))
            except ValueError:
                continue
    return out


def _in_unit(path: Path, number: float, unit: str) -> float:
    """Return a rate in Hz or a step in s; one whose unit is unknown is none."""
    spelt = tidy_unit(unit)
    scale = _HERTZ.get(spelt) if _is(_RATES, path[-1]) else _SECONDS.get(spelt)
    return number * scale if scale else np.nan


def _is(words: re.Pattern[str], name: str) -> bool:
    return words.fullmatch(re.sub(r"[\W_]+", "", parse_header(name)[0].lower())) is not None


def _hertz(name: str, number: float) -> float | None:
    """Return the rate that a number of this name tells."""
    unit = parse_header(name)[1]
    rate = None
    if _is(_RATES, name):
        rate = number * _HERTZ.get(unit, np.nan)
    elif _is(_STEPS, name) and number > 0:
        rate = 1.0 / (number * _SECONDS.get(unit, np.nan))
    return rate if rate is not None and SLOWEST_HZ <= rate <= FASTEST_HZ else None


def _specific(leaf: str, name: str, number: float) -> float | None:
    """Return the rate that `imu_fs` or `fs_imu` tells of `imu` and of `imu_acc`."""
    parts = name.split("_")
    for cut in range(1, len(parts)):
        first, last = "_".join(parts[:cut]), "_".join(parts[cut:])
        for stem, word in ((first, last), (last, first)):
            its = word.lower() not in _TOO_SHORT and (leaf == stem or leaf.startswith(stem + "_"))
            if its and (rate := _hertz(word, number)):
                return rate
    return None


def _one(found: FileArrays, where: Path, rates: list[float | None]) -> float | None:
    """Return the rate that all agree on."""
    told = [rate for rate in rates if rate]
    if told and max(told) > min(told) * (1.0 + _AGREE):
        note = f"{'/'.join(where) or 'The file'} tells two rates, {min(told):g} and {max(told):g} Hz; neither is used."
        if note not in found.notes:
            found.notes.append(note)
        return None
    return told[0] if told else None


def _instant(text: str) -> str:
    plain = text.strip().replace(" ", "T", 1)
    zone = "Z" if plain.endswith("Z") else ""
    try:
        return str(np.datetime64(plain.removesuffix("Z"))) + zone if len(plain) >= len("2024-01-01T00:00") else ""
    except ValueError:
        return ""
