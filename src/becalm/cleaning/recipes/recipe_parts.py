"""The tables of a channel's recipe: tones, coloured noise, holes, gate, limits, calibration, timing and modes."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from becalm.core.reading_verdicts import AGREE, AT_MOST, BEYOND_ANY_SENSOR
from becalm.core.time.clock import GAP_STEPS

# "strict" refuses values that are not numbers, such as true and "1.0".
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]


def _squarable(value: float) -> float:
    if value > BEYOND_ANY_SENSOR:
        raise ValueError(f"{value:g} is too large; give {BEYOND_ANY_SENSOR:g} or less")
    return value


Uncertainty = Annotated[NotNegative, AfterValidator(_squarable)]
PositiveUncertainty = Annotated[Positive, AfterValidator(_squarable)]

_MOST_REJECTS = 1 << 31  # largest `at_most`: no stream has so many rejected readings in a row


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
        Process noise of each of the two states, in unit^2/s; with a *small* value the tone changes slowly.
    disturbance : bool
        Whether the tone is removed from the signal, for example mains hum.
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
        Rate of the readings that the coloured noise was identified from, in Hz.
    coefficients : tuple of float
        phi_1, phi_2, ... of e[k] = phi_1 e[k-1] + phi_2 e[k-2] + ... + w[k].
    std : float
        Standard deviation of e, in unit; with a *small* value more of the readings counts as signal.
    """

    rate_hz: Positive
    coefficients: Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]  # each adds a state
    std: PositiveUncertainty


class HoleRecipe(FrozenSettings):
    """The correction of a smoother's estimates in holes of one length.

    Let r be sigma in the hole divided by sigma at the edge of the hole.

    Attributes
    ----------
    readings : int
        Number of missing readings in the hole.
    model_fading : float
        The estimate's departure from a straight line across the hole is divided by r to this power; a *small* value
        trusts the model.
    sigma_growth : float
        Sigma is multiplied by r to this power; a *small* value trusts the model.
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
        Number of rejected readings in a row that count as a step if they agree with each other; the filter then follows
        the step. With a *small* number it follows steps sooner, but also spikes that agree by chance.
    at_most : int
        Number of rejected readings in a row after which the filter follows the readings in any case. A *small* number
        trusts the readings.
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
        Saturation limits, in unit: readings at or beyond a limit are clipped, and count as missing.
    resolution : float or None
        Difference between two neighbouring codes, in unit; None where readings are not quantised.
    rounding_std : float or None
        Standard deviation of the quantisation error that averaging does not remove, in unit; it widens sigma.
    stuck_readings : int or None
        Number of equal readings in a row that count as stuck, and thus as missing. A *small* number finds a stuck
        channel sooner, but also calls slow signals stuck.
    even_time : bool or None
        Whether rows come at even intervals; a row can be late only at even intervals.
    gap_steps : float or None
        Time since the previous row, in steps, above which there is a gap; 1.5 by default.
    largest : float or None
        Largest magnitude of a valid reading, in unit; a larger reading counts as missing. None for 1e100.
    outlier_distance : float or None
        Least distance of a gross outlier, in unit, for a smoother or a lag of 11 rows or more. A reading is a gross
        outlier, and counts as missing, if its distance from the median of its six nearest neighbours exceeds this value
        and 8 times their spread (without the lowest and the highest neighbour). A *small* value also rejects motion;
        with None there are no gross outliers.
    causal_outlier_distance : float or None
        Least distance of a gross outlier, in unit, for a causal filter or a lag below 11 rows: the distance from the
        median of the six previous readings.
    plausible_low, plausible_high : float or None
        Range of plausible readings, in unit. Outside this range, a first or isolated reading is a gross outlier, and an
        estimate may be a runaway. A *narrow* range trusts the tuning record.
    repeats_are_one : bool or None
        Whether equal readings in a row count as one: either all of them are gross outliers, or none.
    blank : float or None
        Value that a log writes in place of a missing reading, in unit; it counts as missing.
    far_from_0 : float or None
        A reading of 0 counts as missing if all its neighbours are farther than this from 0, in unit. A 0 that lasts 128
        rows is a reading, unless 0 is well inside the plausible range. A *small* value rejects more readings of 0, but
        with `far_from_0 = 0` none is rejected. The value needs `outlier_distance` or `causal_outlier_distance`. By
        default it is a 36th of the plausible range, or 0 if equal readings in a row do not count as one.
    drift_threshold : float or None
        Threshold of the cumulative sum of normalised innovations, in sigma. A *small* value finds a drift sooner, but
        with more false alarms; with None no drift is reported.
    dead_variance : float or None
        Variance of a window of normalised innovations (1 is expected) below which the channel is dead. A *small* value
        allows quieter signals; with None no dead channel is reported.
    """

    low: Finite | None = None
    high: Finite | None = None
    resolution: Positive | None = None
    rounding_std: PositiveUncertainty | None = None
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
        plausible = self.plausible_low, self.plausible_high
        if plausible[0] is not None and plausible[1] is not None and plausible[0] >= plausible[1]:
            raise ValueError("plausible_low is not below plausible_high; give a plausible_low that is less")
        if self.far_from_0 and not (self.outlier_distance or self.causal_outlier_distance):
            raise ValueError("far_from_0 came alone; give outlier_distance or causal_outlier_distance as well")
        return self


class TareRecipe(FrozenSettings):
    """The zero of a sensor, as measured in a stretch of the recording without load.

    It is only a record: whenever the file is read, the zero is measured again.

    Attributes
    ----------
    start_s, stop_s : float
        Start and end of the stretch, in seconds after the first row.
    reading, reading_std : float, float or None
        Mean reading without load, and its standard uncertainty, in raw_unit; `reading_std` is None if the readings did
        not vary.
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
    """The uncertainty of a sensor's calibration. All samples have the same error, which averaging does not reduce.

    Attributes
    ----------
    relative_std : float
        Relative standard uncertainty (k = 1) of the sensitivity; a *small* value trusts the calibration.
    offset_std : float
        Standard uncertainty (k = 1) of the zero, in unit; a *small* value trusts the zero.
    tare : TareRecipe or None
        The measured zero; None if the zero is from the data sheet.
    """

    relative_std: Uncertainty = 0.0
    offset_std: Uncertainty = 0.0
    tare: TareRecipe | None = None


class TimingRecipe(FrozenSettings):
    """The uncertainty of the times of readings, which adds noise where the signal has a slope.

    Attributes
    ----------
    std_s : float
        Standard uncertainty (k = 1) of the time of each reading, in seconds; the errors are independent. A *small*
        value trusts the stamps.
    included_std : float
        Root mean square of the part of this noise that noise_std already includes, in unit; 0 if noise_std was measured
        at rest.
    """

    std_s: PositiveUncertainty
    included_std: Uncertainty = 0.0


# The tables of a recipe for a filter with several modes (IMM).


class ModeRecipe(FrozenSettings):
    """One mode of a channel: a motion model and its noise, for one kind of behaviour of the signal.

    Attributes
    ----------
    name : str
        Name of the mode, such as "still".
    order : int
        Order n of the motion: the n-th derivative of the signal is white noise.
    process_noise_density : float
        q, in unit^2/s^(2 order - 1); a *small* value trusts the model and smooths more.
    level_noise_density : float
        Density of an additional random walk of the level, in unit^2/s. With a *large* value the level may jump, while
        slopes and tones continue.
    noise_std : float
        Standard deviation of one reading's noise in this mode, in unit.
    lasts_s : float
        Mean duration of the mode, in seconds; with a *large* value the filter leaves the mode late.
    then : str
        Name of the mode that follows this mode; "" if any other mode may follow.
    wild_share : float
        Share of outliers among the readings; with a *small* value the filter changes its mode sooner.
    damped_below_hz : float or None
        Motion slower than this is damped, as in `ChannelRecipe`.
    with_tones : bool
        Whether the model of this mode includes the tones and the coloured noise of the channel.
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
    """The modes of an interacting multiple model (IMM).

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        Kind of change that the modes describe.
    wild_std : float
        Standard deviation that outliers have in addition, in unit. With a *small* value a large innovation counts as a
        change of mode rather than an outlier.
    rejects : bool
        Whether the filter leaves outliers out.
    mode : tuple of ModeRecipe
        The modes, one of which is in force at a time.
    """

    kind: Literal["resting", "jumping", "noisy", "spiky", "bursting"]
    wild_std: NotNegative = 0.0
    rejects: bool = False
    mode: Annotated[tuple[ModeRecipe, ...], Field(min_length=1, max_length=8)]
