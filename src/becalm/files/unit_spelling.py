"""Parse the unit in the header of a column: `Gyroscope X (deg/s)`, `Force [N]`, `acc_0_mps2`."""

from __future__ import annotations

import re

from becalm.files.unit_words import is_unit

_BRACKETED = re.compile(
    r"^(?P<name>.*?)\s*"
    r"(?:\((?P<round>[^()]*(?:\([^()]*\)[^()]*)*)\)|\[(?P<square>[^\[\]]*)\]|<(?P<angle>[^<>]*)>)\s*$"
)
_INDEXED = re.compile(r"\w\[[0-9]+\]\s*$")  # `gyro_rad[0]`: an index, not a unit
_AFTER_COMMA = re.compile(r"^(?P<name>.+?)\s*[,/]\s+(?P<unit>\S+)$")
_AFTER_IN = re.compile(r"^(?P<name>.+?)\s+in\s+(?P<unit>\S+)\s*$")
_SIGN = re.compile(r"^(?P<name>.+?)\s+(?P<unit>\S*[\u00b0%/\\^\u00b2]\S*)\s*$")  # a word alone may be part of a name

SUFFIXES: dict[str, str] = {
    "s": "s",
    "sec": "s",
    "secs": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "us": "us",
    "usec": "us",
    "ns": "ns",
    "nsec": "ns",
    "min": "min",
    "h": "h",
    "hours": "h",
    "mps": "m/s",
    "mps2": "m/s^2",
    "ms2": "m/s^2",
    "mss": "m/s^2",
    "kmh": "km/h",
    "kph": "km/h",
    "radps": "rad/s",
    "rads": "rad/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "mdps": "mdeg/s",
    "deg": "deg",
    "rad": "rad",
    "g": "g",
    "mg": "mg",
    "ug": "ug",
    "m": "m",
    "mm": "mm",
    "um": "um",
    "cm": "cm",
    "km": "km",
    "hz": "Hz",
    "V": "V",
    "mV": "mV",
    "uV": "uV",
    "mA": "mA",
    "kN": "kN",
    "Nm": "N*m",
    "Pa": "Pa",
    "pa": "Pa",
    "hpa": "hPa",
    "kpa": "kPa",
    "mpa": "MPa",
    "bar": "bar",
    "mbar": "mbar",
    "degc": "degC",
    "celsius": "degC",
    "ut": "uT",
    "ustrain": "um/m",
    "microstrain": "um/m",
    "percent": "percent",
    "rpm": "rpm",
}
"""Units by the ending of names like `acc_0_mps2`; looked up as written, then in lower case if longer than a letter."""

_SPELLINGS = (
    ("\u03bc", "u"),  # Greek mu
    ("\u00b5", "u"),  # the micro sign
    ("\u03b5", "strain"),
    ("\u00b0", "deg"),
    ("\u03a9", "ohm"),
    ("\u2126", "ohm"),
    ("\u00b2", "^2"),
    ("\u00b3", "^3"),
    ("\u00b7", "*"),
    ("\\", "/"),
    ("**", "^"),
)

_PATTERNS = (
    (r"(?<=\w)\{[^{}]*\}", ""),  # UCUM's remarks: ug{RMS}
    (r"^(\w+)[.* ](\w+?)\^?-1$", r"\1/\2"),  # rad.s-1
    (r"^(\w+)[.* ](\w+?)\^?-([2-9])$", r"\1/\2^\3"),
    (r"/\(([^()/*]*)\)$", r"/\1"),  # m/(s^2)
    (r"/(s|mm|cm|m)([23])$", r"/\1^\2"),
    (r"^[Dd]eg(?:rees?|s)?\.? ?([CF])$", r"deg\1"),
)
_ENCLOSED = re.compile(r"^[\[(<]((?:[^\[\]()<>]|\([^()]*\))*)[\])>]$")

_LARGE_G = re.compile(r"([mun]?)G")
_MAGNETIC = re.compile(r"(?i:mag|gauss|field|flux|hall|compass)|(?:^|[\W_])B_?[xyzXYZ]?(?:$|[\W_])")

_WHOLE = {
    "m/s/s": "m/s^2",
    "mps": "m/s",
    "mps2": "m/s^2",
    "dps": "deg/s",
    "degps": "deg/s",
    "radps": "rad/s",
    "ustrain": "um/m",
    "microstrain": "um/m",
    "degC": "degC",
    "%": "percent",
    "-": "",
    "--": "",
    "n/a": "",
    "none": "",
    "None": "",
    "1": "",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "Second": "s",
    "seconds": "s",
    "Seconds": "s",
    "Sekunden": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "minutes": "min",
    "hours": "h",
    **dict.fromkeys(("volt", "Volt", "volts", "Volts", "VOLT"), "V"),
    **dict.fromkeys(("Amp", "amps", "Amps"), "A"),
}

_UNIT_WORD = re.compile(
    r"^[\[(<]?\s*(?:-|--|%|G|[Ss]ec(?:ond)?s?|[Vv]olts?|[Aa]mps?|(?:[yzafpnumcdhkMGT]|da)?(?:s|sec|m|g|V|A|N|Nm|Pa|bar|Hz|T|Gauss|rad|deg|degC|C|K|W|J|Ohm|strain|"
    r"rpm|min|h|counts?|LSB)(?:[\^]?-?\d)?(?:[/*]\s*(?:[numcdhkM]?(?:s|m|V|h|min|N|g))(?:[\^]?-?\d)?){0,2}"
    r"|hh:mm:ss\S*|dd.mm.yyyy\S*|yyyy\S*)\s*[\])>]?$"
)


def tidy_unit(text: str) -> str:
    r"""Normalise the spelling of a unit: `um\m` becomes `um/m`, `m/s2` and `m.s-2` become `m/s^2`, and a dash ""."""
    unit = text.strip()
    while found := _ENCLOSED.match(unit):
        unit = found[1].strip()
    unit = _plain(unit)
    return _WHOLE.get(unit, unit)


def parse_header(header: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit, "" if there is none."""
    name, unit = _split_header(header)
    return name, on_sensor(name, unit)


def on_sensor(name: str, unit: str) -> str:
    """Return the unit that is meant in a column of that name: G is gauss for a magnetic field, and g for all else."""
    if (found := _LARGE_G.fullmatch(unit)) and not _MAGNETIC.search(name):
        return f"{found[1]}g"
    return unit


def _split_header(header: str) -> tuple[str, str]:
    if _INDEXED.search(header):
        return header.strip(), ""
    found = _BRACKETED.match(header)
    if found and ":" in (found["round"] or ""):  # a remark: (S/N: 123)
        return _split_header(found["name"])
    if found and found["name"].strip(" /"):
        unit = next(text for text in (found["round"], found["square"], found["angle"]) if text is not None)
        if found["round"] is None or is_unit(tidy_unit(unit)):
            return found["name"].rstrip(" /").strip(), tidy_unit(unit)
        name, inner = _split_header(found["name"])  # V(out), acc (g) (raw)
        return (f"{name} ({unit})", inner) if inner else (header.strip(), "")
    for pattern in (_AFTER_COMMA, _AFTER_IN, _SIGN):
        found = pattern.match(header)
        if found and looks_like_unit(found["unit"]):
            return found["name"].strip(), tidy_unit(found["unit"])
    name, underscore, last = header.strip().rpartition("_")
    unit = SUFFIXES.get(last) or (SUFFIXES.get(last.lower(), "") if len(last) > 1 else "")
    if underscore and name.strip("_") and unit:
        return name, unit
    return header.strip(), ""


def looks_like_unit(text: str) -> bool:
    """Return whether a cell below a column's name is a unit, or a dash that stands for no unit."""
    return _UNIT_WORD.match(_plain(text.strip())) is not None


def _plain(text: str) -> str:
    """Replace signs by letters, and write powers with ^."""
    for old, new in _SPELLINGS:
        text = text.replace(old, new)
    for pattern, plain in _PATTERNS:
        text = re.sub(pattern, plain, text)
    return text
