"""Read a text file that is too large for memory as blocks of UTF-8 lines, as often as needed."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import IO, cast

from becalm.errors import InputError
from becalm.files.decoding import (
    BOMS,
    CUT_ARCHIVE,
    CUT_CHARACTER,
    GZIP,
    Gunzip,
    damaged_text,
    explain_read_errors,
    read_bytes,
    refuse_binary,
    refuse_empty_archive,
    refuse_nul,
    refuse_other_formats,
    without_open_line,
)
from becalm.files.library_reader import refuse_claim

WHOLE_BYTES = 64 << 20
"""Text files up to this size, unpacked, are read into memory."""

BLOCK_BYTES = 16 << 20  # unpacked bytes that are read at once
_LONGEST_BYTES = 256 << 20  # bytes of the longest line that is accepted
_GZIP_RATIO = 8  # gzip seldom compresses tables of numbers by more than this factor


class OtherEncodingError(Exception):
    """The text is not in the assumed encoding; reading must start again with another one."""


def is_large(path: Path, head: bytes) -> bool:
    """Return whether a text file is larger than `WHOLE_BYTES`, unpacked, and must be read in blocks."""
    with explain_read_errors(path):
        size = path.stat().st_size
        if not head.startswith(GZIP):
            return size > WHOLE_BYTES
        with path.open("rb") as file:
            file.seek(max(0, size - 4))
            trailer_size = int.from_bytes(file.read(4), "little")  # unpacked size of the last gzip member, modulo 4 GB
        if size * _GZIP_RATIO > WHOLE_BYTES or trailer_size > WHOLE_BYTES:
            return True
        with Gunzip(path, "rb") as unpacked:
            blocks = _blocks(cast(IO[bytes], unpacked))
            return sum(len(block) for block in islice(blocks, WHOLE_BYTES // BLOCK_BYTES + 1)) > WHOLE_BYTES


class TextFile:
    """A text file, compressed or not, in any of the usual encodings.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    encoding : str
        As in `TextLayout`; UTF-8 until another encoding is detected.
    compression : str
        "gzip" or "".
    cut : str
        A sentence that says that the file is truncated; "" if it is complete, or not read to its end yet.

    Raises
    ------
    InputError
        If the file is not text, here or while lines are read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.compression = "gzip" if read_bytes(path, 2) == GZIP else ""
        with explain_read_errors(path), self._open() as file:
            head = file.read(4096)
        if self.compression:
            refuse_empty_archive(path, head)
        refuse_other_formats(path, head)
        self._mark, self._codec, self.encoding = b"", "utf-8", "utf-8"
        self.cut = ""
        for mark, codec, name in BOMS:
            if head.startswith(mark):
                self._mark, self._codec, self.encoding = mark, codec, name

    def assume_western(self) -> None:
        """Decode the text as cp1252 from now on, or as latin-1 if it already was cp1252."""
        self._codec = "latin-1" if self._codec == "cp1252" else "cp1252"
        self.encoding = "cp1252"

    def lines(self) -> Iterator[bytes]:
        """Yield the text as UTF-8 without a byte-order mark, in blocks of whole lines.

        Only the last line may have no line end; if the file is truncated, such a line is left out.

        Raises
        ------
        OtherEncodingError
            If the text is in another encoding: call `assume_western`, and read the lines again.
        InputError
            If the file is damaged, or has a line of more than 256 MiB.
        """
        rest = b""
        for block in self._blocks():
            held = rest + block
            end = held.rfind(b"\n") + 1 or held.rfind(b"\r", 0, len(held) - 1) + 1
            if end:
                yield held[:end]
            rest = held[end:]
            if len(rest) > _LONGEST_BYTES:
                raise InputError(
                    f"{self._path} has a line of over {_LONGEST_BYTES >> 20} MB; a table has shorter ones."
                )
        if self.cut:
            rest = without_open_line(rest)
        if rest:
            yield rest

    def _blocks(self) -> Iterator[bytes]:
        decoder = codecs.getincrementaldecoder(self._codec)()
        lines = count = 0
        certain, rest = self._mark != b"", b""
        size = self._path.stat().st_size
        with explain_read_errors(self._path), self._open() as file:
            file.read(len(self._mark))
            for data in _blocks(file):
                count += len(data)
                refuse_claim(self._path, count, size)
                block = self._as_utf8(decoder, data)
                if lines:
                    refuse_nul(self._path, block, lines)
                else:
                    refuse_binary(self._path, block)
                lines += block.count(b"\n")
                rest = decoder.getstate()[0]
                certain = certain or not block[: max(0, len(block) - len(rest))].isascii()
                yield block
            archive_cut = isinstance(file, Gunzip) and file.cut
        if rest and not (certain or archive_cut):  # the last bytes are letters of another encoding
            raise OtherEncodingError
        self.cut = CUT_ARCHIVE if archive_cut else CUT_CHARACTER if rest else ""

    def _as_utf8(self, decoder: codecs.IncrementalDecoder, data: bytes) -> bytes:
        if self._codec == "utf-8" and data.isascii() and not decoder.getstate()[0]:
            return data
        try:
            text = decoder.decode(data)
        except UnicodeError as cause:
            if self._mark:
                raise damaged_text(self._path, self._codec, cause) from cause
            raise OtherEncodingError from cause
        return data if self._codec == "utf-8" else text.encode("utf-8")

    def _open(self) -> IO[bytes]:
        return cast(IO[bytes], Gunzip(self._path, "rb")) if self.compression else self._path.open("rb")


def _blocks(file: IO[bytes]) -> Iterator[bytes]:
    return iter(lambda: file.read(BLOCK_BYTES), b"")


def rows_of_text(blocks: Iterable[bytes], separator: str) -> Iterator[bytes]:
    """Yield blocks without blank lines at the end of the text; if spaces separate cells, join runs of spaces.

    Parameters
    ----------
    blocks : iterable of bytes
        Whole lines of data.
    separator : str
        The separator, as in `Dialect`.
    """
    blank = b" \r\n\x1a" if separator == "\t" else b" \t\r\n\x1a"
    held = b""
    for block in blocks:
        if held.strip(blank) and block.strip(blank):
            yield _joined_spaces(held, separator)
            held = b""
        held += block
    yield _joined_spaces(held.rstrip(blank), separator) + b"\n"


def _joined_spaces(block: bytes, separator: str) -> bytes:
    if separator != " ":
        return block
    block = re.sub(rb"(?:^|(?<=[\r\n]))[ \t]+|[ \t]+(?=[\r\n]|\Z)", b"", block)
    return re.sub(rb"[ \t]+", b" ", block)
