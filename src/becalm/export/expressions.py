"""Write sums of products as C, without factors of 0 or 1, and count arithmetic operations in C text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from becalm.core.arrays import Floats
from becalm.export.number_type import NumberType


class OperationCount(NamedTuple):
    """The numbers of arithmetic operations in a C text."""

    multiplications: int
    additions: int
    divisions: int = 0

    def __str__(self) -> str:
        """Return the counts as text."""
        counts = f"{self.multiplications} multiplications, {self.additions} additions"
        return f"{counts}, {self.divisions} divisions" if self.divisions else f"{counts}, no division"


def cost_of(lines: Iterable[str]) -> OperationCount:
    """Count the operations in lines of C that run once each; those in comments and indices do not count."""
    text = re.sub(r"/\*.*?\*/|\[[^]]*\]", "", "\n".join(lines))
    text = re.sub(r"0x[0-9a-fA-F.]+p[+-]\d+f?", "c", text)
    return OperationCount(
        len(re.findall(r" \* | \*= ", text)),
        len(re.findall(r" [+-] | [+-]= ", text)),
        len(re.findall(r" / | /= ", text)),
    )


def in_lines(words: Iterable[str], most: int) -> list[list[str]]:
    """Group words into lines of at most `most` words."""
    items = list(words)
    return [items[i : i + most] for i in range(0, len(items), most)]


def product_sum(row: Floats | Sequence[float], names: Sequence[str], number: NumberType) -> str:
    """Write the sum of row[j] * names[j] as C, without terms whose factor is 0, and without factors of 1 or -1."""
    text = ""
    for factor, name in zip(row, names, strict=True):
        size = number.rounded(abs(float(factor)))
        if size == 0.0:
            continue
        term = name if size == 1.0 else f"({number.literal(size)} * {name})"
        if text:
            text += f" {'-' if factor < 0 else '+'} {term}"
        else:
            text = f"-{term}" if factor < 0 else term
    return text or f"0.0{number.suffix}"
