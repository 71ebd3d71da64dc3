"""A file as a stream: the same rows and steps however they are cut, from any row on, at the pace that was asked."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError, UsageError
from becalm.files.inputs.opening import open_source
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.protocols import EndOfStream
from becalm.live.sources.replay import ReplaySource

_DATA = Path(__file__).parents[2].parent / "shared" / "data"
_REAL = [
    "comma2k19/accelerometer.csv",
    "fusion/sensor_data.csv",
    "gaitmap/imu_sample.csv?rate=204.8",
    "munich_bridge/support_load_strain.csv.gz",
    "endaq/test1.IDE?group=40g DC Acceleration",
]


def _source(text: str) -> ReplaySource:
    return ReplaySource(Address.parsed(f"replay:{text}"))


def _blocks(source: ReplaySource, position: str = "", most: int | None = None) -> list[Block]:
    """Read all blocks, or the first ones."""
    blocks: list[Block] = []
    source.open(position)
    try:
        while most is None or len(blocks) < most:
            block = source.read(10.0)
            assert block is not None
            blocks.append(block)
    except EndOfStream:
        pass
    finally:
        source.close()
    return blocks


def _joined(blocks: list[Block]) -> tuple[np.ndarray, ...]:
    elapsed = [block.elapsed for block in blocks if block.elapsed is not None]
    return tuple(map(np.concatenate, ([b.time_s for b in blocks], [b.values for b in blocks], elapsed)))


def test_all_rows_of_a_file_come(drive: Path) -> None:
    source = _source(f"{drive}?rows=64")
    blocks = _blocks(source)
    assert [len(block) for block in blocks] == [64] * 6 + [16]
    assert blocks[0].names == source.names == ("ramp (m/s)", "walk")
    assert blocks[0].units == ("m/s", "")
    assert source.rate_hz == pytest.approx(100.0)
    assert source.step_s == pytest.approx(0.01)
    assert all(block.values.flags.c_contiguous for block in blocks)
    time_s, values, elapsed = _joined(blocks)
    np.testing.assert_allclose(time_s, np.arange(400) / 100, atol=1e-12)
    np.testing.assert_array_equal(elapsed, [0.0, *[1.0] * 399])
    with open_source(drive) as file:
        np.testing.assert_array_equal(values, file.recording().samples)


@pytest.mark.parametrize("name", _REAL)
@pytest.mark.parametrize("rows", [7001, 100_000])
def test_real_files_have_the_steps_that_clean_sees(name: str, rows: int) -> None:
    file, _, more = name.partition("?")
    if not (_DATA / file).exists():
        pytest.skip("the real recordings are not beside this project")
    source = _source(f"{_DATA / file}?rows={rows}" + (f"&{more}" if more else ""))
    _, values, elapsed = _joined(_blocks(source))
    source.open("")
    assert source._file is not None
    told = source._file.recording()
    steps = source._file.elapsed_steps(0, len(elapsed))
    source.close()
    np.testing.assert_array_equal(values, told.samples)
    np.testing.assert_array_equal(elapsed, steps)


def test_true_stamps_with_a_gap_go_on_as_if_never_stopped(tmp_path: Path) -> None:
    file = tmp_path / "gap.csv"
    stamps = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.015, 300))
    stamps[150:] += 7.0
    file.write_text("time_s,a\n" + "".join(f"{t:.6f},{k}.5\n" for k, t in enumerate(stamps)), encoding="utf-8")
    source = _source(f"{file}?rows=40")
    whole = _joined(_blocks(source))
    np.testing.assert_allclose(whole[0], stamps, atol=1e-6)
    before = _blocks(source, most=3)
    again = _joined([*before, *_blocks(source, before[-1].position)])
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_it_ends_where_it_ended(drive: Path) -> None:
    source = _source(str(drive))
    assert _blocks(source, _blocks(source)[-1].position) == []
    with pytest.raises(EndOfStream):
        source.read(0.0)


def test_a_changed_file_is_not_taken_for_the_old(drive: Path) -> None:
    source = _source(f"{drive}?rows=10")
    position = _blocks(source, most=1)[0].position
    text = drive.read_text(encoding="utf-8")
    drive.write_text(text[:-3] + "9" + text[-2:], encoding="utf-8")
    with pytest.raises(InputError, match="is not the file that the stream stopped in"):
        source.open(position)
    with pytest.raises(InputError, match="is not a position of replay:"):
        source.open("17")


def test_it_keeps_the_pace_of_the_file(drive: Path) -> None:
    source = _source(f"{drive}?speed=10&rows=100")
    source.open("")
    began = time.monotonic()
    assert source.read(0.0) is None  # a second of the recording has not gone by
    block = None
    while block is None:
        block = source.read(5.0)
    assert time.monotonic() - began >= 0.099
    assert len(block) == 100
    source.close()


@pytest.mark.parametrize(("speed", "rows"), [("max", 400), ("1", 1), ("100", 100)])
def test_blocks_fit_the_pace(drive: Path, speed: str, rows: int) -> None:
    assert len(_blocks(_source(f"{drive}?speed={speed}"), most=1)[0]) == rows


def test_rows_may_be_counted(drive: Path) -> None:
    source = _source(f"{drive}?rate=50&channels=walk&rows=400")
    (block,) = _blocks(source)
    assert block.names == ("walk",)
    np.testing.assert_allclose(block.time_s, np.arange(400) / 50)
    assert source.rate_hz == 50.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "names no file"),
        ("x.csv?speed=fast", "speed=fast"),
        ("x.csv?speed=-1", "speed=-1"),
        ("x.csv?rows=0", "rows=0"),
        ("x.csv?pace=1", "no option 'pace'"),
    ],
)
def test_impossible_wishes_are_refused(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        _source(text)


def test_what_a_file_needs_to_be_told_is_said_as_it_is_told_here(tmp_path: Path) -> None:
    file = tmp_path / "timeless.csv"
    file.write_text("a,b\n" + "".join(f"{k % 7}.5,{k % 5}.25\n" for k in range(20)), encoding="utf-8")
    with pytest.raises(InputError, match=r"or give \?rate=HZ to count rows"):
        _source(str(file)).open("")


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        _source(str(tmp_path / "absent.csv")).open("")


def test_a_pipe_is_no_file_to_replay() -> None:
    with pytest.raises(InputError, match="stdin:"):
        _source("/dev/null").open("")
