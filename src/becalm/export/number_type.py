"""Write and round numbers as in C: float, double, or a fixed-point integer."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

Precision = Literal["float32", "float64", "q31"]


class NumberType(NamedTuple):
    """A C type for readings and signals.

    Attributes
    ----------
    precision : str
        Name of the precision in `ExportOptions`.
    name, suffix : str
        Name of the C type, and suffix of its literals.
    bits : int
        Bits of the significand, or of an integer without its sign.
    dtype : type
        The same type in NumPy.
    greatest : float
        Largest permitted magnitude of a reading or a state, for which the product of two such numbers is finite.
    """

    precision: Precision
    name: str
    suffix: str
    bits: int
    dtype: type[np.float32 | np.float64 | np.int32]
    greatest: float

    @property
    def is_double(self) -> bool:
        """Return whether the type is double, with eight bytes."""
        return self.bits == 53

    @property
    def bytes(self) -> int:
        """Return the size of one number in bytes."""
        return 8 if self.is_double else 4

    def rounded(self, value: float) -> float:
        """Return the nearest number of this type."""
        return float(self.dtype(value))

    def below(self, value: float) -> float:
        """Return the greatest number of this floating-point type that is at most `value`."""
        near = self.dtype(value)
        return float(near if float(near) <= value else np.nextafter(near, self.dtype(-np.inf)))

    def above(self, value: float) -> float:
        """Return the least number of this floating-point type that is at least `value`."""
        return -self.below(-value)

    def literal(self, value: float) -> str:
        """Return the nearest number of this type as a hexadecimal literal, which is exact."""
        return _short(float(self.rounded(value)).hex()) + self.suffix

    def literal_with_comment(self, value: float) -> str:
        """Return the literal of a number, with its decimal value in a comment."""
        return f"{self.literal(value)} /* {value:.9g} */"


FLOAT = NumberType("float32", "float", "f", 24, np.float32, 1e18)
DOUBLE = NumberType("float64", "double", "", 53, np.float64, 1e100)


def _short(text: str) -> str:
    """Remove zeros at the end of the significand of a hexadecimal literal; keep one digit."""
    digits, exponent = text.split("p")
    whole, _, rest = digits.partition(".")
    rest = rest.rstrip("0")
    return f"{whole}.{rest}p{exponent}" if rest else f"{whole}.0p{exponent}"
