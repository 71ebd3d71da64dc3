"""A page with what is for print inside: still small, and the same bytes each time."""

from __future__ import annotations

import base64
import gzip
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from becalm.core.recording import Recording
from drawing import Drawn, draw

pytest.importorskip("matplotlib", reason="what is for print is drawn by matplotlib; install becalm[figures]")


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    values = np.cumsum(np.random.default_rng(4).normal(size=(20_000, 2)), axis=0)
    return draw(Recording(values, names=["ramp", "walk"], units=["m/s", "m"], rate_hz=100.0))


def sheets(html: str) -> list[str]:
    packed = re.findall(r'data-svg="([^"]+)"', html)
    return [gzip.decompress(base64.b64decode(one)).decode() for one in packed]


def test_what_is_for_print_is_vectors_with_words(drawn: Drawn) -> None:
    html = drawn.page()
    found = sheets(html)
    assert len(found) == 4, "two sheets a channel"
    for sheet, label in zip(found, ["ramp (m/s)", "density ((m/s)²/Hz)", "walk (m)", "density ((m)²/Hz)"], strict=True):
        svg = ElementTree.fromstring(sheet)
        words = {"".join(text.itertext()).strip() for text in svg.iter("{http://www.w3.org/2000/svg}text")}
        assert label in words
        assert not list(svg.iter("{http://www.w3.org/2000/svg}image"))
        assert "<script" not in sheet
    assert html.count('class="vector"') == 2


def test_a_page_with_print_is_the_same_each_time_and_small(drawn: Drawn) -> None:
    one, other = drawn.page(), drawn.page()
    assert one == other
    assert len(one.encode()) < 2_000_000


def test_ids_inside_what_is_printed_do_not_meet_those_of_the_page(drawn: Drawn) -> None:
    html = drawn.page()
    places = set(re.findall(r'<(?:figure|section|script)[^>]* id="([^"]+)"', html))
    for sheet in sheets(html):
        assert not places & set(re.findall(r'id="([^"]+)"', sheet))
