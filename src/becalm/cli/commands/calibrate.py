"""Calibrate an accelerometer from rests in many poses; print a table on stderr and write a sensor file."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from becalm.cleaning.sensor_files.pose_entry import LEAST_GRAVITY, MOST_GRAVITY, PoseReport, report_poses
from becalm.cleaning.sensor_files.sensor_file import to_toml
from becalm.cli.messages import print_notes, stderr
from becalm.cli.opened_file import FileOptions, open_as, refuse_overwriting, shown_name
from becalm.errors import SensorError, UsageError
from becalm.files.atomic_file import refuse_unwritable, write_text
from becalm.files.inputs.portions import read_beginning, unused_rows_note
from becalm.sensors.checks import STANDARD_GRAVITY
from becalm.sensors.record import COVERAGE

_AXES = 3


def run(  # noqa: PLR0913  (one argument for each option)
    file: Path, file_options: FileOptions, output: Path, unit: str, gravity: float | None, *, as_json: bool
) -> None:
    """Calibrate an accelerometer from a recording, and write its sensor file.

    Raises
    ------
    UsageError
        If there are not exactly three channels, or the output is the input.
    SensorError
        If the rests are too few or too similar, or the unit or the gravity is not valid.
    """
    refuse_overwriting(file, output)
    refuse_unwritable(output)
    with open_as(file, file_options) as source:
        if len(source.names) != _AXES:
            raise UsageError(
                f"{len(source.names)} channels came ({', '.join(source.names)}); an accelerometer has three axes. "
                "Choose them with --channels x,y,z."
            )
        print_notes(source)
        recording = read_beginning(source)
        cut = unused_rows_note(source, recording)
        try:
            report = report_poses(recording, unit, gravity)
        except SensorError as cause:
            raise SensorError(f"{cause}{cut}") from cause
    today = datetime.now().astimezone().date()
    write_text(
        output, to_toml([report.entry(today)], f"Calibrated by becalm: {report.rests} rests of {shown_name(file)}.")
    )
    if as_json:
        print(json.dumps({"file": str(file), "output": str(output), **report.as_dict()}, indent=2))  # noqa: T201
    _show(report, gravity)
    if cut:
        stderr.print(cut.strip())
    typer.echo(f"Wrote {output}. Use it with: becalm clean {file} -o OUT --sensors {output}", err=True)


def _show(found: PoseReport, gravity: float | None) -> None:
    """Print the calibration of each axis, the spread of |a| before and after, and remarks on uncertainty."""
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
    how = "as read" if raw in ("g", "m/s^2") else "with one factor for all axes, and the best zero"
    stderr.print(f"Spread of |a| over the rests: {found.before:.3g} {unit} before ({how}), {found.after:.3g} after.")
    if np.isfinite(found.held_out):
        stderr.print(f"Each rest with a calibration from the others: {found.held_out:.3g} {unit} from gravity, rms.")
    if calibration.excess > 1:
        stderr.print(
            f"Rests differ from the model {calibration.excess:.2g} times as much as their noise; the uncertainties of "
            "bias and scale are increased by this factor."
        )
    if gravity is None:
        stderr.print(
            f"Gravity is assumed to be {STANDARD_GRAVITY} m/s^2, with an uncertainty for its range from"
            f" {LEAST_GRAVITY} at the equator to {MOST_GRAVITY} at the poles; if it is known, give it with --gravity."
        )
