"""Check whether a filter, or the rows, pass frequencies at which the sensor's resonance distorts amplitudes."""

from __future__ import annotations

from becalm.sensors.resonance import Resonance

FLAT_PERCENT = 5.0
"""Largest error of an amplitude within the flat band, in percent."""


def beyond_flat(name: str, resonance: Resonance, passed_hz: float | None, rate_hz: float) -> str:
    """Return a warning if a band exceeds the one in which a sensor is right within 5 %; "" if not.

    Parameters
    ----------
    name : str
        Name of the channel.
    resonance : Resonance
        Resonance of its sensor.
    passed_hz : float or None
        -3 dB bandwidth of the filter; None if it is unknown, or no filter was chosen.
    rate_hz : float
        Rate of the rows, which contain frequencies up to half of it.
    """
    flat_hz, held_hz = resonance.right_to_hz(FLAT_PERCENT), rate_hz / 2
    band_hz = held_hz if passed_hz is None else min(passed_hz, held_hz)
    if band_hz <= flat_hz:
        return ""
    what = f"its rows, at {rate_hz:.6g} Hz, contain frequencies" if passed_hz is None else "its filter passes"
    return (
        f"{name}: {what} up to {band_hz:.4g} Hz, but its sensor, with a resonance at {resonance.natural_hz:.6g} Hz and"
        f" a damping ratio of {resonance.damping_ratio:g}, measures amplitudes within {FLAT_PERCENT:g} % only up to"
        f" {flat_hz:.4g} Hz. Do not trust amplitudes above it, or remove them with --bandwidth {flat_hz:.3g}Hz."
    )
