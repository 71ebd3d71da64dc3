"""Read MAT files of version 7.3, which are HDF5: arrays, structs, cells and texts; numbers only when needed."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from becalm.files.arrays.array_groups import Grouping
from becalm.files.arrays.array_labels import apply_labels
from becalm.files.arrays.arrays import Leaf
from becalm.files.arrays.arrays import Path as Where
from becalm.files.arrays.hdf5 import read_tree
from becalm.files.arrays.hdf5_opening import Hdf5File
from becalm.files.arrays.hdf5_tree import DEEPEST, Tree
from becalm.files.arrays.mat import MOST_ELEMENTS, SAVE_AS, SPARSE
from becalm.files.library_reader import LibraryFile
from becalm.files.source import RawTable

_USER_BLOCK = 512  # bytes before the HDF5 signature: MATLAB's header
_MOST_REFERENCES = 100_000  # most elements of all cells and structs in a file, and most letters of a text in one
_TEXT_BYTES = 1 << 24  # largest char array that is read
_NUMBERS = {"double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of a MAT file of version 7.3; nested variables get dotted names.

    Raises
    ------
    InputError
        If nothing in it can be read.
    """
    return read_tree(LibraryFile(path, "MAT 7.3"), "mat", _grouping, _USER_BLOCK)


def _grouping(library_file: LibraryFile, opened: Hdf5File, h5py: ModuleType) -> Grouping:
    contents = _MatlabTree(library_file, opened, h5py).walk(opened.file)
    apply_labels(contents)
    return Grouping(contents, ".", apart=False)


class _MatlabTree(Tree):
    """A walk through a MATLAB file that collects its contents."""

    entries = "columns"
    _left = _MOST_REFERENCES  # elements that may still be read

    def visit(self, group: Any, name: str, path: Where) -> None:
        """Collect an object, except internal data of MATLAB and objects that only MATLAB can open."""
        if name.startswith("#"):
            return
        inside = isinstance(group.get(name, getlink=True), self.h5py.HardLink)  # other links may leave the file
        thing = group.get(name, getclass=True) if inside else None
        if thing is self.h5py.Group and (kind := _kind(group[name])) not in ("", "struct"):
            self.note(path, f"it is a MATLAB {kind}, which only MATLAB opens{SAVE_AS}")
        elif thing is self.h5py.Group and "MATLAB_sparse" in group[name].attrs:
            self.note(path, SPARSE)
        else:
            super().visit(group, name, path)

    def collect_readable(self, dataset: Any, path: Where) -> None:
        """Collect a dataset as MATLAB's array; the file has its axes in reverse order."""
        kind = _kind(dataset)
        if "MATLAB_empty" in dataset.attrs or not dataset.shape:
            return
        if self.h5py.check_ref_dtype(dataset.dtype):
            self._collect_references(dataset, path, struct=kind != "cell")
        elif kind == "char":
            self._collect_text(dataset, path)
        elif kind and kind not in _NUMBERS and kind != "logical":
            self.note(path, f"it is a MATLAB {kind}, which only MATLAB opens{SAVE_AS}")
        else:
            super().collect_readable(dataset, path)
            leaf = self.contents.leaves[-1] if self.contents.leaves else None
            if kind == "logical" and leaf is not None and leaf.path == path and leaf.type.kind == "u":
                self.contents.leaves[-1] = leaf._replace(
                    type=np.dtype(bool), take=lambda key: leaf.take(key).astype(np.bool_)
                )

    def _collect_text(self, dataset: Any, path: Where) -> None:
        if dataset.size * 2 > _TEXT_BYTES:
            self.note(path, f"it is a text of {dataset.size} letters, which is too long")
            return
        codes = np.atleast_2d(dataset[()].T).astype("<u2")
        lines = [row.tobytes().decode("utf-16-le", "replace").rstrip() for row in codes]
        self.contents.add(Leaf.of(path, np.array(lines, object)))

    def _collect_references(self, dataset: Any, path: Where, struct: bool) -> None:
        """Collect the elements of a cell array, or of a field in an array of structs."""
        if dataset.size > min(self._left, _MOST_REFERENCES) or len(path) > DEEPEST:
            self.note(path, f"it has {dataset.size} elements, which are too many")
            return
        self._left -= dataset.size
        things = [self.h5py.h5r.dereference(ref, dataset.id) for ref in dataset[()].T.ravel(order="F")]
        held = [self.h5py.Dataset(thing) if isinstance(thing, self.h5py.h5d.DatasetID) else None for thing in things]
        readable = all(one is not None and not self.why_not(one) for one in held)
        if readable and all(_kind(one) == "char" for one in held):
            if not struct:
                self.contents.add(Leaf.of(path, np.array([self._one_text(one) for one in held], object)))
                return
        elif readable and len(held) > 1 and all(map(_is_number, held)) and (not struct or self._in_records(dataset)):
            self.contents.add(Leaf.of(path, np.array([one[()].item() for one in held if one is not None])))
            return
        for number, (thing, one) in enumerate(zip(things[:MOST_ELEMENTS], held, strict=False), start=1):
            where = (*path[:-2], f"{path[-2]}({number})", path[-1]) if struct and len(path) > 1 else _cell(path, number)
            if one is not None:
                self.collect_dataset(one, where)
            elif isinstance(thing, self.h5py.h5g.GroupID):
                self.walk(self.h5py.Group(thing), where)

    def _in_records(self, field: Any) -> bool:
        """Return whether all fields of the first struct in the array are single numbers or texts."""
        group, firsts = field.parent, []
        for name in group:
            if not isinstance(group.get(name, getlink=True), self.h5py.HardLink) or self.why_not(group[name]):
                return False
            firsts.append(group.file[group[name][()].ravel()[0]])
        return all(_kind(one) == "char" or getattr(one, "size", 0) == 1 for one in firsts)

    def _one_text(self, dataset: Any) -> str:
        if "MATLAB_empty" in dataset.attrs or dataset.size > _MOST_REFERENCES:
            return ""
        return str(np.asarray(dataset[()].T).astype("<u2").tobytes().decode("utf-16-le", "replace"))

    def in_writer_order(self, leaf: Leaf) -> Leaf:
        """Return the array with its axes reversed."""
        turned = leaf._replace(shape=leaf.shape[::-1], claimed=leaf.claimed[::-1])
        return turned._replace(take=lambda key: leaf.take(key[::-1]).T)


def _is_number(dataset: Any) -> bool:
    return dataset is not None and dataset.size == 1 and _kind(dataset) in _NUMBERS


def _cell(path: Where, number: int) -> Where:
    return (*path[:-1], f"{path[-1]}{{{number}}}")


def _kind(thing: Any) -> str:
    kind = thing.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
