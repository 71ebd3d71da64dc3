"""uPlot, which draws a report's pictures; `hatch_build.py` puts it here when becalm is built."""

from __future__ import annotations

from importlib.resources import files

from becalm.errors import BecalmError


def uplot() -> tuple[str, str]:
    """Return uPlot as a page needs it.

    Returns
    -------
    javascript, css : str
        To stand in a page's ``script`` and ``style``; its licence, which every copy must carry, opens the JavaScript.

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
            f"uPlot, which draws the report, is not in {folder}; it comes when becalm is installed. "
            "Type 'pip install --editable .' where becalm's pyproject.toml is, or install a wheel of becalm."
        ) from error
    return f"/*!\n{licence}\n*/\n{javascript}", css
