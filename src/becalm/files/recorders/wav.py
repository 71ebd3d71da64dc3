"""Read WAV files of sound cards and vibration recorders; samples are fractions of full scale."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.errors import InputError
from becalm.files.column_statistics import Column
from becalm.files.groups import Group, tables
from becalm.files.library_reader import LibraryFile
from becalm.files.source import FormatTime, RawTable

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE  # codings of samples; with the last, a later field has the coding
_UNKNOWN = (0, 0xFFFFFFFF)  # lengths written by a recorder that was not stopped, or that writes to a pipe
_BEHIND = re.compile(rb"LIST|bext|iXML|id3 |ID3 |cue |fact|smpl|inst|axml|chna|JUNK|junk|PAD |peak|PEAK|umid|_PMX")
"""Names of the chunks that may follow samples."""

_TAIL_BYTES = 1 << 20  # bytes at the end in which such chunks are searched
_MOST_FORMAT = 1024  # most bytes of the format that are read; it has 16 to 40
_SCALE = "Samples are fractions of full scale, 1.0; a WAV file does not contain the sensor's unit and scale."


class _Sound(NamedTuple):
    """The header of a file."""

    order: str  # byte order, as in struct
    format: bytes
    start: int  # offset of the samples, in bytes
    length: int  # bytes of samples that are in the file
    complete: bool

    def field(self, kind: str, offset: int) -> int:
        return int(struct.unpack_from(self.order + kind, self.format, offset)[0])

    @property
    def coding(self) -> int:
        tag = self.field("H", 0)
        return self.field("H", 24) if tag == _EXTENSIBLE and len(self.format) >= 40 else tag


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the table of a WAV file.

    Raises
    ------
    InputError
        If it is damaged, or its samples are not plain numbers.
    """
    library_file = LibraryFile(path, "WAV")
    decoder = library_file.library("scipy.io.wavfile")
    with library_file.explain_damage():
        sound = _header(library_file)
        channels, rate_hz, width = sound.field("H", 2), sound.field("I", 4), sound.field("H", 12)
        if sound.coding not in (_PCM, _FLOAT):
            raise InputError(
                f"{path} is a WAV file whose samples are packed (coding {sound.coding:#x}); only plain numbers (PCM or"
                " float) are read. Save it as PCM."
            )
        if not (channels and rate_hz and width) or width % channels:
            raise ValueError(f"{channels} channels of {width} bytes at {rate_hz} Hz")
        whole = sound.coding == _PCM
        kept: list[tuple[int, int, NDArray[np.generic]]] = []

        def samples(first: int, last: int) -> NDArray[np.generic]:
            """Read rows, (n, channels), and keep them, because the next column needs the same rows."""
            if not kept or kept[0][:2] != (first, last):
                with path.open("rb") as file:
                    file.seek(sound.start + first * width)
                    data = file.read((last - first) * width)
                _, values = decoder.read(io.BytesIO(_little_file(sound, data)))
                kept[:] = [(first, last, _scaled(values).reshape(-1, channels))]
            return kept[0][2]

        rows = sound.length // width
        kind = pa.from_numpy_dtype(samples(0, min(rows, 1)).dtype)
        columns = {
            name: Column(kind, lambda first, last, number=number: samples(first, last)[:, number])  # type: ignore[misc]
            for number, name in enumerate([f"channel_{number}" for number in range(1, channels + 1)])
        }
        notes = (
            () if sound.complete else (f"The file ends before its samples do; {rows} rows are whole and were read.",)
        )
        group = Group("", columns, rows, FormatTime(rate_hz=float(rate_hz)), (_SCALE,) * whole + notes)
        return tables(library_file, "wav", (group,))


def _header(library_file: LibraryFile) -> _Sound:
    size = library_file.path.stat().st_size
    with library_file.path.open("rb") as file:
        mark = file.read(12)[:4]
        order = ">" if mark == b"RIFX" else "<"
        form, long_length = b"", None
        for name, start, length in _chunks(file, order, size):
            if name == b"ds64":
                long_length = struct.unpack_from("<Q", file.read(16), 8)[0]
            elif name == b"fmt ":
                form = file.read(min(length, _MOST_FORMAT))
                if len(form) < 16:
                    raise ValueError("its format is cut off")
            elif name == b"data":
                if not form:
                    raise ValueError("its samples come before their format")
                claimed = long_length if length == 0xFFFFFFFF and long_length else length
                available = size - start
                unknown = claimed in _UNKNOWN
                held = _samples_bytes(file, order, start, size) if unknown else min(claimed, available)
                return _Sound(order, form, start, held, not unknown and claimed <= available)
    raise ValueError("there are no samples in it")


def _samples_bytes(file: BinaryIO, order: str, start: int, size: int) -> int:
    """Return the bytes of samples whose length is unknown: up to the chunks that reach to the end, or to the end."""
    first = max(start, size - _TAIL_BYTES)
    file.seek(first)
    tail = file.read()
    for found in _BEHIND.finditer(tail):
        at = found.start()
        while at + 8 <= len(tail) and tail[at : at + 4].isascii():
            at += 8 + (length := int(struct.unpack_from(order + "I", tail, at + 4)[0])) + length % 2
        if at in (len(tail), len(tail) + 1):  # the last byte that evens a length may be missing
            return first + found.start() - start
    return size - start


def _chunks(file: BinaryIO, order: str, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the name, offset and length of each chunk, with the file positioned at its content."""
    at = 12
    while at + 8 <= size:
        file.seek(at)
        name, length = struct.unpack(order + "4sI", file.read(8))
        yield name, at + 8, length
        at += 8 + length + length % 2


def _little_file(sound: _Sound, data: bytes) -> bytes:
    """Return a WAV file in memory with only the given samples, for the library to decode."""
    mark = b"RIFX" if sound.order == ">" else b"RIFF"
    form, pad = sound.format, bytes(len(data) % 2)
    body = b"WAVEfmt " + struct.pack(sound.order + "I", len(form)) + form + bytes(len(form) % 2)
    body += b"data" + struct.pack(sound.order + "I", len(data)) + data + pad
    return mark + struct.pack(sound.order + "I", len(body)) + body


def _scaled(values: NDArray[np.generic]) -> NDArray[np.floating]:
    """Return samples as fractions of full scale, from -1 to 1; floats stay unchanged."""
    if values.dtype.kind == "f":
        return values.astype(values.dtype.newbyteorder("="))
    if values.dtype.kind == "u":  # up to 8 bits, with zero at 128
        return (values.astype(np.float64) - 128.0) / 128.0
    return values.astype(np.float64) / 2.0 ** (8 * values.dtype.itemsize - 1)
