"""Walk through the groups of an HDF5 file and collect its arrays, without following links to other files."""

from __future__ import annotations

from contextlib import suppress
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from becalm.files.arrays.arrays import FileArrays, Key, Leaf, Path, as_text
from becalm.files.arrays.hdf5_gaps import WrittenChunks
from becalm.files.arrays.hdf5_opening import Hdf5File
from becalm.files.library_reader import LibraryFile

DEEPEST = 64
"""Deepest nesting of groups that is read."""

_ATTRIBUTE_BYTES = 1 << 20  # larger attributes are ignored
_MOST_NUMBERS = 64  # longer lists in attributes are ignored
_HIDDEN = (b"TINDEX", b"INDEX")  # classes of groups for internal use by PyTables
_FIELD_UNITS = ("units", "unit")  # attributes with a unit for each field of a dataset


class _Shapes(NamedTuple):
    """The shapes of a dataset: what is in the file, and what the dataset claims."""

    readable: tuple[int, ...]
    claimed: tuple[int, ...]  # () if it is the same as `readable`
    written: WrittenChunks | None  # None if no chunk is missing

    def with_axes(self, inner: tuple[int, ...]) -> _Shapes:
        return _Shapes((*self.readable, *inner), (*self.claimed, *inner) if self.claimed else (), self.written)

    def with_gaps(self, leaf: Leaf) -> Leaf:
        if self.written is None:
            return leaf
        written, read = self.written, leaf.take
        return leaf._replace(
            type=written.nullable_type(leaf.type), take=lambda key: written.mark_missing(read(key), key)
        )


class Tree:
    """A walk through a file that collects its contents.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    opened : Hdf5File
        The open file.
    h5py : module
        The library.
    """

    entries = "rows"
    """What messages call the entries on a dataset's first axis."""

    def __init__(self, library_file: LibraryFile, opened: Hdf5File, h5py: ModuleType) -> None:
        self._library_file, self._opened, self.h5py = library_file, opened, h5py
        self.contents = FileArrays()
        self._visited: set[Any] = set()
        self._claimed = 0

    def walk(self, group: Any, path: Path = ()) -> FileArrays:
        """Collect the contents of a group and of all groups in it."""
        self._visited.add(self._identity(group))
        self.collect_attributes(group, path)
        if len(path) >= DEEPEST:
            self.note(path, f"it is nested more than {DEEPEST} deep")
            return self.contents
        for name in group:
            inner = (*path, name.encode("utf-8", "replace").decode())
            try:
                self.visit(group, name, inner)
            except (OSError, KeyError, RuntimeError, ValueError, TypeError) as cause:
                cut = self._opened.size is not None
                self.note(inner, "the file ends before it" if cut else " ".join(str(cause).split())[:120])
        return self.contents

    def visit(self, group: Any, name: str, path: Path) -> None:
        """Collect the object that a name in a group links to, if it is in this file and was not visited before."""
        link = group.get(name, getlink=True)
        if isinstance(link, self.h5py.ExternalLink):
            self.note(path, f"it leads to another file, {link.filename!r}")
        if not isinstance(link, self.h5py.HardLink):
            return  # the target of a soft link is visited under its own name
        thing = group[name]
        if (identity := self._identity(thing)) in self._visited:
            return
        self._visited.add(identity)
        if isinstance(thing, self.h5py.Group):
            if thing.attrs.get("CLASS") not in _HIDDEN:
                self.walk(thing, path)
        elif isinstance(thing, self.h5py.Dataset):
            self.collect_attributes(thing, path)
            self.collect_dataset(thing, path)

    def _identity(self, thing: Any) -> Any:
        return self.h5py.h5o.get_info(thing.id).addr

    def note(self, path: Path, why: str) -> None:
        """Add a note that something is not read, with the reason."""
        self.contents.notes.append(f"{'/'.join(path)!r} is not read: {why}.")

    def collect_attributes(self, thing: Any, path: Path) -> None:
        """Collect the numbers and texts in the attributes of an object."""
        for name in thing.attrs:
            with suppress(OSError, KeyError, RuntimeError, ValueError, TypeError):  # damaged attributes are skipped
                self._collect_attribute(thing, name, path)

    def _collect_attribute(self, thing: Any, name: str, path: Path) -> None:
        attribute = thing.attrs.get_id(name)
        claimed = int(np.prod(attribute.shape or (), dtype=object)) * attribute.dtype.itemsize
        text = self.h5py.check_string_dtype(attribute.dtype) is not None
        if claimed > _ATTRIBUTE_BYTES or not (text or attribute.dtype.kind in "biufSU"):
            return
        value = thing.attrs[name]
        if isinstance(value, self.h5py.Empty):
            return
        values = as_text(np.asarray(value)) if text else np.asarray(value)
        if text and values.size and values.ndim < 2:
            self.contents.words[(*path, name)] = tuple(str(one).strip() for one in values.ravel())
        elif not text and 0 < values.size <= _MOST_NUMBERS:
            self.contents.lists[(*path, name)] = values.ravel()
        if not text and values.size == 1:
            self.contents.numbers[(*path, name)] = float(values.ravel()[0])

    def collect_dataset(self, dataset: Any, path: Path) -> None:
        """Collect a dataset, or add a note if it cannot be read or its values are in another file."""
        if dataset.shape is None:
            return
        if why := self.why_not(dataset):
            self.note(path, why)
        else:
            self.collect_readable(dataset, path)

    def collect_readable(self, dataset: Any, path: Path) -> None:
        """Collect a dataset that may be read, or each of its fields."""
        rows = self._opened.whole_rows(dataset)
        shape = (rows, *dataset.shape[1:]) if dataset.shape else ()
        if shape != dataset.shape:
            if not rows:
                self.note(path, "nothing of it was written" if self._opened.size is None else "the file ends before it")
                return
            says = (
                "The file ends in the middle" if self._opened.size is not None else "The logger stopped in the middle"
            )
            self.contents.notes.append(
                f"{says} of {'/'.join(path)!r}; {rows} of {dataset.shape[0]} {self.entries} are whole and were read."
            )
        self._claimed += int(np.prod(shape, dtype=object)) * dataset.dtype.itemsize
        self._library_file.refuse_claim(max(self._claimed, _chunk_bytes(dataset)))
        written = self._opened.written(dataset, rows)
        if written is not None:
            self.contents.notes.append(f"Parts of {'/'.join(path)!r} were never written, and are missing.")
        shapes = _Shapes(shape, dataset.shape if shape != dataset.shape else (), written)
        if dataset.dtype.names:
            self._collect_fields(dataset, path, shapes)
        else:
            self._collect(path, shapes, dataset.dtype, lambda key: dataset[key])

    def _collect_fields(self, dataset: Any, path: Path, shapes: _Shapes) -> None:
        names = dataset.dtype.names
        for position, name in enumerate(names):
            for word in _FIELD_UNITS:
                texts = self.contents.words.get((*path, word), ())
                own = self.contents.word((*path, f"FIELD_{position}_{word.upper()}"))
                if own or len(texts) == len(names):
                    self.contents.words[(*path, name, "unit")] = (own or texts[position],)
            self._collect_field(dataset, (name,), path, shapes)

    def _collect_field(self, dataset: Any, fields: tuple[str, ...], path: Path, shapes: _Shapes) -> None:
        kind = dataset.dtype
        for name in fields:
            kind = kind[name]
        if kind.names:
            for name in kind.names:
                self._collect_field(dataset, (*fields, name), path, shapes)
            return
        base, inner = kind.subdtype or (kind, ())
        depth = len(shapes.readable)

        def take(key: Key) -> Any:
            values = dataset.fields(fields[0])[key[:depth]]
            for name in fields[1:]:
                values = values[name]
            values = np.asarray(values)
            return values[(..., *key[depth:])] if inner else values

        self._collect((*path, *fields), shapes.with_axes(inner), base, take)

    def _collect(self, path: Path, shapes: _Shapes, kind: np.dtype[Any], take: Any) -> None:
        h5py, shape, claimed = self.h5py, shapes.readable, shapes.claimed
        if h5py.check_string_dtype(kind) or kind.kind in "SU":
            text = Leaf(path, shape, np.dtype(object), lambda key: as_text(np.asarray(take(key))), claimed)
            self.contents.add(self.in_writer_order(shapes.with_gaps(text)))
        elif h5py.check_enum_dtype(kind) or kind.kind in "biufcMm":
            plain = np.dtype(kind.str)
            numbers = Leaf(path, shape, plain, lambda key: np.asarray(take(key)).astype(plain, copy=False), claimed)
            self.contents.add(self.in_writer_order(shapes.with_gaps(numbers)))
        elif not h5py.check_ref_dtype(kind):
            self.note(path, f"it holds {kind}, which is neither numbers nor text")

    def in_writer_order(self, leaf: Leaf) -> Leaf:
        """Return an array with its axes in the writer's order."""
        return leaf

    def why_not(self, dataset: Any) -> str:
        """Return why a dataset must not be read, or "" if it may; call this before every read."""
        if dataset.external:
            return f"its values are in another file, {dataset.external[0][0]!r}"
        if dataset.is_virtual:
            outside = any(source.file_name != "." for source in dataset.virtual_sources())
            return f"its values are in other {'files' if outside else 'arrays, which are read themselves'}"
        settings = dataset.id.get_create_plist()
        for number in range(settings.get_nfilters()):
            code, _, _, name = settings.get_filter(number)
            if not self.h5py.h5z.filter_avail(code):
                label = name.decode("latin-1") or "no name"
                return (
                    f"it is packed by filter {code} ({label}), which is not installed; type: h5repack -f GZIP=4 IN OUT"
                )
        return ""


def _chunk_bytes(dataset: Any) -> int:
    return int(np.prod(dataset.chunks or (0,), dtype=object)) * int(dataset.dtype.itemsize)
