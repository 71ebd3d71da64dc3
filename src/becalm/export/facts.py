"""Describe a channel for the C header: bandwidth, lag and noise of its filter, its matrices and its cost."""

from __future__ import annotations

import hashlib

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.shared_parts import WrittenChannel

_MOST_WRITTEN = 36  # largest number of entries of a matrix that are written


def facts_of(recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> list[str]:
    """Return the lines of the comment above a channel in the header."""
    return [
        *_filter(design),
        f"readings: those beyond +-{written.largest:.6g}{design.unit_after} are overrange",
        f"calibration: {_calibration(recipe)}",
        *_word(design, written),
        f"cost: {cost_words(written)}; state {written.state_bytes} bytes, tables {written.table_bytes} bytes",
        *_numbers(design),
    ]


def reset_words(design: Design) -> str:
    """Return a description of a filter's state after a reset to a given signal."""
    if design.modes is not None or design.steady is None:
        return "as after a first reading of that value"
    return "as if it had always had that value"


def _filter(design: Design) -> list[str]:
    if design.modes is not None:
        names = ", ".join(mode.name for mode in design.modes.modes)
        return [f"filter: {len(design.modes.modes)} modes (IMM): {names}; sigma follows the mode"]
    response = design.response
    if response is None:
        return ["filter: has no steady state; it carries its covariance, and sigma falls"]
    lag = "" if np.isnan(response.lag_s) else f", lag {response.lag_s:.6g} s"
    return [
        f"filter: {response}",
        f"bandwidth {response.bandwidth_hz:.6g} Hz{lag}, noise gain {response.noise_gain_db:.3f} dB",
        f"sigma: {design.settled_std:.6g}{design.unit_after} in the steady state, where the model holds",
    ]


def cost_words(written: WrittenChannel) -> str:
    """Return a description of the cost of one row."""
    if written.cost is None:
        return "the same row as in becalm itself: make cortex-m-count counts its instructions"
    return f"{written.cost}, a settled row"


def _calibration(recipe: ChannelRecipe) -> str:
    if recipe.calibration is None:
        return "none in the recipe"
    text = recipe.calibration.model_dump_json(exclude_none=True)
    return f"SHA-256 {hashlib.sha256(text.encode()).hexdigest()[:16]}: {text}"


def _word(design: Design, written: WrittenChannel) -> list[str]:
    word, unit = written.word, design.unit_after
    if word is None:
        return ["word: it computes in double, for any type of readings"]
    level = "stays at the first reading" if word.quantum is None else f"moves by {word.quantum:.6g}{unit}"
    return [
        f"word: stalls at most {word.stall:.3g}{unit} off, rounding adds {word.noise:.3g}{unit}:"
        f" {word.share:.2g} of sigma; the level {level}",
        f"range: computed for readings up to {word.range:.6g}{unit} apart",
    ]


def _numbers(design: Design) -> list[str]:
    """Return lines with the matrices of a single filter."""
    if design.modes is not None:
        return []
    lines = [*_matrix("F", design.model.F), *_matrix("H", design.model.H), *_matrix("C", design.output[np.newaxis])]
    return lines if design.steady is None else [*lines, *_matrix("K", design.steady.gain.T)]


def _matrix(name: str, rows: Floats) -> list[str]:
    """Return lines with the first 36 entries of a matrix that are not 0, in decimals and in exact hexadecimal."""
    cells = [(i, j, value) for (i, j), value in np.ndenumerate(rows) if value != 0.0]
    return [f"{name}[{i}][{j}] = {value:.9g} = {float(value).hex()}" for i, j, value in cells[:_MOST_WRITTEN]]
