"""Load the files of uPlot, which draws the figures of a report. `hatch_build.py` copies them into this package."""

from __future__ import annotations

from importlib.resources import files

from becalm.errors import BecalmError


def uplot() -> tuple[str, str]:
    """Return the JavaScript and the CSS of uPlot as text.

    Returns
    -------
    javascript, css : str
        Contents for a page's ``script`` and ``style`` elements. The JavaScript begins with the licence, which every
        copy must include.

    Raises
    ------
    BecalmError
        If becalm runs from sources that were never installed.
    """
    folder = files("becalm.report") / "uplot"
    names = ("uPlot.LICENSE", "uPlot.iife.min.js", "uPlot.min.css")
    try:
        licence, javascript, css = ((folder / name).read_text(encoding="utf-8") for name in names)
    except FileNotFoundError as error:
        raise BecalmError(
            f"uPlot, which draws the report, is missing in {folder}; an installation of becalm puts it there. "
            "Type 'pip install --editable .' in the folder of becalm's pyproject.toml, or install a wheel of becalm."
        ) from error
    return f"/*!\n{licence}\n*/\n{javascript}", css
