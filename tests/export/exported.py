"""Recipes, bundles and programs that tests of the export share."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe, ModeRecipe, SwitchingRecipe, ToneRecipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.export.bundle import Bundle, Exported, ExportOptions, bundle_of
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, Build, build, run
from becalm.export.proof.verifying import write_bundle

TONE = ToneRecipe(frequency_hz=5.0, bandwidth_hz=0.05, process_noise_density=0.1)
HUM = TONE.model_copy(update={"disturbance": True})
LIMITS = LimitsRecipe(low=-60.0, high=60.0, stuck_readings=9)
WIDE_LIMITS = LimitsRecipe(low=-300.0, high=300.0, stuck_readings=4)
STILL = ModeRecipe(name="still", order=1, process_noise_density=0.01, noise_std=1.0, lasts_s=4.0)
MOVING = ModeRecipe(name="moving", order=2, process_noise_density=3e3, noise_std=1.1, lasts_s=1.0, wild_share=0.02)
MODES = SwitchingRecipe(kind="resting", wild_std=20.0, rejects=True, mode=(STILL, MOVING))
SPAN = 2.0**15
SANITIZED_O0 = ("-O0", *SANITIZED[1:])
"""Sanitizers see no less than at -O1, and compile in a fifth of the time."""

_GCC = [("gcc", flags) for flags in OPTIMISED if flags != ("-O2",)]  # at which golden vectors pass elsewhere
BUILDS: list[tuple[str, tuple[str, ...]]] = [*_GCC, ("clang", OPTIMISED[-1]), ("clang", SANITIZED_O0)]
"""Each compiler, one in each way; what one's sanitizers see the other's see too."""

ANY = st.one_of(
    st.floats(width=32), st.sampled_from([np.nan, np.inf, -np.inf, 1e38, -1e38, 3e5, -3e5, 0.0, 60.0, 5e-324, 1e308])
)
"""Whatever may be read."""


def need(program: str) -> None:
    """Skip where a program is absent; in CI, where it is installed, fail."""
    if shutil.which(program) is None:
        if os.environ.get("CI"):
            pytest.fail(f"{program} is not here, and CI installs it")
        pytest.skip(f"{program} is not installed")


def channel(
    name: str = "ax", order: int = 2, cutoff: float = 0.05, rate_hz: float = 100.0, **more: Any
) -> ChannelRecipe:
    """Return a motion whose cut-off is so many radians a step, with a noise of 1 unless said otherwise."""
    std = more.pop("noise_std", 1.0)
    density = cutoff ** (2 * order) * std**2 * rate_hz ** (2 * order - 1)
    unit = more.pop("unit", "m/s^2")
    return ChannelRecipe(
        name=name, unit=unit, model="motion", order=order, process_noise_density=density, noise_std=std, **more
    )


def recipe_of(*channels: ChannelRecipe, rate_hz: float = 100.0) -> Recipe:
    """Return a causal recipe of these channels."""
    return Recipe(mode="causal", tuned_on=Origin(rate_hz=rate_hz), channel=channels)


def bundle(*channels: ChannelRecipe, rate_hz: float = 100.0, **asked: Any) -> Bundle:
    """Write these channels as C."""
    return bundle_of(recipe_of(*channels, rate_hz=rate_hz), "drive", ExportOptions(**asked))


def fixed(*told: ChannelRecipe, span: tuple[float, float] = (-SPAN, SPAN)) -> Bundle:
    """Write these channels in fixed point; a span is for those that have no rails."""
    railed = [one.name for one in told if one.limits is not None and one.limits.low is not None]
    return bundle(*told, precision="q31", spans={one.name: span for one in told if one.name not in railed})


def built(made: Bundle, folder: Path, compiler: str = "cc", flags: tuple[str, ...] = ("-O2",)) -> Build:
    """Compile a bundle in a folder of its own."""
    need(compiler)
    place = Path(tempfile.mkdtemp(dir=folder))
    return build(write_bundle(made, place), made.stem, compiler, flags)


def through(program: Build, one: Exported, readings: Floats) -> tuple[Floats, Codes]:
    """Run readings (N,) of a channel through C; return the signal, in unit, and the statuses."""
    raw = one.kind.raw(readings, one.written)
    with tempfile.TemporaryDirectory(dir=program.program.parent) as place:
        source, out, codes = (Path(place) / name for name in ("in", "out", "codes"))
        source.write_bytes(raw.tobytes())
        ran = run(program, one.prefix, str(source), str(out), str(codes))
        assert ran.returncode == 0, ran.stderr
        told = np.frombuffer(out.read_bytes(), raw.dtype)
        return one.kind.in_unit(told, one.written), np.frombuffer(codes.read_bytes(), np.int8)


def live(one: Exported, told: ChannelRecipe, readings: Floats) -> Floats:
    """Return what becalm's stream makes of readings (N,), as C is given them."""
    given = one.kind.in_unit(one.kind.raw(readings, one.written), one.written)
    stream = StreamCleaner(recipe_of(told, rate_hz=1 / one.design.step_s), one.design.step_s)
    return stream.push(given[:, np.newaxis], np.ones(len(given))).signal[:, 0]


def wandering(rows: int, seed: int = 5, noise: float = 1.0) -> Floats:
    """Return readings (N,) of a signal that moves, in noise."""
    rng, k = np.random.default_rng(seed), np.arange(rows)
    return 30 * noise * np.sin(k / 70) + noise * np.cumsum(rng.normal(0, 0.1, rows)) + noise * rng.normal(size=rows)


def snr_db(got: Floats, want: Floats) -> float:
    """Return the power of what is wanted over that of the difference, in dB."""
    wrong = float(np.square(got - want).sum())
    return float(10 * np.log10(np.square(want).sum() / wrong)) if wrong > 0 else np.inf
