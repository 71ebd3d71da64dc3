"""What the header says of a channel: the filter in an engineer's words, its numbers, and what it costs."""

from __future__ import annotations

import hashlib

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.written import WrittenChannel

_MOST_WRITTEN = 36  # numbers of a matrix


def facts_of(recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> list[str]:
    """Return lines for the comment above a channel."""
    return [
        *_filter(design),
        f"readings: those beyond +-{written.largest:.6g}{design.unit_after} are none",
        f"calibration: {_calibration(recipe)}",
        *_word(design, written),
        f"cost: {cost_words(written)}; state {written.state_bytes} bytes, tables {written.table_bytes} bytes",
        *_numbers(design),
    ]


def reset_words(design: Design) -> str:
    """Say what a filter is once it was reset to a signal."""
    if design.modes is not None or design.steady is None:
        return "as after a first reading of it"
    return "as if it had been so for ever"


def _filter(design: Design) -> list[str]:
    if design.modes is not None:
        names = ", ".join(mode.name for mode in design.modes.modes)
        return [f"filter: switches between {len(design.modes.modes)} modes: {names}; sigma follows the mode"]
    found = design.response
    if found is None:
        return ["filter: never settles; it carries its covariance, and sigma falls"]
    lag = "" if np.isnan(found.lag_s) else f", lag {found.lag_s:.6g} s"
    return [
        f"filter: {found}",
        f"bandwidth {found.bandwidth_hz:.6g} Hz{lag}, noise gain {found.noise_gain_db:.3f} dB",
        f"sigma: {design.settled_std:.6g}{design.unit_after} once settled, where the model holds",
    ]


def cost_words(written: WrittenChannel) -> str:
    """Say what a row costs."""
    if written.cost is None:
        return "a row as becalm itself runs it: make cortex-m-count counts its instructions"
    return f"{written.cost}, a settled row"


def _calibration(recipe: ChannelRecipe) -> str:
    if recipe.calibration is None:
        return "none in the recipe"
    text = recipe.calibration.model_dump_json(exclude_none=True)
    return f"SHA-256 {hashlib.sha256(text.encode()).hexdigest()[:16]}: {text}"


def _word(design: Design, written: WrittenChannel) -> list[str]:
    word, unit = written.word, design.unit_after
    if word is None:
        return ["word: it computes in double, whatever readings are"]
    level = "stays at the first reading" if word.quantum is None else f"moves by {word.quantum:.6g}{unit}"
    return [
        f"word: stalls {word.stall:.3g}{unit} off at the most, rounding adds {word.noise:.3g}{unit}:"
        f" {word.share:.2g} of sigma; the level {level}",
        f"range: computed for readings that lie {word.range:.6g}{unit} apart",
    ]


def _numbers(design: Design) -> list[str]:
    """Write the matrices of a filter that does not switch."""
    if design.modes is not None:
        return []
    told = [*_matrix("F", design.model.F), *_matrix("H", design.model.H), *_matrix("C", design.output[np.newaxis])]
    return told if design.steady is None else [*told, *_matrix("K", design.steady.gain.T)]


def _matrix(name: str, rows: Floats) -> list[str]:
    """Write a matrix in decimals and exactly; a large one only where it is not 0."""
    cells = [(i, j, value) for (i, j), value in np.ndenumerate(rows) if value != 0.0]
    return [f"{name}[{i}][{j}] = {value:.9g} = {float(value).hex()}" for i, j, value in cells[:_MOST_WRITTEN]]
