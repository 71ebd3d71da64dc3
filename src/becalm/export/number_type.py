"""How a number is written and rounded in C: float, double, or a fixed-point integer."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

Precision = Literal["float32", "float64", "q31"]


class NumberType(NamedTuple):
    """A type of C for readings and signals.

    Attributes
    ----------
    precision : str
        As a person asks for it.
    name, suffix : str
        Of the type, and of its literals.
    bits : int
        Of its significand, or, of an integer, besides its sign.
    dtype : type
        Of NumPy: the same numbers.
    greatest : float
        Magnitude that no reading, and no state, may exceed: products of two stay finite.
    """

    precision: Precision
    name: str
    suffix: str
    bits: int
    dtype: type[np.float32 | np.float64 | np.int32]
    greatest: float

    @property
    def is_double(self) -> bool:
        """Whether it has eight bytes."""
        return self.bits == 53

    @property
    def bytes(self) -> int:
        """Of one number."""
        return 8 if self.is_double else 4

    def rounded(self, value: float) -> float:
        """Return the nearest number of this type."""
        return float(self.dtype(value))

    def below(self, value: float) -> float:
        """Return the greatest number of this type, a floating-point one, that is not above a value."""
        near = self.dtype(value)
        return float(near if float(near) <= value else np.nextafter(near, self.dtype(-np.inf)))

    def above(self, value: float) -> float:
        """Return the least number of this type, a floating-point one, that is not below a value."""
        return -self.below(-value)

    def literal(self, value: float) -> str:
        """Write a number exactly, as a hexadecimal literal."""
        return _short(float(self.rounded(value)).hex()) + self.suffix

    def commented(self, value: float) -> str:
        """Write a number exactly, and beside it as a person reads it."""
        return f"{self.literal(value)} /* {value:.9g} */"


FLOAT = NumberType("float32", "float", "f", 24, np.float32, 1e18)
DOUBLE = NumberType("float64", "double", "", 53, np.float64, 1e100)


def _short(text: str) -> str:
    """Leave zeros at the end of a hexadecimal significand out."""
    digits, exponent = text.split("p")
    whole, _, rest = digits.partition(".")
    rest = rest.rstrip("0")
    return f"{whole}.{rest}p{exponent}" if rest else f"{whole}.0p{exponent}"
