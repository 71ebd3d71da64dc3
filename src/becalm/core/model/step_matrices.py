"""A cache of the matrices F and Q of steps of any length."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.components import Component

_MOST = 1024  # cached lengths


class StepMatrices:
    """The step matrices of a component, cached by step length.

    Parameters
    ----------
    component : Component
        A component whose time unit is the step.

    Attributes
    ----------
    output : (1, n) float array
        Output matrix of the component.
    """

    def __init__(self, component: Component) -> None:
        self._component, self.output = component, component.output
        self._cache: dict[float, tuple[Floats, Floats]] = {}

    def over(self, lengths: Floats) -> tuple[Floats, Floats]:
        """Return F and Q, (u, n, n) each, over steps of several lengths (u,), as `Component.over` does."""
        requested = lengths.tolist()
        missing = [length for length in dict.fromkeys(requested) if length not in self._cache]
        if missing:
            if len(self._cache) + len(missing) > _MOST:
                self._cache.clear()
                missing = list(dict.fromkeys(requested))
            matrices = self._component.over(np.array(missing, dtype=np.float64))
            self._cache.update(zip(missing, zip(*matrices, strict=True), strict=True))
        cached = [self._cache[length] for length in requested]
        return np.stack([F for F, _ in cached]), np.stack([Q for _, Q in cached])
