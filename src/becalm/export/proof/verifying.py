"""Verify that exported C agrees with becalm: compile it, run it and compare the signals."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.core.reading_verdicts import LOST
from becalm.export.bundle import Bundle, Exported
from becalm.export.channel.kind import WholeChannel
from becalm.export.design import NOT_IN_C
from becalm.export.kind import Raw
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, Build, CompileError, build, compilers, run
from becalm.export.vectors import STARTING

_LONG = 1_000_000  # simulated readings
_FIRST = 20_000  # of them, for a comparison with the specification: the stream may have fewer digits than C
_SAME_FILTER_DB = 60.0  # signal over difference; a smaller ratio is not due to rounding
_SEED = 7


class GoldenRun(NamedTuple):
    """The result of the golden vectors with one build."""

    build: Build
    says: str  # the first checks that failed, and what was printed to stderr
    passed: bool


class Compared(NamedTuple):
    """A comparison of C and becalm over a record of one channel.

    Attributes
    ----------
    channel, record : str
        Names of the channel and of the record.
    rows : int
        Number of readings.
    beside : str
        Name of the reference: becalm's stream, or the specification of the filter.
    error : float
        Greatest difference, relative to the greatest signal.
    error_row, first_row : int
        Row of that difference, and first row with a filtered signal; -1 if there is none.
    snr_db : float
        Power of the signal over that of the difference, in dB; inf if there is no difference.
    kept : bool
        Whether the ratio reaches what the precision guarantees: 240 dB in float64, 120 dB in float32, 90 dB in q31.
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


Becalm = Callable[[Exported, ChannelRecipe, Floats], tuple[Floats, str]]
"""Function that returns the signal of becalm for readings (N,), in unit, and the name of the reference."""


class Verified(NamedTuple):
    """The results of a verification."""

    runs: list[GoldenRun]
    compared: list[Compared]


def verify(bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats], folder: Path) -> Verified:
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
        If there is no compiler, or its programs cannot be run.
    CompileError
        If the C does not compile, a golden vector fails, or C and becalm differ by more than rounding.
    """
    unpacked(bundle, folder)
    ways = [flags for flags in (*OPTIMISED, SANITIZED) if not (bundle.needs_nan and "-ffast-math" in flags)]
    runs = [_run(folder, bundle, name, flags) for name in compilers() for flags in ways]
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
    return Verified(runs, compared)


def unpacked(bundle: Bundle, folder: Path) -> Path:
    """Write the files of a bundle into a folder; return the folder."""
    for path, text in bundle.files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


def _run(folder: Path, bundle: Bundle, compiler: str, flags: tuple[str, ...]) -> GoldenRun:
    made = build(folder, bundle.stem, compiler, flags)
    ran = run(made)
    failed = [line for line in ran.stdout.splitlines() if "FAILED" in line]
    return GoldenRun(made, " ".join([*failed[:3], ran.stderr[:300]]).strip(), ran.returncode == 0)


def _compare_channels(
    made: Build, bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats]
) -> Iterator[Compared]:
    for one in bundle.channels:
        (channel,) = (channel for channel in recipe.channel if channel.name == one.name)
        records = {"drawn from its own model": drawn(one, _LONG)}
        if one.name in recorded:
            records["the recording"] = recorded[one.name]
        for record, readings in records.items():
            comparison = compare(made, one, channel, record, readings)
            yield comparison
            if not comparison.kept and one.design.modes is None:
                yield compare(made, one, channel, f"{record}, its first rows", readings[:_FIRST], specified)


def drawn(one: Exported, rows: int) -> Floats:
    """Return simulated readings (rows,) of a channel's model, in unit, well within its saturation limits."""
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
    if np.abs(signal).max() > half:  # a motion has no bounds; reflect it
        signal = half * (2 / np.pi) * np.arcsin(np.sin(signal * (np.pi / 2) / half))
    return centre + signal + rng.normal(0, one.design.noise_std, rows)


def compare(  # noqa: PLR0913
    made: Build, one: Exported, channel: ChannelRecipe, record: str, readings: Floats, becalm: Becalm | None = None
) -> Compared:
    """Run a record of one channel through C and through becalm.

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
        Readings in unit, one step apart; NaN where missing.
    becalm : callable, optional
        Reference to compare with; by default becalm's stream, or the specification where the stream differs.
    """
    raw = one.kind.raw(readings, one.written)
    out, codes = streamed(made, one, raw)
    signal = one.kind.in_unit(out, one.written)
    given = one.kind.in_unit(raw, one.written)
    want, reference = (becalm or _expected)(one, channel, given)
    known = np.isfinite(want) & (codes != STARTING)  # while starting, readings are passed on unfiltered
    off, power = np.where(known, np.abs(signal - want), 0.0), float(np.square(want[known]).sum())
    wrong, greatest = float(np.square(off).sum()), float(np.abs(want[known]).max(initial=0.0))
    snr_db = _ratio_db(power, wrong)
    error_row = int(np.where(known, off, -1.0).argmax()) if known.any() else -1
    first_row = int(known.argmax()) if known.any() else -1
    error = float(off.max(initial=0.0)) / (greatest or 1.0)
    kept = snr_db >= one.kind.promised_db
    return Compared(one.name, record, len(given), reference, error, error_row, first_row, snr_db, kept)


def _ratio_db(power: float, error_power: float) -> float:
    """Return the ratio in dB; inf without an error, -inf for one that is NaN or has no signal beside it."""
    if error_power == 0:
        return np.inf
    return float(10 * np.log10(power / error_power)) if power > 0 and np.isfinite(error_power) else -np.inf


def _expected(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return the expected signal for readings (N,), and the name of its reference: the stream or a specification.

    A filter without a covariance is compared with its own specification if readings are missing, or if its table of
    gains was thinned.
    """
    step_s = one.design.step_s
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=1 / step_s), channel=(_as_exported(one, channel),))
    cleaned = StreamCleaner(recipe, step_s).push(given[:, np.newaxis], np.ones(len(given)))
    if one.kind.bridges or (one.written.exact and not LOST[cleaned.verdicts].any()):
        return cleaned.signal[:, 0], "becalm's stream"
    return specified(one, channel, given)


def _as_exported(one: Exported, channel: ChannelRecipe) -> ChannelRecipe:
    """Return the recipe of what the C does: it predicts across any hole.

    Except for the library's own channel, it lacks the limits `NOT_IN_C`.
    """
    limits = channel.limits
    if limits is not None and not isinstance(one.kind, WholeChannel):
        limits = limits.model_copy(update=dict.fromkeys(NOT_IN_C))
    return channel.model_copy(update={"limits": limits, "fill": True})


def specified(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return the signal of a filter's specification for readings (N,), and the name of that reference."""
    return one.kind.reference(channel, one.design, one.written).run(given)[0], "its specification"


def streamed(made: Build, one: Exported, raw: Raw) -> tuple[Raw, Codes]:
    """Run raw readings (N,) through a channel in C; return the raw signal and the code of each.

    Raises
    ------
    CompileError
        If the program does not exit with 0, or takes too long.
    """
    with tempfile.TemporaryDirectory(dir=made.program.parent) as place:
        source, out, codes = (Path(place) / name for name in ("in", "out", "codes"))
        source.write_bytes(raw.tobytes())
        ran = run(made, one.prefix, str(source), str(out), str(codes))
        if ran.returncode != 0:
            raise CompileError(f"{one.name}: the program ended with {ran.returncode}. {ran.stderr[:300]}")
        return np.frombuffer(out.read_bytes(), raw.dtype), np.frombuffer(codes.read_bytes(), np.int8)
