"""The section on units: how becalm parses and converts headers that loggers write, by the functions for files."""

from __future__ import annotations

from becalm.errors import UsageError
from becalm.files.units.unit_conversion import conversion
from becalm.files.units.unit_spelling import QUANTITIES, parse_header

HEADERS = (
    ("acc_x (g)", "m/s^2"),
    ("acc_0_mps2", "g"),
    ("a [m.s-2]", "mm/s^2"),
    ("Gyroscope X (deg/s)", "rad/s"),
    ("wheel [rpm]", "Hz"),
    ("wheel [rpm]", "deg/s"),
    ("strain (um\\m)", "mm/m"),
    ("eps <\u00b5\u03b5>", "um/m"),
    ("bridge [mV/V]", "um/m"),
    ("Force in kN", "kgf"),
    ("Load (kg)", "N"),
    ("Moment [N\u00b7m]", "kN*m"),
    ("p [psi]", "MPa"),
    ("Temp \u00b0C", "degF"),
    ("Speed km/h", "m/s"),
    ("field_ut", "Gauss"),
    ("noise [ug/sqrt(Hz)]", "m/s^2/sqrt(Hz)"),
    ("raw (LSB)", "V"),
)
"""Headers of columns, each with a unit to convert the column to."""


def units_table() -> str:
    """Return the table of headers with their conversions, and the list of the kinds of units."""
    lines = ["| header | name | unit | asked for | becomes |", "|---|---|---|---|---|", *map(_row, HEADERS)]
    kinds = [f"{kind} (`{unit.replace('g_n', 'g')}`)" for kind, unit in QUANTITIES.items()]
    return "\n".join([*lines, "", f"It can convert units of {', '.join(kinds)}, and products and ratios of these.", ""])


def _row(asked: tuple[str, str]) -> str:
    header, wanted = asked
    name, unit = parse_header(header)
    try:
        factor, offset = conversion(unit, wanted)
        result = f"{factor:.9g} x" + (f" {'-' if offset < 0 else '+'} {abs(offset):.9g}" if offset else "")
    except UsageError as refusal:
        result = f"refused: {refusal}"
    return f"| `{header}` | {name} | {unit} | {wanted} | {result} |"
