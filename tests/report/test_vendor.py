"""uPlot is in the package, with its licence, and a page can hold it."""

from __future__ import annotations

from pathlib import Path

import pytest

from becalm.errors import BecalmError
from becalm.report import vendor


def test_uplot_is_installed_with_its_licence() -> None:
    javascript, css = vendor.uplot()
    licence, code = javascript.removeprefix("/*!\n").split("\n*/\n", 1)
    assert licence.startswith("The MIT License")
    assert "Leon Sorokin" in licence
    assert "*/" not in licence
    assert "var uPlot=" in code
    assert ".uplot" in css


def test_a_page_can_hold_it() -> None:
    javascript, css = vendor.uplot()
    assert "</script" not in javascript.lower()
    assert "</style" not in css.lower()


def test_sources_that_were_never_installed_say_what_to_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vendor, "files", lambda _: tmp_path)
    with pytest.raises(BecalmError, match=r"pip install --editable \."):
        vendor.uplot()
