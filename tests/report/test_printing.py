"""What is described is drawn: every kind of layer, into every kind of file, whatever the numbers are."""

from __future__ import annotations

import re
from importlib import resources
from typing import get_args
from xml.etree import ElementTree as Tree

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.report import printing
from becalm.report.data.description import Axis, Band, Curve, DrawnSurface, Figure, Lane, Layer, Rule
from becalm.report.printing import COLOURS, OTHERS, Kind, printed

X = np.linspace(0.0, 1.0, 5)
SVG = "{http://www.w3.org/2000/svg}"
LAYERS: dict[str, Layer] = {
    "line": Curve("told", X, X**2, "clean"),
    "points": Curve("told", X, X**2, look="points", labels=("first", "second")),
    "band": Band("told", X, X - 1, X + 1, "clean", faint=True),
    "lane": Lane("told", X[:2], X[:2] + 0.1),
    "rule": Rule("told", 0.5, "limit"),
    "surface": DrawnSurface("told", X, X[:3], np.add.outer(X, X[:3])),
    "surface by point": DrawnSurface("told", X, X[:3], np.add.outer(X, X[:3]), by_point=True),
}
FIRST_BYTES = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.fixture(autouse=True)
def _drawing() -> None:
    pytest.importorskip("matplotlib")


def figure(*layers: Layer, x: Axis | None = None, y: Axis | None = None, title: str = "drawn") -> Figure:
    return Figure("drawn", title, x or Axis("x"), y or Axis("y"), layers)


def drawn(*figures: Figure, columns: int = 1) -> Tree.Element:
    return Tree.fromstring(printed(figures, "svg", columns))


def texts(sheet: Tree.Element) -> list[str]:
    return [each.text or "" for each in sheet.iter(f"{SVG}text")]


def paths(sheet: Tree.Element, colour: str) -> list[str]:
    """Return the outlines of lines in a colour inside the axes."""
    styled = [each for each in sheet.iter(f"{SVG}path") if colour in each.get("style", "")]
    return [each.get("d", "") for each in styled if "clip-path" in each.attrib]


def areas(sheet: Tree.Element, colour: str) -> list[str]:
    """Return the outlines of areas in a colour; their heights count from the foot of the sheet, downwards."""
    return [each.get("d", "") for each in sheet.findall(f".//{SVG}defs/{SVG}path") if colour in each.get("style", "")]


def top(outlines: list[str]) -> float:
    """Return the least height that outlines reach."""
    return min(float(y) for outline in outlines for y in re.findall(r"[ML] \S+ (\S+)", outline))


@pytest.mark.parametrize("kind", get_args(Kind))
@pytest.mark.parametrize("layer", LAYERS.values(), ids=LAYERS)
def test_every_layer_is_drawn_into_every_kind_of_file_and_twice_the_same(layer: Layer, kind: Kind) -> None:
    without = printed([figure(Curve("", X, X, "truth"))], kind)
    once, twice = (printed([figure(Curve("", X, X, "truth"), layer)], kind) for _ in range(2))
    assert once == twice
    assert once != without
    assert once.startswith(FIRST_BYTES[kind])


@pytest.mark.parametrize("name", LAYERS)
def test_every_layer_is_told_by_its_name(name: str) -> None:
    assert "told" in texts(drawn(figure(Curve("", X, X, "truth"), LAYERS[name])))


def test_roles_have_their_colours_and_others_differ() -> None:
    layers = [Curve(role, X, X, role) for role in COLOURS]
    sheet = drawn(figure(*layers, *(Rule(f"other {k}", k / 10) for k in range(3))))
    assert all(paths(sheet, colour) for colour in (*COLOURS.values(), *OTHERS[:3]))
    assert not paths(sheet, OTHERS[3])


def test_a_page_has_the_colours_of_print() -> None:
    style, script = (
        (resources.files("becalm.report") / "assets" / name).read_text(encoding="utf-8")
        for name in ("figures.css", "colours.js")
    )
    light = style.partition("@media")[0]
    wanted = {str(role): colour for role, colour in COLOURS.items()}
    wanted |= {f"other-{k}": one for k, one in enumerate(OTHERS)}
    assert {name: colour for name, colour in re.findall(r"--([\w-]+): (#\w+);", light) if name in wanted} == wanted
    assert f"--other-{len(OTHERS)}:" not in light
    assert f"const OTHERS = {len(OTHERS)};" in script


def test_looks_differ() -> None:
    line, dashed, dotted = (printed([figure(Curve("", X, X, look=look))]) for look in ("line", "dashed", "dotted"))
    assert b"stroke-dasharray: 3.7" in dashed
    assert b"stroke-dasharray: 1,1.65" in dotted
    assert len({line, dashed, dotted}) == 3


def test_points_are_not_joined_and_have_their_labels() -> None:
    sheet = drawn(figure(Curve("", X, X, "clean", "points", ("a", "b"))))
    marks = [use for use in sheet.iter(f"{SVG}use") if COLOURS["clean"] in use.get("style", "")]
    assert len(marks) == len(X)
    assert not paths(sheet, COLOURS["clean"])
    assert {"a", "b"} <= set(texts(sheet))


def test_a_gap_is_a_gap_and_a_point_that_is_none_has_no_label() -> None:
    y = np.where(X == 0.5, np.nan, X)
    sheet = drawn(figure(Curve("", X, y, "clean"), Curve("", X, y, "other", "points", tuple("abcde"))))
    (outline,) = paths(sheet, COLOURS["clean"])
    assert outline.count("M") == 2
    assert set("abcde") & set(texts(sheet)) == set("abde")


def test_a_band_with_a_gap_is_two_bands() -> None:
    low = np.where(X == 0.5, np.nan, X)
    sheet = drawn(figure(Band("", X, low, low + 1, "clean")))
    outlines = paths(sheet, COLOURS["clean"]) + areas(sheet, COLOURS["clean"])
    assert sum(outline.count("M") for outline in outlines) == 2


@pytest.mark.parametrize("at", [0, 7777, 99_999])
@pytest.mark.parametrize("kind", ["curve", "band"])
def test_no_spike_is_lost(kind: str, at: int) -> None:
    x, y = np.linspace(0.0, 1.0, 100_000), np.random.default_rng(2).uniform(0.0, 0.1, 100_000)
    y[at] = 1.0
    svgs = [
        printed([figure(each, y=Axis("y", low=0.0, high=1.0))])
        for each in (
            (Curve("", x, y, "clean"), Curve("", X, X, "clean"))
            if kind == "curve"
            else (Band("", x, y, y, "clean"), Band("", X, 0 * X, X, "clean"))
        )
    ]
    outlined = paths if kind == "curve" else areas
    spike, whole = (top(outlined(Tree.fromstring(svg), COLOURS["clean"])) for svg in svgs)
    assert spike == pytest.approx(whole, abs=0.5)
    assert len(svgs[0]) < 150_000


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("count", [0, 1])
def test_one_point_or_none_does_no_harm(count: int, log: bool) -> None:
    x = np.ones(count)
    layers = (Curve("a", x, x), Curve("b", x, x, "other", "points"), Band("c", x, x, x), Rule("d", 1.0))
    told = texts(drawn(figure(*layers, x=Axis("x", log), y=Axis("y", log))))
    assert set("abcd") <= set(told)


@pytest.mark.parametrize("y", [X, -X, 0 * X, X - 0.5, np.nan * X], ids=["0", "negative", "all 0", "both", "none"])
def test_what_a_logarithmic_axis_cannot_show_does_no_harm(y: Floats) -> None:
    layers = (Curve("a", X, y), Band("b", X, y, y), Curve("c", X, y, "other", "points", tuple("pqrst")))
    assert set("abc") <= set(texts(drawn(figure(*layers, x=Axis("x", log=True), y=Axis("y", log=True)))))


@pytest.mark.parametrize("y", [np.geomspace(1.1e-5, 2.3e-5, 5), np.geomspace(3, 8, 5), np.geomspace(1e-9, 1e9, 5)])
def test_a_logarithmic_axis_has_numbers(y: Floats) -> None:
    sheet = drawn(figure(Curve("", X, y), y=Axis("y", log=True)))
    (axis,) = (group for group in sheet.iter(f"{SVG}g") if group.get("id") == "matplotlib.axis_2")
    numbers = [float(text.replace("\N{MINUS SIGN}", "-")) for text in texts(axis) if text != "y"]
    assert 2 <= len(numbers) <= 12
    assert all(0.5 * y[0] < number < 2 * y[-1] for number in numbers)


def test_places_are_rounded_and_what_is_written_is_not() -> None:
    y = np.random.default_rng(1).normal(0.0, 0.004, 50)
    svg = printed([figure(Curve("", np.arange(50.0), y), title="R = 0.0001847")])
    sheet = Tree.fromstring(svg)
    assert "R = 0.0001847" in texts(sheet)
    assert "0.005" in texts(sheet)
    assert not re.search(r"\d\.\d{3}", "".join(each.get("d", "") for each in sheet.iter(f"{SVG}path")))


@pytest.mark.parametrize("columns", [1, 2])
def test_all_figures_of_a_sheet_lie_on_it(columns: int) -> None:
    names = [f"a name that is rather long, the {word}" for word in ("first", "second", "third", "fourth")]
    figures = [
        figure(*(Curve(name, X, X) for name in names), title="A"),
        figure(*LAYERS.values(), title="B"),
        figure(LAYERS["surface"], Curve("valley", X, X), title="C"),
    ]
    sheet = drawn(*figures, columns=columns)
    width, height = (float(size) for size in sheet.get("viewBox", "").split()[2:])
    assert {"A", "B", "C", *names} <= set(texts(sheet))
    for text in sheet.iter(f"{SVG}text"):
        assert 0 < float(text.get("x", "nan")) < width
        assert 0 < float(text.get("y", "nan")) < height


def test_without_matplotlib_it_is_said_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(printing, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install 'becalm\[figures\]'"):
        printed([figure(LAYERS["line"])])


@pytest.mark.parametrize("name", [r"cost $\frac{$", "加速度", "a\nb", "", "x" * 300])
@pytest.mark.parametrize("kind", get_args(Kind))
def test_any_name_is_printed(name: str, kind: Kind) -> None:
    """A name may hold what mathematics is set with, and letters that the font lacks."""
    curve = Curve(name, X, X)
    assert printed([Figure("any", name, Axis(name), Axis(name), (curve, curve._replace(name="other")))], kind)


def test_heights_that_begin_at_zero_end_above_what_is_drawn() -> None:
    level = Curve("innovations", X, np.ones(len(X)), "clean")
    free, fixed = (drawn(figure(level, y=Axis("power", low=0.0, high=high))) for high in (None, 1.05))
    assert paths(free, COLOURS["clean"]) == paths(fixed, COLOURS["clean"])
