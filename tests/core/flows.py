"""What opens a causal filter, or a smoother, of one channel."""

from __future__ import annotations

from becalm.core.causal_flow import CausalFlow
from becalm.core.components import Component
from becalm.core.gates import Gate
from becalm.core.smoothed_flow import SmoothedFlow


def flow_of(
    component: Component, noise_variance: float, *, causal: bool, gate: Gate | None = None
) -> CausalFlow | SmoothedFlow:
    """Return a filter, or a smoother."""
    return CausalFlow(component, noise_variance, gate) if causal else SmoothedFlow(component, noise_variance, gate=gate)
