"""Whether exported C does what becalm does: compiled, run, compared; and the certificate that says so."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.core.verdict import LOST
from becalm.export.bundle import Bundle, Exported
from becalm.export.channel.kind import WholeChannel
from becalm.export.design import NOT_IN_C
from becalm.export.kind import Raw
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, Build, CompileError, build, compilers, run
from becalm.export.vectors import STARTING

_LONG = 1_000_000  # readings drawn from the model itself
_FIRST = 20_000  # of them, where the stream itself may keep fewer digits than C
_SAME_FILTER_DB = 60.0  # below it is no rounding
_SEED = 7


class GoldenRun(NamedTuple):
    """The golden vectors, run by one build."""

    build: Build
    says: str
    passed: bool


class Compared(NamedTuple):
    """A record of one channel through C and through becalm.

    Attributes
    ----------
    channel, record : str
        Which.
    rows : int
        How many readings.
    beside : str
        What it was held against: becalm's stream, or the specification of a filter that carries no covariance.
    error : float
        The greatest difference, in parts of the greatest signal.
    error_row, first_row : int
        Row of that difference, and the first whose signal is a filter's; -1 where there is none.
    snr_db : float
        Power of the signal over that of the difference; inf where there is none.
    kept : bool
        Whether that is what its precision promises: 240 dB in float64, 120 dB in float32, 90 dB in fixed point.
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
"""Returns what becalm makes of readings (N,), and which of its parts did."""


class Verified(NamedTuple):
    """What was run."""

    runs: list[GoldenRun]
    compared: list[Compared]


def verify(bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats], folder: Path) -> Verified:
    """Compile a bundle in every way that this machine can, run it, and compare it with becalm.

    Parameters
    ----------
    bundle : Bundle
        What was written.
    recipe : Recipe
        What it was written from.
    recorded : mapping of str to (N,) float array
        Whole records, by channel, in unit.
    folder : Path
        An empty one, for what is compiled.

    Raises
    ------
    UsageError
        If there is no compiler, or what it makes cannot be run.
    CompileError
        If it does not compile, a vector fails, or it differs from becalm by more than rounding can explain.
    """
    unpacked(bundle, folder)
    ways = [flags for flags in (*OPTIMISED, SANITIZED) if not (bundle.needs_nan and "-ffast-math" in flags)]
    runs = [_run(folder, bundle, name, flags) for name in compilers() for flags in ways]
    if failed := [one for one in runs if not one.passed]:
        raise CompileError(
            f"Built by {failed[0].build.compiler} {' '.join(failed[0].build.flags)}, golden vectors or checks fail:"
            f" {failed[0].says}"
        )
    quick = next(one.build for one in runs if one.build.flags == ("-O2",))
    compared = list(_compared(quick, bundle, recipe, recorded))
    if other := [one for one in compared if not one.snr_db >= _SAME_FILTER_DB]:
        raise CompileError(
            f"{other[0].channel}, {other[0].record}: C and becalm differ, by {other[0].snr_db:.0f} dB less than the"
            " signal."
        )
    return Verified(runs, compared)


def unpacked(bundle: Bundle, folder: Path) -> Path:
    """Write the texts of a bundle into a folder of one's own; return it."""
    for path, text in bundle.files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


def _run(folder: Path, bundle: Bundle, compiler: str, flags: tuple[str, ...]) -> GoldenRun:
    made = build(folder, bundle.stem, compiler, flags)
    ran = run(made)
    failed = [line for line in ran.stdout.splitlines() if "FAILED" in line]
    return GoldenRun(made, " ".join([*failed[:3], ran.stderr[:300]]).strip(), ran.returncode == 0)


def _compared(made: Build, bundle: Bundle, recipe: Recipe, recorded: Mapping[str, Floats]) -> Iterator[Compared]:
    for one in bundle.channels:
        (channel,) = (channel for channel in recipe.channel if channel.name == one.name)
        records = {"drawn from its own model": drawn(one, _LONG)}
        if one.name in recorded:
            records["the recording"] = recorded[one.name]
        for record, readings in records.items():
            found = compare(made, one, channel, record, readings)
            yield found
            if not found.kept and one.design.modes is None:
                yield compare(made, one, channel, f"{record}, its first rows", readings[:_FIRST], specified)


def drawn(one: Exported, rows: int) -> Floats:
    """Return readings (N,) of a signal that a channel's model makes, within its rails."""
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
    if (far := np.abs(signal).max()) > half:  # a motion has no bounds: reflect it at those of the sensor
        signal = half * (2 / np.pi) * np.arcsin(np.sin(signal * (np.pi / 2) / half)) if far > half else signal
    return centre + signal + rng.normal(0, one.design.noise_std, rows)


def compare(  # noqa: PLR0913
    made: Build, one: Exported, channel: ChannelRecipe, record: str, readings: Floats, becalm: Becalm | None = None
) -> Compared:
    """Run a record of one channel through C and through becalm.

    Parameters
    ----------
    made : Build
        What runs it.
    one : Exported
        The channel.
    channel : ChannelRecipe
        Its recipe.
    record : str
        What the record is called.
    readings : (N,) float array
        In unit, a step apart; NaN where missing.
    becalm : callable, optional
        Returns what becalm makes of readings, and what of it did; by default its stream, where that is the same filter.
    """
    raw = one.kind.raw(readings, one.written)
    out, codes = streamed(made, one, raw)
    told = one.kind.in_unit(out, one.written)
    given = one.kind.in_unit(raw, one.written)
    want, beside = (becalm or _wanted)(one, channel, given)
    known = np.isfinite(want) & (codes != STARTING)  # readings that are passed on are no filter's
    off, power = np.where(known, np.abs(told - want), 0.0), float(np.square(want[known]).sum())
    wrong, greatest = float(np.square(off).sum()), float(np.abs(want[known]).max(initial=0.0))
    snr_db = float(10 * np.log10(power / wrong)) if wrong > 0 < power else np.inf
    error_row = int(np.where(known, off, -1.0).argmax()) if known.any() else -1
    first_row = int(known.argmax()) if known.any() else -1
    error = float(off.max(initial=0.0)) / (greatest or 1.0)
    kept = snr_db >= one.kind.promised_db
    return Compared(one.name, record, len(given), beside, error, error_row, first_row, snr_db, kept)


def _wanted(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return what becalm makes of readings (N,), and which becalm: its stream, or a specification.

    A filter without a covariance that meets missing readings, or whose start was thinned, is held against its own.
    """
    step_s = one.design.step_s
    alone = Recipe(mode="causal", tuned_on=Origin(rate_hz=1 / step_s), channel=(_as_exported(one, channel),))
    found = StreamCleaner(alone, step_s).push(given[:, np.newaxis], np.ones(len(given)))
    if one.kind.bridges or (one.written.exact and not LOST[found.verdicts].any()):
        return found.signal[:, 0], "becalm's stream"
    return specified(one, channel, given)


def _as_exported(one: Exported, channel: ChannelRecipe) -> ChannelRecipe:
    """Return a recipe of what C does: it predicts in any hole.

    But for the library's own channel it believes gross outliers, and has no last sentinel.
    """
    limits = channel.limits
    if limits is not None and not isinstance(one.kind, WholeChannel):
        limits = limits.model_copy(update=dict.fromkeys(NOT_IN_C))
    return channel.model_copy(update={"limits": limits, "fill": True})


def specified(one: Exported, channel: ChannelRecipe, given: Floats) -> tuple[Floats, str]:
    """Return what the specification of a filter makes of readings (N,), and that it did."""
    return one.kind.reference(channel, one.design, one.written).run(given)[0], "its specification"


def streamed(made: Build, one: Exported, raw: Raw) -> tuple[Raw, Codes]:
    """Run numbers (N,) through a channel in C; return what it tells, and what became of each.

    Raises
    ------
    CompileError
        If it ends otherwise than well.
    """
    with tempfile.TemporaryDirectory(dir=made.program.parent) as place:
        source, out, codes = (Path(place) / name for name in ("in", "out", "codes"))
        source.write_bytes(raw.tobytes())
        ran = run(made, one.prefix, str(source), str(out), str(codes))
        if ran.returncode != 0:
            raise CompileError(f"{one.name}: the program ended with {ran.returncode}. {ran.stderr[:300]}")
        return np.frombuffer(out.read_bytes(), raw.dtype), np.frombuffer(codes.read_bytes(), np.int8)
