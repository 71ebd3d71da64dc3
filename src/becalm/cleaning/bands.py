"""Whether what a filter passes, or rows can hold, is within the band in which the sensor's amplitudes are right."""

from __future__ import annotations

from becalm.sensors.resonance import Resonance

FLAT_PERCENT = 5.0
"""By which amplitudes may be wrong."""


def beyond_flat(name: str, resonance: Resonance, passed_hz: float | None, rate_hz: float) -> str:
    """Say that a band goes beyond the one in which a sensor is right within 5 %; "" where it does not.

    Parameters
    ----------
    name : str
        Of the channel.
    resonance : Resonance
        Of its sensor.
    passed_hz : float or None
        Up to where the filter lets signals through, -3 dB; None where that is not known, or no filter was chosen.
    rate_hz : float
        Of the rows, which hold up to half of it.
    """
    flat_hz, held_hz = resonance.right_to_hz(FLAT_PERCENT), rate_hz / 2
    band_hz = held_hz if passed_hz is None else min(passed_hz, held_hz)
    if band_hz <= flat_hz:
        return ""
    what = f"its rows, at {rate_hz:.6g} Hz, hold" if passed_hz is None else "its filter passes"
    return (
        f"{name}: {what} up to {band_hz:.4g} Hz, but its sensor, with a resonance at {resonance.natural_hz:.6g} Hz and"
        f" a damping ratio of {resonance.damping_ratio:g}, tells amplitudes within {FLAT_PERCENT:g} % only up to"
        f" {flat_hz:.4g} Hz. Trust no amplitude above, or smooth it away with --bandwidth {flat_hz:.3g}Hz."
    )
