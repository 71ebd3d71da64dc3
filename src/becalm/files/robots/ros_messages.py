"""Decode messages of ROS 1 and ROS 2: numbers by dotted names, stamps, and the units that the types define."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from keyword import iskeyword
from operator import attrgetter
from types import ModuleType
from typing import Any, NamedTuple

from becalm.files.libraries.unpacking import ZSTD, unpacked
from becalm.files.library_reader import LibraryFile

UNITS = {
    "sensor_msgs/msg/Imu": {"linear_acceleration.": "m/s^2", "angular_velocity.": "rad/s"},
}
"""Units by type and by the beginning of a field's name, as the type's definition states them."""

_LOGS = ("rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log")  # texts; their only numbers are line numbers
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_STAMPS = ("header.stamp", "stamp", "timestamp")
_BYTES = ("byte", "char", "int8", "uint8")
_TEXTS = ("string", "wstring", "wchar", "float128")
_LONGEST = 64  # longest list of variable length that becomes columns
_DEEPEST, _MOST_FIELDS = 16, 4096  # levels of nesting, and fields with numbers, of a type
_SECOND = 1_000_000_000  # in nanoseconds

MSG, IDL = "ros2msg", "ros2idl"  # languages of definitions

NamedNumbers = Iterator[tuple[str, float]]  # names and values


class Schema(NamedTuple):
    """The type of messages.

    Attributes
    ----------
    type : str
        Name of the type, such as "sensor_msgs/msg/Imu".
    encoding : str
        "ros1" or "cdr".
    definition : str
        Definition of the type as text; "" if the file has none.
    language : str
        Language of the definition: MSG (also for ROS 1) or IDL.
    """

    type: str
    encoding: str
    definition: str = ""
    language: str = MSG


class _Fields(NamedTuple):
    names: list[str]  # names of columns
    most: list[int]  # longest list that becomes columns; 0 for a single number
    paths: list[str]  # paths of attributes in the decoded message
    out: list[str]  # fields that are left out: texts, nested lists
    stamp: str  # path of the stamp, or ""


class RosDecoder:
    """A decoder of the messages of one type.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    schema : Schema
        The type.

    Attributes
    ----------
    units : mapping of str to str
        Units by the beginning of a field's name.
    has_signals : bool
        Whether the messages hold signals, and not only texts, images and point clouds.
    left_out : set of str
        Names of fields that are not numbers, or are lists too long for columns.

    Raises
    ------
    Exception
        Any exception of the library, if the type is unknown or its definition is damaged.
    """

    def __init__(self, library_file: LibraryFile, schema: Schema) -> None:
        typesys = library_file.library("rosbags.typesys")
        kind = library_file.library("rosbags.typesys.msg").normalize_msgtype(schema.type)
        store = _store(typesys, schema, kind)
        fields = _Fields([], [], [], [], _stamp_path(store, kind))
        is_numeric = kind not in _LOGS and _gather(store, kind, fields, ("", ""), 0)
        self.has_signals = is_numeric and any(not path.startswith("header.") for path in fields.paths)
        self.left_out = set(fields.out)
        self.units = UNITS.get(kind, {})
        self._names = list(zip(fields.names, fields.most, strict=True))
        self._get = attrgetter(*fields.paths) if fields.paths else None
        self._one = len(fields.paths) == 1
        self._stamp = attrgetter(fields.stamp) if fields.stamp else None
        self._library_file, self._ros1 = library_file, schema.encoding == "ros1"
        decode = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        self._decode: Callable[[bytes], Any] = lambda data: decode(data, kind)

    def __call__(self, data: bytes) -> tuple[int | None, NamedNumbers]:
        """Return the stamp of a message in nanoseconds, or None, and its numbers with their names."""
        message = self._decode(data if self._ros1 or not data.startswith(ZSTD) else self._plain(data))
        stamp = None
        if self._stamp is not None:
            time = self._stamp(message)
            stamp = time.sec * _SECOND + time.nanosec
        values = self._get(message) if self._get is not None else ()
        return stamp, self._numbers((values,) if self._one else values)

    def _plain(self, data: bytes) -> bytes:
        """Unpack a message that is compressed separately; plain CDR never begins with the first bytes of zstd."""
        size = self._library_file.library("zstandard").frame_content_size(data)
        return unpacked(self._library_file, "zstd", data, size)

    def _numbers(self, values: tuple[Any, ...]) -> NamedNumbers:
        for (name, most), value in zip(self._names, values, strict=True):
            if not most:
                yield name, value
            elif len(value) > most:
                self.left_out.add(name)
            else:
                for place, one in enumerate(value.tolist()):
                    yield f"{name}_{place}", one


def _store(typesys: ModuleType, schema: Schema, kind: str) -> Any:
    """Return the types that the file defines, or the standard ones if it defines none."""
    if not schema.definition:
        return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if schema.encoding == "ros1" else typesys.Stores.LATEST)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    if schema.language == MSG:
        types = typesys.get_types_from_msg(schema.definition, kind)
    else:
        types = _types_of_idl(typesys, schema.definition)
    store.register(types)
    return store


def _types_of_idl(typesys: ModuleType, definition: str) -> dict[str, Any]:
    types: dict[str, Any] = {}
    ruler = "=" * 80 + "\n"
    for part in definition.split(ruler):  # each part except the first begins with a line with its name
        text = part.partition("\n")[2] if part.startswith("IDL: ") else part
        types |= typesys.get_types_from_idl(text) if text.strip() else {}
    return types


def _stamp_path(store: Any, kind: str) -> str:
    """Return the path of a message's stamp, or "" if it has none."""
    for path in _STAMPS:
        at = kind
        for name in path.split("."):
            at = next((_named(desc) for own, desc in store.fielddefs.get(at, ([], []))[1] if own == name), "")
        if at == _TIMES[0]:
            return path
    return ""


def _named(desc: Any) -> str:
    return desc[1] if isinstance(desc[1], str) else ""


def _gather(store: Any, kind: str, fields: _Fields, within: tuple[str, str], depth: int) -> bool:
    """Add the numbers of a type to `fields`; return False if it holds bytes of variable length, as an image does."""
    if depth > _DEEPEST or len(fields.paths) > _MOST_FIELDS:
        raise ValueError(f"the type {kind} nests without an end")
    own_name, own_path = within
    for field, (node, what) in store.fielddefs[kind][1]:
        name, path = own_name + field, own_path + field + ("_" if iskeyword(field) else "")
        if path == fields.stamp or field == "structure_needs_at_least_one_member":
            continue
        if isinstance(what, str):
            if not _gather(store, what, fields, (f"{name}.", f"{path}."), depth + 1):
                return False
            continue
        element, count = what if isinstance(what[0], tuple) else ((node, what), None)
        base = element[1][0] if isinstance(element[1], tuple) else ""
        if base in _BYTES and count == 0:  # a list of variable length
            return False
        if not base or base in _TEXTS:
            fields.out.append(name)
            continue
        fields.names.append(name)
        fields.most.append(0 if count is None else max(count, _LONGEST))
        fields.paths.append(path)
    return True
