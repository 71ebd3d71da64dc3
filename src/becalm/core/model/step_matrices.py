"""The matrices of steps of any length, remembered as long as the same lengths come again."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.components import Component

_MOST = 1024  # lengths that are remembered


class StepMatrices:
    """What a component does over steps.

    Parameters
    ----------
    component : Component
        In steps.

    Attributes
    ----------
    output : (1, n) float array
        The component's.
    """

    def __init__(self, component: Component) -> None:
        self._component, self.output = component, component.output
        self._known: dict[float, tuple[Floats, Floats]] = {}

    def over(self, lengths: Floats) -> tuple[Floats, Floats]:
        """Return F and Q, (u, n, n) each, over steps of several lengths (u,), as `Component.over` does."""
        wanted = lengths.tolist()
        unknown = [length for length in dict.fromkeys(wanted) if length not in self._known]
        if unknown:
            if len(self._known) + len(unknown) > _MOST:
                self._known.clear()
                unknown = list(dict.fromkeys(wanted))
            matrices = self._component.over(np.array(unknown, dtype=np.float64))
            self._known.update(zip(unknown, zip(*matrices, strict=True), strict=True))
        found = [self._known[length] for length in wanted]
        return np.stack([F for F, _ in found]), np.stack([Q for _, Q in found])
