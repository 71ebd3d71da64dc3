"""What was found and done for one channel, and whether to trust it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from becalm.cleaning.faults import Fault
from becalm.cleaning.judging import Judgement


@dataclass(frozen=True)
class ModeReport:
    """One mode of a filter that switches.

    Attributes
    ----------
    share : float
        Of the record, in which it was in force.
    bandwidth_hz, lag_s : float or None
        Once it is in force for long: as of a filter that does not switch.
    noise_left : float or None
        Then, standard deviation of the noise that passes, in unit.
    """

    share: float
    bandwidth_hz: float | None = None
    lag_s: float | None = None
    noise_left: float | None = None


@dataclass(frozen=True)
class ChannelReport(Judgement):
    """What was found and done for one channel, beside the judgement.

    Attributes
    ----------
    name, unit : str
        As in the recording.
    model : str
        "motion", "constant" or "untold".
    order : int or None
        Order of the motion.
    tones_hz, removed_hz : tuple of float
        Frequencies of the tones beside it: of the signal, and of disturbances that were taken off.
    noise_std, coloured_std : float or None
        Standard deviation of one reading's white noise, of a bank in its calmest mode, and of its coloured noise, in
        unit.
    q_over_r : float or None
        Ratio of process to measurement noise, per step.
    bandwidth_hz, lag_s : float or None
        -3 dB bandwidth, and lag, as `core.response.Response` has them.
    delay_s : float or None
        How much later a row is told, if it waits for readings after it; bandwidth and lag are not told then.
    independence_s : float or None
        How far apart samples must be for their errors to count as independent: the mean over T seconds has
        the random uncertainty sigma sqrt(independence_s / T), and never more than sigma.
    tuning_spread : float or None
        Share by which sigma is wider for what the tuning does not know.
    calibration_std : float or None
        What the calibration adds, as a root of a sum of squares, at the mean magnitude of the signal, in unit; no
        averaging lowers it. None where the recipe tells no calibration.
    timing_share : float or None
        By which share sigma is wider for an uncertain time of readings, at most; None where the recipe tells none.
    modes : dict of str to ModeReport
        Of a filter that switches, which has neither one bandwidth nor one lag.
    log_likelihood : float or None
        Of the readings, given the recipe.
    settled_row : int or None
        The first row whose gain was the settled one.
    verdicts : dict
        How many readings were used, missing, and so on.
    advice : tuple of str
        What these say is to be looked at.
    faults : tuple of Fault
        What was wrong with the sensor, or with the time of its rows, and when first.
    """

    name: str = ""
    unit: str = ""
    model: str = ""
    order: int | None = None
    tones_hz: tuple[float, ...] = ()
    removed_hz: tuple[float, ...] = ()
    noise_std: float | None = None
    coloured_std: float | None = None
    q_over_r: float | None = None
    bandwidth_hz: float | None = None
    lag_s: float | None = None
    delay_s: float | None = None
    independence_s: float | None = None
    tuning_spread: float | None = None
    calibration_std: float | None = None
    timing_share: float | None = None
    modes: dict[str, ModeReport] = field(default_factory=dict)
    log_likelihood: float | None = None
    settled_row: int | None = None
    verdicts: dict[str, int] = field(default_factory=dict)
    advice: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return the report for JSON; what is unknown is None."""
        told = {key: _finite(value) for key, value in asdict(self).items() if key != "lagged"}
        return told | {"describes": self.describes}


def _finite(value: object) -> object:
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
