"""The parts of a channel's recipe: what may be beside its motion, and what surrounds the filter."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from becalm.core.time.clock import GAP_STEPS
from becalm.core.verdict import AGREE, AT_MOST

# Strict: neither true nor "1.0" is a number.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]

_MOST_REJECTS = 1 << 31  # in a row: more than are ever waited for


class FrozenSettings(BaseModel):
    """What a person may write, and nothing else; never changed."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ToneRecipe(FrozenSettings):
    """A tone beside the motion: an oscillator that is driven by white noise.

    Attributes
    ----------
    frequency_hz : float
        Where it oscillates.
    bandwidth_hz : float
        Width of its resonance at half the power.
    process_noise_density : float
        Of each of its two states, in unit^2/s; a *small* one lets it change slowly.
    disturbance : bool
        Whether it is taken off the signal, as hum is.
    """

    frequency_hz: Positive
    bandwidth_hz: Positive
    process_noise_density: Positive
    disturbance: bool = False


class ColouredNoiseRecipe(FrozenSettings):
    """Noise that remembers itself, beside the white noise: it is taken off the signal.

    Attributes
    ----------
    rate_hz : float
        Readings a second that it was told at.
    coefficients : tuple of float
        phi_1, phi_2, ... of e[k] = phi_1 e[k-1] + phi_2 e[k-2] + ... + w[k].
    std : float
        Standard deviation of e, in unit; a *small* one leaves more to the signal.
    """

    rate_hz: Positive
    coefficients: Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]  # each a state more
    std: Positive


class HoleRecipe(FrozenSettings):
    """What a smoother is worth in holes of one length, as readings showed that were hidden.

    Attributes
    ----------
    readings : int
        How many are missing in such a hole.
    model_fading : float
        Of the model's departure from a line across the hole a share is told: sigma beside the hole over sigma, to this
        power; a *small* one trusts the model.
    sigma_growth : float
        Sigma is that of the model times (sigma over sigma beside the hole), to this power; a *small* one trusts the
        model.
    """

    readings: Annotated[int, Field(ge=2)]
    model_fading: NotNegative
    sigma_growth: NotNegative


class GateRecipe(FrozenSettings):
    """What leaves spikes out, and follows steps.

    Attributes
    ----------
    false_alarms_per_hour : float
        Good readings that are taken for spikes; a *small* one trusts the readings.
    agree : int
        So many rejected readings in a row that agree with each other are a step, and followed; with a *small* one
        sooner, but spikes that agree by chance are followed too.
    at_most : int
        So many rejected readings in a row are believed whatever they are; a *small* one trusts the readings.
    """

    false_alarms_per_hour: Positive = 1.0
    agree: Annotated[int, Field(ge=2)] = AGREE
    at_most: Annotated[int, Field(le=_MOST_REJECTS)] = AT_MOST

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.at_most < self.agree:
            raise ValueError("at_most is less than agree; as many rejects in a row are needed at least")
        return self


class LimitsRecipe(FrozenSettings):
    """What a channel keeps to while its sensor is healthy.

    Attributes
    ----------
    low, high : float or None
        The rails, in unit: readings there or beyond are clipped, and count as missing.
    resolution : float or None
        The step between two codes, in unit; None where readings lie on no lattice.
    rounding_std : float or None
        What the steps between codes leave in the signal, in unit, however long it is averaged; it widens sigma.
    stuck_readings : int or None
        From so many equal readings in a row on they count as missing; a *small* one finds a stuck channel
        sooner, and calls slow signals stuck.
    even_time : bool or None
        Whether rows came in even time, so that one can be late.
    gap_steps : float or None
        More steps than this since the row before are a gap; 1.5 by default.
    largest : float or None
        Readings of a greater magnitude, in unit, are none, and count as missing; None for 1e100.
    outlier_distance : float or None
        Readings farther than this, in unit, and than 8 times their middle spread, from the median of three readings on
        each side are gross outliers of a smoother, or of a lag of 13 rows or more, and count as missing; a *small* one
        finds more that are motion, None finds none.
    causal_outlier_distance : float or None
        The same, from the six readings before, of a filter that waits for none after, or for too few.
    plausible_low, plausible_high : float or None
        Range of plausible readings, in unit: outside it a first or a single reading is a gross outlier, and an estimate
        ran away; a *narrow* one trusts the record that it was tuned on.
    repeats_are_one : bool or None
        Whether equal readings in a row count as one, of which all are gross outliers, or none.
    blank : float or None
        What is written where there is no reading, in unit; it counts as missing.
    far_from_0 : float or None
        A 0 whose neighbours are all farther away than this, in unit, counts as missing, until it lasts 128 rows, unless
        it is amid what is plausible; a *small* one leaves out more of them, 0 none. It goes with `outlier_distance`, or
        the causal one; by default it is a 36th of what is plausible, where equal readings in a row count as one.
    drift_threshold : float or None
        Of the cumulative sum of innovations, in sigma: a *small* one finds a drift sooner, and more that are
        none; None tells no drift.
    dead_variance : float or None
        Variance of a window of innovations, of the expected one, below which the channel is dead; a *small*
        one lets it rest, None tells no death.
    """

    low: Finite | None = None
    high: Finite | None = None
    resolution: Positive | None = None
    rounding_std: Positive | None = None
    stuck_readings: Annotated[int, Field(ge=2)] | None = None
    even_time: bool | None = None
    gap_steps: Annotated[float, Field(ge=GAP_STEPS, allow_inf_nan=False)] | None = None
    largest: Positive | None = None
    outlier_distance: Positive | None = None
    causal_outlier_distance: Positive | None = None
    plausible_low: Finite | None = None
    plausible_high: Finite | None = None
    repeats_are_one: bool | None = None
    blank: Finite | None = None
    far_from_0: NotNegative | None = None
    drift_threshold: Positive | None = None
    dead_variance: Positive | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError("low is not below high; a range goes from low to high")
        if self.far_from_0 and not (self.outlier_distance or self.causal_outlier_distance):
            raise ValueError("far_from_0 came alone; give outlier_distance or causal_outlier_distance as well")
        return self


class TareRecipe(FrozenSettings):
    """A zero that was taken while the recording was read: an event, told here and taken anew from the readings.

    Attributes
    ----------
    start_s, stop_s : float
        The stretch, in seconds after the first row.
    reading, reading_std : float, float or None
        What was read without load, and its standard uncertainty, in raw_unit; None where readings did not vary.
    raw_unit : str
        Of the readings.
    readings : int
        In the stretch.
    temperature_degc : float or None
        Of the sensor then, where it is known.
    """

    start_s: NotNegative
    stop_s: Positive
    reading: Finite
    reading_std: NotNegative | None = None
    raw_unit: str
    readings: Annotated[int, Field(ge=1)]
    temperature_degc: Finite | None = None


class CalibrationRecipe(FrozenSettings):
    """What is uncertain in the sensor's calibration: one error for all samples, which averaging does not lower.

    Attributes
    ----------
    relative_std : float
        Standard uncertainty (k = 1) of the sensitivity, as a share; a *small* one trusts the calibration.
    offset_std : float
        Standard uncertainty (k = 1) of the zero, in unit; a *small* one trusts it.
    tare : TareRecipe or None
        The zero that was taken.
    """

    relative_std: NotNegative = 0.0
    offset_std: NotNegative = 0.0
    tare: TareRecipe | None = None


class TimingRecipe(FrozenSettings):
    """What is uncertain in the time of readings: noise where the signal moves.

    Attributes
    ----------
    std_s : float
        Standard uncertainty (k = 1) of the time of each reading, independent of the others, in seconds; a *small* one
        trusts the stamps.
    included_std : float
        What of it noise_std holds already, in unit, as a root mean square; 0 where the noise was told at rest.
    """

    std_s: Positive
    included_std: NotNegative = 0.0
