"""Define `becalm export` and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

Recipe = Annotated[Path, typer.Argument(metavar="R.toml", help="Recipe of becalm tune or becalm clean.")]
To = Annotated[
    str,
    typer.Option(
        "--to",
        metavar="c|sos|json|scipy",
        help="C with its verification; or second-order sections, JSON, a Python module.",
    ),
]
Where = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Output folder for C; else an output file.")]
PrecisionOf = Annotated[
    str | None,
    typer.Option("--precision", metavar="float32|float64|q31", help="Number type of the C code; float32 by default."),
]
GainOf = Annotated[
    str | None,
    typer.Option(
        "--gain", metavar="settled|full", help="Settled gain, or full covariance; by default what the recipe needs."
    ),
]
Channels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Use these channels of the recipe only.")
]
Ranges = Annotated[
    list[str] | None,
    typer.Option("--range", metavar="NAME=LOW:HIGH", help="Range of a channel, in its unit; may be repeated."),
]
Recorded = Annotated[
    Path | None, typer.Option("--recording", metavar="FILE", help="Recording for test vectors and --verify.")
]
Verify = Annotated[bool, typer.Option("--verify", help="Compile, run and compare the C code, and write a certificate.")]


def export(  # noqa: PLR0913  (one argument for each option)
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
    """Export a recipe's filters as C for a microcontroller, and verify them against becalm."""
    from becalm.cli.export import CExportOptions, run

    run(recipe, output, to, CExportOptions(precision, gain, channels, ranges, recording, verify), as_json=as_json)
