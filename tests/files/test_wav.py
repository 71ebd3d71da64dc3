"""WAV: every width of number, either order of bytes; cut, lying and packed files."""

from __future__ import annotations

import io
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import wavfile

import becalm
from becalm.errors import BecalmError, InputError
from becalm.files import ReadOptions, open_source
from becalm.files.registry import read_tables

ROWS = 300
WAVES = np.random.default_rng(8).uniform(-1, 1, (ROWS, 2))


def wav(samples: NDArray[Any], rate_hz: int = 8000) -> bytes:
    held = io.BytesIO()
    wavfile.write(held, rate_hz, samples)
    return held.getvalue()


def packed(data: bytes, width: int, mark: bytes = b"RIFF", tag: int = 1, length: int | None = None) -> bytes:
    """Return a file of one channel, `width` bytes a sample."""
    order = ">" if mark == b"RIFX" else "<"
    form = struct.pack(order + "HHIIHH", tag, 1, 1000, 1000 * width, width, 8 * width)
    count = len(data) if length is None else length
    long = b"ds64" + struct.pack("<IQQQI", 28, 0, len(data), 0, 0) if mark in (b"RF64", b"BW64") else b""
    body = b"WAVE" + long + b"fmt " + struct.pack(order + "I", 16) + form
    body += b"LIST" + struct.pack(order + "I", 5) + b"hello\0" + b"data" + struct.pack(order + "I", count) + data
    return mark + struct.pack(order + "I", len(body)) + body


def written(folder: Path, data: bytes) -> Path:
    path = folder / "sound.bin"  # the content decides
    path.write_bytes(data)
    return path


WIDTHS = {"i2": 2**15, "i4": 2**31, "i8": 2**63, "f4": 1, "f8": 1}


@pytest.mark.parametrize(("kind", "full"), WIDTHS.items(), ids=WIDTHS.keys())
def test_numbers_come_back_as_parts_of_full_scale(kind: str, full: int, tmp_path: Path) -> None:
    numbers = (WAVES * (full - 1) if full > 1 else WAVES).astype(kind)
    read = becalm.read(written(tmp_path, wav(numbers)))
    np.testing.assert_array_equal(read.samples, numbers.astype(np.float64) / full)
    assert read.names == ("channel_1", "channel_2")
    assert read.rate_hz == 8000
    assert read.timebase.uniform


def test_eight_bits_lie_around_their_middle(tmp_path: Path) -> None:
    read = becalm.read(written(tmp_path, wav(np.array([0, 64, 128, 255] * 5, np.uint8))))
    assert read.samples[:4, 0].tolist() == [-1.0, -0.5, 0.0, 127 / 128]


@pytest.mark.parametrize("mark", [b"RIFF", b"RIFX", b"RF64", b"BW64"])
def test_24_bits_in_either_order(mark: bytes, tmp_path: Path) -> None:
    counts = [-(2**23), -1, 0, 1, 2**23 - 1] * 3
    data = b"".join(one.to_bytes(3, "big" if mark == b"RIFX" else "little", signed=True) for one in counts)
    length = 0xFFFFFFFF if mark in (b"RF64", b"BW64") else None
    with open_source(written(tmp_path, packed(data, 3, mark=mark, length=length))) as source:
        assert source.recording().samples[:, 0].tolist() == [one / 2**23 for one in counts]
        assert source.rate_hz == 1000


def test_big_endian_floats(tmp_path: Path) -> None:
    data = packed(WAVES[:, 0].astype(">f4").tobytes(), 4, mark=b"RIFX", tag=3)
    np.testing.assert_array_equal(becalm.read(written(tmp_path, data)).samples[:, 0], WAVES[:, 0].astype(np.float32))


def test_extensible_format(tmp_path: Path) -> None:
    guid = struct.pack("<H", 1) + bytes.fromhex("000000001000800000aa00389b71")
    form = struct.pack("<HHIIHHHHI", 0xFFFE, 1, 1000, 2000, 2, 16, 22, 16, 0) + guid
    data = np.arange(20, dtype="<i2").tobytes()
    body = b"WAVEfmt " + struct.pack("<I", 40) + form + b"data" + struct.pack("<I", len(data)) + data
    read = becalm.read(written(tmp_path, b"RIFF" + struct.pack("<I", len(body)) + body))
    assert read.samples[:, 0].tolist() == [one / 2**15 for one in range(20)]


def test_the_unit_is_said_to_be_outside(tmp_path: Path) -> None:
    (table,) = read_tables(written(tmp_path, wav((WAVES * 99).astype("i2"))))
    assert "full scale" in table.notes[0]
    assert table.units == {"time_s": "s"}
    (table,) = read_tables(written(tmp_path, wav(WAVES)))
    assert table.notes == ()


def test_a_rate_from_the_command_line_is_that_of_the_written_time(tmp_path: Path) -> None:
    path = written(tmp_path, wav(WAVES.astype(np.float32)))
    with open_source(path, ReadOptions(rate_hz=16_000.0)) as source:
        assert source.rate_hz == 16_000.0
        np.testing.assert_array_equal(source.table()["time_s"].to_numpy(), np.arange(ROWS) * (1 / 16_000))


def test_a_chunk_is_a_slice_of_the_whole(tmp_path: Path) -> None:
    with open_source(written(tmp_path, wav((WAVES * 32767).astype("i2")))) as source:
        whole = source.recording().samples
        for chunk in source.chunks(77):
            np.testing.assert_array_equal(chunk.samples, whole[chunk.first_row : chunk.first_row + len(chunk)])


@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_cut_file_gives_its_whole_rows_and_says_so(tenth: int, tmp_path: Path) -> None:
    counts = (WAVES * 32767).astype("i2")
    data = wav(counts)
    cut = len(data) * tenth // 10 + 1
    path, rows = written(tmp_path, data[:cut]), (cut - 44) // 4
    np.testing.assert_array_equal(becalm.read(path).samples, counts[:rows] / 2**15)
    (table,) = read_tables(path)
    assert any(f"{rows} rows are whole" in note for note in table.notes)


@pytest.mark.parametrize("length", [0, 0xFFFFFFFF])
def test_a_recorder_that_was_not_stopped(length: int, tmp_path: Path) -> None:
    data = packed(np.arange(50, dtype="<i2").tobytes(), 2, length=length)
    (table,) = read_tables(written(tmp_path, data))
    assert table.count == 50
    assert any("50 rows are whole" in note for note in table.notes)


@pytest.mark.parametrize("length", [0, 0xFFFFFFFF])
def test_what_a_recorder_wrote_behind_its_samples_is_no_sound(length: int, tmp_path: Path) -> None:
    data = packed(np.arange(50, dtype="<i2").tobytes(), 2, length=length)
    more = b"LIST" + struct.pack("<I", 12) + b"INFOISFT\0\0\0\0" + b"id3 " + struct.pack("<I", 3) + b"abc\0"
    (table,) = read_tables(written(tmp_path, data + more))
    assert table.count == 50


BAD = {
    "packed": (packed(bytes(64), 1, tag=7), "Save it as PCM"),
    "no samples": (packed(b"", 2), "no channel with rows"),
    "no format": (b"RIFF\x28\0\0\0WAVEdata\x10\0\0\0" + bytes(40), "damaged WAV"),
    "no channels": (
        packed(bytes(64), 2).replace(struct.pack("<HHI", 1, 1, 1000), struct.pack("<HHI", 1, 0, 1000)),
        "damaged",
    ),
    "only a head": (b"RIFF\x28\0\0\0WAVE", "no samples"),
    "half a format": (b"RIFF\x28\0\0\0WAVEfmt \x10\0\0\0\1\0\1\0", "cut off"),
    "600-bit numbers": (packed(bytes(6000), 75), "damaged WAV"),
}


@pytest.mark.parametrize(("data", "says"), BAD.values(), ids=BAD.keys())
def test_what_is_no_recording_is_refused(data: bytes, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        becalm.read(written(tmp_path, data))


def test_mutants_are_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(44)
    whole = wav((WAVES[:40] * 32767).astype("i2"))
    for _ in range(200):
        data = bytearray(whole)
        for at in rng.integers(0, 60, rng.integers(1, 5)):
            data[at] = rng.integers(256)
        path = written(tmp_path, bytes(data))
        with suppress(BecalmError):
            becalm.read(path)
