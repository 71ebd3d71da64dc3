"""Write the constants of the library's own channel as C, and the functions that call the library."""

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
from becalm.export.shared_parts import WrittenChannel, channel_context
from becalm.export.templates import render
from becalm.native import packed_size
from becalm.native.library import COEFFICIENTS, MOST_STATES, SETTINGS

NUMBER = 8
"""Size of a double, in bytes."""

_GREATEST_FLOAT = 3e38  # largest magnitude of a signal in float; larger signals are limited to it


class DeviceInterface(NamedTuple):
    """One of the library's C interfaces for controllers.

    Attributes
    ----------
    name : str
        Prefix of the interface's functions and types.
    fields : sequence of (str, str)
        Fields of the struct of constants, with their values as C text.
    state_bytes, table_bytes : int
        Sizes of the state and of the constants, in bytes.
    modes : sequence of str
        Names of the modes in C; () without modes.
    """

    name: str
    fields: Sequence[tuple[str, str]]
    state_bytes: int
    table_bytes: int
    modes: Sequence[str] = ()


def channel_interface(design: Design, settings: ChannelSettings, most_states: int) -> DeviceInterface:
    """Return the C interface of a single filter, with or without a gate.

    Parameters
    ----------
    design : Design
        The filter.
    settings : ChannelSettings
        Settings of the library's own channel.
    most_states : int
        Number of states of the largest filter of the export.
    """
    n, (F, Q) = design.states, StepTable(settings.component).matrices
    coefficients = packed_coefficients(settings.component, settings.noise_variance, disturbed=settings.disturbed)
    steps = {"F": F, "Q": Q, "P": _settled_covariance(design), "still": design.level_direction}
    fields = [
        ("settings", of_struct(packed_settings(settings))),
        ("model", of_struct(coefficients, {"h": n, "c": n, "prior": n * n})),
        *((name, of_array(values)) for name, values in steps.items()),
    ]
    spare = 2 * (MOST_STATES - most_states) + MOST_STATES**2 - most_states**2  # numbers cut from h, c and prior
    numbers = 3 * most_states**2 + most_states  # F, Q, P and still
    table_bytes = SETTINGS.itemsize + COEFFICIENTS.itemsize + NUMBER * (numbers - spare)
    return DeviceInterface("device", fields, packed_size(most_states) + NUMBER, table_bytes)


def write_interface(
    interface: DeviceInterface, design: Design, prefix: str, number: NumberType, largest: float
) -> WrittenChannel:
    """Write the functions of one filter, which call a C interface of the library.

    Parameters
    ----------
    interface : DeviceInterface
        The interface with its constants.
    design : Design
        The filter.
    prefix : str
        Prefix of the channel's names in C.
    number : NumberType
        Number type of readings and signals; the library computes in double.
    largest : float
        Magnitude beyond which a value is overrange, in unit.
    """
    context = {
        **channel_context(design, prefix, number),
        **interface._asdict(),
        "door": interface.name,
        "widened": "" if number.is_double else "(double)",
        "narrowed": "" if number.is_double else "(float)",
        "greatest": DOUBLE.literal(_GREATEST_FLOAT),
    }
    return WrittenChannel(
        header=render("channel.h.jinja", context),
        source=render("channel.c.jinja", context),
        cost=None,
        state_bytes=interface.state_bytes,
        table_bytes=interface.table_bytes,
        word=None,
        largest=largest,
        exact=True,
        start_rows=len(design.opening.weights) + design.settled_rows if design.settles and not interface.modes else 0,
    )


def of_struct(struct: NDArray[np.void], sizes: dict[str, int] | None = None) -> str:
    """Write a struct as C; arrays that are named in `sizes` are cut to the length given there."""
    lengths = sizes or {}
    values = [
        (name, of_array(struct[name][: lengths[name]]) if name in lengths else of_number(struct[name].item()))
        for name in struct.dtype.names or ()
    ]
    lines = "".join(f"        .{name} = {value},\n" for name, value in values)
    return f"{{\n{lines}    }}"


def of_array(values: NDArray[Any]) -> str:
    """Write an array as C, row by row."""
    return f"{{ {', '.join(of_number(value) for value in np.ravel(values).tolist())} }}"


def of_number(value: float) -> str:
    """Write a number as C, exactly."""
    if isinstance(value, int):
        return str(value)
    if np.isinf(value):
        return "INFINITE" if value > 0 else "-INFINITE"
    return DOUBLE.literal(value)


def _settled_covariance(design: Design) -> Floats:
    """Return the posterior covariance in the steady state, by equation (7).

    For a filter whose gain does not settle, return the covariance after the first readings that determine the state.
    """
    if design.steady is None or not design.settles:
        return design.opening.P
    return covariance_after(design.steady.predicted_cov, design.steady.gain, design.model)
