"""Hold the named arrays of a MAT, HDF5 or NPZ file, before they are grouped into tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Path = tuple[str, ...]
"""Names of nested groups (structs, folders), and last the name of the array itself."""

Key = tuple[int | slice, ...]
"""An index or a slice for each axis of an array."""

_SPECIFIED = re.compile(r"[`'\"](\w+)[`'\"] in ([^\s,;()`'\"]+)")  # "`imu_gyr` in rad/s", in a description
_MOST_WORDS, _LONG = 4096, 100_000  # a longer list has no names or units; a longer text is no description


class Leaf(NamedTuple):
    """One array of a file.

    Attributes
    ----------
    path : tuple of str
        The groups that contain it, and its name.
    shape : tuple of int
        Shape of the part that is in the file.
    type : numpy.dtype
        Type of its values: number, flag, instant, or `object` for text.
    take : callable
        Returns its values at an index or a slice for each axis.
    claimed : tuple of int
        Shape of the complete array, if only a part of it is in the file; otherwise ().
    """

    path: Path
    shape: tuple[int, ...]
    type: np.dtype[Any]
    take: Callable[[Key], NDArray[Any]]
    claimed: tuple[int, ...] = ()

    @classmethod
    def of(cls, path: Path, values: NDArray[Any]) -> Leaf:
        """Return an array that is in memory."""
        if values.dtype.kind in "US":
            values = as_text(values)
        return cls(path, values.shape, values.dtype, lambda key: np.asarray(values[key]))

    @property
    def length(self) -> int:
        """Return the length of its longest axis."""
        return max(self.shape, default=1)

    @property
    def full_shape(self) -> tuple[int, ...]:
        """Return the shape of the complete array."""
        return self.claimed or self.shape

    def squeezed(self) -> Leaf:
        """Return the array without axes of length one, which MATLAB's vectors have."""
        kept = [axis for axis, size in enumerate(self.full_shape) if size != 1]
        if len(kept) == len(self.shape):
            return self

        def take(key: Key) -> NDArray[Any]:
            left = iter(key)
            return self.take(tuple(next(left) if axis in kept else 0 for axis in range(len(self.shape))))

        shape, claimed = (tuple(sizes[axis] for axis in kept) for sizes in (self.shape, self.full_shape))
        return self._replace(shape=shape, take=take, claimed=claimed if self.claimed else ())


@dataclass
class FileArrays:
    """The contents of a file: arrays, texts and numbers.

    Attributes
    ----------
    leaves : list of Leaf
        Arrays, in the order of the file.
    words : dict
        Texts, and lists of texts, by path.
    numbers : dict
        Single numbers, by path.
    lists : dict
        Attributes of a few numbers, (n,), by path, in their own type.
    notes : list of str
        Sentences for the user on what is not read, and on what is missing.
    """

    leaves: list[Leaf] = field(default_factory=list)
    words: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    numbers: dict[Path, float] = field(default_factory=dict)
    lists: dict[Path, NDArray[Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, leaf: Leaf) -> None:
        """Add an array, unless it is empty.

        A single number goes to `numbers`. Up to 4096 texts also go to `words`, as possible names or units.
        """
        if 0 in leaf.shape:
            return
        leaf = leaf.squeezed()
        text = leaf.type.kind == "O"
        if leaf.shape and not (text and len(leaf.shape) > 1):
            self.leaves.append(leaf)
        if text and leaf.length <= _MOST_WORDS:
            values = leaf.take(tuple(slice(0, size) for size in leaf.shape))
            self.words[leaf.path] = tuple(str(value).strip() for value in np.ravel(values))
        elif not leaf.shape and leaf.type.kind in "iuf":
            self.numbers[leaf.path] = float(leaf.take(()))

    def word(self, path: Path) -> str:
        """Return the text at a path; "" if there is none, or a list of several."""
        texts = self.words.get(path, ())
        return texts[0] if len(texts) == 1 else ""

    def described_units(self) -> dict[str, str]:
        """Return units by name from descriptions such as "`imu_gyr` in rad/s"."""
        texts = (texts[0] for texts in self.words.values() if len(texts) == 1 and len(texts[0]) < _LONG)
        return {name: unit.rstrip(".") for text in texts for name, unit in _SPECIFIED.findall(text)}


def as_text(values: NDArray[Any]) -> NDArray[np.object_]:
    """Return values as an array of str; bytes are decoded, and other objects converted by `str`."""
    out = np.empty(values.shape, object)
    out.ravel()[:] = [_text(value) for value in values.ravel()]
    return out


def _text(value: object) -> str:
    if isinstance(value, bytes):
        return value.rstrip(b"\0").decode("utf-8", "replace")
    return "" if value is None else str(value).rstrip("\0").encode("utf-8", "replace").decode()
