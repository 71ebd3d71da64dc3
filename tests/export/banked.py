"""Banks compiled and run, and records and recipes for them."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

import numpy as np

from becalm.cleaning.modes import modes_in_seconds
from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipe_modes import ModeRecipe, SwitchingRecipe
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.cleaning.steps import in_seconds
from becalm.cleaning.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.export.bank.kind import Bank
from becalm.export.design import design_of
from becalm.export.number_type import NumberType
from becalm.export.proof.compiling import STRICT
from becalm.export.templates import render
from becalm.export.written import Written
from becalm.noise.banks import jumping, noisy, resting, spiky
from becalm.noise.far import NONE_FAR
from becalm.noise.likelihood import Evidence, tune_motion
from becalm.noise.switching import Switched

RATE_HZ = 200.0
KINDS = ("resting", "jumping", "noisy", "spiky")

_DRIVER = """
#include "bank.c"
#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words)
{
    b_state state;
    char what;
    double value;
    b_init(&state);
    (void)words;
    if (count > 1) {
        printf("%zu\\n", sizeof state);
        return 0;
    }
    while (scanf(" %c %lf", &what, &value) == 2) {
        REAL signal = 0;
        if (what == 'z') {
            const int status = (int)b_step(&state, (REAL)value, &signal);
            printf("%a %d", (double)signal, status);
            for (uint32_t mode = 0u; mode < MODES; mode++) {
                printf(" %a", (double)b_probability(&state, mode));
            }
            printf("\\n");
        } else if (what == 'g') {
            b_gap(&state, (uint32_t)value);
        } else if (what == 'r') {
            b_reset(&state, (REAL)value);
        } else {
            printf("%a %a\\n", (double)b_decay((REAL)value), (double)b_per_root((REAL)value));
        }
    }
    return 0;
}
"""


class Told(NamedTuple):
    """What is told of some rows."""

    signal: Floats  # (N,)
    codes: Codes  # (N,)
    modes: Floats  # (N, M)


class Program:
    """A bank of one channel, compiled."""

    def __init__(self, recipe: ChannelRecipe, number: NumberType, compiler: str, flags: Sequence[str]) -> None:
        design = design_of(recipe, 1 / RATE_HZ)
        assert design is not None
        assert design.modes is not None
        self.kind, self.design, self.recipe = Bank(number), design, recipe
        self.written: Written = self.kind.write(design, "b", None)
        folder = Path(mkdtemp(prefix="becalm-bank-"))
        (folder / "becalm.h").write_text(render("becalm.h.jinja", {}))
        prototypes = (
            f"void b_init(b_state *s);\nvoid b_reset(b_state *s, {number.name} x);\n"
            f"void b_gap(b_state *s, uint32_t n);\n"
            f"becalm_status b_step(b_state *s, {number.name} z, {number.name} *y);\nvoid b_step_block(b_state *s,"
            f" const {number.name} *z, {number.name} *y, uint8_t *status, size_t rows);\n"
        )
        source = f'#include "becalm.h"\n{self.written.header}{prototypes}{self.written.source}'
        (folder / "bank.c").write_text(source)
        (folder / "driver.c").write_text(_DRIVER)
        names = [f"-DREAL={number.name}", f"-DMODES={len(design.modes.modes)}u"]
        command = [compiler, *STRICT, *flags, *names, "driver.c", "-o", "driver"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        self._program = folder / "driver"

    def size(self) -> int:
        """Return the size of the state."""
        return int(subprocess.run([self._program, "size"], check=True, capture_output=True, text=True).stdout)

    def run(self, readings: Floats, *before: str) -> Told:
        """Take readings (N,) from the start, after other commands."""
        lines = self.answers([*before, *(f"z {value.hex()}" for value in readings.tolist())])
        rows = [line.split() for line in lines]
        signal = np.array([float.fromhex(row[0]) for row in rows])
        modes = np.array([[float.fromhex(word) for word in row[2:]] for row in rows])
        return Told(signal, np.array([int(row[1]) for row in rows], np.int8), modes)

    def answers(self, commands: Sequence[str]) -> list[str]:
        """Return what the program says to commands."""
        text = "\n".join(commands).replace("nan", "nan ").replace("-inf", "-inf ")
        return subprocess.run(
            [self._program], input=text, check=True, capture_output=True, text=True
        ).stdout.splitlines()

    def expected(self, readings: Floats) -> Told:
        """Return what becalm's own stream tells of readings (N,)."""
        limits = (self.recipe.limits or LimitsRecipe()).model_copy(update={"largest": self.written.largest})
        recipe = Recipe(
            mode="causal",
            tuned_on=Origin(rate_hz=RATE_HZ),
            channel=(self.recipe.model_copy(update={"limits": limits}),),
        )
        told = StreamCleaner(recipe, 1 / RATE_HZ).push(readings[:, np.newaxis], np.ones(len(readings)))
        return Told(np.nan_to_num(told.signal[:, 0], nan=0.0), told.verdicts[:, 0], told.modes)

    def as_given(self, readings: Floats) -> Floats:
        """Return readings (N,) as its number type holds them."""
        return self.kind.in_unit(self.kind.raw(readings, self.written), self.written)


@cache
def program(recipe: str, number: NumberType, compiler: str = "cc", flags: tuple[str, ...] = ("-O2",)) -> Program:
    return Program(RECIPES[recipe], number, compiler, flags)


def record(rows: int, seed: int) -> Floats:
    """Return readings that rest, move, jump and grow loud."""
    rng = np.random.default_rng(seed)
    moves = np.sin(np.arange(rows) / 150 * np.pi) > 0
    z = 0.3 * np.cumsum(np.cumsum(0.02 * moves * rng.normal(size=rows)) * moves) + rng.normal(size=rows)
    z[rows // 2 :] += 25.0
    z[2 * rows // 3 :] -= 60.0
    z[3 * rows // 4 : 5 * rows // 6] += 4 * rng.normal(size=5 * rows // 6 - 3 * rows // 4)
    return z


def spoilt(rows: int, seed: int) -> Floats:
    """Return such readings with wild ones, and with some missing."""
    rng, z = np.random.default_rng(seed), record(rows, seed)
    wild = rng.random(rows) < 0.02
    z[wild] += 30 * rng.normal(size=int(wild.sum()))
    z[rng.random(rows) < 0.03] = np.nan
    z[:3], z[rows // 3 : rows // 3 + 40], z[rows // 5], z[rows // 7] = np.nan, np.nan, np.inf, 1e300
    return z


def made(kind: str, order: int) -> ChannelRecipe:
    """Return a recipe of a bank with the numbers that a search begins with."""
    z = record(6000, 1)
    evidence = Evidence.of(z, np.ones(len(z)))
    tuning = tune_motion(order, evidence)
    bank = {
        "resting": lambda: resting(tuning, evidence),
        "jumping": lambda: jumping(evidence, NONE_FAR),
        "noisy": lambda: noisy(tuning),
        "spiky": lambda: spiky(tuning, evidence),
    }[kind]()
    switching = bank.make(*(number.default for number in bank.numbers))
    modes = modes_in_seconds(Switched(kind, switching, 0.0, 0.0), 1 / RATE_HZ)  # type: ignore[arg-type]
    return in_seconds("a", "V", tuning, 1 / RATE_HZ).model_copy(update={"switching": modes})


def nervous(order: int, noise_std: float = 1.0) -> ChannelRecipe:
    """Return a recipe of a bank that hardly smooths, so that gaps are soon beyond its reach."""
    density = RATE_HZ ** (2 * order - 1) * noise_std**2

    def mode(name: str, loud: float) -> ModeRecipe:
        return ModeRecipe(
            name=name, order=order, process_noise_density=density, noise_std=loud * noise_std, lasts_s=5.0
        )

    switching = SwitchingRecipe(kind="noisy", mode=(mode("quiet", 1.0), mode("loud", 10.0)))
    return ChannelRecipe(
        name="a",
        model="motion",
        order=order,
        process_noise_density=density,
        noise_std=noise_std,
        switching=switching,
    )


LIMITS = LimitsRecipe(low=-300.0, high=300.0, stuck_readings=4)
RECIPES = {
    **{f"{kind} {order}": made(kind, order) for kind in KINDS for order in (1, 3)},
    "limited": made("spiky", 2).model_copy(update={"limits": LIMITS}),
    "nervous": nervous(3),
}


def one_noise(rows: int) -> Floats:
    return np.random.default_rng(0).normal(size=rows).astype(np.float32).astype(np.float64)
