"""Clean a record on three paths through becalm: as a file, as a live stream, with exported C."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

import becalm
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.reading_verdicts import LOST, Verdict
from becalm.export.bundle import ExportOptions, bundle_of
from becalm.export.proof.compiling import build
from becalm.export.proof.verifying import run_in_c, write_bundle
from becalm.export.vectors import STARTING
from safe_bounds import Estimate
from safe_signals import RATE_HZ, Floats

LAG_ROWS = 20
_BLOCK = 50  # rows of a block
_SPIKES = [Verdict.SPIKE, Verdict.OUTLIER]
_NO_ESTIMATE = [Verdict.HOLE, Verdict.RUNAWAY]  # with these statuses the number that C returns is no estimate

Path_ = Callable[[Floats], Estimate]
"""Function that gets readings (N,), and returns their estimate."""


def _recording(z: Floats, rate_hz: float = RATE_HZ) -> becalm.Recording:
    return becalm.Recording(z, names=["z"], rate_hz=rate_hz)


def by_file(z: Floats, estimate: str, rate_hz: float = RATE_HZ) -> Estimate:
    """Clean a record without options; `estimate` is "smoothed", "causal" or "lag"."""
    lag_s = LAG_ROWS / rate_hz if estimate == "lag" else None
    out = becalm.clean(_recording(z, rate_hz), causal=estimate == "causal", lag_s=lag_s)
    spikes = np.isin(out.verdicts["z"], _SPIKES)
    return Estimate(out.signal.samples[:, 0], out.sigma.samples[:, 0], spikes)


def _recipe(z: Floats, estimate: str) -> becalm.Recipe:
    """Tune a recipe on an undamaged record."""
    lag_s = LAG_ROWS / RATE_HZ if estimate == "lag" else None
    return becalm.tune(_recording(z), causal=estimate == "causal", wishes=becalm.Wishes(lag_s=lag_s))


def by_stream(sound: Floats, estimate: str) -> Path_:
    """Return a function that runs readings through a live stream; its recipe is tuned on an undamaged record."""
    recipe = _recipe(sound, estimate)

    def path(z: Floats) -> Estimate:
        stream = StreamCleaner(recipe, 1 / RATE_HZ)
        parts: list[Streamed] = []
        for start in range(0, len(z), _BLOCK):
            block = np.ascontiguousarray(z[start : start + _BLOCK, np.newaxis])
            parts.append(stream.push(block, np.ones(len(block))))
        if stream.lag_rows:
            parts.append(stream.finish())
        signal, sigma, verdicts = (np.concatenate([getattr(part, name)[:, 0] for part in parts]) for name in _FIELDS)
        sigma = np.where(np.isfinite(sigma), sigma, np.nan)
        signal = np.where(np.isnan(sigma) & ~np.isfinite(z), np.nan, signal)
        return Estimate(signal, sigma, np.isin(verdicts, _SPIKES))

    return path


_FIELDS = ("signal", "sigma", "verdicts")


class Exported(AbstractContextManager["Exported"]):
    """A causal filter in C (float64), tuned on an undamaged record, exported and compiled; it returns no sigma."""

    def __init__(self, sound: Floats) -> None:
        self._stack = ExitStack()
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        bundle = bundle_of(_recipe(sound, "causal"), "safe", ExportOptions(precision="float64"))
        self._program = build(write_bundle(bundle, folder), bundle.stem, "cc", ("-O2",))
        (self._channel,) = bundle.channels

    def __call__(self, z: Floats) -> Estimate:
        """Run readings (N,) through the program."""
        one = self._channel
        out, codes = run_in_c(self._program, one, one.kind.raw(z, one.written))
        started = np.cumsum(~LOST[np.where(codes == STARTING, Verdict.USED, codes)]) > 0  # after the first used reading
        signal = np.where(started & ~np.isin(codes, _NO_ESTIMATE), one.kind.in_unit(out, one.written), np.nan)
        return Estimate(signal, np.full(len(z), np.nan), np.isin(codes, _SPIKES))

    def __enter__(self) -> Self:
        """Return the filter."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the compiled program."""
        self._stack.close()
