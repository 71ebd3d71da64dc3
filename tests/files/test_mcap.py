"""MCAP: topics of JSON, whole and cut off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from becalm.errors import InputError
from becalm.files import open_source
from robot_logs import EPOCH_NS, by_name, json_log, read_through, whole

LOGGED = "The time is when messages were logged, because its messages have no stamp of their own."
MESSAGES = [
    (EPOCH_NS + row * 10**7, {"acc": {"x": row, "y": 0.5}, "ok": row > 1, "v": [1, 2.5], "name": "q"})
    for row in range(9)
]


@pytest.mark.parametrize("how", CompressionType)
@pytest.mark.parametrize("chunked", [True, False])
def test_numbers_flags_and_lists_become_columns(tmp_path: Path, how: CompressionType, chunked: bool) -> None:
    (table,) = by_name(json_log(tmp_path / "a", MESSAGES, compression=how, use_chunking=chunked)).values()
    rows = whole(table)
    assert rows.column_names == ["time_s", "acc.x", "acc.y", "ok", "v_0", "v_1"]
    assert [str(kind) for kind in rows.schema.types] == ["double", "int64", "double", "bool", "int64", "double"]
    assert rows["acc.x"].to_pylist() == list(range(9))
    np.testing.assert_array_equal(rows["time_s"], np.arange(9) / 100)
    assert table.notes == (LOGGED, "Texts, nested and long lists were left out: name.")


def test_what_a_message_lacks_is_missing(tmp_path: Path) -> None:
    messages = [(EPOCH_NS + row, row) for row in range(4)]
    held = [{"a": 1}, {"b": 2.5, "f": True}, {"a": 2**70}, {"a": None, "f": False}]
    (table,) = by_name(json_log(tmp_path / "a", [(at, held[row]) for at, row in messages])).values()
    rows = whole(table).to_pydict()
    np.testing.assert_array_equal(rows["a"], [1, np.nan, 2.0**70, np.nan])
    np.testing.assert_array_equal(rows["b"], [np.nan, 2.5, np.nan, np.nan])
    np.testing.assert_array_equal(rows["f"], [np.nan, 1, np.nan, 0])


@pytest.mark.parametrize("name", ["header", "timestamp", "stamp"])
def test_stamps_in_messages_are_the_time(tmp_path: Path, name: str) -> None:
    def stamped(row: int) -> dict[str, object]:
        stamp = {"sec": 1_700_000_000, "nanosec" if name == "header" else "nsec": row * 20_000_000}
        return {name: {"stamp": stamp} if name == "header" else stamp, "x": row}

    (table,) = by_name(json_log(tmp_path / "a", [(EPOCH_NS, stamped(row)) for row in range(5)])).values()
    assert whole(table)["time_s"].to_pylist() == [0.0, 0.02, 0.04, 0.06, 0.08]
    assert table.names == ["time_s", "x"]


def test_messages_logged_at_once_are_told(tmp_path: Path) -> None:
    bursts = [(EPOCH_NS + row // 5 * 10**9 + row % 5 // 2, {"x": row}) for row in range(20)]
    (table,) = by_name(json_log(tmp_path / "a", bursts)).values()
    assert table.notes == (
        LOGGED,
        "Messages that were logged at the same instant as the one before: 8.",
        "They were logged in bursts, so this is not the time when they were measured.",
    )


def test_messages_out_of_order_are_sorted(tmp_path: Path) -> None:
    (table,) = by_name(json_log(tmp_path / "a", [(EPOCH_NS + at, {"x": at}) for at in (3, 1, 2)])).values()
    assert whole(table)["x"].to_pylist() == [1, 2, 3]


def test_an_encoding_that_is_not_read_is_told(tmp_path: Path) -> None:
    path = json_log(tmp_path / "a", MESSAGES, encoding="protobuf")
    with pytest.raises(InputError, match=r"Left out, because their encoding \(protobuf\) is not read: /s \(thing\)"):
        read_through(path)


def test_a_name_for_each_message_fills_no_memory(tmp_path: Path) -> None:
    messages = [(EPOCH_NS + row, {f"x{row}": 1.0, "y": 2.0}) for row in range(5000)]
    (table,) = by_name(json_log(tmp_path / "a", messages)).values()
    assert len(table.names) <= 4097
    np.testing.assert_array_equal(whole(table)["y"], np.full(5000, 2.0))
    assert "The messages have more names of numbers than a table can have columns; some were left out." in table.notes


@pytest.mark.parametrize("how", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("kept", range(10, 100, 10))
def test_what_is_whole_of_a_log_is_read(tmp_path: Path, kept: int, how: CompressionType) -> None:
    messages = [(EPOCH_NS + row * 10**7, {"x": row, "noise": float(np.sin(row**2))}) for row in range(400)]
    path = json_log(tmp_path / "a", messages, compression=how, chunk_size=1000)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * kept // 100])
    (table,) = by_name(path).values()
    assert whole(table)["x"].to_pylist() == list(range(table.count))
    told = "The file has no end, as if recording or copying was cut off; what is whole was read." in table.notes
    assert told or table.count == 400


def test_a_damaged_chunk_is_left_out(tmp_path: Path) -> None:
    path = json_log(tmp_path / "a", [(EPOCH_NS + row * 10**7, {"x": row}) for row in range(400)], chunk_size=1000)
    data = bytearray(path.read_bytes())
    data[data.find(b'{"x": 200}') + 6] = ord("9")
    path.write_bytes(data)
    (table,) = by_name(path).values()
    kept = whole(table)["x"].to_pylist()
    assert 950 not in kept
    assert 300 < len(kept) < 400
    assert "Damaged parts of the file were left out: 1." in table.notes


def test_a_chunk_that_claims_to_be_endless_is_refused(tmp_path: Path) -> None:
    path = json_log(tmp_path / "a", MESSAGES, compression=CompressionType.ZSTD)
    data = bytearray(path.read_bytes())
    at = data.find(b"zstd") - 16  # its size comes before its check sum and its compression
    data[at : at + 8] = (1 << 50).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match="claims to hold 1,125,899,906,842,624 bytes"):
        read_through(path)


def test_no_code_in_the_name_of_a_type_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        name = 'a/msg/B(__import__("pathlib").Path("ran").touch() or object)'
        topic = writer.register_channel("/x", "cdr", writer.register_schema(name, "ros2msg", b"float64 x\n"))
        writer.add_message(topic, EPOCH_NS, bytes((0, 1, 0, 0)) + bytes(8), EPOCH_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match="the file does not define their types correctly: /x"):
        read_through(path)
    assert not (tmp_path / "ran").exists()


IDL = """module a { module msg {
  struct Pair { double x; sequence<float> more; string text; boolean on; };
}; };"""


def test_a_type_may_be_defined_in_idl(tmp_path: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_idl(IDL))
    path = tmp_path / "a"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("a/msg/Pair", "ros2idl", IDL.encode())
        topic = writer.register_channel("/x", "cdr", kind)
        for row in range(3):
            pair = store.types["a/msg/Pair"](row + 0.5, np.array([1.0, row], np.float32), "t", row == 1)
            writer.add_message(topic, EPOCH_NS + row, bytes(store.serialize_cdr(pair, "a/msg/Pair")), EPOCH_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    (table,) = by_name(path).values()
    held = whole(table).select(["x", "more_0", "more_1", "on"]).to_pylist()
    assert held[1] == {"x": 1.5, "more_0": 1.0, "more_1": 1.0, "on": True}
    assert held[2] == {"x": 2.5, "more_0": 1.0, "more_1": 2.0, "on": False}


def test_types_without_an_end_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a"
    kinds = "b/A a\n", "===\n", "MSG: b/A\n", "b/A a\n"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("b/msg/X", "ros2msg", "".join(kinds).replace("===", "=" * 80).encode())
        topic = writer.register_channel("/x", "cdr", kind)
        writer.add_message(topic, EPOCH_NS, bytes(20), EPOCH_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match="the file does not define their types correctly: /x"):
        read_through(path)


def test_a_stamp_in_the_messages_is_no_signal(tmp_path: Path) -> None:
    messages = [(EPOCH_NS + row * 10**7, {"timestamp": 0.013 * row, "x": row % 7 / 3}) for row in range(9)]
    with open_source(json_log(tmp_path / "a", messages)) as source:
        assert source.names == ("x",)
        assert [column.why for column in source.columns if column.name == "timestamp"] == ["another time"]


def test_a_number_beyond_all_floats_is_left_out(tmp_path: Path) -> None:
    messages = [(EPOCH_NS + row * 10**7, {"x": row, "y": 10**400 if row == 3 else 1}) for row in range(9)]
    (table,) = by_name(json_log(tmp_path / "a", messages)).values()
    assert whole(table)["x"].to_pylist() == list(range(9))
    assert [one for one in whole(table)["y"].to_pylist() if one == one] == [1] * 8
    assert any("left out: y" in note for note in table.notes)
