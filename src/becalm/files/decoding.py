"""Decode the bytes of a text file: detect compression and encoding, and refuse files that are not text."""

from __future__ import annotations

import codecs
import gzip
import hashlib
import io
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.library_reader import refuse_claim

GZIP = b"\x1f\x8b"  # the first bytes of a gzip file
PARQUET = b"PAR1"  # the first and the last bytes of a Parquet file

READS = "becalm reads CSV (also gzipped), Parquet, MF4, TDMS, UFF58, MAT, HDF5, NPZ, WAV, ROS bags, MCAP, ULog and IDE."

_OTHER_FORMATS: tuple[tuple[bytes, str], ...] = (  # first bytes, and name in messages
    (b"PK\x03\x04", "a ZIP archive or an Excel workbook"),
    (b"\xd0\xcf\x11\xe0", "an old Excel or Office file"),
    (b"\x89PNG", "a picture"),
    (b"%PDF", "a PDF document"),
    (b"ARROW1", "an Arrow (Feather) file"),
    (b"\x28\xb5\x2f\xfd", "a file compressed with zstd"),
    (b"BZh", "a file compressed with bzip2"),
    (b"\xfd7zXZ", "a file compressed with xz"),
)

BOMS: tuple[tuple[bytes, str, str], ...] = (  # byte-order mark, codec, and name of the encoding
    (b"\xef\xbb\xbf", "utf-8", "utf-8-bom"),
    (b"\xff\xfe", "utf-16-le", "utf-16-le"),
    (b"\xfe\xff", "utf-16-be", "utf-16-be"),
)

CUT_ARCHIVE = (
    "The gzip file ends too early and is read up to its last whole line. The file is incomplete; copy or download it"
    " again if the original is longer."
)
CUT_CHARACTER = "The file is incomplete: its text ends within a character. The last line is left out."

_BLOCK = 1 << 20  # bytes to unpack between two checks of the total size
_PART = 1 << 16  # most bytes to unpack with one call
_CONTROL = bytes(set(range(32)) - set(b"\t\n\r\f\v\x1a"))  # control characters that do not occur in text


@dataclass(frozen=True)
class Text:
    """The text of a file as UTF-8 bytes without a byte-order mark, and how the file stores it.

    If the file is truncated, `cut` is a sentence that says so and `data` has whole lines only; otherwise `cut` is "".
    """

    data: bytes
    encoding: str
    compression: str
    cut: str = ""


class Gunzip(gzip.GzipFile):
    """A gzip file that can be truncated; then it is unpacked up to the truncation.

    Attributes
    ----------
    cut : bool
        Whether the file is truncated; valid once the file was read to its end.
    """

    cut = False
    _some = False  # whether a byte was read before

    def read(self, size: int | None = -1) -> bytes:
        """Read `size` bytes, fewer only at the end or where the file is truncated.

        Raises
        ------
        EOFError
            If the file is truncated before its first byte of content.
        """
        out = bytearray()
        wanted = sys.maxsize if size is None or size < 0 else size
        while len(out) < wanted and not self.cut:
            try:
                part = self.read1(min(_PART, wanted - len(out)))  # unlike read, it loses no bytes before a truncation
            except EOFError:
                if not (self._some or out):
                    raise
                self.cut = True
                break
            if not part:
                break
            out += part
        self._some = self._some or bool(out)
        return bytes(out)


def read_bytes(path: Path, most: int | None = None) -> bytes:
    """Read a whole file, or its first `most` bytes.

    Raises
    ------
    InputError
        If the file is missing, a directory, unreadable or empty.
    """
    with explain_read_errors(path):
        if most is None:
            data = path.read_bytes()
        else:
            with path.open("rb") as file:
                data = file.read(most)
    if not data:
        raise InputError(f"{path} is empty (0 bytes); a header and two or more rows are needed.")
    return data


@contextmanager
def explain_read_errors(path: Path) -> Iterator[None]:
    """Turn errors of the system and of gzip into an InputError that explains why a file cannot be read.

    Raises
    ------
    InputError
        If the file is missing, a directory, unreadable, or a damaged archive.
    """
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; give the path of a recording.") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; give the path of one file in it.") from None
    except PermissionError:
        raise InputError(f"{path} may not be read; change its permissions (`chmod u+r`).") from None
    except EOFError:
        raise InputError(f"{path} is a gzip file that ends too early; copy or download it again.") from None
    except (gzip.BadGzipFile, zlib.error) as cause:
        raise InputError(f"{path} is a damaged gzip file ({cause}); copy or download it again.") from cause
    except (OSError, ValueError) as cause:
        raise InputError(f"{path} cannot be read: {getattr(cause, 'strerror', None) or cause}.") from cause


def decode(path: Path, data: bytes) -> Text:
    """Uncompress and decode the bytes of a text file.

    Raises
    ------
    InputError
        If the bytes are a damaged archive, another format, or not text.
    """
    compression = cut = ""
    if data.startswith(GZIP):
        data, cut = _gunzip(path, data)
        compression = "gzip"
    refuse_other_formats(path, data)
    for mark, codec, name in BOMS:
        if data.startswith(mark):
            (data, rest), encoding = _recode(path, data[len(mark) :], codec), name
            break
    else:
        refuse_binary(path, data)
        data, rest, encoding = _without_mark(data, surely_cut=cut != "")
    cut = cut or (CUT_CHARACTER if rest else "")
    return Text(without_open_line(data) if cut else data, encoding, compression, cut)


def _gunzip(path: Path, data: bytes) -> tuple[bytes, str]:
    plain = bytearray()
    with explain_read_errors(path), Gunzip(fileobj=io.BytesIO(data)) as file:
        while block := file.read(_BLOCK):
            plain += block
            refuse_claim(path, len(plain), len(data))
    refuse_empty_archive(path, plain)
    return bytes(plain), CUT_ARCHIVE if file.cut else ""


def _without_mark(data: bytes, surely_cut: bool) -> tuple[bytes, bytes, str]:
    """Return a text as UTF-8, the bytes of an incomplete last character, and the encoding."""
    try:
        rest = _decoded(data, "utf-8")[1]
    except UnicodeDecodeError:
        return _from_western(data), b"", "cp1252"
    if rest and not surely_cut and data[: -len(rest)].isascii():  # the last bytes are letters of cp1252
        return _from_western(data), b"", "cp1252"
    return data, rest, "utf-8"


def _decoded(data: bytes, codec: str) -> tuple[str, bytes]:
    """Decode a text; return it and the bytes of an incomplete last character."""
    decoder = codecs.getincrementaldecoder(codec)()
    return decoder.decode(data), decoder.getstate()[0]


def without_open_line(data: bytes) -> bytes:
    """Return text without its last line if that has no line end."""
    return data[: max(data.rfind(b"\n"), data.rfind(b"\r")) + 1]


def refuse_empty_archive(path: Path, plain: bytes | bytearray) -> None:
    """Refuse an archive without content.

    Raises
    ------
    InputError
        If `plain` is empty.
    """
    if not plain:
        raise InputError(f"{path} is a gzip file with nothing in it; a header and two or more rows are needed.")


def refuse_other_formats(path: Path, data: bytes) -> None:
    """Refuse known binary formats that becalm does not read.

    Raises
    ------
    InputError
        If the file has one of these formats; the message names it.
    """
    for magic, what in _OTHER_FORMATS:
        if data.startswith(magic):
            raise InputError(f"{path} is {what}; {READS} Export it as one of these.")


def _recode(path: Path, data: bytes, codec: str) -> tuple[bytes, bytes]:
    try:
        text, rest = _decoded(data, codec)
    except UnicodeError as cause:
        raise damaged_text(path, codec, cause) from cause
    plain = text.encode("utf-8")
    refuse_binary(path, plain)
    return plain, rest


def damaged_text(path: Path, codec: str, cause: UnicodeError) -> InputError:
    """Return the error for a text that does not decode as its byte-order mark states."""
    reason = getattr(cause, "reason", cause)
    return InputError(f"{path} begins as {codec.upper()} text but is damaged ({reason}); save it again.")


def refuse_nul(path: Path, data: bytes, lines: int = 0) -> None:
    """Refuse a part of a text that holds a NUL byte; `lines` is the number of lines before the part.

    Raises
    ------
    InputError
        If there is a NUL byte; the message gives its line.
    """
    if (at := data.find(b"\0")) >= 0:
        line = lines + data.count(b"\n", 0, at) + 1
        raise InputError(f"{path} is not text: there is a NUL byte in line {line}. {READS}")


def refuse_binary(path: Path, data: bytes) -> None:
    """Refuse data that holds NUL bytes or begins with unprintable bytes.

    Raises
    ------
    InputError
        If the data is not text.
    """
    if b"\0" in data:
        if data[:400:2].count(0) * 4 >= len(data[:400]) or data[1:400:2].count(0) * 4 >= len(data[:400]):
            raise InputError(f"{path} looks like UTF-16 text without a byte-order mark; save it as UTF-8.")
        refuse_nul(path, data)
    head = data[:4096]
    controls = len(head) - len(head.translate(None, _CONTROL))
    if controls > len(head) // 100:
        raise InputError(f"{path} is not text: it begins with unprintable bytes. {READS}")


def _from_western(data: bytes) -> bytes:
    try:
        return data.decode("cp1252").encode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")


# Detect changes of a file while it is read, and compute its hash.


class _FileStatus(NamedTuple):
    """The attributes of a file that show whether it was changed or replaced."""

    device: int
    inode: int
    size: int
    changed_ns: int


class Original:
    """The state of a file when reading began, to detect later changes.

    Parameters
    ----------
    path : Path
        The file; not a pipe, because it must be possible to read it again.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._status = path, _status(path)

    def refuse_changed(self) -> None:
        """Refuse a file that changed since reading began: its inode, size or time of modification.

        Raises
        ------
        InputError
            If the file was replaced, written to or removed.
        """
        if _status(self._path) != self._status:
            raise InputError(f"{self._path} changed while it was read; wait until it is complete, and repeat.")

    def sha256(self) -> str:
        """Return the SHA-256 of the file's bytes, as hexadecimal digits.

        Raises
        ------
        InputError
            If the file cannot be read, or changed since reading began.
        """
        with explain_read_errors(self._path), self._path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        self.refuse_changed()
        return digest.hexdigest()


def _status(path: Path) -> _FileStatus | None:
    try:
        status = path.stat()
    except OSError:  # the file was removed, or its disk is not connected
        return None
    return _FileStatus(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
