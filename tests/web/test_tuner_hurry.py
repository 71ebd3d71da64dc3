"""Pictures in a hurry: what a gate left out before is left out again, and nothing else is another number."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.web.tuner import painting
from becalm.web.tuner.painting import PaintedPicture, Painter, PictureRequest
from tuner_records import GATE, RATE_HZ, motion, walk, with_gaps, with_spikes
from tuner_served import drive_in, served

GATED = motion(process_noise_density=0.3, gate=GATE)
PLACES = [500, 9_000, 9_001, 15_000, 15_300, 29_980]


@pytest.fixture
def painter(monkeypatch: pytest.MonkeyPatch) -> Iterator[Painter]:
    monkeypatch.setattr(painting, "LONG", 1000)
    with ThreadPoolExecutor(2) as pool:
        yield Painter(pool)


def opened(z: Floats) -> Any:
    elapsed, step_s = np.ones(len(z)), 1 / RATE_HZ
    rows = ChannelRows(z, elapsed, step_s)
    return SimpleNamespace(rows=lambda _: rows, times_s=None, step_s=step_s)


def wanted(of: Any, recipe: ChannelRecipe = GATED, *, hurried: bool = False, **more: Any) -> PictureRequest:
    told: dict[str, Any] = {"lag": None, "span_s": (-inf, inf), "width": 300, "answers": 1} | more
    return PictureRequest(opened=of, channel=0, recipe=recipe, hurried=hurried, **told)


def spiky(z: Floats) -> Floats:
    z = z.copy()
    z[PLACES] += 40.0
    return z


def assert_alike(found: PaintedPicture, exact: PaintedPicture) -> None:
    for name in ("signal", "band"):
        for end in ("low", "high"):
            drawn, right = (getattr(getattr(one.clean, name), end) for one in (found, exact))
            np.testing.assert_allclose(drawn, right, rtol=1e-9)
    np.testing.assert_array_equal(found.clean.verdicts, exact.clean.verdicts)
    np.testing.assert_array_equal(found.clean.spikes, exact.clean.spikes)


@pytest.mark.parametrize("lag", [None, 0, 20])
@pytest.mark.parametrize("span_s", [(-inf, inf), (9.0, 14.0)])
def test_a_hurried_picture_is_that_of_the_gate(painter: Painter, lag: int | None, span_s: tuple[float, float]) -> None:
    of = opened(spiky(with_gaps(walk())))
    first = wanted(of, lag=lag)
    painted = painter.picture(first)
    assert len(painted.clean.spikes) > 3
    painter.remember(first, painted)
    exact = painter.picture(wanted(of, lag=lag, span_s=span_s))
    hurried = painter.picture(wanted(of, lag=lag, span_s=span_s, hurried=True))
    assert (exact.header["hurried"], hurried.header["hurried"]) == (False, True)
    assert_alike(hurried, exact)


def test_the_dial_turns_a_hurried_picture(painter: Painter) -> None:
    of, calmer = opened(spiky(walk())), motion(process_noise_density=0.03, gate=GATE)
    painter.remember(wanted(of), painter.picture(wanted(of)))
    hurried, exact = (painter.picture(wanted(of, calmer, hurried=hurry)) for hurry in (True, False))
    np.testing.assert_array_equal(hurried.clean.spikes, PLACES)
    assert_alike(hurried, exact)


def test_a_turn_is_shown_in_a_hurry_before_the_gate_judges_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(painting, "LONG", 1000)
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as page:
        page.opened("folder/drive.csv")
        page.until("figures")
        number = page.ask("turn", channel=0, settings={"process_noise_density": 1e4})
        assert [page.picture(number).told["hurried"] for _ in range(2)] == [True, False]


@pytest.mark.parametrize("why", ["nothing is remembered", "no gate", "another file", "a part only", "a step"])
def test_a_picture_that_cannot_be_hurried_is_painted_as_ever(why: str, painter: Painter) -> None:
    of = opened(with_spikes(walk()) if why == "a step" else spiky(walk()))
    recipe = motion(process_noise_density=0.3) if why == "no gate" else GATED
    first = wanted(of, recipe, span_s=(1.0, 5.0) if why == "a part only" else (-inf, inf))
    if why != "nothing is remembered":
        painter.remember(first, painter.picture(first))
    looked_at = opened(spiky(walk(4))) if why == "another file" else of
    assert not painter.picture(wanted(looked_at, recipe, hurried=True)).header["hurried"]
