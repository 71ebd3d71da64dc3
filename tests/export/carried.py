"""Filters that carry their covariance: channels that try them, and one of them held in this process as C."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import ColouredNoiseRecipe, GateRecipe, LimitsRecipe, ToneRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.autoregressive import from_partial_autocorrelations
from becalm.export.design import design_of
from becalm.export.full.kind import Full
from becalm.export.full.reference import FullReference
from becalm.export.number_type import DOUBLE, FLOAT, NumberType
from becalm.export.templates import render
from becalm.export.written import Written
from exported import channel
from held import library

STEP_S = 0.01
GATE = GateRecipe()
TONE = ToneRecipe(frequency_hz=5.0, bandwidth_hz=0.05, process_noise_density=0.1)
HUM = ToneRecipe(frequency_hz=20.0, bandwidth_hz=0.05, process_noise_density=0.1, disturbance=True)
PHI = from_partial_autocorrelations((0.8, 0.1, 0.05))
COLOURED = ColouredNoiseRecipe(rate_hz=100.0, coefficients=PHI, std=2.0)
LIMITS = LimitsRecipe(low=-60.0, high=60.0, stuck_readings=9)
CHANNELS = {
    "level": channel("level", 1, 0.2),
    "slope": channel("slope", 2, 0.05),
    "bend": channel("bend", 3, 0.05),
    "jerk": channel("jerk", 4, 0.1),
    "snap": channel("snap", 5, 0.3),
    "slow": channel("slow", 2, 1e-3),
    "never": channel("never", 2, 0.0),
    "hum": channel("hum", 1, 0.05, tone=(HUM,)),
    "coloured": channel("coloured", 2, 0.05, coloured_noise=COLOURED),
    "railed": channel("railed", 2, 0.05, limits=LIMITS),
    "small": channel("small", 2, 0.05, noise_std=1e-9),
    "large": channel("large", 2, 0.05, noise_std=1e9),
}
BOTH = {**CHANNELS, **{f"gated {name}": told.model_copy(update={"gate": GATE}) for name, told in CHANNELS.items()}}
HARD = {
    "tone": channel("tone", 2, 0.05, tone=(TONE,)),
    "slow tone": channel("tone", 2, 0.05, tone=(TONE.model_copy(update={"frequency_hz": 0.5}),)),
    "snap": channel("snap", 5, 1e-3),
}
"""Whose covariance keeps few digits."""

NUMBERS = {"float64": DOUBLE, "float32": FLOAT}
USUAL = ("level", "slope", "gated bend", "gated snap", "gated never", "gated hum", "gated coloured", "gated railed")


class Program:
    """One channel, compiled and loaded."""

    def __init__(self, told: ChannelRecipe, number: NumberType, folder: Path) -> None:
        design = design_of(told, STEP_S)
        assert design is not None
        self.told, self.design, self.kind = told, design, Full(number)
        self.written: Written = self.kind.write(design, "f", None)
        real = number.name
        declared = (
            f"void f_init(f_state *s); void f_reset(f_state *s, {real} x); void f_gap(f_state *s, uint32_t rows);\n"
            f"becalm_status f_step(f_state *s, {real} z, {real} *y);\n"
            f"void f_step_block(f_state *s, const {real} *z, {real} *y, uint8_t *status, size_t rows);\n"
            "size_t f_size(void);\n"
        )
        size = "size_t f_size(void) { return sizeof(f_state); }\n"
        (folder / "becalm.h").write_text(render("becalm.h.jinja", {}))
        (folder / "f.c").write_text(f'#include "becalm.h"\n{self.written.header}{declared}{self.written.source}{size}')
        self._c: Any = library(folder, "f.c", "-O2")
        self._real = ctypes.c_double if number.is_double else ctypes.c_float
        self._c.f_size.restype, self._c.f_variance.restype = ctypes.c_size_t, self._real
        self._c.f_reset.argtypes = [ctypes.c_void_p, self._real]
        self.size = int(self._c.f_size())
        self.state = ctypes.create_string_buffer(self.size)
        self.init()

    def init(self) -> None:
        self._c.f_init(self.state)

    def reset(self, signal: float) -> None:
        self._c.f_reset(self.state, signal)

    def gap(self, rows: int) -> None:
        self._c.f_gap(self.state, ctypes.c_uint32(rows))

    @property
    def variance(self) -> float:
        return float(self._c.f_variance(self.state))

    def rounded(self, readings: Floats) -> Floats:
        return self.kind.in_unit(self.kind.raw(readings, self.written), self.written)

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        raw = np.ascontiguousarray(self.kind.raw(readings, self.written))
        signal, codes = np.empty_like(raw), np.empty(len(raw), np.uint8)
        places = (ctypes.c_void_p(array.ctypes.data) for array in (raw, signal, codes))
        self._c.f_step_block(self.state, *places, ctypes.c_size_t(len(raw)))
        return signal.astype(np.float64), codes.astype(np.int8)

    def becalm(self, readings: Floats) -> tuple[Floats, Codes]:
        """Return what becalm makes of the same readings, in its own digits."""
        signal, _, codes = FullReference(self.told, self.design, self.written.largest).both(self.rounded(readings))
        return signal, codes


def rough(told: ChannelRecipe, rows: int = 3000, seed: int = 1) -> Floats:
    """Return readings (N,) with noise, spikes, steps, and holes of all lengths up to 80."""
    rng, std = np.random.default_rng(seed), told.noise_std or 1.0
    z = 12 * np.sin(np.arange(rows) / 40) + rng.normal(size=rows)
    for row in rng.integers(100, rows - 100, 5).tolist():
        z[row:] += rng.normal() * 20
        z[row + 50 : row + 50 + int(rng.integers(2, 80))] = np.nan
    spikes = rng.random(rows) < 0.01
    z[spikes] += rng.normal(size=spikes.sum()) * 200
    z[rng.random(rows) < 0.02] = np.nan
    return np.asarray(std * z, np.float64)
