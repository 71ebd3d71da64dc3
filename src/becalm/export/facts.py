"""What the header says of a channel: the filter in an engineer's words, its numbers, and what it costs."""

from __future__ import annotations

import hashlib

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.written import Written

_MOST_WRITTEN = 36  # numbers of a matrix


def facts_of(recipe: ChannelRecipe, design: Design, written: Written) -> list[str]:
    """Return lines for the comment above a channel."""
    return [
        *_filter(design),
        f"sigma    {design.settled_std:.6g} {design.unit} once settled, where the model holds"
        if np.isfinite(design.settled_std)
        else "sigma    not settled: it falls, or follows the mode",
        f"readings beyond +-{written.largest:.6g} {design.unit} are none",
        f"calibration {_calibration(recipe)}",
        *_word(design, written),
        f"a settled row costs {written.cost}; state {written.state_bytes} bytes, tables {written.table_bytes} bytes",
        *_numbers(design),
    ]


def _filter(design: Design) -> list[str]:
    found = design.response
    if found is None:
        return ["filter   carries its covariance"]
    lag = "" if np.isnan(found.lag_s) else f", lag {found.lag_s:.6g} s"
    return [
        f"filter   {found}",
        f"bandwidth {found.bandwidth_hz:.6g} Hz{lag}, noise gain {found.noise_gain_db:.3f} dB",
    ]


def _calibration(recipe: ChannelRecipe) -> str:
    if recipe.calibration is None:
        return "none in the recipe"
    text = recipe.calibration.model_dump_json(exclude_none=True)
    return f"SHA-256 {hashlib.sha256(text.encode()).hexdigest()[:16]}: {text}"


def _word(design: Design, written: Written) -> list[str]:
    word = written.word
    if word is None:
        return []
    level = "stays at the first reading" if word.quantum is None else f"moves by {word.quantum:.6g} {design.unit}"
    return [
        f"word     stalls {word.stall:.3g} {design.unit} off at the most, rounding adds {word.noise:.3g} {design.unit}:"
        f" {word.share:.2g} of sigma; the level {level}",
        f"range    proved for readings that lie {word.range:.6g} {design.unit} apart",
    ]


def _numbers(design: Design) -> list[str]:
    told = [*_matrix("F", design.model.F), *_matrix("H", design.model.H), *_matrix("C", design.output[np.newaxis])]
    return told if design.steady is None else [*told, *_matrix("K", design.steady.gain.T)]


def _matrix(name: str, rows: Floats) -> list[str]:
    """Write a matrix in decimals and exactly; a large one only where it is not 0."""
    cells = [(i, j, value) for (i, j), value in np.ndenumerate(rows) if value != 0.0]
    return [f"{name}[{i}][{j}] = {value:.9g} = {float(value).hex()}" for i, j, value in cells[:_MOST_WRITTEN]]
