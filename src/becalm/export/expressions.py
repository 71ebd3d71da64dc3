"""Sums of products as C writes them, without what is 0 or 1, and what they cost; words in lines."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from becalm.core.arrays import Floats
from becalm.export.number_type import NumberType


class OperationCount(NamedTuple):
    """Operations on numbers, counted in the text of what is written."""

    multiplications: int
    additions: int
    divisions: int = 0

    def __str__(self) -> str:
        """Say it in words."""
        told = f"{self.multiplications} multiplications, {self.additions} additions"
        return f"{told}, {self.divisions} divisions" if self.divisions else f"{told}, no division"


def cost_of(lines: Iterable[str]) -> OperationCount:
    """Count the operations in lines of C, comments aside; each of them runs once."""
    text = re.sub(r"/\*.*?\*/|\[[^]]*\]", "", "\n".join(lines))
    text = re.sub(r"0x[0-9a-fA-F.]+p[+-]\d+f?", "c", text)
    return OperationCount(
        len(re.findall(r" \* | \*= ", text)),
        len(re.findall(r" [+-] | [+-]= ", text)),
        len(re.findall(r" / | /= ", text)),
    )


def in_lines(words: Iterable[str], most: int) -> list[list[str]]:
    """Part words into lines of so many at the most."""
    told = list(words)
    return [told[i : i + most] for i in range(0, len(told), most)]


def product_sum(row: Floats | Sequence[float], names: Sequence[str], number: NumberType) -> str:
    """Write sum of row[j] * names[j]; a factor of 0 leaves its term out, one of 1 or -1 is not written."""
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
