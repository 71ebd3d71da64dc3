"""A Numba type for small float64 arrays whose shape the compiler knows: an address, and nothing else.

Numba's own arrays carry shape, strides and owner through every call as numbers of their own, seven to ten
for each array; to kernels of many small parts that is most of the work of compiling them. Indices are
trusted, as everywhere in kernels, and are never negative.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

_DOUBLE = ir.DoubleType()
_INDEX: Any = types.intp
_KIND: Any = types.Type
_MODEL: Any = models.PrimitiveModel
_TEMPLATE: Any = AbstractTemplate
_modelled: Any = register_model
_typed: Any = infer_global
_lowered: Any = lower_builtin
_TYPES: Any = types
_called: Any = signature


class Small(_KIND):  # type: ignore[misc]
    """The type: elements of `shape`, of which neighbours along each axis lie `strides` elements apart."""

    mutable = True

    def __init__(self, shape: tuple[int, ...], strides: tuple[int, ...]) -> None:
        self.shape, self.strides = shape, strides
        super().__init__(name=f"Small({shape}, {strides})")


def small(*shape: int) -> Small:
    """Return the type of a small array in one piece, row by row."""
    strides = [1]
    for extent in shape[:0:-1]:
        strides.insert(0, strides[0] * extent)
    return Small(shape, tuple(strides))


@_modelled(Small)
class _Address(_MODEL):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Small) -> None:
        super().__init__(manager, kind, _DOUBLE.as_pointer())


def _indices(kind: Any, index: Any) -> Any:
    """Return how an index is taken: as whole numbers, one for each axis or, of a row, one for the first."""
    if not isinstance(kind, Small):
        return None
    if isinstance(index, types.Integer):
        return _INDEX
    if isinstance(index, types.BaseTuple) and len(index) == len(kind.shape):
        return _TYPES.UniTuple(_INDEX, len(index))
    return None


@_typed(operator.getitem)
class _Get(_TEMPLATE):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        assert not kws
        kind, index = args
        wanted = _indices(kind, index)
        if wanted is None:
            return None
        if wanted == _INDEX and len(kind.shape) > 1:
            return _called(Small(kind.shape[1:], kind.strides[1:]), kind, wanted)
        return _called(types.float64, kind, wanted)


@_typed(operator.setitem)
class _Set(_TEMPLATE):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        assert not kws
        kind, index, _ = args
        wanted = _indices(kind, index)
        if wanted is None or (wanted == _INDEX and len(kind.shape) > 1):
            return None
        return _called(types.none, kind, wanted, types.float64)


def _at(builder: Any, kind: Small, address: Any, numbers: Any) -> Any:
    """Return the address of an element, or of a row."""
    offset = None
    for number, stride in zip(numbers, kind.strides, strict=False):
        far = number if stride == 1 else builder.mul(number, ir.Constant(number.type, stride), flags=("nsw",))
        offset = far if offset is None else builder.add(offset, far, flags=("nsw",))
    return builder.gep(address, [offset], inbounds=True)


def _numbers(builder: Any, index: Any, value: Any) -> Any:
    if isinstance(index, types.BaseTuple):
        return [builder.extract_value(value, i) for i in range(len(index))]
    return [value]


def _get(context: Any, builder: Any, called: Any, arguments: Any) -> Any:
    kind, index = called.args
    place = _at(builder, kind, arguments[0], _numbers(builder, index, arguments[1]))
    return place if isinstance(called.return_type, Small) else builder.load(place)


def _set(context: Any, builder: Any, called: Any, arguments: Any) -> Any:
    kind, index, _ = called.args
    builder.store(arguments[2], _at(builder, kind, arguments[0], _numbers(builder, index, arguments[1])))
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    _lowered(operator.getitem, Small, _index)(_get)
    _lowered(operator.setitem, Small, _index, types.Float)(_set)
