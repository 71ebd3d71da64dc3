"""A recording cleaned and drawn in memory, and what a page holds read back from it."""

from __future__ import annotations

import base64
import json
import re
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.report.channel import CleanedChannels, Pictures
from becalm.report.gathering import Gathering
from becalm.report.page import Facts, page_of


class Drawn(NamedTuple):
    """A recording that was cleaned, ready to be drawn."""

    recipe: Recipe
    gathering: Gathering
    pictures: Pictures
    facts: Facts

    def page(self) -> str:
        return page_of(self.facts, self.recipe, self.pictures)


def draw(recording: Recording, recipe: Recipe | None = None, *, block: int = 1 << 18, name: str = "drive.csv") -> Drawn:
    """Clean a recording in blocks of some rows, and gather what is drawn of it."""
    recipe, time = tune(recording) if recipe is None else recipe, recording.timebase
    columns = [np.ascontiguousarray(recording.channel(name)) for name in recording.names]
    gathering = Gathering(len(recording), time.step_s, len(columns))
    blocks = [slice(start, start + block) for start in range(0, len(recording), block)]
    callbacks = [channel.add_innovations for channel in gathering.channels]
    with Cleaner(recipe, time.step_s, innovation_callbacks=callbacks) as cleaner:
        answers = [cleaner.push([z[rows] for z in columns], time.elapsed_steps[rows]) for rows in blocks]
        answers.append(cleaner.finish())
        reports = cleaner.reports()
    for rows, told in zip(blocks, (one for answer in answers for one in answer), strict=True):
        gathering.add([z[rows] for z in columns], time.elapsed_steps[rows], told)
    facts = Facts(name, "0123456789abcdef" * 4)
    return Drawn(recipe, gathering, Pictures(CleanedChannels(recipe, reports, gathering, time.step_s)), facts)


def figures_of(html: str) -> dict[str, dict[str, Any]]:
    """Read the figures of a page as its script does; each array is in the place of its number."""
    found = re.search(r'<script type="application/json" id="figures">(.*?)</script>', html, re.S)
    assert found is not None
    held = json.loads(found[1], parse_constant=_refuse)
    arrays = [_decoded(one) for one in held["arrays"]]
    for figure in held["figures"]:
        for layer in figure["layers"]:
            layer.update({key: arrays[layer[key]] for key in _ARRAYS if key in layer})
    return {figure["name"]: figure for figure in held["figures"]}


_ARRAYS = ("x", "y", "low", "high", "starts", "ends")


def _refuse(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


def _decoded(held: dict[str, Any]) -> Floats:
    kind = "float64" if "float64" in held else "float32"
    values = np.frombuffer(base64.b64decode(held[kind]), kind).astype(np.float64)
    return values + float(held.get("offset", 0.0))
