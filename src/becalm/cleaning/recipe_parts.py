"""The tables of a channel's recipe: tones, coloured noise, holes, gate, limits, calibration, timing and modes."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from becalm.core.reading_verdicts import AGREE, AT_MOST
from becalm.core.time.clock import GAP_STEPS

# Strict: neither true nor "1.0" is a number.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]

_MOST_REJECTS = 1 << 31  # rejected readings in a row: more than any stream has


class FrozenSettings(BaseModel):
    """Settings that a person writes: immutable, and without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ToneRecipe(FrozenSettings):
    """A tone that is added to the motion: an oscillator driven by white noise.

    Attributes
    ----------
    frequency_hz : float
        Frequency of the tone, in Hz.
    bandwidth_hz : float
        Width of the resonance at half its power, in Hz.
    process_noise_density : float
        Process noise of each of the two states, in unit^2/s; with a *small* one the tone changes slowly.
    disturbance : bool
        Whether the tone is removed from the signal, as mains hum is.
    """

    frequency_hz: Positive
    bandwidth_hz: Positive
    process_noise_density: Positive
    disturbance: bool = False


class ColouredNoiseRecipe(FrozenSettings):
    """Coloured noise, AR(p), in addition to the white noise; it is removed from the signal.

    Attributes
    ----------
    rate_hz : float
        Rate of the readings that it was identified from, in Hz.
    coefficients : tuple of float
        phi_1, phi_2, ... of e[k] = phi_1 e[k-1] + phi_2 e[k-2] + ... + w[k].
    std : float
        Standard deviation of e, in unit; a *small* one leaves more to the signal.
    """

    rate_hz: Positive
    coefficients: Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]  # each adds a state
    std: Positive


class HoleRecipe(FrozenSettings):
    """Correction of a smoother in holes of one length, measured with hidden readings.

    r is sigma in the hole divided by sigma at the edge of the hole.

    Attributes
    ----------
    readings : int
        How many readings are missing in such a hole.
    model_fading : float
        The estimate's departure from a straight line across the hole is divided by r to this power; a *small* one
        trusts the model.
    sigma_growth : float
        Sigma is multiplied by r to this power; a *small* one trusts the model.
    """

    readings: Annotated[int, Field(ge=2)]
    model_fading: NotNegative
    sigma_growth: NotNegative


class GateRecipe(FrozenSettings):
    """An innovation gate that rejects spikes and follows steps.

    Attributes
    ----------
    false_alarms_per_hour : float
        Good readings per hour that may be rejected as spikes; a *small* number trusts the readings.
    agree : int
        Number of rejected readings in a row that are a step, which the filter follows, if they agree with each other.
        With a *small* number it follows steps sooner, but also spikes that agree by chance.
    at_most : int
        Number of rejected readings in a row that the filter follows in any case; a *small* number trusts the readings.
    """

    false_alarms_per_hour: Positive = 1.0
    agree: Annotated[int, Field(ge=2)] = AGREE
    at_most: Annotated[int, Field(le=_MOST_REJECTS)] = AT_MOST

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.at_most < self.agree:
            raise ValueError("at_most is less than agree; give agree or more")
        return self


class LimitsRecipe(FrozenSettings):
    """Limits of a channel while its sensor is healthy.

    Attributes
    ----------
    low, high : float or None
        Saturation limits, in unit: readings at or beyond them are clipped, and count as missing.
    resolution : float or None
        Difference between two neighbouring codes, in unit; None where readings are not quantised.
    rounding_std : float or None
        Standard deviation of the quantisation error that averaging does not remove, in unit; it widens sigma.
    stuck_readings : int or None
        Number of equal readings in a row from which on they count as missing; a *small* number finds a stuck channel
        sooner, but also calls slow signals stuck.
    even_time : bool or None
        Whether rows come at even intervals; only then a row can be late.
    gap_steps : float or None
        More steps than this since the previous row are a gap; 1.5 by default.
    largest : float or None
        Readings of a greater magnitude, in unit, are invalid and count as missing; None for 1e100.
    outlier_distance : float or None
        For a smoother, or a lag of 11 rows or more. A reading is a gross outlier, and counts as missing, if its
        distance from the median of its six nearest neighbours exceeds this, in unit, and 8 times their spread (without
        the lowest and the highest). A *small* value also rejects motion; None finds no outliers.
    causal_outlier_distance : float or None
        The same for a causal filter or a shorter lag: the distance from the median of the six previous readings.
    plausible_low, plausible_high : float or None
        Range of plausible readings, in unit. Outside it a first or a single reading is a gross outlier, and an estimate
        may be a runaway. A *narrow* range trusts the record that it was tuned on.
    repeats_are_one : bool or None
        Whether equal readings in a row count as one: all of them are gross outliers, or none.
    blank : float or None
        Value that stands for a missing reading, in unit; it counts as missing.
    far_from_0 : float or None
        A 0 whose neighbours are all farther than this from 0, in unit, counts as missing. A 0 that lasts 128 rows is a
        reading, unless 0 is well inside the plausible range. A *small* value leaves out more of them, but the value 0
        none. It needs `outlier_distance` or `causal_outlier_distance`. By default it is a 36th of the plausible range,
        or 0 if equal readings in a row do not count as one.
    drift_threshold : float or None
        Threshold of the cumulative sum of normalised innovations, in sigma: a *small* one finds a drift sooner, with
        more false alarms; None reports no drift.
    dead_variance : float or None
        Variance of a window of innovations, as a share of the expected one, below which the channel is dead; a *small*
        one allows quieter signals, None reports no dead channel.
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
            raise ValueError("low is not below high; give a low that is less than high")
        if self.far_from_0 and not (self.outlier_distance or self.causal_outlier_distance):
            raise ValueError("far_from_0 came alone; give outlier_distance or causal_outlier_distance as well")
        return self


class TareRecipe(FrozenSettings):
    """A zero that was measured while the recording was read.

    It is only a record: whenever the file is read, the zero is measured again.

    Attributes
    ----------
    start_s, stop_s : float
        Stretch that the zero was measured in, in seconds after the first row.
    reading, reading_std : float, float or None
        Mean reading without load, and its standard uncertainty, in raw_unit; the latter is None if readings did not
        vary.
    raw_unit : str
        Unit of the readings.
    readings : int
        Number of readings in the stretch.
    temperature_degc : float or None
        Temperature of the sensor at that time, in degrees Celsius; None if it is unknown.
    """

    start_s: NotNegative
    stop_s: Positive
    reading: Finite
    reading_std: NotNegative | None = None
    raw_unit: str
    readings: Annotated[int, Field(ge=1)]
    temperature_degc: Finite | None = None


class CalibrationRecipe(FrozenSettings):
    """Uncertainty of the sensor's calibration: one error for all samples, which averaging does not reduce.

    Attributes
    ----------
    relative_std : float
        Standard uncertainty (k = 1) of the sensitivity, as a share; a *small* one trusts the calibration.
    offset_std : float
        Standard uncertainty (k = 1) of the zero, in unit; a *small* one trusts it.
    tare : TareRecipe or None
        The zero that was measured.
    """

    relative_std: NotNegative = 0.0
    offset_std: NotNegative = 0.0
    tare: TareRecipe | None = None


class TimingRecipe(FrozenSettings):
    """Uncertainty of the time of readings: it adds noise where the signal moves.

    Attributes
    ----------
    std_s : float
        Standard uncertainty (k = 1) of the time of each reading, independent of the others, in seconds; a *small* one
        trusts the stamps.
    included_std : float
        Root mean square of the part of this noise that noise_std includes, in unit; 0 if noise_std is that at rest.
    """

    std_s: Positive
    included_std: NotNegative = 0.0


# The tables of a recipe for a filter with several modes (IMM).


class ModeRecipe(FrozenSettings):
    """One mode of a channel: one way in which its signal may behave.

    Attributes
    ----------
    name : str
        Name of the mode, such as "still".
    order : int
        Order n of the motion: the n-th derivative of the signal is white noise.
    process_noise_density : float
        q, in unit^2/s^(2 order - 1); a *small* one trusts the model and smooths more.
    level_noise_density : float
        Additional random walk of the level, in unit^2/s; a *large* one lets the level jump, while slopes and tones
        continue.
    noise_std : float
        Standard deviation of one reading's noise in this mode, in unit.
    lasts_s : float
        Mean duration of the mode, in seconds; with a *large* one the filter leaves the mode late.
    then : str
        Name of the mode that follows it; "" for any other.
    wild_share : float
        Share of outliers among the readings; with a *small* one the filter changes its mode sooner.
    damped_below_hz : float or None
        Motion slower than this is damped, as in the channel's recipe.
    with_tones : bool
        Whether this mode has the tones and the coloured noise of the channel.
    """

    name: Annotated[str, Field(min_length=1)]
    order: Annotated[int, Field(ge=1, le=5)]
    process_noise_density: NotNegative
    level_noise_density: NotNegative = 0.0
    noise_std: Positive
    lasts_s: Positive
    then: str = ""
    wild_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    damped_below_hz: Positive | None = None
    with_tones: bool = False


class SwitchingRecipe(FrozenSettings):
    """The modes of a filter with several modes (IMM).

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        Kind of change that the modes describe.
    wild_std : float
        Additional standard deviation of outliers, in unit; with a *small* one a far reading is a change of mode rather
        than an outlier.
    rejects : bool
        Whether outliers are left out.
    mode : tuple of ModeRecipe
        The modes, one of which is in force at a time.
    """

    kind: Literal["resting", "jumping", "noisy", "spiky", "bursting"]
    wild_std: NotNegative = 0.0
    rejects: bool = False
    mode: Annotated[tuple[ModeRecipe, ...], Field(min_length=1, max_length=8)]
