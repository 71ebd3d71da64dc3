"""Export steady-state filters for other programs: second-order sections, plain numbers, a module for SciPy."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.errors import RecipeError
from becalm.export.bundle import choose_channels
from becalm.export.design import Design
from becalm.export.templates import render
from becalm.installation import version


def write_filters_as(recipe: Recipe, form: str, channels: Sequence[str] | None) -> tuple[str, list[str]]:
    """Write the steady-state filters of a recipe for another program.

    Parameters
    ----------
    recipe : Recipe
        The recipe of the channels.
    form : {"json", "sos", "scipy"}
        "json": all matrices and figures; "sos": only second-order sections; "scipy": a Python module that filters.
    channels : sequence of str or None
        Names of the channels; None for all channels that are filtered.

    Returns
    -------
    (str, list of str)
        The text, and notes for the user.

    Raises
    ------
    RecipeError
        If a filter has no steady state or several modes, so that it has no constant coefficients.
    UsageError
        If a channel is not in the recipe.
    """
    filtered, notes = choose_channels(recipe, channels)
    numbers_of = {design.name: _numbers(design) for _, design in filtered}
    notes = [*notes, *(_gate_note(design) for _, design in filtered if design.gate is not None)]
    about = {
        "becalm": version(),
        "recipe_sha256": hashlib.sha256(recipe.to_toml().encode()).hexdigest(),
        "rate_hz": recipe.nominal_rate_hz,
    }
    if form == "sos":
        return _as_json({name: numbers["sos"] for name, numbers in numbers_of.items()}), notes
    if form == "json":
        return _as_json({**about, "channels": numbers_of}), notes
    return render(
        "scipy.py.jinja", {**about, "sos": {name: numbers["sos"] for name, numbers in numbers_of.items()}}
    ), notes


def sections_of(design: Design) -> Floats:
    """Return a steady-state filter as second-order sections (s, 6) of `scipy.signal`; the first contains the gain.

    Notes
    -----
    With y[k] = C A x[k-1] + C K z[k] and x[k] = A x[k-1] + K z[k], the poles are the eigenvalues of A, and the zeros
    those of A - K C A / (C K). Both are computed with states that are scaled to equal uncertainty, so that slow filters
    do not lose digits.

    Raises
    ------
    RecipeError
        If the filter has several modes, or no steady state.
    """
    from scipy.signal import zpk2sos

    if design.modes is not None or design.steady is None:
        why = "has several modes" if design.modes is not None else "has no steady state"
        raise RecipeError(f"The filter of {design.name} {why}, so it is not a fixed filter; export it with --to c.")
    loop, row = design.steady.loop, design.steady.row
    direct = float((row @ loop.K)[0, 0])
    zeros = np.linalg.eigvals(loop.A - loop.K @ (row @ loop.A) / direct).astype(np.complex128)
    poles: Any = design.steady.poles  # may be complex, which SciPy's stubs do not allow
    sections: Floats = np.asarray(zpk2sos(cast(Any, zeros), poles, direct), dtype=np.float64)
    return sections


def _gate_note(design: Design) -> str:
    return f"{design.name} has a gate, which a fixed filter cannot include: spikes pass; --to c includes it."


def _numbers(design: Design) -> dict[str, Any]:
    sections = sections_of(design)
    assert design.steady is not None
    assert design.response is not None
    model, response = design.model, design.response
    return {
        "unit": design.unit,
        "F": model.F.tolist(),
        "Q": model.process_covariance.tolist(),
        "H": model.H.tolist(),
        "R": model.R.tolist(),
        "C": [design.output.tolist()],
        "K": design.steady.gain.tolist(),
        "sigma": design.settled_std,
        "bandwidth_hz": response.bandwidth_hz,
        "lag_s": None if np.isnan(response.lag_s) else response.lag_s,
        "noise_gain_db": response.noise_gain_db,
        "sos": sections.tolist(),
    }


def _as_json(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
