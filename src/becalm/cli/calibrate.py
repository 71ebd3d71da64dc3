"""An accelerometer calibrated by its rests in many poses: a table on stderr, and the sensor's file."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from becalm.cleaning.pose_entry import LEAST_GRAVITY, MOST_GRAVITY, PoseReport, report_poses
from becalm.cleaning.sensor_file import to_toml
from becalm.cli.messages import stderr, tell_notes
from becalm.cli.opened_file import Said, open_as, refuse_overwriting, shown_name
from becalm.errors import SensorError, UsageError
from becalm.files.portions import beginning, cut_short
from becalm.files.text_file import refuse_unwritable, write_text
from becalm.sensors.checks import STANDARD_GRAVITY
from becalm.sensors.record import COVERAGE

_AXES = 3


def run(file: Path, said: Said, output: Path, unit: str, gravity: float | None, *, as_json: bool) -> None:  # noqa: PLR0913  (the contract's options)
    """Calibrate the accelerometer of a file, and write its sensor file.

    Raises
    ------
    UsageError
        If the file does not hold just three channels and none were named.
    SensorError
        If its rests are too few or too alike, or a unit or gravity is impossible.
    """
    refuse_overwriting(file, output)
    refuse_unwritable(output)
    with open_as(file, said) as source:
        if len(source.names) != _AXES:
            raise UsageError(
                f"{len(source.names)} channels came ({', '.join(source.names)}); an accelerometer has three axes. "
                "Name those with --channels x,y,z."
            )
        tell_notes(source)
        recording = beginning(source)
        cut = cut_short(source, recording)
        try:
            found = report_poses(recording, unit, gravity)
        except SensorError as cause:
            raise SensorError(f"{cause}{cut}") from cause
    today = datetime.now().astimezone().date()
    write_text(
        output, to_toml([found.entry(today)], f"Calibrated by becalm: {found.rests} rests of {shown_name(file)}.")
    )
    if as_json:
        print(json.dumps({"file": str(file), "output": str(output), **found.as_dict()}, indent=2))  # noqa: T201
    _show(found, gravity)
    if cut:
        stderr.print(cut.strip())
    typer.echo(f"Wrote {output}. Use it with: becalm clean {file} -o OUT --sensors {output}", err=True)


def _show(found: PoseReport, gravity: float | None) -> None:
    """Show the axes, how |a| spread before and after, and what is not known."""
    raw, unit, calibration = found.raw_unit, found.unit, found.calibration
    table = Table(box=None, pad_edge=False)
    for heading in (
        "channel",
        f"bias ({raw})",
        "U (k=2)",
        f"scale ({unit} per {raw.removesuffix('s')})",
        "U (k=2)",
        "cross-axis",
    ):
        table.add_column(heading, justify="left" if heading == "channel" else "right")
    for axis, name in enumerate(found.channels):
        others = np.delete(calibration.matrix[axis], axis) / found.scales[axis]
        table.add_row(
            name,
            f"{calibration.bias[axis]:.6g}",
            f"{COVERAGE * calibration.bias_std[axis]:.2g}",
            f"{found.scales[axis]:.6g}",
            f"{found.scale_uncertainties_percent[axis]:.2g} %",
            f"{100 * np.abs(others).max():.2g} %",
        )
    stderr.print(f"{found.rests} rests found.")
    stderr.print(table)
    how = "as read" if raw in ("g", "m/s^2") else "one factor for all axes, and its best zero"
    stderr.print(f"|a| over the rests spreads by {found.before:.3g} {unit} before ({how}), {found.after:.3g} after.")
    if np.isfinite(found.held_out):
        stderr.print(f"Each rest held out of its calibration: {found.held_out:.3g} {unit} from gravity, rms.")
    if calibration.excess > 1:
        stderr.print(
            f"Rests differ from the model {calibration.excess:.2g} times as much as their noise; the uncertainties of "
            "bias and scale are as much larger."
        )
    if gravity is None:
        stderr.print(
            f"Gravity is taken to be {STANDARD_GRAVITY} m/s^2, and to be uncertain as it goes from {LEAST_GRAVITY} at "
            f"the equator to {MOST_GRAVITY} at the poles; where it is known, say --gravity."
        )
