"""MAT, HDF5 and NPZ that lie, lead elsewhere, or are damaged: a sentence, and nothing else."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from becalm.errors import BecalmError, InputError
from becalm.files.registry import read_tables
from robot_logs import read_through

COUNT = 60
VALUES = np.random.default_rng(1).standard_normal((COUNT, 3))


def test_links_that_lead_out_of_the_file_are_not_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = VALUES
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = VALUES
        file["out"] = h5py.ExternalLink("other.h5", "/secret")
        file["soft"] = h5py.SoftLink("/out")
        file["round"] = h5py.SoftLink("/")
        raw = [(str(tmp_path / "raw.bin"), 0, VALUES.nbytes)]
        file.create_dataset("raw", data=VALUES, external=raw)
        layout = h5py.VirtualLayout(VALUES.shape, VALUES.dtype)
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "secret", VALUES.shape)
        file.create_virtual_dataset("virtual", layout)
    (table,) = read_tables(tmp_path / "a.h5")
    assert table.names == ["x_0", "x_1", "x_2"]
    assert [note.split(" ", 1)[0] for note in table.notes] == ["'out'", "'raw'", "'virtual'"]


def test_mat_files_lead_nowhere_either(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes("secret".encode("utf-16-le") + VALUES.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_group("secret").attrs["MATLAB_class"] = np.bytes_("secret")

    def out(group: h5py.Group, name: str, shape: tuple[int, int], kind: str) -> h5py.Dataset:
        form = {"char": "u2", "double": "f8", "cell": h5py.ref_dtype}[kind]
        begin = 0 if kind == "char" else 12
        there = [(str(tmp_path / "secret"), begin, shape[0] * shape[1] * np.dtype(form).itemsize)]
        dataset = group.create_dataset(name, shape, form, external=there)
        dataset.attrs["MATLAB_class"] = np.bytes_(kind)
        return dataset

    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["x"] = VALUES.T
        file["x"].attrs["MATLAB_class"] = np.bytes_("double")
        kept = file.create_group("#refs#")
        letters = [out(kept, f"text{n}", (6, 1), "char").ref for n in range(3)]
        numbers = [out(kept, f"number{n}", (1, 1), "double").ref for n in range(3)]
        for name, held in (("x_names", letters), ("numbers", numbers)):
            file[name] = np.array([held], h5py.ref_dtype).T
            file[name].attrs["MATLAB_class"] = np.bytes_("cell")
        out(file, "text", (6, 1), "char")
        out(file, "cells", (6, 1), "cell")
        fields = file.create_group("fields")
        fields["a"] = np.array([[file["x"].ref] * 2], h5py.ref_dtype).T
        out(fields, "b", (1, 1), "cell")
        fields["c"] = h5py.ExternalLink("other.h5", "/secret")
        file["out"] = h5py.ExternalLink("other.h5", "/secret")
        file["soft"] = h5py.SoftLink("/out")
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(data)
    (table,) = read_tables(tmp_path / "a.mat")
    assert not [name for name in table.names if "x" not in name and "fields" not in name]
    told = [note.split("'")[1] for note in table.notes if "another file" in note]
    elements = [f"{name}{{{n}}}" for name in ("numbers", "x_names") for n in (1, 2, 3)]
    assert sorted(told) == sorted(["cells", "fields/b", "fields/c", "out", "text", *elements])
    assert "secret" not in " ".join(table.names)


def test_a_filter_that_is_not_here_is_told(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        settings.set_chunk((COUNT,))
        settings.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((COUNT,))
        h5py.h5d.create(file.id, b"x", h5py.h5t.NATIVE_DOUBLE, space, settings)
    with pytest.raises(InputError, match=r"filter 32001.*h5repack"):
        read_tables(tmp_path / "a.h5")


def test_rows_that_no_logger_wrote_are_no_rows(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", (1 << 40,), "f8", chunks=(10,))[:20] = np.arange(20) / 3
        file.create_dataset("empty", (1 << 40,), "f8", chunks=(10,))
    (table,) = read_tables(tmp_path / "a.h5")
    assert table.count == 20
    assert "The logger stopped in the middle of 'x'" in " ".join(table.notes)


def test_large_chunks_of_noise_are_read(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).random(1 << 18)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", data=noise, chunks=(1 << 18,), compression="gzip", shuffle=True, fletcher32=True)
    (table,) = read_tables(tmp_path / "a.h5")
    np.testing.assert_array_equal(np.concatenate([block["x"] for block in table.blocks(["x"])]), noise)


def test_npz_is_never_unpickled(tmp_path: Path) -> None:
    bomb = io.BytesIO()
    np.lib.format.write_array(bomb, np.array([{}, {}], object), allow_pickle=True)
    assert pickle.PROTO in bomb.getvalue()
    plain = io.BytesIO()
    np.save(plain, VALUES)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", plain.getvalue())
        archive.writestr("z.npy", bomb.getvalue())
    (table,) = read_tables(tmp_path / "a.npz")
    assert table.names == ["x_0", "x_1", "x_2"]
    assert "Python objects" in table.notes[0]


@pytest.mark.slow
def test_members_that_would_fill_the_memory_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 26,)})
        with archive.open("x.npy", "w") as file:
            file.write(header.getvalue())
            for _ in range(512):
                file.write(bytes(1 << 20))
    with pytest.raises(InputError, match="claims to hold"):
        read_tables(tmp_path / "a.npz")


def test_mat_elements_that_would_fill_the_memory_are_refused(tmp_path: Path) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(struct.pack("<II", 14, 1 << 31) + bytes(1 << 16))
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(InputError, match="holds no channel that can be read"):
        read_tables(tmp_path / "a.mat")


def test_mat_cells_nested_too_deep_are_refused(tmp_path: Path) -> None:
    element = b""
    for _ in range(5000):
        inside = struct.pack("<IIQ", 6, 8, 1) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0) + element
        element = struct.pack("<II", 14, len(inside)) + inside
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + element)
    with pytest.raises(InputError, match="deep"):
        read_tables(tmp_path / "a.mat")


def make_h5(path: Path, libver: str) -> None:
    with h5py.File(path, "w", libver=libver) as file:
        group = file.create_group("imu")
        group.attrs["fs"] = 100.0
        group.attrs["units"] = np.bytes_("m/s2")
        group.create_dataset("acc", data=VALUES, chunks=(16, 3), compression="gzip", shuffle=True)
        file["plain"] = VALUES[:, 0]
        file["table"] = np.zeros(COUNT, [("t", "f8"), ("v", "f4", (2,)), ("s", "S4")])


def make_mat(path: Path, packed: bool) -> None:
    imu = {"acc": VALUES, "t": np.arange(COUNT) / 10, "unit": "m/s^2"}
    cells = np.array(["a", "b"], object)
    savemat(path, {"imu": imu, "fs": 50.0, "x": VALUES[:, :2], "x_names": cells}, do_compression=packed)


def make_npz(path: Path, packed: bool) -> None:
    save = np.savez_compressed if packed else np.savez
    save(path, t=np.arange(COUNT) / 10, acc=VALUES, s=np.array(["a"] * COUNT))


MAKERS = {
    "old.h5": lambda path: make_h5(path, "earliest"),
    "new.h5": lambda path: make_h5(path, "latest"),
    "plain.mat": lambda path: make_mat(path, packed=False),
    "packed.mat": lambda path: make_mat(path, packed=True),
    "four.mat": lambda path: savemat(path, {"t": np.arange(COUNT) / 10, "acc": VALUES, "n": "abc"}, format="4"),
    "plain.npz": lambda path: make_npz(path, packed=False),
    "packed.npz": lambda path: make_npz(path, packed=True),
    "one.npy": lambda path: np.save(path, VALUES),
}


@pytest.mark.parametrize("name", MAKERS)
def test_damaged_files_give_tables_or_a_sentence(name: str, tmp_path: Path) -> None:
    MAKERS[name](tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    random = np.random.default_rng(11)
    for _ in range(200):
        data = bytearray(whole)
        for _ in range(random.integers(1, 6)):
            reach = len(data) if random.random() < 0.5 else min(2048, len(data))
            data[random.integers(reach)] = random.choice([0, 1, 128, 255, int(random.integers(256))])
        if random.random() < 0.1:
            data = data[: random.integers(1, len(data))]
        (tmp_path / name).write_bytes(data)
        with suppress(BecalmError):
            assert all(len(table) <= 100_000 for table in read_through(tmp_path / name))
