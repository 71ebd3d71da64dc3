"""What opens a causal filter, or a smoother, of one channel."""

from __future__ import annotations

from becalm.core.filter.gate import Gate
from becalm.core.filter.restarting_flow import CausalFlow
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.model.components import Component


def flow_of(
    component: Component, noise_variance: float, *, causal: bool, gate: Gate | None = None
) -> CausalFlow | SmoothedFlow:
    """Return a filter, or a smoother."""
    return CausalFlow(component, noise_variance, gate) if causal else SmoothedFlow(component, noise_variance, gate=gate)
