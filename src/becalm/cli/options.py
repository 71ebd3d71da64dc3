"""Define the options that several commands have, and read their values."""

from __future__ import annotations

import csv
import re
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from becalm.cleaning.stretches import stretch_s
from becalm.errors import UsageError

if TYPE_CHECKING:
    from becalm.identification.wishes.dial import Dial, Kind

_READ = "CSV, Parquet, MF4, TDMS, UFF58, MAT, HDF5, NPZ, WAV, ROS bag, MCAP, ULog or IDE"
Source = Annotated[Path, typer.Argument(metavar="FILE", help=f"Recording: {_READ}.")]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Where to write; format by file ending.")]
RecipeOut = Annotated[Path, typer.Option("-o", "--output", metavar="R.toml", help="Where to write the recipe.")]
RecipeIn = Annotated[Path | None, typer.Option("--recipe", metavar="R.toml", help="Use the filters of this recipe.")]
Truth = Annotated[
    Path | None, typer.Option("--truth", metavar="FILE", help="True signal: the same channels at the same times.")
]
ComparedIn = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="DIR", help="Folder for a page with figures of the results."),
]
Channels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Clean these channels; the others pass through.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Count rows at this rate; replaces the time column.")
]
Time = Annotated[str | None, typer.Option("--time", metavar="COLUMN", help="Name of the time column.")]
Stamps = Annotated[
    str | None,
    typer.Option(
        "--stamps", metavar="as-written|mended", help="Whether to repair stamps that a driver made; mended by default."
    ),
]
TimeJitter = Annotated[
    str | None,
    typer.Option(
        "--time-jitter",
        metavar="50us",
        help="Standard deviation of the sampling jitter, which widens sigma; s, ms or us.",
    ),
]
Group = Annotated[
    str | None,
    typer.Option("--group", metavar="NAME", help="Channel group to read, where a file has several time bases."),
]
Units = Annotated[
    list[str] | None,
    typer.Option("--unit", metavar="NAME=UNIT", help="Unit of a channel, such as ax=m/s^2; may be repeated."),
]
Sensors = Annotated[
    Path | None,
    typer.Option("--sensors", metavar="S.toml", help="Convert volts to units with these calibrations first."),
]
SensorsOut = Annotated[
    Path, typer.Option("-o", "--output", metavar="S.toml", help="Where to write the sensor, for --sensors.")
]
Clean = Annotated[Path, typer.Argument(metavar="CLEAN", help="Output of becalm clean, with its recipe next to it.")]
OldSensors = Annotated[Path, typer.Option("--from", metavar="OLD.toml", help="Sensor file that it was cleaned with.")]
NewSensors = Annotated[Path, typer.Option("--to", metavar="NEW.toml", help="Sensor file of the new calibration.")]
Axes = Annotated[str | None, typer.Option("--channels", metavar="x,y,z", help="The three axes.")]
Gravity = Annotated[
    float | None, typer.Option("--gravity", metavar="9.81", help="Local gravity in m/s^2; 9.80665 by default.")
]
Acceleration = Annotated[str, typer.Option("--unit", metavar="m/s^2|g", help="Unit of the calibration.")]
Causal = Annotated[
    bool, typer.Option("--causal", help="Filter causally, as a live filter does: no later measurements.")
]
MaxLag = Annotated[
    str | None,
    typer.Option("--max-lag", metavar="5ms", help="Largest delay of a causal filter; s, ms or us."),
]
Lag = Annotated[
    str | None,
    typer.Option("--lag", metavar="10ms", help="Fixed lag: delay each row to use later measurements; s, ms or us."),
]
Bandwidth = Annotated[
    str | None, typer.Option("--bandwidth", metavar="40Hz", help="Bandwidth of the filter at -3 dB; Hz or kHz.")
]
NoiseGain = Annotated[
    str | None, typer.Option("--noise-gain", metavar="-20dB", help="Noise power gain for white noise, in dB.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
UsedChannels = Annotated[str | None, typer.Option("--channels", metavar="a,b", help="Use these channels only.")]
_STILL = "START:STOP in seconds after the first row (0:30 is the first half minute), or 1min:2min; several with commas."
Rest = Annotated[
    str | None,
    typer.Option("--still", metavar="0:30,60:90", help=f"Where the sensor lies still: {_STILL} Detected by default."),
]
Still = Annotated[
    str | None,
    typer.Option("--still", metavar="0:30,60:90", help=f"Measure the noise where the sensor lay still: {_STILL}"),
]
Remove = Annotated[
    str | None,
    typer.Option("--remove", metavar="50Hz,100Hz", help="Remove tones near these frequencies, such as mains hum."),
]
Robust = Annotated[bool, typer.Option("--robust", help="Reject outliers, even one in ten; jumps are followed.")]
Fill = Annotated[bool, typer.Option("--fill", help="Fill long holes with the best guess instead of NaN.")]
Split = Annotated[bool, typer.Option("--split", help="Write the parts of each channel too: motion, tones, noise.")]
Verdicts = Annotated[
    bool, typer.Option("--verdicts", help="Write the verdict on each sample: used, missing, spike, ...")
]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="R.html", help="Write a report: one HTML page with figures."),
]
Figures = Annotated[
    str | None,
    typer.Option("--figures", metavar="png|svg|pdf", help="Draw the same figures into the folder OUT.figures."),
]
Cutoff = Annotated[
    str | None,
    typer.Option("--cutoff", metavar="1Hz", help="Frequency at which to split the noise at rest; 1Hz by default."),
]


_QUANTITY = re.compile(r"(?P<number>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*(?P<unit>[a-z]+)", re.IGNORECASE)
_SIZES: dict[Kind, dict[str, float]] = {
    "max_lag_s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "bandwidth_hz": {"hz": 1.0, "khz": 1e3},
    "noise_gain_db": {"db": 1.0},
}

_UNITS: dict[Kind, str] = {"max_lag_s": "s, ms or us", "bandwidth_hz": "Hz or kHz", "noise_gain_db": "dB"}


class FilterOptions(NamedTuple):
    """The options for the filters and the noise."""

    dial: Dial | None
    still_s: tuple[tuple[float, float], ...]
    removed_hz: tuple[float, ...]
    robust: bool
    time_std_s: float | None = None
    fill: bool = False

    @property
    def anything(self) -> bool:
        """Return whether at least one option was given."""
        given = self.dial is not None or self.time_std_s is not None
        return given or self.robust or self.fill or bool(self.still_s or self.removed_hz)


class TimeOptions(NamedTuple):
    """The options for the time of rows."""

    rate_hz: float | None = None
    time: str | None = None
    group: str | None = None
    stamps: str | None = None


class Dials(NamedTuple):
    """The texts of the three dial options."""

    max_lag: str | None
    bandwidth: str | None
    noise_gain: str | None


def filter_options(
    dials: Dials, still: str | None, remove: str | None, robust: bool = False, jitter: str | None = None
) -> FilterOptions:
    """Return the filter options from --max-lag, --bandwidth, --noise-gain, --still, --remove, --robust, --time-jitter.

    Raises
    ------
    UsageError
        If an option cannot be read.
    """
    parts = [] if remove is None else [part for part in remove.split(",") if part.strip()]
    removed = tuple(frequency_of("--remove", part) for part in parts)
    return FilterOptions(dial_of(*dials), still_of(still) or (), removed, robust, jitter_of(jitter))


def units_of(texts: list[str] | None) -> dict[str, str]:
    """Return the units of channels, by name, from texts NAME=UNIT.

    Raises
    ------
    UsageError
        If a text is not NAME=UNIT, or names a channel twice.
    """
    units: dict[str, str] = {}
    for text in texts or ():
        name, _, unit = (part.strip() for part in text.rpartition("="))
        if not name or not unit:
            raise UsageError(f"--unit {text} is not NAME=UNIT; write a channel and its unit: ax=m/s^2")
        if name in units:
            raise UsageError(f"--unit names {name!r} twice; give it one unit.")
        units[name] = unit
    return units


def lag_of(text: str | None) -> float | None:
    """Return the lag in seconds; None without a text.

    Raises
    ------
    UsageError
        If the text is not a positive number with its unit.
    """
    if text is None:
        return None
    lag_s = _quantity(text, "max_lag_s")
    if lag_s is None or not 0 < lag_s < inf:
        raise UsageError(f"--lag {text} is not a time; write a positive number and then s, ms or us: 10ms.")
    return lag_s


def jitter_of(text: str | None) -> float | None:
    """Return the standard deviation of the sampling jitter in seconds; None without a text.

    Raises
    ------
    UsageError
        If the text is not a positive number with its unit.
    """
    std_s = None if text is None else _quantity(text, "max_lag_s")
    if text is not None and (std_s is None or not 0 < std_s < inf):
        raise UsageError(f"--time-jitter {text} is not a time; write a positive number and then s, ms or us: 50us.")
    return std_s


def dial_of(max_lag: str | None, bandwidth: str | None, noise_gain: str | None) -> Dial | None:
    """Return the dial, which is the one of three options that was given; None if none was.

    Raises
    ------
    UsageError
        If two options are given, or a text is not a number with its unit.
    """
    texts: dict[Kind, str | None] = {"max_lag_s": max_lag, "bandwidth_hz": bandwidth, "noise_gain_db": noise_gain}
    given = {kind: text for kind, text in texts.items() if text is not None}
    if not given:
        return None
    if len(given) > 1:
        raise UsageError("Give only one of --max-lag, --bandwidth and --noise-gain: each determines the others.")
    from becalm.identification.wishes.dial import Dial

    ((kind, text),) = given.items()
    value = _quantity(text, kind)
    if value is None:
        name, units = kind.rpartition("_")[0].replace("_", "-"), _UNITS[kind]
        raise UsageError(f"--{name} {text} is not a number with its unit; write a number and then {units}.")
    return Dial(kind, value)


def still_of(text: str | None) -> tuple[tuple[float, float], ...] | None:
    """Return the rests of a sensor: `0:30,60:90` is 0 to 30 s and 60 to 90 s after the first row.

    Raises
    ------
    UsageError
        If a part of the text is not START:STOP, or its STOP is before its START.
    """
    return None if text is None else tuple(map(_span_of, text.split(",")))


def frequency_of(option: str, text: str) -> float:
    """Return a frequency in hertz.

    Raises
    ------
    UsageError
        If the text is not a positive number with Hz or kHz.
    """
    frequency_hz = _quantity(text, "bandwidth_hz")
    if frequency_hz is None or not 0 < frequency_hz < inf:
        raise UsageError(f"{option} {text} is not a frequency; write a positive number and then Hz or kHz: 1Hz.")
    return frequency_hz


def _quantity(text: str, kind: Kind) -> float | None:
    """Return a number in the base unit of its kind; None if the text is not a number with a unit."""
    match = _QUANTITY.fullmatch(text.strip())
    size = _SIZES[kind].get(match["unit"].lower()) if match else None
    return None if match is None or size is None else float(match["number"]) * size


def _span_of(text: str) -> tuple[float, float]:
    span_s = stretch_s(text)
    if span_s is None:
        raise UsageError(
            f"--still {text.strip()} is not a stretch of time; write START:STOP in seconds after the first row, such as"
            " 0:30 for the first half minute, or with units, such as 1min:2min; several with commas."
        )
    return span_s


def split_names(text: str) -> tuple[str, ...]:
    """Split a list of names at its commas; a name with a comma must be in double quotes."""
    return tuple(name.strip() for name in next(csv.reader([text], skipinitialspace=True), []) if name.strip())
