"""Run random cases on the filter in C that is compiled with sanitizers; `sanitized.py` starts this program."""

from __future__ import annotations

import faulthandler
import json
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import becalm
from becalm.cleaning.channels.channels import ChannelCleaner, open_channel
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import (
    CalibrationRecipe,
    ColouredNoiseRecipe,
    GateRecipe,
    LimitsRecipe,
    ModeRecipe,
    SwitchingRecipe,
    TimingRecipe,
    ToneRecipe,
)
from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.model.model import Model
from becalm.core.rows import EstimatedRows
from becalm.core.time.live_clock import LiveClock
from becalm.errors import BecalmError
from becalm.identification.modes.banks import Kind

COUNTED: Counter[str] = Counter()
EXAMPLES, MOST_ROWS, LONGEST_S = 60, 1200, 300.0
SPECIAL = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1.7e308, 1e150, 5e-324, 0.0, -0.0, 65535.0, 1e12)
STEPS = (0.0, 1e-9, 0.4, 1.02, 2.0, 17.0, 300.0, 1e5, 1e12, np.inf, np.nan)
magnitudes = st.floats(-9, 9).map(lambda power: 10.0**power)


class Rows(NamedTuple):
    """The input of a channel."""

    z: Floats  # readings
    elapsed: Floats  # steps before each reading
    cuts: list[int]  # first rows of the blocks after the first one


@st.composite
def rows(draw: st.DrawFn, unit: float = 1.0) -> Rows:
    """Draw readings of a channel that drifts and jumps, with holes and invalid values, and the steps before them."""
    count, rng = draw(st.integers(1, MOST_ROWS)), np.random.default_rng(draw(st.integers(0, 1 << 30)))
    z = np.cumsum(rng.normal(0, draw(st.sampled_from([0.0, 0.05, 0.5])), count)) + rng.normal(size=count)
    z = unit * (z + draw(st.sampled_from([0.0, 30.0, 1e6])))
    if draw(st.booleans()):
        z = np.round(z / unit) * unit
    elapsed = np.ones(count)
    places = st.integers(0, count - 1)
    for at, length in draw(st.lists(st.tuples(places, st.sampled_from([1, 2, 8, 70, 400])), max_size=4)):
        z[at : at + length] = np.nan
    for at, length in draw(st.lists(st.tuples(places, st.sampled_from([2, 5, 13, 90])), max_size=3)):
        z[at : at + length] = z[at]
    for at, value in draw(st.lists(st.tuples(places, st.sampled_from(SPECIAL)), max_size=6)):
        z[at] = value
    for at, height in draw(st.lists(st.tuples(places, st.floats(-1e4, 1e4)), max_size=4)):
        z[at:] += unit * height
    for at, step in draw(st.lists(st.tuples(places, st.sampled_from(STEPS)), max_size=5)):
        elapsed[at] = step
    if draw(st.booleans()):
        elapsed[rng.random(count) < 0.3] = draw(st.sampled_from([0.5, 1.5, 2.0, 3.0]))
    return Rows(z, elapsed, sorted(set(draw(st.lists(places, max_size=5)))))


@st.composite
def recipes(draw: st.DrawFn) -> tuple[ChannelRecipe, float]:
    """Draw a recipe of any kind, and its sampling interval in seconds."""
    rate_hz, noise = 10.0 ** draw(st.floats(-1, 4)), draw(magnitudes)

    def density(order: int) -> float:
        return float(noise**2 * rate_hz ** (2 * order - 1) * 10.0 ** draw(st.floats(-12, 3)))

    order = draw(st.integers(1, 5))
    few = st.integers(0, 2) if draw(st.booleans()) else st.just(0)
    tones = tuple(
        ToneRecipe(
            frequency_hz=rate_hz * draw(st.floats(0.01, 0.49)),
            bandwidth_hz=rate_hz * 10.0 ** draw(st.floats(-5, -1)),
            process_noise_density=rate_hz * noise**2 * 10.0 ** draw(st.floats(-6, 1)),
            disturbance=draw(st.booleans()),
        )
        for _ in range(draw(few))
    )
    coloured = draw(st.sampled_from([None, None, (0.6,), (0.5, -0.3)]))
    damped = draw(st.none() | st.floats(1e-5, 0.2).map(lambda share: share * rate_hz))
    modes, switching = draw(st.sampled_from([0, 0, 0, 1, 2, 3, 4, 6])), None
    if modes:
        kind: Kind = draw(st.sampled_from(get_args(Kind)))
        made = tuple(
            ModeRecipe(
                name=f"mode {k}",
                order=draw(st.integers(1, 3)),
                process_noise_density=density(1),
                level_noise_density=draw(st.sampled_from([0.0, noise**2 * rate_hz])),
                noise_std=noise * draw(st.sampled_from([1.0, 1.0, 7.0])),
                lasts_s=10.0 ** draw(st.floats(0, 4)) / rate_hz,
                wild_share=draw(st.sampled_from([0.0, 0.02])),
                damped_below_hz=damped,
                with_tones=draw(st.booleans()),
            )
            for k in range(modes)
        )
        switching = SwitchingRecipe(kind=kind, wild_std=30 * noise, rejects=draw(st.booleans()), mode=made)
    limited = draw(st.booleans())
    distances = draw(st.sampled_from([None, 9 * noise])), draw(st.sampled_from([None, 12 * noise]))
    limits = LimitsRecipe(
        low=draw(st.sampled_from([None, -50 * noise])),
        high=draw(st.sampled_from([None, 80 * noise])),
        resolution=draw(st.sampled_from([None, noise])),
        stuck_readings=draw(st.sampled_from([None, 2, 5, 40])),
        even_time=draw(st.sampled_from([None, True, False])),
        largest=draw(st.sampled_from([None, 1e9 * noise])),
        outlier_distance=distances[0],
        causal_outlier_distance=distances[1],
        plausible_low=-40 * noise,
        plausible_high=60 * noise,
        repeats_are_one=draw(st.booleans()),
        blank=draw(st.sampled_from([None, 0.0])),
        far_from_0=draw(st.sampled_from([None, 5 * noise])) if any(distances) else None,
        drift_threshold=draw(st.sampled_from([None, 20.0])),
        dead_variance=draw(st.sampled_from([None, 0.05])),
    )
    made_of = ChannelRecipe(
        name="a",
        model="motion",
        order=order,
        process_noise_density=density(order),
        noise_std=noise,
        damped_below_hz=damped,
        tone=tones,
        coloured_noise=coloured
        and ColouredNoiseRecipe(rate_hz=rate_hz, coefficients=coloured, std=noise * draw(st.floats(0.1, 3.0))),
        gate=None if switching else draw(st.sampled_from([None, GateRecipe(), GateRecipe(agree=2, at_most=3)])),
        switching=switching,
        limits=limits if limited else None,
        timing=draw(st.sampled_from([None, TimingRecipe(std_s=0.1 / rate_hz)])),
        calibration=draw(st.sampled_from([None, CalibrationRecipe(relative_std=0.01, offset_std=noise)])),
        spread_std=draw(st.sampled_from([None, 10 * noise])),
        tuning_spread=draw(st.sampled_from([0.0, 0.1])),
        fill=draw(st.booleans()),
    )
    return made_of, 1 / rate_hz


def estimated(channel: ChannelCleaner, given_it: Rows, cuts: list[int]) -> EstimatedRows:
    """Return all estimates of a channel for rows in blocks."""
    ends = [*cuts, len(given_it.z)]
    parts = [EstimatedRows.empty()]
    for begin, end in zip([0, *ends], ends, strict=False):
        parts += channel.push(given_it.z[begin:end], given_it.elapsed[begin:end])
    parts += channel.finish()
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))


def damaged(arrays: Any, places: list[tuple[int, int]]) -> Any:
    """Return a filter's saved state with some bytes changed in the parts that C reads."""
    if isinstance(arrays, dict):
        return {
            name: damaged(value, places) if name.endswith(("state", "modes")) else value
            for name, value in arrays.items()
        }
    if not isinstance(arrays, np.ndarray) or not arrays.size:
        return arrays
    content = bytearray(np.ascontiguousarray(arrays).tobytes())
    for at, value in places:
        content[at % len(content)] = value
    return np.frombuffer(bytes(content), arrays.dtype).reshape(arrays.shape)


def channel(draw: st.DataObject) -> None:
    """Run a channel of a recipe in one block and in several blocks, and then from a damaged state."""
    recipe, step_s = draw.draw(recipes())
    lag = draw.draw(st.sampled_from([0, 0, None, None, 1, 6, 40]))
    given_it = draw.draw(rows(recipe.noise_std or 1.0))
    watch(recipe.model_dump_json(), step_s, lag, given_it)
    try:
        whole, cut = (estimated(open_channel(recipe, step_s, lag), given_it, cuts) for cuts in ([], given_it.cuts))
    except BecalmError:
        COUNTED["channel, refused"] += 1
        return
    for name in ("signal", "sigma", "verdicts"):
        one, other = getattr(whole, name), getattr(cut, name)
        assert one.tobytes() == other.tobytes() or np.array_equal(one, other, equal_nan=True), f"{name} is cut"
    modes = ", modes" if recipe.switching else ""
    COUNTED["channel, " + ("causal" if lag == 0 else "smoothed" if lag is None else "lagged") + modes] += 1
    first, second = open_channel(recipe, step_s, lag), open_channel(recipe, step_s, lag)
    first.push(given_it.z, given_it.elapsed)
    held = first.state_dict()
    places = draw.draw(st.lists(st.tuples(st.integers(0, 1 << 14), st.integers(0, 255)), max_size=3))
    if held is None:
        return
    second.load_state_dict(held)  # an undamaged state must be accepted
    try:
        second.load_state_dict(damaged(held, places))
        second.push(given_it.z, given_it.elapsed)
        COUNTED["channel, restored"] += 1
    except (BecalmError, ValueError, KeyError):
        COUNTED["channel, not restored"] += 1


def model(draw: st.DataObject) -> None:
    """Run a model of some channels: live, filtered, smoothed, and resumed from a damaged snapshot."""
    n, m = draw.draw(st.integers(1, 10)), draw.draw(st.sampled_from([1, 1, 2, 3, 4]))
    rng = np.random.default_rng(draw.draw(st.integers(0, 1 << 30)))
    root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-6, 2, n)[:, np.newaxis]
    F = np.eye(n) + draw.draw(st.sampled_from([0.0, 0.1, 1.0])) * rng.normal(size=(n, n))
    more: dict[str, Any] = {}
    if draw.draw(st.booleans()):
        more = {
            "x0": rng.normal(size=n),
            "P0": np.diag(10.0 ** rng.uniform(-3, draw.draw(st.sampled_from([3, 18])), n)),
        }
    own = Model(F, rng.normal(size=(m, n)), root @ root.T, np.diag(10.0 ** rng.uniform(-6, 6, m)), **more)
    count = draw.draw(st.integers(1, 300))
    z = rng.normal(size=(count, m)) * 10.0 ** rng.uniform(-3, 3)
    z[rng.random((count, m)) < draw.draw(st.sampled_from([0.0, 0.05, 0.6]))] = np.nan
    for at, value in draw.draw(st.lists(st.tuples(st.integers(0, count - 1), st.sampled_from(SPECIAL)), max_size=4)):
        z[at, at % m] = value
    lag = draw.draw(st.sampled_from([0, 0, 1, 9]))
    gate = Gate(4.0, 3, 6) if m == 1 and draw.draw(st.booleans()) else None
    watch("model", F.tolist(), own, z.tolist(), lag, gate)
    try:
        online = becalm.Online(own, lag, gate)
        half = count // 2
        online.run(z[:half])
        for row in z[half:]:
            online.step(float(row[0]) if m == 1 else row)
        online.finish()
        for run in (becalm.kalman_filter, becalm.kalman_smoother):
            run(own, z)
    except (BecalmError, np.linalg.LinAlgError):
        COUNTED["model, refused"] += 1
        return
    COUNTED[f"model of {'one channel' if m == 1 else 'several channels'}"] += 1
    becalm.Online.resume(online.snapshot())  # an undamaged snapshot must be accepted
    blob = bytearray(online.snapshot())
    for at, value in draw.draw(st.lists(st.tuples(st.integers(0, 1 << 14), st.integers(0, 255)), max_size=3)):
        blob[at % len(blob)] = value
    try:
        becalm.Online.resume(bytes(blob)).run(z)
        COUNTED["model, resumed"] += 1
    except BecalmError:
        COUNTED["model, not resumed"] += 1


def clock(draw: st.DataObject) -> None:
    """Run the clock of a stream."""
    step_s = draw.draw(magnitudes)
    live_clock = LiveClock(step_s, draw.draw(st.sampled_from([0.0, 0.01, 0.3, 1.0, 5.0])) * step_s)
    count = draw.draw(st.integers(1, 500))
    stamps = step_s * np.arange(count, dtype=float)
    places = st.integers(0, count - 1)
    jumps = st.sampled_from([-1e9, -5.0, 0.3, 4.0, 1e7, 1e300, np.nan, np.inf, -np.inf])
    for at, jump in draw.draw(st.lists(st.tuples(places, jumps), max_size=6)):
        stamps[at : at + int(draw.draw(st.sampled_from([1, 9, count])))] += step_s * jump
    watch("clock", step_s, stamps.tolist())
    live_clock.process_stamps(stamps)
    COUNTED["clock"] += 1


def tuned(draw: st.DataObject) -> None:
    """Tune a record, and clean it."""
    unit = draw.draw(magnitudes)
    given_it = draw.draw(rows(unit))
    z = given_it.z[:500]
    watch("tuned", z.tolist())
    try:
        record = becalm.Recording(z[:, np.newaxis], names=["a"], rate_hz=100.0)
        becalm.clean(record, causal=draw.draw(st.booleans()))
        COUNTED["tuned and cleaned"] += 1
    except BecalmError:
        COUNTED["tuned, refused"] += 1


def watch(*what: object) -> None:
    """Write the next case to a file, for the report of a finding; end the program if the case takes too long."""
    faulthandler.dump_traceback_later(LONGEST_S, exit=True)
    Path(sys.argv[2]).write_text(repr(what), encoding="utf-8")


def main() -> None:
    """Run cases of each kind in turn until the time is over."""
    begin, until = int(sys.argv[3]), float(sys.argv[4])
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    np.set_printoptions(threshold=sys.maxsize)  # prints whole arrays, so that a case can be run again
    unhurried = settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    slow = settings(unhurried, max_examples=EXAMPLES // 20)
    kinds: tuple[tuple[Callable[..., None], settings], ...] = (
        *((channel, unhurried),) * 3,
        (model, unhurried),
        (clock, unhurried),
        (tuned, slow),
    )
    while time.time() < until:
        for case, how in kinds:
            if time.time() < until:
                seed(begin)(how(given(draw=st.data())(case)))()
            begin += 1
    Path(sys.argv[1]).write_text(json.dumps(COUNTED), encoding="utf-8")


if __name__ == "__main__":
    main()
