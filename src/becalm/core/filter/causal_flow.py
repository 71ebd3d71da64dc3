"""A causal filter of one channel as `SmoothedFlow` is a smoother: without what watches its sensor."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats, input_of
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.gate import Gate
from becalm.core.model.components import Component
from becalm.core.rows import EstimatedRows


class CausalFlow:
    """Filters the rows of one channel, each as a stream does.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    gate : Gate, optional
        What leaves spikes out, and follows steps.
    """

    def __init__(self, component: Component, noise_variance: float, gate: Gate | None = None) -> None:
        self._channel, self._begun = Channel(ChannelSettings(component, noise_variance, gate=gate)), False

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return what is told of them."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._begun:
            elapsed, self._begun = np.concatenate([[1.0], elapsed[1:]]), True  # the first row comes when it is due
        return [self._channel.process(z, elapsed).told()]

    def finish(self) -> list[EstimatedRows]:
        """Return nothing: no row waits."""
        return []
