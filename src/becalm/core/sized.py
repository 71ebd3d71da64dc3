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
from numba.np.arrayobj import make_array, populate_array

Size = tuple[None, ...]
"""A number that the compiler knows: that many None."""

_DOUBLE = 8  # bytes


def size(count: int) -> Size:
    """Return `count` in a form that kernels are specialised for."""
    return (None,) * count


class Sizes(NamedTuple):
    """The sizes of a model, as kernels are specialised for them."""

    states: Size  # n
    channels: Size  # m


def _stack_array(context: Any, builder: Any, kind: Any, shape: list[int]) -> Any:
    """Reserve room on the stack and describe it as an array of `shape`."""
    count = 1
    strides: list[int] = []
    for extent in reversed(shape):
        strides.insert(0, count * _DOUBLE)
        count *= extent
    data = cgutils.alloca_once(builder, ir.DoubleType(), size=ir.Constant(ir.IntType(64), count))
    array = make_array(kind)(context, builder)
    populate_array(
        array,
        data=data,
        shape=[context.get_constant(types.intp, extent) for extent in shape],
        strides=[context.get_constant(types.intp, stride) for stride in strides],
        itemsize=context.get_constant(types.intp, _DOUBLE),
        meminfo=None,
    )
    return array._getvalue()


def _vector(_: Any, rows: Any) -> Any:
    kind = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return _stack_array(context, builder, kind, [rows.count])

    return kind(rows), generate


def _matrix(_: Any, rows: Any, columns: Any) -> Any:
    kind = types.Array(types.float64, 2, "C")

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return _stack_array(context, builder, kind, [rows.count, columns.count])

    return kind(rows, columns), generate


def _rows(_: Any, rows: Any, length: Any) -> Any:
    if not isinstance(length, types.IntegerLiteral):
        return None
    row = types.Array(types.float64, 1, "C")
    kind = types.UniTuple(row, rows.count)

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        made = [_stack_array(context, builder, row, [length.literal_value]) for _ in range(rows.count)]
        return context.make_tuple(builder, kind, made)

    return kind(rows, length), generate


def _triangle(_: Any, extent: Any, length: Any) -> Any:
    if not isinstance(length, types.IntegerLiteral):
        return None
    row = types.Array(types.float64, 1, "C")
    kind = types.UniTuple(row, extent.count * (extent.count + 1) // 2)

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        made = [_stack_array(context, builder, row, [length.literal_value]) for _ in range(kind.count)]
        return context.make_tuple(builder, kind, made)

    return kind(extent, length), generate


def _view(context: Any, builder: Any, source: Any, kind: Any, corner: Any, length: int, stride: int) -> Any:  # noqa: PLR0913
    """Describe `length` elements of the matrix `source` from a corner (array, row, column) on as an array."""
    whole = make_array(source)(context, builder, corner[0])
    data = cgutils.get_item_pointer(context, builder, source, whole, corner[1:], wraparound=False)
    array = make_array(kind)(context, builder)
    populate_array(
        array,
        data=data,
        shape=[context.get_constant(types.intp, length)],
        strides=[context.get_constant(types.intp, stride)],
        itemsize=context.get_constant(types.intp, _DOUBLE),
        meminfo=None,
    )
    return array._getvalue()


def _across(_: Any, source: Any, row: Any, column: Any, length: Any) -> Any:
    if not isinstance(length, types.IntegerLiteral):
        return None
    kind = types.Array(types.float64, 1, "C", readonly=not source.mutable)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _view(context, builder, source, kind, arguments[:3], length.literal_value, _DOUBLE)

    return kind(source, types.intp, types.intp, length), generate


def _down(_: Any, source: Any, row: Any, column: Any, columns: Any, length: Any) -> Any:
    if not isinstance(length, types.IntegerLiteral):
        return None
    kind = types.Array(types.float64, 1, "C" if columns.count == 1 else "A", readonly=not source.mutable)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        stride = _DOUBLE * columns.count
        return _view(context, builder, source, kind, arguments[:3], length.literal_value, stride)

    return kind(source, types.intp, types.intp, columns, length), generate


def _piece(_: Any, source: Any, first: Any, length: Any) -> Any:
    if not isinstance(length, types.IntegerLiteral):
        return None
    kind = types.Array(types.float64, 1, "C", readonly=not source.mutable)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _view(context, builder, source, kind, arguments[:2], length.literal_value, _DOUBLE)

    return kind(source, types.intp, length), generate


stack_vector: Callable[..., Any] = intrinsic(_vector)
"""stack_vector(rows): an uninitialised (rows,) float64 array."""

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

piece: Callable[..., Any] = intrinsic(_piece)
"""piece(vector, first, length): `length` elements from `first` on."""
