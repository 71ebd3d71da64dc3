"""A recipe: the parameters of each channel's filter, as TOML that a person can read and change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self, TypeVar

import numpy as np
import tomlkit
from pydantic import Field, ValidationError, field_validator, model_validator

from becalm.cleaning.recipes.recipe_parts import (
    CalibrationRecipe,
    ColouredNoiseRecipe,
    FrozenSettings,
    GateRecipe,
    HoleRecipe,
    LimitsRecipe,
    NotNegative,
    Positive,
    SwitchingRecipe,
    TimingRecipe,
    ToneRecipe,
)
from becalm.errors import RecipeError, SensorError

# Parse TOML that a person wrote.

Document = TypeVar("Document", bound=FrozenSettings)


class TomlKind(NamedTuple):
    """A kind of TOML file: its name in messages, and the type of error for a file that is not valid."""

    name: str
    error: type[RecipeError | SensorError]

    def read_text(self, path: str | Path, advice: str) -> str:
        """Return the text of a file; an error message ends with `advice`.

        Raises
        ------
        RecipeError or SensorError
            An error of the type `error`, if the file cannot be read or is not UTF-8.
        """
        try:
            return Path(path).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError, TypeError) as cause:
            is_path = not isinstance(cause, TypeError)
            reason = getattr(cause, "strerror", None) or ("it is not UTF-8 text" if is_path else "it is not a path")
            raise self.error(f"The {self.name} {path} cannot be read: {reason}. {advice}") from cause

    def parse(self, model: type[Document], text: str, source: str, advice: str) -> Document:
        """Return the settings that a TOML text contains; an error message starts with `source` and ends with `advice`.

        Raises
        ------
        RecipeError or SensorError
            An error of the type `error`, if the text is not TOML, or a value is missing, unknown or impossible.
        """
        try:
            return model.model_validate(tomlkit.parse(text).unwrap())
        except ValidationError as cause:
            faults = "; ".join(_faults({error["loc"]: _plain(error["msg"]) for error in cause.errors()}))
            raise self.error(f"{source} is not a valid {self.name}: {faults}. {advice}") from cause
        except (tomlkit.exceptions.TOMLKitError, ValueError) as cause:
            raise self.error(f"{source} is not TOML ({cause}). {advice}") from cause


def _faults(messages: dict[tuple[int | str, ...], str]) -> list[str]:
    """Return each message after the key that it is about; leave out a table or list whose entries have messages.

    The keys of `messages` are paths in the document: names of keys and positions in lists, counted from 0.
    """
    parents = {path[:depth] for path in messages for depth in range(1, len(path))}
    names = {path: ".".join(str(part + 1) if isinstance(part, int) else part for part in path) for path in messages}
    return [f"{names[path]}: {fault}" if path else fault for path, fault in messages.items() if path not in parents]


def _plain(message: str) -> str:
    """Return a message of pydantic without its prefix "Value error, " and without the full stop."""
    return message.removeprefix("Value error, ").removesuffix(".")


# Version 2 added tones, 3 disturbances, 4 gates, lags and spread, 5 damping and outliers. All versions can be read.
VERSION: Literal[5] = 5

# Journals and fleets compare the whole text of recipes: if this header changes, a saved stream cannot continue.
_HEADER = """A recipe of becalm: what was decided for each channel.
Use it again:  becalm clean FILE -o OUT --recipe THIS
A small process_noise_density trusts the model and smooths more; a small noise_std trusts the readings.
Motion slower than damped_below_hz is damped: without readings the signal returns to its own level and spread.
In a hole the departure of a smoother from a line across it fades, and sigma grows, by powers of sigma over that beside
the hole: model_fading and sigma_growth, for holes of so many readings.
Where sigma is nearly as wide as spread_std and no reading came, no estimate is returned unless fill = true.
A tone with disturbance = true, and coloured_noise, are taken off the signal.
A gate leaves spikes out and follows steps; without one every reading is believed.
Readings at low or high, or beyond, are clipped, and stuck from so many equal ones on; those farther than
outlier_distance from their neighbours are gross outliers: they count as missing.
sigma is widened by the share tuning_spread; [channel.calibration] with relative_std, offset_std adds what averaging
does not lower; [channel.timing] with std_s adds to the noise where the signal moves, beyond its included_std."""


# Sigma over spread_std from which on a row in a hole has no estimate: the model then leaves nine tenths of the
# readings' variance unexplained.
_UNKNOWN_SHARE = 0.95

_KIND = TomlKind("recipe", RecipeError)

Mode = Literal["smoothed", "causal", "lagged"]


class TunedMotion(NamedTuple):
    """The parameters of a motion model, its tones and its coloured noise; attributes as in `ChannelRecipe`."""

    order: int
    process_noise_density: float
    noise_std: float
    damped_below_hz: float | None = None
    tones: tuple[ToneRecipe, ...] = ()
    coloured_noise: ColouredNoiseRecipe | None = None


class ChannelRecipe(FrozenSettings):
    """The filter of one channel.

    Attributes
    ----------
    name, unit : str
        Name and unit of the channel, as in the recording.
    model : {"motion", "constant", "untold"}
        "motion": the channel is filtered; "constant" or "untold" (too few readings): the channel passes unchanged.
    order : int or None
        Order n of the motion: the n-th derivative of the signal is white noise.
    process_noise_density : float or None
        q, in unit^2/s^(2 order - 1); a *small* value trusts the model and smooths more.
    noise_std : float or None
        Standard deviation of one reading's noise, in unit; a *small* value trusts the readings.
    damped_below_hz : float or None
        Motion slower than this is damped: without readings the estimate returns to the level of the signal, and sigma
        grows to the spread of the signal. With a *small* value this takes long. None for a motion without damping.
    tuning_spread : float
        Relative increase of sigma because the tuning is uncertain; a *small* value trusts the tuning.
    spread_std : float or None
        Standard deviation of the readings, in unit. In a row without a reading and with a sigma nearly as large, the
        model predicts nothing, so that the row has no estimate. None for an estimate in every row.
    fill : bool
        Whether to return an estimate even in rows in which the model predicts nothing.
    rate_hz : float or None
        Rate of new readings, in Hz, if it is lower than the rate of the rows; bandwidth and tests refer to this rate.
    coloured_noise : ColouredNoiseRecipe or None
        Coloured noise, in addition to the white noise.
    calibration : CalibrationRecipe or None
        Uncertainty of the sensor's calibration.
    timing : TimingRecipe or None
        Uncertainty of the times of the channel's readings.
    tone : tuple of ToneRecipe
        Tones that are added to the motion.
    hole : tuple of HoleRecipe
        Corrections of a smoother's estimates in holes, where readings are missing; each is for one length of holes.
    gate : GateRecipe or None
        The gate that rejects spikes; None for a filter that uses every reading.
    switching : SwitchingRecipe or None
        The modes of an interacting multiple model; None for one fixed filter.
    limits : LimitsRecipe or None
        Limits of a healthy sensor; with None no reading counts as clipped or stuck.
    """

    name: str
    unit: str = ""
    model: Literal["motion", "constant", "untold"]
    order: Annotated[int, Field(ge=1, le=5)] | None = None
    process_noise_density: NotNegative | None = None
    noise_std: Positive | None = None
    damped_below_hz: Positive | None = None
    tuning_spread: NotNegative = 0.0
    spread_std: Positive | None = None
    fill: bool = False
    rate_hz: Positive | None = None
    coloured_noise: ColouredNoiseRecipe | None = None
    calibration: CalibrationRecipe | None = None
    timing: TimingRecipe | None = None
    tone: Annotated[tuple[ToneRecipe, ...], Field(max_length=32)] = ()  # each adds two states
    hole: Annotated[tuple[HoleRecipe, ...], Field(max_length=16)] = ()
    gate: GateRecipe | None = None
    switching: SwitchingRecipe | None = None
    limits: LimitsRecipe | None = None

    @model_validator(mode="after")
    def _check_motion(self) -> Self:
        if self.model == "motion" and None in (self.order, self.process_noise_density, self.noise_std):
            raise ValueError("a motion needs order, process_noise_density and noise_std")
        return self

    def own_steps(self, step_s: float) -> float:
        """Return the number of steps of a recording from one reading to the next; 1 if every row has a reading."""
        return 1.0 if self.rate_hz is None else max(1.0, 1 / (self.rate_hz * step_s))

    @property
    def hole_sigma(self) -> float:
        """Return the sigma, in unit, from which on a row without a reading has no estimate; inf without a limit."""
        return np.inf if self.fill or self.spread_std is None else _UNKNOWN_SHARE * self.spread_std

    @property
    def parts(self) -> tuple[str, ...]:
        """Return the names of the parts that a split estimates, in order; the probabilities of modes come last."""
        if self.model != "motion":
            return (self.model,)
        tones = [f"{tone.frequency_hz:.6g}Hz" for tone in self.tone]
        numbered = [f"tone_{tone}" + "_again" * tones[:k].count(tone) for k, tone in enumerate(tones)]
        others = [*numbered, *(["coloured_noise"] if self.coloured_noise else [])]
        if self.switching is None:
            return ("motion", *others)
        shown = others if any(mode.with_tones for mode in self.switching.mode) else []
        return ("motion", *shown, *(f"probability_{mode.name}" for mode in self.switching.mode))

    @property
    def motion(self) -> TunedMotion | None:
        """Return the parameters of the motion model; None if the channel passes unchanged."""
        if self.model != "motion" or self.order is None or self.process_noise_density is None or self.noise_std is None:
            return None
        return TunedMotion(
            self.order,
            self.process_noise_density,
            self.noise_std,
            self.damped_below_hz,
            self.tone,
            self.coloured_noise,
        )


class Origin(FrozenSettings):
    """The recording that a recipe was tuned on.

    Attributes
    ----------
    sha256 : str
        SHA-256 of the file; "" if the recording was not a file.
    rows : int
        Number of rows of the recording.
    rate_hz : float
        Rows per second: 1 / step.
    becalm : str
        Version of becalm that tuned the recipe.
    """

    sha256: str = ""
    rows: int = 0
    rate_hz: Positive
    becalm: str = ""


class Recipe(FrozenSettings):
    """The filters of a recording's channels, and how to apply them.

    Attributes
    ----------
    becalm_recipe : int
        Version of the recipe format.
    mode : {"smoothed", "causal", "lagged"}
        Whether estimates use all later readings, none, or those within a lag.
    lag_s : float or None
        Lag of the mode "lagged", in seconds; with a *small* lag the estimates come sooner, but are noisier.
    time : str or None
        Name of the time column, if a person gave one.
    rate_hz : float or None
        Rate of the rows, in Hz, that replaces the time column, if a person gave one.
    stamps : "as-written" or None
        With "as-written", stamps that a driver made up are used as they are; with None they are corrected.
    tuned_on : Origin
        The recording that the recipe was tuned on.
    channel : tuple of ChannelRecipe
        The filters of the channels to clean, one for each.
    """

    becalm_recipe: Literal[1, 2, 3, 4, 5] = VERSION
    mode: Mode = "smoothed"
    lag_s: Positive | None = None
    time: str | None = None
    rate_hz: Positive | None = None
    stamps: Literal["as-written"] | None = None
    tuned_on: Origin
    channel: Annotated[tuple[ChannelRecipe, ...], Field(min_length=1)]

    @property
    def nominal_rate_hz(self) -> float:
        """Return the rate of a stream without stamps, in Hz: `rate_hz`, or the rate of the tuning recording."""
        return self.rate_hz or self.tuned_on.rate_hz

    @field_validator("becalm_recipe")
    @classmethod
    def _upgrade_version(cls, _: int) -> int:
        return VERSION  # every key of an older version is still valid

    @model_validator(mode="after")
    def _lag_belongs_to_lagged(self) -> Self:
        if (self.mode == "lagged") != (self.lag_s is not None):
            raise ValueError('lag_s and mode = "lagged" belong together; give both, or neither')
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [channel.name for channel in self.channel]
        if len(set(names)) != len(names):
            raise ValueError("two channels have the same name")
        return self

    def to_toml(self) -> str:
        """Return the recipe as TOML; equal recipes have equal texts."""
        document = tomlkit.document()
        for line in _HEADER.splitlines():
            document.add(tomlkit.comment(line))
        for key, value in self.model_dump(exclude_none=True, exclude={"channel", "tuned_on"}).items():
            document.add(key, value)
        document.add("tuned_on", tomlkit.item(self.tuned_on.model_dump()))
        channels = tomlkit.aot()
        for channel in self.channel:
            unneeded = {field for field in ("tone", "tuning_spread", "fill", "hole") if not getattr(channel, field)}
            channels.append(tomlkit.item(channel.model_dump(exclude_none=True, exclude=unneeded)))
        document.add("channel", channels)
        return tomlkit.dumps(document)

    @classmethod
    def from_toml(cls, text: str, source: str = "The recipe") -> Recipe:
        """Return the recipe in a TOML text; an error message starts with `source`.

        Raises
        ------
        RecipeError
            If the text is not TOML, or a value is missing, unknown or impossible.
        """
        return _KIND.parse(cls, text, source, "Make one with: becalm tune FILE -o R.toml")

    @classmethod
    def load(cls, path: str | Path) -> Recipe:
        """Read a recipe from a file.

        Raises
        ------
        RecipeError
            If the file cannot be read or is not a recipe.
        """
        text = _KIND.read_text(path, f"Make one with: becalm tune FILE -o {path}")
        return cls.from_toml(text, f"The recipe {path}")
