"""The page: small, closed, complete, and the same each time; whatever channels are called and whatever they hold."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from importlib.metadata import version

import numpy as np
import pytest

from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.report.data.description import Axis, Band, Curve, DrawnSurface, Figure
from becalm.report.data.payload import payload
from becalm.report.page import MOST_PICTURED
from drawing import Drawn, draw, figures_of

LARGEST = 2_000_000  # bytes
NAMES = [
    "</script><b>",
    "\"quoted\" 'name' &amp;",
    "Beschleunigung ä µ 加速度",
    "a" * 300,
    "{{ 7 * 7 }}",
    "<!--",
    "x",
    "X!",
]


def walk(rows: int, channels: int = 1, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    values: Floats = np.cumsum(rng.normal(0, 0.05, (rows, channels)), axis=0) + rng.normal(0, 0.3, (rows, channels))
    return values


class Elements(HTMLParser):
    """Every element of a page, with its attributes, and the text of each kind."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text: dict[str, list[str]] = {}
        self._open = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self._open = tag

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        self.text.setdefault(self._open, []).append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(autouse=True)
def _unprinted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what is for print, which takes a second a channel; test_printed_page looks at it."""
    monkeypatch.setattr("becalm.report.page.can_print", lambda: False)


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return draw(Recording(walk(400, 2), names=["ramp", "walk"], units=["m/s", "m"], rate_hz=100.0))


@pytest.fixture
def small(drawn: Drawn) -> str:
    return drawn.page()


def test_nothing_is_asked_of_the_network(small: str) -> None:
    page = Elements(small)
    places = [
        value
        for _, attributes in page.found
        for name, value in attributes.items()
        if name in ("src", "href", "action", "data", "srcset", "poster", "background")
    ]
    assert places, "the table leads to channels"
    assert all(place is not None and place.startswith("#") for place in places)
    assert not page.of("link")
    assert not page.of("base")
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|\bimport\(", small)
    (policy,) = (one["content"] for one in page.of("meta") if one.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_what_was_done_is_told(drawn: Drawn) -> None:
    page = Elements(drawn.page())
    assert drawn.facts.sha256[:16] in "".join(page.text["dd"])
    assert "".join(page.text["pre"]) == drawn.recipe.to_toml()
    for library in ("becalm", "numpy", "scipy"):
        assert f"{library} {version(library)}" in "".join(page.text["p"])
    for report in drawn.pictures.reports:
        assert report.says in "".join(page.text["p"])


def test_the_same_recording_gives_the_same_bytes(small: str) -> None:
    again = draw(Recording(walk(400, 2), names=["ramp", "walk"], units=["m/s", "m"], rate_hz=100.0))
    assert again.page() == small


def test_every_figure_has_its_place_and_every_place_its_figure(small: str) -> None:
    figures = figures_of(small)
    assert [place["id"] for place in Elements(small).of("figure")] == list(figures)
    assert {"1-ramp-signal", "2-walk-signal", "1-ramp-spectrum", "1-ramp-nis"} <= figures.keys()


def test_a_page_holds_what_was_gathered() -> None:
    drawn = draw(Recording(walk(20_000), names=["a"], units=["m"], rate_hz=100.0))
    readings, band, signal = figures_of(drawn.page())["1-a-signal"]["layers"]
    gathered, times = drawn.gathering.channels[0], drawn.gathering.times
    np.testing.assert_array_equal(readings["x"], times.low)
    for layer, envelope in ((readings, gathered.readings), (band, gathered.band), (signal, gathered.clean)):
        np.testing.assert_allclose(layer["low"], envelope.low, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(layer["high"], envelope.high, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("rows", "channels"),
    [(2, 1), (9, 60), (400, 1), (400, 60), (30_000, 60), pytest.param(300_000, 1, marks=pytest.mark.slow)],
)
def test_a_page_is_small(rows: int, channels: int) -> None:
    names = [f"c{k}" for k in range(channels)]
    recording = Recording(walk(rows, channels), names=names, rate_hz=100.0)
    one = tune(recording.select(["c0"]))  # and the others alike
    alike = tuple(one.channel[0].model_copy(update={"name": name}) for name in names)
    html = draw(recording, one.model_copy(update={"channel": alike})).page()
    assert len(html.encode()) < LARGEST
    page = Elements(html)
    drawn = [one["id"] for one in page.of("section")]
    assert len(drawn) == min(channels, MOST_PICTURED)
    assert all(name in page.text["td"] or name in page.text["a"] for name in names), "the table tells of all"
    assert ("the table lists" in html) == (channels > MOST_PICTURED)


def test_names_are_text_and_nothing_else() -> None:
    drawn = draw(Recording(walk(400, len(NAMES)), names=NAMES, rate_hz=100.0), name='<img src=x onerror="alert(1)">')
    html = drawn.page()
    page = Elements(html)
    assert not page.of("b")
    assert not page.of("img")
    assert page.text["h1"] == [drawn.facts.name]
    assert page.text["h2"] == NAMES
    ids = [attributes["id"] for _, attributes in page.found if "id" in attributes]
    assert len(set(ids)) == len(ids), "channels whose names look alike have figures of their own"
    figures = figures_of(html)
    assert [figures[f"{k}-{slug}-signal"]["y"]["label"] for k, slug in ((7, "x"), (8, "x"))] == ["x", "X!"]
    assert figures["1-script-b-signal"]["title"].startswith("</script><b>")


def spiked(rows: int) -> Floats:
    values = walk(rows)
    values[rows // 2] = np.inf
    return values


GAPPED_S = np.cumsum(np.where(np.arange(3000) % 500 == 0, 3.0, 0.01))
REPEATED_S = np.floor(np.arange(3000) * 0.9) / 100
HOSTILE = {
    "missing": Recording(np.full((500, 1), np.nan), names=["a"], rate_hz=100.0),
    "constant": Recording(np.full((5000, 1), 2.5), names=["a"], rate_hz=100.0),
    "infinite": Recording(spiked(5000), names=["a"], rate_hz=100.0),
    "half missing": Recording(np.where(np.arange(5000)[:, np.newaxis] < 2500, np.nan, walk(5000)), rate_hz=100.0),
    "two rows": Recording(walk(2), names=["a"], rate_hz=100.0),
    "far": Recording(1e9 + 1e-3 * walk(5000), names=["a"], rate_hz=100.0),
    "large": Recording(1e60 * walk(5000), names=["a"], rate_hz=100.0),
    "small": Recording(1e-30 * walk(5000), names=["a"], rate_hz=100.0),
    "slow": Recording(walk(4000), names=["a"], rate_hz=1e-3),
    "quick": Recording(walk(4000), names=["a"], rate_hz=1e6),
    "gaps": Recording(walk(3000), names=["a"], times_s=GAPPED_S),
    "repeats": Recording(walk(3000), names=["a"], times_s=REPEATED_S),
    "quantised": Recording(np.round(walk(5000)), names=["a"], rate_hz=100.0),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_any_channel_makes_a_page(name: str) -> None:
    recording = HOSTILE[name]
    drawn = draw(recording)
    html = drawn.page()
    figures = figures_of(html)
    assert len(html.encode()) < LARGEST
    signal = next(figure for key, figure in figures.items() if key.endswith("-signal"))
    z = np.where(np.isfinite(recording.samples[:, 0]), recording.samples[:, 0], np.nan)
    low, high = signal["layers"][0]["low"], signal["layers"][0]["high"]
    assert np.isfinite(low).any() == np.isfinite(z).any()
    if np.isfinite(z).any():
        scale = np.ptp(z[np.isfinite(z)]) + abs(np.nanmax(z)) * 1e-12
        assert np.nanmin(low) == pytest.approx(np.nanmin(z), abs=1e-6 * scale)
        assert np.nanmax(high) == pytest.approx(np.nanmax(z), abs=1e-6 * scale)
    for figure in figures.values():
        for layer in figure["layers"]:
            if "x" in layer:
                assert (np.diff(layer["x"]) >= 0).all(), figure["name"]
                assert np.isfinite(layer["x"]).all(), figure["name"]
        if figure["y"]["log"]:
            heights = [np.max(layer["y"], initial=0, where=np.isfinite(layer["y"])) for layer in figure["layers"]]
            assert max(heights) > 0, figure["name"]


@pytest.mark.parametrize("name", ["gaps", "slow", "quick"])
def test_how_long_it_lasts_is_told_by_its_time(name: str) -> None:
    recording = HOSTILE[name]
    drawn = draw(recording)
    told = "".join(Elements(drawn.page()).text["dd"])
    times_s = recording.timebase.times_s
    lasts_s = times_s[-1] - times_s[0] + recording.timebase.step_s
    seconds = [float(number) * (1e-3 if prefix else 1) for number, prefix in re.findall(r"([\d.e+]+) (m?)s", told)]
    assert any(found == pytest.approx(lasts_s, rel=1e-2) for found in seconds), told


def test_what_is_near_keeps_its_digits() -> None:
    values = 1e9 + np.random.default_rng(0).normal(0, 1e-3, 500)
    figure = Figure("f", "", Axis("x"), Axis("y"), (Curve("c", np.arange(500.0), values),))
    html = f'<script type="application/json" id="figures">{payload([figure])}</script>'
    np.testing.assert_allclose(figures_of(html)["f"]["layers"][0]["y"], values, rtol=0, atol=2e-7)


def test_an_array_stands_in_a_page_once() -> None:
    x, y = np.arange(1000.0), np.sin(np.arange(1000.0))
    once = payload([Figure("f", "", Axis("x"), Axis("y"), (Curve("c", x, y),))])
    twice = payload([Figure("f", "", Axis("x"), Axis("y"), (Curve("c", x, y), Band("b", x, y, y)))])
    assert len(twice) < len(once) + 200


def test_a_surface_is_for_print_only() -> None:
    flat = DrawnSurface("heights", np.arange(2.0), np.arange(2.0), np.zeros((2, 2)))
    with pytest.raises(TypeError, match="heights"):
        payload([Figure("f", "", Axis("x"), Axis("y"), (flat,))])
