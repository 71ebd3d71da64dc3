"""A causal filter of one channel with the interface of `SmoothedFlow`; it does not monitor the sensor."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats, input_of
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.gate import Gate
from becalm.core.model.components import Component
from becalm.core.rows import EstimatedRows


class CausalFlow:
    """A causal filter of one channel, with the same estimates as a live stream.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    gate : Gate, optional
        The innovation gate, which rejects spikes and follows steps; by default every reading is used.
    """

    def __init__(self, component: Component, noise_variance: float, gate: Gate | None = None) -> None:
        self._channel, self._has_rows = Channel(ChannelSettings(component, noise_variance, gate=gate)), False

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return their estimates."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._has_rows:
            elapsed, self._has_rows = np.concatenate([[1.0], elapsed[1:]]), True  # the first row is on time
        return [self._channel.process(z, elapsed).told()]

    def finish(self) -> list[EstimatedRows]:
        """Return an empty list: no row waits."""
        return []
