"""Named arrays in folders, as MAT, HDF5 and NPZ files hold them, before anyone asked which of them belong together."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Path = tuple[str, ...]
"""Folders, and the name in the last of them."""

Key = tuple[int | slice, ...]

_SPECIFIED = re.compile(r"[`'\"](\w+)[`'\"] in ([^\s,;()`'\"]+)")  # "`imu_gyr` in rad/s", in a description
_MOST_WORDS, _LONG = 4096, 100_000


class Leaf(NamedTuple):
    """One array of a file.

    Attributes
    ----------
    path : tuple of str
        Where it is, and its name.
    shape : tuple of int
        Of all of it.
    type : numpy.dtype
        Of its values: a number, a flag, an instant, or `object` for text.
    take : callable
        Gives its values at an index or a slice for each axis.
    claimed : tuple of int
        The shape that the file claims, where it ends before that; () where it does not.
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
        """How many values its longest axis has."""
        return max(self.shape, default=1)

    @property
    def meant(self) -> tuple[int, ...]:
        """The shape that it has in a file that is not cut short."""
        return self.claimed or self.shape

    def squeezed(self) -> Leaf:
        """Return it without axes of one value: MATLAB's vectors have one."""
        kept = [axis for axis, size in enumerate(self.meant) if size != 1]
        if len(kept) == len(self.shape):
            return self

        def take(key: Key) -> NDArray[Any]:
            left = iter(key)
            return self.take(tuple(next(left) if axis in kept else 0 for axis in range(len(self.shape))))

        shape, claimed = (tuple(sizes[axis] for axis in kept) for sizes in (self.shape, self.meant))
        return self._replace(shape=shape, take=take, claimed=claimed if self.claimed else ())


@dataclass
class FileArrays:
    """All that a file holds.

    Attributes
    ----------
    leaves : list of Leaf
        Arrays, in the order of the file.
    words : dict
        Texts, and lists of texts, by where they are.
    numbers : dict
        Single numbers.
    notes : list of str
        What a person must know, as sentences.
    """

    leaves: list[Leaf] = field(default_factory=list)
    words: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    numbers: dict[Path, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, leaf: Leaf) -> None:
        """Keep an array; what is single is a number or a text, and a few texts may also name or give units."""
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
        """Return a single text, "" where there is none."""
        texts = self.words.get(path, ())
        return texts[0] if len(texts) == 1 else ""

    def described_units(self) -> dict[str, str]:
        """Return the units that descriptions give to names in quotes: "`imu_gyr` in rad/s"."""
        texts = (texts[0] for texts in self.words.values() if len(texts) == 1 and len(texts[0]) < _LONG)
        return {name: unit.rstrip(".") for text in texts for name, unit in _SPECIFIED.findall(text)}


def as_text(values: NDArray[Any]) -> NDArray[np.object_]:
    """Return texts of any kind, bytes among them, as an array of str; what is no text becomes what it prints."""
    out = np.empty(values.shape, object)
    out.ravel()[:] = [_text(value) for value in values.ravel()]
    return out


def _text(value: object) -> str:
    if isinstance(value, bytes):
        return value.rstrip(b"\0").decode("utf-8", "replace")
    return "" if value is None else str(value).rstrip("\0").encode("utf-8", "replace").decode()
