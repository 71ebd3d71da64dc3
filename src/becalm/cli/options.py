"""The options that commands share, each with its one help text."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from becalm.errors import UsageError

if TYPE_CHECKING:
    from becalm.noise.dial import Dial

Kind = Literal["max_lag_s", "bandwidth_hz", "noise_gain_db"]

Source = Annotated[Path, typer.Argument(metavar="FILE", help="Recording: CSV (also gzipped) or Parquet.")]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Where to write; format by file ending.")]
RecipeOut = Annotated[Path, typer.Option("-o", "--output", metavar="R.toml", help="Where to write the recipe.")]
RecipeIn = Annotated[Path | None, typer.Option("--recipe", metavar="R.toml", help="Do as this recipe says.")]
Channels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Clean these channels; the others pass through.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Count rows at this rate; replaces the time column.")
]
Time = Annotated[str | None, typer.Option("--time", metavar="COLUMN", help="Name of the time column.")]
Causal = Annotated[bool, typer.Option("--causal", help="Let each estimate know only the past, as a live filter does.")]
MaxLag = Annotated[
    str | None, typer.Option("--max-lag", metavar="5ms", help="Let no causal filter come later; s, ms or us.")
]
Bandwidth = Annotated[
    str | None, typer.Option("--bandwidth", metavar="40Hz", help="Pass what is slower: -3 dB there; Hz or kHz.")
]
NoiseGain = Annotated[
    str | None, typer.Option("--noise-gain", metavar="-20dB", help="Leave so much of white noise, in dB.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]


_QUANTITY = re.compile(r"(?P<number>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*(?P<unit>[a-z]+)", re.IGNORECASE)
_SIZES: dict[Kind, dict[str, float]] = {
    "max_lag_s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "bandwidth_hz": {"hz": 1.0, "khz": 1e3},
    "noise_gain_db": {"db": 1.0},
}


def dial_of(max_lag: str | None, bandwidth: str | None, noise_gain: str | None) -> Dial | None:
    """Read the dial; at most one of them is turned.

    Raises
    ------
    UsageError
        If two are turned, or one to what is no number with its unit.
    """
    said: dict[Kind, str | None] = {"max_lag_s": max_lag, "bandwidth_hz": bandwidth, "noise_gain_db": noise_gain}
    turned = {kind: text for kind, text in said.items() if text is not None}
    if not turned:
        return None
    if len(turned) > 1:
        raise UsageError("Turn one of --max-lag, --bandwidth and --noise-gain: each of them decides the others.")
    from becalm.noise.dial import Dial

    ((kind, text),) = turned.items()
    written = _QUANTITY.fullmatch(text.strip())
    size = _SIZES[kind].get(written["unit"].lower()) if written else None
    if written is None or size is None:
        name, units = kind.rpartition("_")[0].replace("_", "-"), " or ".join(_SIZES[kind])
        raise UsageError(f"--{name} {text} is no number with its unit; write a number and then {units}.")
    return Dial(kind, float(written["number"]) * size)


def split_names(text: str) -> tuple[str, ...]:
    """Split a list of names at its commas; a name with a comma goes in double quotes."""
    return tuple(name.strip() for name in next(csv.reader([text], skipinitialspace=True), []) if name.strip())
