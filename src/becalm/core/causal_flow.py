"""A causal filter of one channel as `Flow` is one: for a part of a record, without what watches its sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from becalm.core.arrays import Floats
from becalm.core.channel import Channel
from becalm.core.channel_settings import Settings
from becalm.core.components import Component
from becalm.core.gates import Gate
from becalm.core.limits import Limits
from becalm.core.monitor import NO_ALARMS
from becalm.core.told import Told


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

    log_likelihood = 0.0
    """Nobody asks for it."""

    def __init__(self, component: Component, noise_variance: float, gate: Gate | None = None) -> None:
        self._channel = Channel(Settings(component, noise_variance, 1.0, Limits(), NO_ALARMS, gate))

    @property
    def settled_row(self) -> int | None:
        """The first row with a settled gain."""
        return self._channel.settled_row

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take the next rows, readings (B,) and the steps before them; return what is told of them."""
        return [self._channel.process(z, elapsed).told()]

    def finish(self) -> list[Told]:
        """Return nothing: no row waits."""
        return []

    def saved(self) -> dict[str, Any]:
        """Return what later rows depend on, as arrays."""
        return dict(self._channel.state_dict())

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._channel.load_state_dict(arrays)

    def tell_from(self, reading: float) -> None:
        """Take no notice of a reading that came first: such a part tells its rows from one of its own."""
