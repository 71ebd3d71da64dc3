"""`becalm export`: its options, each with its one help text."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

Recipe = Annotated[Path, typer.Argument(metavar="R.toml", help="The recipe, as becalm tune or clean writes it.")]
To = Annotated[
    str,
    typer.Option("--to", metavar="c|sos|json|scipy", help="C and its proof; or sections, numbers, a Python module."),
]
Where = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for C and what proves it; else a file.")
]
PrecisionOf = Annotated[
    str | None, typer.Option("--precision", metavar="float32|float64|q31", help="What C computes in; float32.")
]
GainOf = Annotated[
    str | None,
    typer.Option("--gain", metavar="settled|full", help="Whether a covariance is carried; where the recipe needs one."),
]
Channels = Annotated[str | None, typer.Option("--channels", metavar="a,b", help="These channels of the recipe only.")]
Ranges = Annotated[
    list[str] | None,
    typer.Option("--range", metavar="NAME=LOW:HIGH", help="How far readings reach, in the unit; may be repeated."),
]
Recorded = Annotated[
    Path | None, typer.Option("--recording", metavar="FILE", help="A recording, for a golden vector and for --verify.")
]
Verify = Annotated[bool, typer.Option("--verify", help="Compile it, run it, compare it, and write a certificate.")]


def export(  # noqa: PLR0913  (the contract's options)
    recipe: Recipe,
    output: Where,
    to: To = "c",
    precision: PrecisionOf = None,
    gain: GainOf = None,
    channels: Channels = None,
    ranges: Ranges = None,
    recording: Recorded = None,
    verify: Verify = False,
    as_json: o.Json = False,
) -> None:
    """Write a recipe's filters for a microcontroller, with the proof that they are the same."""
    from becalm.cli.export import Wanted, run

    run(recipe, output, to, Wanted(precision, gain, channels, ranges, recording, verify), as_json=as_json)
