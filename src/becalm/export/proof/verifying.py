"""Verify that exported C agrees with becalm: compile it, run it and compare the signals."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.core.reading_verdicts import LOST
from becalm.export.bundle import Bundle, Exported
from becalm.export.channel.kind import WholeChannel
from becalm.export.design import NOT_IN_C
from becalm.export.kind import Raw
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, Build, CompileError, build, compilers, run
from becalm.export.vectors import STARTING

_LONG = 1_000_000  # number of simulated readings
_FIRST = 20_000  # first readings that are also compared with the specification, if the stream has fewer digits than C
_SAME_FILTER_DB = 60.0  # least ratio of signal to difference; a smaller ratio is not due to rounding
_SEED = 7


class GoldenRun(NamedTuple):
    """The result of a run of the golden vectors, with one build."""

    build: Build
    says: str  # the first failed checks, and the output to stderr
    passed: bool


class RecordComparison(NamedTuple):
    """A comparison of the C code with becalm over a record of one channel.

    Attributes
    ----------
    channel, record : str
        Names of the channel and of the record.
    rows : int
        Number of readings.
    beside : str
        Name of the reference: becalm's stream, or the specification of the filter.
    error : float
        Largest difference of the two signals, relative to the largest signal.
    error_row, first_row : int
        Row of that difference, and first row with a filtered signal; -1 without a filtered signal.
    snr_db : float
        Ratio of the signal's power to that of the difference, in dB; inf if there is no difference.
    kept : bool
        Whether `snr_db` reaches the ratio that the precision guarantees: 240 dB in float64, 120 dB in float32, 90 dB in
        q31.
    """

    channel: str
    record: str
    rows: int
    beside: str
    error: float
    error_row: int
    first_row: int
    snr_db: float
    kept: bool


SignalFunction = Callable[[Exported, ChannelRecipe, Floats], tuple[Floats, str]]
"""Function that returns becalm's signal for readings (N,), in unit, and the name of the reference."""


class Verification(NamedTuple):
    """The results of a verification."""

    runs: list[GoldenRun]
    compared: list[RecordComparison]


def verify(bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats], folder: Path) -> Verification:
    """Compile a bundle with all compilers and flags, run it, and compare it with becalm.

    Parameters
    ----------
    bundle : Bundle
        The exported bundle.
    recipe : Recipe
        The recipe that the bundle was written from.
    recorded : mapping of str to (N,) float array
        Complete records by channel, in unit.
    folder : Path
        An empty folder for the compiled files.

    Raises
    ------
    UsageError
        If there is no compiler, or compiled programs cannot be run.
    CompileError
        If the C does not compile, a golden vector fails, or C and becalm differ by more than rounding.
    """
    write_bundle(bundle, folder)
    builds = [flags for flags in (*OPTIMISED, SANITIZED) if not (bundle.needs_nan and "-ffast-math" in flags)]
    runs = [_run(folder, bundle, name, flags) for name in compilers() for flags in builds]
    if failed := [one for one in runs if not one.passed]:
        raise CompileError(
            f"Built by {failed[0].build.compiler} {' '.join(failed[0].build.flags)}, golden vectors or checks fail:"
            f" {failed[0].says}"
        )
    optimised = next(one.build for one in runs if one.build.flags == ("-O2",))
    compared = list(_compare_channels(optimised, bundle, recipe, recorded))
    if other := [one for one in compared if not one.snr_db >= _SAME_FILTER_DB]:
        raise CompileError(
            f"{other[0].channel}, {other[0].record}: C and becalm differ; the signal is only {other[0].snr_db:.0f} dB"
            " above the difference."
        )
    return Verification(runs, compared)


def write_bundle(bundle: Bundle, folder: Path) -> Path:
    """Write the files of a bundle into a folder; return the folder."""
    for path, text in bundle.files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


def _run(folder: Path, bundle: Bundle, compiler: str, flags: tuple[str, ...]) -> GoldenRun:
    """Compile a bundle, and run its golden vectors and checks."""
    made = build(folder, bundle.stem, compiler, flags)
    ran = run(made)
    failed = [line for line in ran.stdout.splitlines() if "FAILED" in line]
    return GoldenRun(made, " ".join([*failed[:3], ran.stderr[:300]]).strip(), ran.returncode == 0)


def _compare_channels(
    made: Build, bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats]
) -> Iterator[RecordComparison]:
    for one in bundle.channels:
        (channel,) = (channel for channel in recipe.channel if channel.name == one.name)
        records = {"drawn from its own model": simulate_readings(one, _LONG)}
        if one.name in recorded:
            records["the recording"] = recorded[one.name]
        for record, readings in records.items():
            comparison = compare(made, one, channel, record, readings)
            yield comparison
            if not comparison.kept and one.design.modes is None:
                yield compare(made, one, channel, f"{record}, its first rows", readings[:_FIRST], run_specification)


def simulate_readings(one: Exported, rows: int) -> Floats:
    """Return simulated readings (rows,) of a channel's model, in unit, well within the saturation limits."""
    rng, model = np.random.default_rng(_SEED), one.design.model
    low, high = one.design.limits.rails
    centre = (low + high) / 2 if np.isfinite(low + high) else 0.0
    values, vectors = np.linalg.eigh(model.process_covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise, x, signal = rng.normal(size=(rows, model.states)) @ root.T, np.zeros(model.states), np.empty(rows)
    for k in range(rows):
        x = model.F @ x + noise[k]
        signal[k] = (model.H @ x)[0]
    half = min((high - low) / 4, 1e4 * one.design.noise_std)
    if np.abs(signal).max() > half:  # the motion model has no bounds: reflect the signal at +-half
        signal = half * (2 / np.pi) * np.arcsin(np.sin(signal * (np.pi / 2) / half))
    return centre + signal + rng.normal(0, one.design.noise_std, rows)


def compare(  # noqa: PLR0913
    made: Build,
    one: Exported,
    channel: ChannelRecipe,
    record: str,
    readings: Floats,
    becalm: SignalFunction | None = None,
) -> RecordComparison:
    """Run a record of one channel through the C code and through becalm, and compare the signals.

    Parameters
    ----------
    made : Build
        The compiled program.
    one : Exported
        The exported channel.
    channel : ChannelRecipe
        Recipe of the channel.
    record : str
        Name of the record.
    readings : (N,) float array
        Readings in unit, one for each step; NaN where missing.
    becalm : callable, optional
        Reference to compare with; by default becalm's stream, or the specification of a filter that differs from it.
    """
    raw = one.kind.raw(readings, one.written)
    out, codes = run_in_c(made, one, raw)
    signal = one.kind.in_unit(out, one.written)
    given = one.kind.in_unit(raw, one.written)
    want, reference = (becalm or _expected)(one, channel, given)
    known = np.isfinite(want) & (codes != STARTING)  # with code STARTING a reading is returned unfiltered
    error, power = np.where(known, np.abs(signal - want), 0.0), float(np.square(want[known]).sum())
    error_power, greatest = float(np.square(error).sum()), float(np.abs(want[known]).max(initial=0.0))
    snr_db = _ratio_db(power, error_power)
    error_row = int(np.where(known, error, -1.0).argmax()) if known.any() else -1
    first_row = int(known.argmax()) if known.any() else -1
    largest_error = float(error.max(initial=0.0)) / (greatest or 1.0)
    kept = snr_db >= one.kind.promised_db
    return RecordComparison(one.name, record, len(given), reference, largest_error, error_row, first_row, snr_db, kept)


def _ratio_db(power: float, error_power: float) -> float:
    """Return power / error_power in dB; inf if the error is 0, -inf if the error is not finite or the signal is 0."""
    if error_power == 0:
        return np.inf
    return float(10 * np.log10(power / error_power)) if power > 0 and np.isfinite(error_power) else -np.inf


def _expected(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return the expected signal for readings (N,), and the name of its reference: the stream or a specification.

    A filter without a covariance has its own specification as reference if readings are missing, or if its table of
    gains is thinned; all other filters have becalm's stream.
    """
    step_s = one.design.step_s
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=1 / step_s), channel=(_as_exported(one, channel),))
    cleaned = StreamCleaner(recipe, step_s).push(given[:, np.newaxis], np.ones(len(given)))
    if one.kind.has_covariance or (one.written.exact and not LOST[cleaned.verdicts].any()):
        return cleaned.signal[:, 0], "becalm's stream"
    return run_specification(one, channel, given)


def _as_exported(one: Exported, channel: ChannelRecipe) -> ChannelRecipe:
    """Return the recipe of the filter that the C code computes, which predicts across any hole.

    Except for the library's own channel, the limits `NOT_IN_C` are removed.
    """
    limits = channel.limits
    if limits is not None and not isinstance(one.kind, WholeChannel):
        limits = limits.model_copy(update=dict.fromkeys(NOT_IN_C))
    return channel.model_copy(update={"limits": limits, "fill": True})


def run_specification(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return the signal of a filter's specification for readings (N,), and the name of this reference."""
    return one.kind.reference(channel, one.design, one.written).run(given)[0], "its specification"


def run_in_c(made: Build, one: Exported, raw: Raw) -> tuple[Raw, Codes]:
    """Run raw readings (N,) through a channel in C; return the raw signal (N,) and the codes (N,).

    Raises
    ------
    CompileError
        If the exit status of the program is not 0, or the program takes too long.
    """
    with tempfile.TemporaryDirectory(dir=made.program.parent) as place:
        source, out, codes = (Path(place) / name for name in ("in", "out", "codes"))
        source.write_bytes(raw.tobytes())
        ran = run(made, one.prefix, str(source), str(out), str(codes))
        if ran.returncode != 0:
            raise CompileError(f"{one.name}: the program ended with {ran.returncode}. {ran.stderr[:300]}")
        return np.frombuffer(out.read_bytes(), raw.dtype), np.frombuffer(codes.read_bytes(), np.int8)
