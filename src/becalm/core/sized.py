"""Small arrays on the stack, whose sizes the compiler knows: what makes one source fast for every n.

A size is given as a tuple of that many None: the length of a tuple is part of its type, so that Numba
compiles a kernel once for each number of states and channels, unrolls its short loops and keeps small
matrices in registers. The arrays live as long as the kernel that made them and own nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from becalm.core.small import Small, small

Size = tuple[None, ...]
"""A number that the compiler knows: that many None."""


def size(count: int) -> Size:
    """Return `count` in a form that kernels are specialised for."""
    return (None,) * count


class Sizes(NamedTuple):
    """The sizes of a model, as kernels are specialised for them."""

    states: Size  # n
    channels: Size  # m


def _reserve(builder: Any, count: int) -> Any:
    """Reserve room on the stack."""
    return cgutils.alloca_once(builder, ir.DoubleType(), size=ir.Constant(ir.IntType(64), count))


def _vector(_: Any, rows: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return _reserve(builder, rows.count)

    return small(rows.count)(rows), generate


def _matrix(_: Any, rows: Any, columns: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return _reserve(builder, rows.count * columns.count)

    return small(rows.count, columns.count)(rows, columns), generate


def _apart(count: int, length: Any, extent: Any) -> Any:
    """Describe a tuple of `count` arrays, each with room of its own."""
    if not isinstance(length, types.IntegerLiteral):
        return None
    kind = types.UniTuple(small(length.literal_value), count)

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return context.make_tuple(builder, kind, [_reserve(builder, length.literal_value) for _ in range(count)])

    return kind(extent, length), generate


def _rows(_: Any, rows: Any, length: Any) -> Any:
    return _apart(rows.count, length, rows)


def _triangle(_: Any, extent: Any, length: Any) -> Any:
    return _apart(extent.count * (extent.count + 1) // 2, length, extent)


def _view(source: Any, kind: Any, *sizes: Any) -> Any:
    """Describe a part of the array `source` from a corner (array, indices) on as a small array."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole, corner = make_array(source)(context, builder, arguments[0]), arguments[1 : 1 + source.ndim]
        return cgutils.get_item_pointer(context, builder, source, whole, corner, wraparound=False)

    return kind(source, *(types.intp,) * source.ndim, *sizes), generate


def _across(_: Any, source: Any, row: Any, column: Any, length: Any) -> Any:
    known = isinstance(length, types.IntegerLiteral)
    return _view(source, small(length.literal_value), length) if known else None


def _down(_: Any, source: Any, row: Any, column: Any, columns: Any, length: Any) -> Any:
    known = isinstance(length, types.IntegerLiteral)
    return _view(source, Small((length.literal_value,), (columns.count,)), columns, length) if known else None


def _piece(_: Any, source: Any, first: Any, length: Any) -> Any:
    known = isinstance(length, types.IntegerLiteral)
    return _view(source, small(length.literal_value), length) if known else None


def _layer(_: Any, source: Any, number: Any, rows: Any, columns: Any) -> Any:
    kind = small(rows.count, columns.count)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole, zero = make_array(source)(context, builder, arguments[0]), context.get_constant(types.intp, 0)
        corner = [arguments[1], *[zero] * (source.ndim - 1)]
        return cgutils.get_item_pointer(context, builder, source, whole, corner, wraparound=False)

    return kind(source, types.intp, rows, columns), generate


stack_vector: Callable[..., Any] = intrinsic(_vector)
"""stack_vector(rows): an uninitialised (rows,) float64 array, a `Small`."""

stack_matrix: Callable[..., Any] = intrinsic(_matrix)
"""stack_matrix(rows, columns): an uninitialised (rows, columns) float64 array."""

stack_rows: Callable[..., Any] = intrinsic(_rows)
"""stack_rows(rows, length): a tuple of uninitialised (length,) arrays, which the compiler knows to be apart."""

stack_triangle: Callable[..., Any] = intrinsic(_triangle)
"""stack_triangle(extent, length): such a tuple with one array for each element of a lower triangle, row by row."""

across: Callable[..., Any] = intrinsic(_across)
"""across(matrix, row, column, length): `length` elements to the right, as an array of their own."""

down: Callable[..., Any] = intrinsic(_down)
"""down(matrix, row, column, columns, length): `length` elements downwards, of a matrix of `columns` columns."""

layer: Callable[..., Any] = intrinsic(_layer)
"""layer(arrays, number, rows, columns): one matrix of several in one piece; number 0 of a single one."""

piece: Callable[..., Any] = intrinsic(_piece)
"""piece(vector, first, length): `length` elements from `first` on."""
