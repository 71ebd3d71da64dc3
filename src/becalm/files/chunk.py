"""A chunk of consecutive rows of a file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.files.roles import values_of


@dataclass(frozen=True)
class Chunk:
    """A chunk of consecutive rows of a file.

    Attributes
    ----------
    first_row : int
        The first row of the chunk, counted from 0 at the start of the file.
    table : pyarrow.Table
        All columns in the order of the file, with their values unchanged.
    elapsed_steps : (n,) float array
        Time since the previous row, in steps of the clock; 0 for the first row of the file.
    names : tuple of str
        The channels.
    decimal : str
        The decimal separator of numbers in text.
    """

    first_row: int
    table: pa.Table
    elapsed_steps: Floats
    names: tuple[str, ...]
    decimal: str = "."

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self.table.num_rows)

    def channel(self, number: int) -> Floats:
        """Return one channel, (n,), NaN where a cell is missing; read-only where it shares memory with the table."""
        return values_of(self.table.column(self.names[number]), self.decimal)

    @property
    def samples(self) -> Floats:
        """All channels, (n, m), NaN where a cell is missing."""
        out = np.empty((len(self), len(self.names)))
        for number in range(len(self.names)):
            out[:, number] = self.channel(number)
        return out
