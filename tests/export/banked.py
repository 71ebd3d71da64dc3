"""Banks by their names, what becalm tells of their readings, and readings for them."""

from __future__ import annotations

from functools import cache

import numpy as np

from becalm.cleaning.channels.figures import modes_in_seconds
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe, ModeRecipe, SwitchingRecipe
from becalm.cleaning.recipes.steps import in_seconds
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.export.bundle import Bundle, Exported
from becalm.identification.likelihood import Evidence, tune_motion
from becalm.identification.modes.banks import bursting, jumping, noisy, resting, spiky
from driven import Told
from exported import WIDE_LIMITS, bundle, recipe_of

RATE_HZ = 200.0
_DAMPED_HZ = 0.5
KINDS = ("resting", "jumping", "noisy", "spiky", "bursting")
NAMES = (*(f"{kind} {order}" for kind in KINDS for order in (1, 3)), "limited", "nervous", "damped 1", "damped 3")


def told_of(name: str) -> ChannelRecipe:
    """Return a recipe by its name."""
    if name == "nervous":
        return nervous(3)
    if name == "limited":
        return made("spiky", 2).model_copy(update={"limits": WIDE_LIMITS})
    kind, order = name.split()
    if kind == "damped":
        return damped(made("bursting", int(order)))
    return made(kind, int(order))


@cache
def bundle_of_bank(name: str, precision: str) -> Bundle:
    """Write a bank by its name."""
    return bundle(told_of(name), rate_hz=RATE_HZ, precision=precision)


@cache
def bundle_of_banks(precision: str, *names: str) -> Bundle:
    """Write banks, all of them if none is named; their channels are called c0, c1, ... in that order."""
    named = [told_of(name).model_copy(update={"name": f"c{k}"}) for k, name in enumerate(names or NAMES)]
    return bundle(*named, rate_hz=RATE_HZ, precision=precision)


def expected(told: ChannelRecipe, one: Exported, readings: Floats) -> Told:
    """Return what becalm's own stream tells of readings (N,)."""
    limits = (told.limits or LimitsRecipe()).model_copy(update={"largest": one.kind.number.greatest})
    recipe = recipe_of(told.model_copy(update={"limits": limits}), rate_hz=RATE_HZ)
    found = StreamCleaner(recipe, 1 / RATE_HZ).push(readings[:, np.newaxis], np.ones(len(readings)))
    return Told(np.nan_to_num(found.signal[:, 0], nan=0.0), found.verdicts[:, 0], found.modes)


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


@cache
def made(kind: str, order: int) -> ChannelRecipe:
    """Return a recipe of a bank with the numbers that a search begins with."""
    z = record(6000, 1)
    evidence = Evidence.of(z, np.ones(len(z)))
    tuning = tune_motion(order, evidence)
    bank = {
        "resting": lambda: resting(tuning, evidence),
        "jumping": lambda: jumping(evidence),
        "noisy": lambda: noisy(tuning),
        "bursting": lambda: bursting(tuning, evidence),
        "spiky": lambda: spiky(tuning, evidence),
    }[kind]()
    switching = bank.make(*(number.default for number in bank.numbers))
    modes = modes_in_seconds(kind, switching, 1 / RATE_HZ)  # type: ignore[arg-type]
    return in_seconds("a", "V", tuning, 1 / RATE_HZ).model_copy(update={"switching": modes})


def damped(bank: ChannelRecipe) -> ChannelRecipe:
    """Return a recipe whose modes all return to a level of their own."""
    assert bank.switching is not None
    damping = {"damped_below_hz": _DAMPED_HZ}
    modes = tuple(mode.model_copy(update=damping) for mode in bank.switching.mode)
    return bank.model_copy(update={**damping, "switching": bank.switching.model_copy(update={"mode": modes})})


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


def one_noise(rows: int) -> Floats:
    return np.random.default_rng(0).normal(size=rows).astype(np.float32).astype(np.float64)
