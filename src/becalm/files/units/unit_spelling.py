"""Parse the unit in the header of a column: `Gyroscope X (deg/s)`, `Force [N]`, `acc_0_mps2`."""

from __future__ import annotations

import re
from functools import cache

# Decide whether a text is a unit: `um/m`, `counts` and `degrees C` are, `raw`, `out` and `+0100` are not.

_OTHERS = (
    *("dB", "dBA", "dBm", "dBV", "dBFS", "pH", "bpm", "RH", "FS", "ADC", "adu", "inHg", "mmHg", "inH", "mmH", "cmH"),
    *("VDC", "VAC", "Vdc", "Vac", "Vrms", "Vpp", "grms", "gRMS", "RMS", "rms", "pk", "peak", "O", "Ah", "Wh", "VA"),
    *("var", "VAR", "Nm", "Ncm", "Nmm", "Deg", "gal", "lbs", "oz", "ksi", "ustrain", "mps", "kph", "kmh", "C", "F"),
    *("psig", "psia", "sample", "samples", "tick", "ticks", "cycle", "cycles", "frame", "frames"),
)
"""Words that are units in a header, besides the names in `DEFINITIONS`."""

_LONG = 4  # letters; a unit of at least this length may also be written in lower case or in the plural
_MARKS = re.compile(r"[\s*/^().\-+\d%\[\]]*")  # characters that are allowed between the words of a unit
_WORDS = re.compile(r"[A-Za-z_]+")


def is_unit(text: str) -> bool:
    """Return whether each word of a text is a unit.

    Parameters
    ----------
    text : str
        The text in the brackets of a header, normalised by `tidy_unit`.
    """
    words = _WORDS.findall(text)
    if not words:
        return text in ("", "%")
    return _MARKS.fullmatch(_WORDS.sub("", text)) is not None and all(map(_is_known, words))


def _is_known(word: str) -> bool:
    units, prefixes = _names()
    spelt = [word, *([word.lower(), word.lower().removesuffix("s")] if len(word) >= _LONG else [])]
    if word == "sqrt" or any(one in units for one in spelt):
        return True
    return any(one.removeprefix(prefix) in units for one in spelt for prefix in prefixes if one.startswith(prefix))


@cache
def _names() -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of all units, and of all prefixes."""
    units, prefixes = set(_OTHERS), set()
    for definition in DEFINITIONS:
        name, _, *aliases = (part.strip() for part in re.sub(r";[^=]*", "", definition).split("="))
        named = {name, *aliases}
        if name.endswith("-"):
            prefixes |= {one.removesuffix("-") for one in named}
        else:
            units |= {*named, *(one.lower() for one in named if len(one) >= _LONG)}
    return frozenset(units), frozenset(prefixes)


# The units of sensors in pint's notation.
#
# They replace pint's own list for two reasons. First, angles and counts are dimensions here, so that a count does not
# convert to a radian, nor rpm to hertz. Second, a letter in a header has its meaning on a sensor: `c` is not the speed
# of light, and `e` is not a charge.

DEFINITIONS = (
    *("giga- = 1e9 = G-", "mega- = 1e6 = M-", "kilo- = 1e3 = k-", "hecto- = 1e2 = h-", "deci- = 1e-1 = d-"),
    *("centi- = 1e-2 = c-", "milli- = 1e-3 = m-", "micro- = 1e-6 = u-", "nano- = 1e-9 = n-", "pico- = 1e-12 = p-"),
    "meter = [length] = m = metre",
    "second = [time] = s = sec",
    "gram = [mass] = g",
    "ampere = [current] = A = amp",
    "kelvin = [temperature]; offset: 0 = K",
    "mole = [substance] = mol",
    "candela = [luminosity] = cd",
    "radian = [angle] = rad",
    "count = [count] = counts = LSB = digit",
    "percent = 0.01 = pct",
    "ppm = 1e-6",
    "strain = meter / meter",
    "minute = 60 * second = min",
    "hour = 3600 * second = h = hr",
    "day = 24 * hour = d",
    "hertz = 1 / second = Hz",
    "degree = 0.017453292519943295 * radian = deg",
    "arcminute = degree / 60 = arcmin",
    "arcsecond = degree / 3600 = arcsec",
    "gon = 0.9 * degree",
    "revolution = 360 * degree = rev = turn",
    "rpm = revolution / minute",
    "dps = degree / second",
    "standard_gravity = 9.80665 * meter / second ** 2 = g_n",
    "galileo = 0.01 * meter / second ** 2 = Gal",
    "newton = kilogram * meter / second ** 2 = N",
    "kilogram_force = kilogram * standard_gravity = kgf = kp",
    "pound = 453.59237 * gram = lb",
    "pound_force = pound * standard_gravity = lbf",
    "tonne = 1000 * kilogram = t",
    "pascal = newton / meter ** 2 = Pa",
    "bar = 1e5 * pascal",
    "atmosphere = 101325 * pascal = atm",
    "torr = atmosphere / 760 = Torr",
    "psi = pound_force / inch ** 2",
    "inch = 0.0254 * meter = in",
    "foot = 12 * inch = ft",
    "yard = 3 * foot = yd",
    "mile = 1760 * yard = mi",
    "nautical_mile = 1852 * meter = nmi",
    "knot = nautical_mile / hour = kn = kt",
    "mph = mile / hour",
    "liter = 1e-3 * meter ** 3 = l = L = litre",
    "joule = newton * meter = J",
    "watt = joule / second = W",
    "volt = watt / ampere = V",
    "ohm = volt / ampere = Ohm",
    "coulomb = ampere * second = C",
    "farad = coulomb / volt = F",
    "henry = volt * second / ampere = H",
    "siemens = 1 / ohm = S",
    "weber = volt * second = Wb",
    "tesla = weber / meter ** 2 = T",
    "gauss = 1e-4 * tesla = Gauss = G",
    "lumen = candela = lm",
    "lux = lumen / meter ** 2 = lx",
    "degree_Celsius = kelvin; offset: 273.15 = degC = celsius = Cel",
    "degree_Fahrenheit = 5 / 9 * kelvin; offset: 459.67 * 5 / 9 = degF = fahrenheit",
)

QUANTITIES = {
    "ratio": "percent",
    "count": "counts",
    "length": "mm",
    "time": "s",
    "frequency": "Hz",
    "angle": "deg",
    "angular rate": "deg/s",
    "angular acceleration": "rad/s^2",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "mass": "kg",
    "force": "kN",
    "torque or energy": "N*m",
    "pressure or stress": "MPa",
    "temperature": "degC",
    "voltage": "mV",
    "current": "mA",
    "resistance": "ohm",
    "charge": "pC",
    "magnetic flux density": "uT",
    "power": "W",
    "acceleration noise density": "g_n/Hz^0.5",
    "angular rate noise density": "deg/s/Hz^0.5",
}
"""Names of the quantities that units measure, each with an example of a unit."""


_BRACKETED = re.compile(
    r"^(?P<name>.*?)\s*"
    r"(?:\((?P<round>[^()]*(?:\([^()]*\)[^()]*)*)\)|\[(?P<square>[^\[\]]*)\]|<(?P<angle>[^<>]*)>)\s*$"
)
_INDEXED = re.compile(r"\w\[[0-9]+\]\s*$")  # `gyro_rad[0]`: an index, not a unit
_AFTER_COMMA = re.compile(r"^(?P<name>.+?)\s*[,/]\s+(?P<unit>\S+)$")
_AFTER_IN = re.compile(r"^(?P<name>.+?)\s+in\s+(?P<unit>\S+)\s*$")
# A unit that follows only a space must contain one of these symbols; otherwise, the word is part of the name.
_SIGN = re.compile(r"^(?P<name>.+?)\s+(?P<unit>\S*[\u00b0%/\\^\u00b2]\S*)\s*$")

_TIME_WORDS = {
    "s": "s sec secs second seconds sekunde sekunden",
    "ms": "ms msec msecs millis millisec millisecs millisecond milliseconds",
    "us": "us usec usecs micros microsec microsecs microsecond microseconds",
    "ns": "ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds",
    "min": "min mins minute minutes minuten",
    "h": "h hr hrs hour hours stunde stunden",
    "d": "d day days tage",
}
TIME_UNITS = {word: unit for unit, words in _TIME_WORDS.items() for word in words.split()}
"""Units of time by their spellings in lower case."""

SUFFIXES: dict[str, str] = {
    **{word: unit for word, unit in TIME_UNITS.items() if word.endswith("s")},
    "sec": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "h": "h",
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
    "mPa": "mPa",
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

_TIME = re.compile(r"(?i)t|.*(?:time|elapsed|epoch|clock|zeit|tempo|tiempo|duration)(?:stamps?)?")
"""Names behind which every word of `TIME_UNITS` is a unit: `time_min`; `temp_min` is a minimum."""

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
    (r"(?<=\w)\{[^{}]*\}", ""),  # annotations of UCUM: ug{RMS}
    (r"^(\w+)[.* ](\w+?)\^?-1$", r"\1/\2"),  # rad.s-1
    (r"^(\w+)[.* ](\w+?)\^?-([2-9])$", r"\1/\2^\3"),
    (r"/\(([^()/*]*)\)$", r"/\1"),  # m/(s^2)
    (r"/(s|mm|cm|m)([23])$", r"/\1^\2"),
    (r"^[Dd]eg(?:rees?|s)?\.? ?([CF])$", r"deg\1"),
)
_ENCLOSED = re.compile(r"^[\[(<]((?:[^\[\]()<>]|\([^()]*\))*)[\])>]$")

_LARGE_G = re.compile(r"([mun]?)G")
_MAGNETIC = re.compile(r"(?i:mag|gauss|field|flux|hall|compass)|(?:^|[\W_])B_?[xyzXYZ]?(?:$|[\W_])")

_WHOLE = {  # other spellings of complete units
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
    **TIME_UNITS,
    **dict.fromkeys(("volt", "Volt", "volts", "Volts", "VOLT"), "V"),
    **dict.fromkeys(("Amp", "amps", "Amps"), "A"),
}

_CLOCKS = ("utc", "gmt", "local", "unix", "epoch", "elapsed", "relative", "rel", "abs")
"""Words in the brackets behind a time that are no units."""

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
    return _WHOLE.get(unit) or TIME_UNITS.get(unit.lower() if len(unit) > _LONG else unit, _WHOLE.get(unit, unit))


def parse_header(header: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit, "" if there is none."""
    name, unit = _split_header(header)
    return name, on_sensor(name, unit)


def time_unit(header: str, unit: str = "") -> str:
    """Return the unit of a time column, "" if there is none.

    Parameters
    ----------
    header : str
        The name of the column; the unit may be its last word: `timestampMs`, `elapsed seconds`, `millis`.
    unit : str
        The unit that the file gives separately from the name.
    """
    bare, own = parse_header(header)
    unit = (tidy_unit(unit) or own).partition(" since ")[0].rstrip(".")
    last = (re.findall(r"(?:[A-Z]?[a-z]+|[A-Z]+)$", bare) or [""])[0]
    before = bare.removesuffix(last).rstrip(" _-./,:")
    if not unit and (_TIME.fullmatch(before) or (not before and len(last) > 2)):
        return TIME_UNITS.get(last.lower(), "")
    spelt = unit.lower() if len(unit) > 2 or _TIME.fullmatch(bare) else unit  # an mS is a siemens, except of a time
    return TIME_UNITS.get(spelt, "" if unit.lower() in _CLOCKS else unit)


def on_sensor(name: str, unit: str) -> str:
    """Return the unit of a column; G stays gauss if the name suggests a magnetic field, and otherwise becomes g."""
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
    if not unit and _TIME.fullmatch(name):
        unit = TIME_UNITS.get(last.lower(), "")
    if underscore and name.strip("_") and unit:
        return name, unit
    return header.strip(), ""


def looks_like_unit(text: str) -> bool:
    """Return whether a word of a header, or a cell below it, is a unit, a format of times, or a dash for no unit."""
    word = text.strip()
    return _UNIT_WORD.match(_plain(word)) is not None or (len(word) > _LONG and word.lower() in TIME_UNITS)


def _plain(text: str) -> str:
    """Replace symbols by ASCII letters, and write powers with ^."""
    for old, new in _SPELLINGS:
        text = text.replace(old, new)
    for pattern, plain in _PATTERNS:
        text = re.sub(pattern, plain, text)
    return text
