"""A channel of the library as constants in C, and the few functions through which it is called."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.core.filter.channel_settings import ChannelSettings, StepTable, packed_coefficients, packed_settings
from becalm.core.model.covariances import covariance_after
from becalm.export.design import Design
from becalm.export.number_type import DOUBLE, NumberType
from becalm.export.templates import render
from becalm.export.written import WrittenChannel, words_of
from becalm.native import packed_size
from becalm.native.rows import COEFFICIENTS, MOST_STATES, SETTINGS

NUMBER = 8
"""Bytes of a number."""

_GREATEST_FLOAT = 3e38


class Door(NamedTuple):
    """One of the library's doors for controllers.

    Attributes
    ----------
    name : str
        What its functions and types begin with.
    fields : sequence of (str, str)
        Of its struct of constants, with their values as C writes them.
    state_bytes, table_bytes : int
        Of its state, and of its constants.
    modes : sequence of str
        Names in C of the modes that it switches between.
    """

    name: str
    fields: Sequence[tuple[str, str]]
    state_bytes: int
    table_bytes: int
    modes: Sequence[str] = ()


def channel_door(design: Design, settings: ChannelSettings, most_states: int) -> Door:
    """Return the door to a filter, or to a gated one.

    Parameters
    ----------
    design : Design
        The filter.
    settings : ChannelSettings
        What the library's own channel is made of.
    most_states : int
        Of the largest filter that is written beside it, or itself.
    """
    n, (F, Q) = design.states, StepTable(settings.component).matrices
    coefficients = packed_coefficients(settings.component, settings.noise_variance, disturbed=settings.disturbed)
    steps = {"F": F, "Q": Q, "P": _settled_covariance(design), "still": design.level_direction}
    fields = [
        ("settings", of_struct(packed_settings(settings))),
        ("model", of_struct(coefficients, {"h": n, "c": n, "prior": n * n})),
        *((name, of_array(values)) for name, values in steps.items()),
    ]
    spare = 2 * (MOST_STATES - most_states) + MOST_STATES**2 - most_states**2  # of h, c and prior
    numbers = 3 * most_states**2 + most_states  # F, Q, P and still
    table_bytes = SETTINGS.itemsize + COEFFICIENTS.itemsize + NUMBER * (numbers - spare)
    return Door("device", fields, packed_size(most_states) + NUMBER, table_bytes)


def written_door(door: Door, design: Design, prefix: str, number: NumberType, largest: float) -> WrittenChannel:
    """Write a door, as the functions of one filter.

    Parameters
    ----------
    door : Door
        With its constants.
    design : Design
        The filter.
    prefix : str
        What its names in C begin with.
    number : NumberType
        What readings and signals are; the library computes in double.
    largest : float
        Magnitude beyond which a value is no reading, in unit.
    """
    context = {
        **words_of(design, prefix, number),
        **door._asdict(),
        "door": door.name,
        "widened": "" if number.is_double else "(double)",
        "narrowed": "" if number.is_double else "(float)",
        "greatest": DOUBLE.literal(_GREATEST_FLOAT),
    }
    return WrittenChannel(
        header=render("channel.h.jinja", context),
        source=render("channel.c.jinja", context),
        cost=None,
        state_bytes=door.state_bytes,
        table_bytes=door.table_bytes,
        word=None,
        largest=largest,
        exact=True,
        start_rows=len(design.opening.weights) + design.settled_rows if design.settles and not door.modes else 0,
    )


def of_struct(struct: NDArray[np.void], sizes: dict[str, int] | None = None) -> str:
    """Write a struct; of its arrays, which are longer than a filter needs, so many numbers."""
    known = sizes or {}
    told = [
        (name, of_array(struct[name][: known[name]]) if name in known else of_number(struct[name].item()))
        for name in struct.dtype.names or ()
    ]
    lines = "".join(f"        .{name} = {value},\n" for name, value in told)
    return f"{{\n{lines}    }}"


def of_array(values: NDArray[Any]) -> str:
    """Write an array, row after row."""
    return f"{{ {', '.join(of_number(value) for value in np.ravel(values).tolist())} }}"


def of_number(value: float) -> str:
    """Write a number exactly."""
    if isinstance(value, int):
        return str(value)
    if np.isinf(value):
        return "INFINITE" if value > 0 else "-INFINITE"
    return DOUBLE.literal(value)


def _settled_covariance(design: Design) -> Floats:
    """Return the covariance after a reading, once settled, by (7); of a filter that never settles, after the first."""
    if design.steady is None or not design.settles:
        return design.opening.P
    return covariance_after(design.steady.predicted_cov, design.steady.gain, design.model)
