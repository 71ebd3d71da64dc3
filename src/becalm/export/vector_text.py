"""Write golden vectors as C: readings as integers with the same bits, signals as hexadecimal literals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from becalm.export.design import Design
from becalm.export.expressions import in_lines
from becalm.export.kind import Kind, NewReference, Raw
from becalm.export.number_type import DOUBLE
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Vector

_NUMBERS, _CODES = 6, 24  # largest numbers of readings or signals, and of codes, in a line of C


def vector_texts(
    vectors: Sequence[Vector], kind: Kind, design: Design, written: WrittenChannel, new_reference: NewReference
) -> list[dict[str, Any]]:
    """Return the texts of golden vectors for the templates."""
    texts = []
    for vector in vectors:
        most_error = kind.most_error(vector, design, written, new_reference)
        most_power = kind.most_power(vector, design, most_error)
        texts.append({**_text(vector, kind, written), "most": f"{most_error:.3g}", "most_power": f"{most_power:.3g}"})
    return texts


def _text(vector: Vector, kind: Kind, written: WrittenChannel) -> dict[str, Any]:
    gaps = zip(vector.gap_rows.tolist(), vector.gap_lengths.tolist(), strict=True)
    return {
        "name": vector.name,
        "rows": len(vector.readings),
        "readings": in_lines(bits_of(kind.raw(vector.readings, written)), _NUMBERS),
        "signal": in_lines(map(DOUBLE.literal, kind.counts(vector.signal, written).tolist()), _NUMBERS),
        "codes": in_lines((f"{code}u" for code in vector.codes.tolist()), _CODES),
        "gaps": [f"{{ {row}u, {length}u }}" for row, length in gaps] or ["{ 0u, 0u }"],
    }


def bits_of(raw: Raw) -> list[str]:
    """Return numbers (N,) as C literals of unsigned integers with the same bits."""
    wide = raw.itemsize == 8
    integers = raw.view(np.uint64 if wide else np.uint32)
    return [f"0x{bits:0{16 if wide else 8}x}{'ULL' if wide else 'u'}" for bits in integers.tolist()]
