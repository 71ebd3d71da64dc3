"""Bytes to text: compression and encoding by content, and a clear word about what is no text."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from becalm.errors import InputError
from becalm.files.foreign import refuse_claim

GZIP = b"\x1f\x8b"
PARQUET = b"PAR1"

READS = "becalm reads CSV (also gzipped), Parquet, MF4, TDMS, UFF58, MAT, HDF5, NPZ, WAV, ROS bags, MCAP, ULog and IDE."

_OTHER_FORMATS: tuple[tuple[bytes, str], ...] = (
    (b"PK\x03\x04", "a ZIP archive or an Excel workbook"),
    (b"\xd0\xcf\x11\xe0", "an old Excel or Office file"),
    (b"\x89PNG", "a picture"),
    (b"%PDF", "a PDF document"),
    (b"ARROW1", "an Arrow (Feather) file"),
    (b"\x28\xb5\x2f\xfd", "a file compressed with zstd"),
    (b"BZh", "a file compressed with bzip2"),
    (b"\xfd7zXZ", "a file compressed with xz"),
)

BOMS: tuple[tuple[bytes, str, str], ...] = (
    (b"\xef\xbb\xbf", "utf-8", "utf-8-bom"),
    (b"\xff\xfe", "utf-16-le", "utf-16-le"),
    (b"\xfe\xff", "utf-16-be", "utf-16-be"),
)

_BLOCK = 1 << 20
_CONTROL = bytes(set(range(32)) - set(b"\t\n\r\f\v\x1a"))


@dataclass(frozen=True)
class Text:
    """The text of a file as UTF-8 bytes without a byte-order mark, and how it was stored."""

    data: bytes
    encoding: str
    compression: str


def read_bytes(path: Path, most: int | None = None) -> bytes:
    """Read a whole file, or its first bytes.

    Raises
    ------
    InputError
        If it is missing, a directory, forbidden or empty.
    """
    with told(path):
        if most is None:
            data = path.read_bytes()
        else:
            with path.open("rb") as file:
                data = file.read(most)
    if not data:
        raise InputError(f"{path} is empty (0 bytes); a header and two or more rows are needed.")
    return data


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Say in a sentence why a file cannot be read.

    Raises
    ------
    InputError
        If it is missing, a directory, forbidden, or a damaged archive.
    """
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; give the path of a recording.") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; give the path of one file in it.") from None
    except PermissionError:
        raise InputError(f"{path} may not be read; ask for permission (`chmod u+r`).") from None
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
        If the bytes are a damaged archive, another format, or no text.
    """
    compression = ""
    if data.startswith(GZIP):
        data, compression = _gunzip(path, data), "gzip"
    refuse_other_formats(path, data)
    for mark, codec, name in BOMS:
        if data.startswith(mark):
            return Text(_recode(path, data[len(mark) :], codec), name, compression)
    refuse_binary(path, data)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return Text(_from_western(data), "cp1252", compression)
    return Text(data, "utf-8", compression)


def _gunzip(path: Path, data: bytes) -> bytes:
    plain = bytearray()
    with told(path), gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
        while block := file.read(_BLOCK):
            plain += block
            refuse_claim(path, len(plain), len(data))
    refuse_nothing(path, plain)
    return bytes(plain)


def refuse_nothing(path: Path, plain: bytes | bytearray) -> None:
    """Refuse an archive that holds nothing.

    Raises
    ------
    InputError
        If it does.
    """
    if not plain:
        raise InputError(f"{path} is a gzip file with nothing in it; a header and two or more rows are needed.")


def refuse_other_formats(path: Path, data: bytes) -> None:
    """Refuse what is known to be no text.

    Raises
    ------
    InputError
        If it is; the sentence says what.
    """
    for magic, what in _OTHER_FORMATS:
        if data.startswith(magic):
            raise InputError(f"{path} is {what}; {READS} Export it as one of these.")


def _recode(path: Path, data: bytes, codec: str) -> bytes:
    try:
        plain = data.decode(codec).encode("utf-8")
    except UnicodeError as cause:
        raise damaged_text(path, codec, cause) from cause
    refuse_binary(path, plain)
    return plain


def damaged_text(path: Path, codec: str, cause: UnicodeError) -> InputError:
    """Say that a text is not written as its byte-order mark promises."""
    reason = getattr(cause, "reason", cause)
    return InputError(f"{path} begins as {codec.upper()} text but is damaged ({reason}); save it again.")


def refuse_nul(path: Path, data: bytes, lines: int = 0) -> None:
    """Refuse a part of a text, below so many lines, if it holds a NUL byte.

    Raises
    ------
    InputError
        If it does.
    """
    if (at := data.find(b"\0")) >= 0:
        line = lines + data.count(b"\n", 0, at) + 1
        raise InputError(f"{path} is not text: there is a NUL byte in line {line}. {READS}")


def refuse_binary(path: Path, data: bytes) -> None:
    """Refuse what holds zeros or begins with unprintable bytes.

    Raises
    ------
    InputError
        If it does.
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
