"""Define the commands of the command line; each command imports its packages when it runs."""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o
from becalm.cli.opened_file import load, open_as, open_every, read_file_options, refuse_overwriting, tuned
from becalm.cli.stopping import stop_cleanly
from becalm.cli.stream_commands import fleet, journal, live
from becalm.errors import NOT_DESCRIBED, BecalmError, UsageError
from becalm.installation import version

# Define `becalm app` and its options.

Opened = Annotated[Path | None, typer.Argument(metavar="FILE", help="Recording to open first.")]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder", metavar="DIR", help="Folder whose files may be opened; by default FILE's, or the current one."
    ),
]
Port = Annotated[
    int | None, typer.Option("--port", metavar="PORT", help="Port of the page; 8765 by default, 0 for any free port.")
]
Host = Annotated[
    str, typer.Option("--host", metavar="HOST", help="Address to listen on; this machine only by default.")
]
TokenFile = Annotated[
    Path | None,
    typer.Option("--token-file", metavar="FILE", help="File of the access token, so that it survives a restart."),
]
UploadLimit = Annotated[str, typer.Option("--upload-limit", metavar="2GB", help="Largest file that may be uploaded.")]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Do not open a browser; print the address only.")]


def open_app(  # noqa: PLR0913  (one argument for each option)
    file: Opened = None,
    rate: o.Rate = None,
    time: o.Time = None,
    folder: Folder = None,
    port: Port = None,
    host: Host = "127.0.0.1",
    token_file: TokenFile = None,
    upload_limit: UploadLimit = "2GB",
    no_browser: NoBrowser = False,
) -> None:
    """Open the tuner in a browser: raw and clean signal, one dial between noise and lag."""
    from becalm.cli.commands.app import PageAddress, bytes_of, place_of, run
    from becalm.files.read_options import ReadOptions

    run(
        place_of(file, folder, ReadOptions(time, rate)),
        PageAddress(host, port, token_file),
        bytes_of(upload_limit),
        browser=not no_browser,
    )


# Define `becalm export` and its options.

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
    from becalm.cli.commands.export import CExportOptions, run

    run(recipe, output, to, CExportOptions(precision, gain, channels, ranges, recording, verify), as_json=as_json)


app = typer.Typer(
    help="Make noisy sensor signals calm: a recording goes in, the signal comes out with its uncertainty.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"becalm {version()}".rstrip())  # noqa: T201
        raise typer.Exit


@app.callback()
def becalm(
    _: Annotated[
        bool, typer.Option("--version", help="Show which becalm this is.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Handle the options before a command."""


@app.command()
def inspect(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    channels: o.Channels = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    unit: o.Units = None,
    sensors: o.Sensors = None,
    as_json: o.Json = False,
) -> None:
    """Show how becalm reads a file: columns, units, time."""
    from becalm.cli.layouts import show, summary
    from becalm.cli.messages import print_bands

    with open_every(
        file, read_file_options(channels, o.TimeOptions(rate, time, group, stamps), unit, sensors)
    ) as opened:
        if as_json:
            print(json.dumps({"file": str(file), **summary(opened)}, indent=2))  # noqa: T201
        else:
            show(file, opened)
        for source in opened.sources:
            print_bands(source)


@app.command()
def clean(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    output: o.Output,
    recipe: o.RecipeIn = None,
    channels: o.Channels = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    unit: o.Units = None,
    sensors: o.Sensors = None,
    causal: o.Causal = False,
    lag: o.Lag = None,
    max_lag: o.MaxLag = None,
    bandwidth: o.Bandwidth = None,
    noise_gain: o.NoiseGain = None,
    still: o.Still = None,
    time_jitter: o.TimeJitter = None,
    remove: o.Remove = None,
    robust: o.Robust = False,
    fill: o.Fill = False,
    split: o.Split = False,
    verdicts: o.Verdicts = False,
    report: o.Report = None,
    figures: o.Figures = None,
    as_json: o.Json = False,
) -> None:
    """Remove the noise from a recording; no option is required."""
    from becalm.cli.commands.clean import CleanOptions, Outputs, run

    wanted = o.filter_options(o.Dials(max_lag, bandwidth, noise_gain), still, remove, robust, time_jitter)._replace(
        fill=fill
    )
    outputs = Outputs(output, split, verdicts, report, figures)
    file_options = read_file_options(channels, o.TimeOptions(rate, time, group, stamps), unit, sensors)
    if not run(file, file_options, CleanOptions(recipe, causal, o.lag_of(lag), wanted), outputs, as_json=as_json):
        raise typer.Exit(NOT_DESCRIBED)


@app.command()
def tune(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    output: o.RecipeOut,
    channels: o.Channels = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    unit: o.Units = None,
    sensors: o.Sensors = None,
    causal: o.Causal = False,
    lag: o.Lag = None,
    max_lag: o.MaxLag = None,
    bandwidth: o.Bandwidth = None,
    noise_gain: o.NoiseGain = None,
    still: o.Still = None,
    time_jitter: o.TimeJitter = None,
    remove: o.Remove = None,
    robust: o.Robust = False,
    fill: o.Fill = False,
    as_json: o.Json = False,
) -> None:
    """Identify the filter of each channel and write it as a recipe; list the remaining noise for each delay."""
    from becalm.cleaning.delays import delays
    from becalm.cleaning.pipeline import join_recipes
    from becalm.cli.messages import print_delays, print_notes
    from becalm.files.atomic_file import refuse_unwritable, write_text

    refuse_overwriting(file, output)
    refuse_unwritable(output)
    file_options = read_file_options(channels, o.TimeOptions(rate, time, group, stamps), unit, sensors)
    wanted = o.filter_options(o.Dials(max_lag, bandwidth, noise_gain), still, remove, robust, time_jitter)._replace(
        fill=fill
    )
    with open_every(file, file_options) as opened:
        print_notes(*opened.sources)
        recipe = file_options.with_time_options(
            join_recipes([tuned(source, causal, wanted, o.lag_of(lag)) for source in opened.sources])
        )
    write_text(output, recipe.to_toml())
    curves = delays(recipe)
    print_delays(curves)
    if as_json:
        rows = {name: [asdict(one) for one in curve] for name, curve in curves.items()}
        summary = {"file": str(file), "recipe": str(output), **recipe.model_dump(), "delays": rows}
        print(json.dumps(summary, indent=2))  # noqa: T201
    typer.echo(f"Wrote {output}. Use it with: becalm clean {file} -o OUT --recipe {output}", err=True)


@app.command()
def compare(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    truth: o.Truth = None,
    recipe: o.RecipeIn = None,
    channels: o.UsedChannels = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    unit: o.Units = None,
    sensors: o.Sensors = None,
    causal: o.Causal = False,
    output: o.ComparedIn = None,
    as_json: o.Json = False,
) -> None:
    """Compare becalm with Butterworth, averages and others, at equal noise and at equal lag."""
    from becalm.cli.commands.compare import CompareOptions, run

    loaded = load(recipe)
    file_options = read_file_options(channels, o.TimeOptions(rate, time, group, stamps), unit, sensors)
    file_options = file_options if loaded is None else file_options.with_defaults_of(loaded)
    with open_as(file, file_options) as source:
        run(source, file_options, CompareOptions(truth, causal, output), as_json=as_json)


@app.command()
def noise(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    channels: o.UsedChannels = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    unit: o.Units = None,
    sensors: o.Sensors = None,
    still: o.Rest = None,
    cutoff: o.Cutoff = None,
    as_json: o.Json = False,
) -> None:
    """Measure a sensor's noise at rest: R, Allan deviation, data-sheet figures."""
    from becalm.cli.commands.noise import run

    cutoff_hz = None if cutoff is None else o.frequency_of("--cutoff", cutoff)
    with open_as(file, read_file_options(channels, o.TimeOptions(rate, time, group, stamps), unit, sensors)) as source:
        run(source, o.still_of(still), cutoff_hz, as_json)


@app.command()
def calibrate(  # noqa: PLR0913  (one argument for each option)
    file: o.Source,
    output: o.SensorsOut,
    channels: o.Axes = None,
    rate: o.Rate = None,
    time: o.Time = None,
    stamps: o.Stamps = None,
    group: o.Group = None,
    gravity: o.Gravity = None,
    unit: o.Acceleration = "m/s^2",
    as_json: o.Json = False,
) -> None:
    """Calibrate a triaxial accelerometer from ten or more static poses; write its sensor file."""
    from becalm.cli.commands.calibrate import run

    run(
        file,
        read_file_options(channels, o.TimeOptions(rate, time, group, stamps), None, None),
        output,
        unit,
        gravity,
        as_json=as_json,
    )


@app.command()
def recalibrate(file: o.Clean, output: o.Output, old: o.OldSensors, new: o.NewSensors) -> None:
    """Apply another calibration to a clean recording, without the raw file."""
    from becalm.cli.commands.recalibrate import Calibrations, run

    run(file, output, Calibrations(old, new))


@app.command()
def study(
    paper: Annotated[str, typer.Argument(metavar="car|imu|strain", help="Which paper.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the page.")] = Path("study"),
) -> None:
    """Reproduce one of the three papers behind becalm: compare its tables with ours, redraw its figures."""
    from becalm.cli.commands.study import run

    run(paper, output)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the files.")] = Path("demo"),
) -> None:
    """Simulate a test drive, clean it, and print the errors before and after."""
    from becalm.cli.commands.demo import run

    run(output)


app.command("app")(open_app)
for command in (live, journal, export):
    app.command()(command)
app.add_typer(fleet)


def main() -> None:
    """Run the command line; after an error, print one sentence and exit with a code."""
    stop_cleanly()
    # Matrices are small: more OpenBLAS threads would take a fifth of a short run. Set this before NumPy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = _run()
    for stream in filter(None, (sys.stdout, sys.stderr)):  # a stream is None if it was closed at the start
        try:
            stream.flush()
        except OSError:  # for example, the reading process has closed the pipe
            code = code or UsageError.exit_code
    os._exit(code)  # at a normal exit, threads of pyarrow may abort the process


def _run() -> int:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A file or pipe gets UTF-8, on Windows too; a terminal may not be able to show all names.
            stream.reconfigure(encoding=None if stream.isatty() else "utf-8", errors="backslashreplace")
    try:
        app()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except BecalmError as cause:
        _print_error(str(cause))
        return cause.exit_code
    except OSError as cause:
        _print_error(f"{cause.filename or 'standard output'} cannot be written: {cause.strerror}. Free some space.")
    except MemoryError:
        _print_error("Not enough memory for this recording; clean fewer channels with --channels.")
    return UsageError.exit_code


def _print_error(sentence: str) -> None:
    with suppress(OSError):  # if stderr is closed or full, only the exit code reports the error
        typer.echo(f"becalm: {sentence}", err=True)
