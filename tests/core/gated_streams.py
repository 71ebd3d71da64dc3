"""What tests of gates share: a gate, motions, and a stream in chunks."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.components import motion
from becalm.core.gates import Gate
from becalm.core.model import Model
from becalm.core.online import Online

GATE = Gate(5.0)
PARTS = {order: motion(order, (2 * np.pi * 0.01) ** (2 * order)) for order in (1, 2, 3)}


def model_of(order: int) -> Model:
    return PARTS[order].to_model(1.0, 1.0)


def in_chunks(online: Online, z: Floats, cuts: list[int]) -> tuple[Floats, Floats, Codes]:
    """Return signal, sigma and verdicts of a stream that is cut."""
    out = []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        signal, sigma = online.run(z[start:stop])
        assert online.verdicts is not None
        out.append((signal, sigma, online.verdicts))
    signal, sigma, verdicts = (np.concatenate(parts) for parts in zip(*out, strict=True))
    return signal, sigma, verdicts
