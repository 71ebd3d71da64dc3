"""Live over every time of every real recording beside the project: the numbers of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.channels.faults import find_healthy
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, TimingRecipe
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.files import ReadOptions
from becalm.files.inputs.opening import OpenSource
from becalm.files.inputs.time_bases import open_file
from becalm.files.outputs.chunked_cleaning import rows_of_chunks
from becalm.live.address import Address
from becalm.live.block import Output
from becalm.live.protocols import EndOfStream
from becalm.live.sources.replay import ReplaySource
from becalm.live.stream import Stream
from stream_recipes import assert_same_numbers, streamed

DATA = Path(__file__).parents[2].parent / "shared" / "data"
ROWS = 40_000
FILES = {
    "broad/04_undisturbed_slow_rotation_with_breaks_A.mat": 2000 / 7,
    "broad/05_undisturbed_slow_rotation_with_breaks_B.hdf5": None,
    "broad/15_undisturbed_fast_translation_A.hdf5": None,
    "comma2k19/accelerometer.csv": None,
    "comma2k19/can_speed.csv": None,
    "comma2k19/gyroscope.csv": None,
    "css_mf4/00000003-60FEBB3B.MF4": None,
    "endaq/test1.IDE": None,
    "fusion/sensor_data.csv": None,
    "gaitmap/imu_sample.csv": 204.8,
    "gaitmap/mocap_sample.csv": 100.0,
    "imu_tk/xsens_acc.mat.txt.gz": None,
    "imu_tk/xsens_gyro.mat.txt.gz": None,
    "munich_bridge/reference_state_strain.csv.gz": None,
    "munich_bridge/support_load_strain.csv.gz": None,
    "px4/sample_log_small.ulg": None,
    "pyuff/MPSTD_Set001.uff": None,
}


def recipe_for(recording: Recording) -> Recipe:
    """Return filters that are not tuned: about as quick as a twentieth of the rate, some with a gate."""
    time = recording.timebase
    channels = []
    for number, name in enumerate(recording.names):
        z = np.ascontiguousarray(recording.channel(name))
        channels.append(channel_for(name, z, time.elapsed_steps, time.step_s, number))
    units = dict(zip(recording.names, recording.units, strict=True))
    told = tuple(channel.model_copy(update={"unit": units[channel.name]}) for channel in channels)
    return Recipe(mode="causal", tuned_on=Origin(rate_hz=time.rate_hz), channel=told)


def channel_for(name: str, z: Floats, elapsed: Floats, step_s: float, number: int) -> ChannelRecipe:
    seen = z[np.isfinite(z)]
    noise = float(np.median(np.abs(np.diff(seen)))) if len(seen) > 1 else 0.0
    noise = noise or (float(np.std(seen)) / 10 if len(seen) else 0.0)
    if not 1e-100 < noise < 1e100:
        return ChannelRecipe(name=name, model="constant")
    order = 1 + number % 3
    density = noise**2 * step_s * (2 * np.pi * 0.05 / step_s) ** (2 * order)
    return ChannelRecipe(
        name=name,
        model="motion",
        order=order,
        process_noise_density=float(density),
        noise_std=noise,
        limits=find_healthy(z, elapsed, step_s).limits,
        gate=GateRecipe() if number % 2 else None,
        timing=TimingRecipe(std_s=0.1 * step_s) if number % 5 == 0 else None,
        tuning_spread=0.1,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rate_hz"), FILES.items(), ids=FILES)
def test_live_over_a_real_recording_is_the_file(name: str, rate_hz: float | None) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    with open_file(path, ReadOptions() if rate_hz is None else ReadOptions(rate_hz=rate_hz)) as opened:
        assert opened.sources
        for source in opened.sources:
            recording = source.stretches([(0, min(ROWS, source.rows))])
            recipe, time = recipe_for(recording), recording.timebase
            cleaned = clean(recording, recipe)
            stream = StreamCleaner(recipe, time.step_s)
            got = streamed(stream, recording.samples, time.elapsed_steps, range(100, len(recording.samples), 1000))
            verdicts = np.column_stack([cleaned.verdicts[one] for one in recording.names])
            assert_same_numbers(got, Streamed(cleaned.signal.samples, cleaned.sigma.samples, verdicts))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rate_hz"), FILES.items(), ids=FILES)
def test_a_real_recording_replayed_whole_is_the_file(name: str, rate_hz: float | None) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    with open_file(path, ReadOptions() if rate_hz is None else ReadOptions(rate_hz=rate_hz)) as opened:
        for source in opened.sources:
            recipe = recipe_for(source.stretches([(0, min(ROWS, source.rows))]))
            options = {"rows": "5000", "group": source.group, "rate": "" if rate_hz is None else str(rate_hz)}
            told = {option: value for option, value in options.items() if value}
            got = replayed(ReplaySource(Address("replay", str(path), told)), recipe)
            assert len(got.signal) == source.rows
            assert_same_numbers(got, filed(source, recipe))


def replayed(source: ReplaySource, recipe: Recipe) -> Streamed:
    """Send all of a file through a stream."""
    source.open("")
    outputs: list[Output] = []
    try:
        assert source.step_s is not None
        stream = Stream(recipe, source.step_s)
        while (block := source.read(30.0)) is not None:
            outputs.append(stream.take(block))
    except EndOfStream:
        pass
    finally:
        source.close()
    return Streamed(
        np.concatenate([one.signal for one in outputs]),
        np.concatenate([one.sigma for one in outputs]),
        np.concatenate([one.verdicts for one in outputs]),
    )


def filed(source: OpenSource, recipe: Recipe) -> Streamed:
    """Send all of a file through the file's way, a chunk at a time."""
    told: list[list[EstimatedRows]] = []
    with Cleaner(recipe, source.clock.step_s) as cleaner:
        for chunk in source.chunks(rows_of_chunks(source, len(source.names))):
            told += cleaner.push([chunk.channel(k) for k in range(len(source.names))], chunk.elapsed_steps)
        told += cleaner.finish()
    columns = [
        EstimatedRows(*(np.concatenate(parts, axis=-1) for parts in zip(*one, strict=True)))
        for one in zip(*told, strict=True)
    ]
    return Streamed(
        np.column_stack([one.signal for one in columns]),
        np.column_stack([one.sigma for one in columns]),
        np.column_stack([one.verdicts for one in columns]),
    )


def _joined(chunks: tuple[EstimatedRows, ...]) -> EstimatedRows:
    return EstimatedRows(*(np.concatenate(parts, axis=-1) for parts in zip(*chunks, strict=True)))
