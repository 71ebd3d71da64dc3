"""CSV as loggers write it: every variant gives the same recording."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError
from becalm.files import ReadOptions, read, read_source

TIMES = np.arange(60) / 100
FORCE = np.round(20 + np.sin(np.arange(60) / 5), 4) + 0.0001
ACC = np.round(np.cos(np.arange(60) / 7), 5) - 0.00001


def rows(separator: str = ",", decimal: str = ".", end: str = "\n", tail: str = "") -> str:
    lines = [
        separator.join(f"{v:.{d}f}" for v, d in ((t, 2), (f, 4), (a, 5)))
        for t, f, a in zip(TIMES, FORCE, ACC, strict=True)
    ]
    return "".join(line.replace(".", decimal) + tail + end for line in lines)


HEAD = "time_s,force_kN,acc\n"
VARIANTS = {
    "plain": HEAD + rows(),
    "no newline at the end": (HEAD + rows()).rstrip(),
    "crlf": HEAD.replace("\n", "\r\n") + rows(end="\r\n"),
    "old mac": HEAD.replace("\n", "\r") + rows(end="\r"),
    "semicolon": "time_s;force_kN;acc\n" + rows(";"),
    "tab": "time_s\tforce_kN\tacc\n" + rows("\t"),
    "pipe": "time_s|force_kN|acc\n" + rows("|"),
    "spaces": "time_s   force_kN acc\n" + rows("   "),
    "spaces before": "  time_s   force_kN acc\n" + "".join(f"  {line}  \n" for line in rows("   ").splitlines()),
    "space after comma": "time_s, force_kN, acc\n" + rows(", "),
    "semicolon, decimal comma": "time_s;force_kN;acc\n" + rows(";", ","),
    "tab, decimal comma": "time_s\tforce_kN\tacc\n" + rows("\t", ","),
    "spaces, decimal comma": "time_s force_kN acc\n" + rows(" ", ","),
    "sep line": "sep=;\ntime_s;force_kN;acc\n" + rows(";", ","),
    "sep line, comma": "SEP=,\r\n" + HEAD + rows(),
    "quoted names": '"time_s","force_kN","acc"\n' + rows(),
    "quoted numbers": HEAD + "".join('"' + line.replace(",", '","') + '"\n' for line in rows().splitlines()),
    "quoted decimal commas": HEAD
    + "".join('"' + line.replace(";", '","') + '"\n' for line in rows(";", ",").splitlines()),
    "blank lines at the end": HEAD + rows() + "\n\n  \n",
    "separators at the end": HEAD + rows() + ",,\n,,\n",
    "blank line below the header": HEAD + "\n" + rows(),
    "trailing separators": "time_s,force_kN,acc,\n" + rows(tail=","),
    "trailing separators in the data": HEAD + rows(tail=","),
    "trailing separator in the header": "time_s,force_kN,acc,\n" + rows(),
    "comments above": "# logger 7\n# made on 2022-03-07, noon\n" + HEAD + rows(),
    "commented header": "# time_s,force_kN,acc\n" + rows(),
    "preamble": "Logger: X7\nSerial: 1234\nStart: 2022-03-07 10:00, local\n\n" + HEAD + rows(),
    "preamble with separators": "Logger;X7\nSerial;1234\n\n\ntime_s;force_kN;acc\n" + rows(";"),
    "preamble as wide as the table": "Logger,X7,\nSerial,1234,\n" + HEAD + rows(),
    "units row": "time,force,acc\ns,kN,m/s^2\n" + rows(),
    "units row in brackets": "time;force;acc\n[s];[kN];[m/s²]\n" + rows(";", ","),
    "units row with a dash": "time,force,acc\ns,kN,-\n" + rows(),
    "plus signs": HEAD + "".join("+" + line + "\n" for line in rows().splitlines()),
    "control-z at the end": HEAD + rows() + "\x1a",
}


def save(folder: Path, text: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


@pytest.mark.parametrize("text", VARIANTS.values(), ids=VARIANTS.keys())
def test_every_variant_gives_the_same_recording(text: str, tmp_path: Path) -> None:
    recording = read(save(tmp_path, text))
    assert recording.names[0] in ("force_kN", "force")
    assert recording.names[1] == "acc"
    assert recording.units[0] == "kN"
    np.testing.assert_array_equal(recording.samples[:, 0], [float(f"{v:.4f}") for v in FORCE])
    np.testing.assert_array_equal(recording.samples[:, 1], [float(f"{v:.5f}") for v in ACC])
    np.testing.assert_allclose(recording.times_s, TIMES, atol=1e-9)
    assert recording.timebase.uniform


ENCODINGS = {
    "utf-8": "time_s,Dehnung (µm/m)\n".encode(),
    "utf-8-bom": "\ufefftime_s,Dehnung (µm/m)\n".encode(),
    "cp1252": "time_s,Dehnung (µm/m)\n".encode("cp1252"),
}


@pytest.mark.parametrize("encoding", [*ENCODINGS, "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("packed", [False, True])
def test_encodings_and_gzip_are_found_by_content(encoding: str, packed: bool, tmp_path: Path) -> None:
    body = "".join(f"{t:.2f},{f:.4f}\n" for t, f in zip(TIMES, FORCE, strict=True))
    if encoding.startswith("utf-16"):
        data = ("\ufefftime_s,Dehnung (µm/m)\n" + body).encode(encoding)
    else:
        data = ENCODINGS[encoding] + body.encode()
    source = read_source(save(tmp_path, gzip.compress(data) if packed else data, "log.dat"))
    assert source.recording.names == ("Dehnung (µm/m)",)
    assert source.recording.units == ("um/m",)
    assert source.layout.encoding == encoding
    assert source.layout.compression == ("gzip" if packed else "")


def test_two_header_rows_are_joined_with_a_dot(tmp_path: Path) -> None:
    text = "sensor,left,left,right\naxis,x,y,x\n" + "".join(f"{i},{i}.5,2.25,3.5\n" for i in range(30))
    source = read_source(save(tmp_path, text), ReadOptions(rate_hz=50))
    assert source.recording.names == ("left.x", "left.y", "right.x")
    assert source.table.column_names[0] == "sensor.axis"
    assert source.layout.header_rows == 2


def test_without_a_header_columns_are_numbered(tmp_path: Path) -> None:
    recording = read(save(tmp_path, rows()))
    assert recording.names == ("column_2", "column_3")
    assert len(recording) == 60


def test_repeated_names_are_made_different(tmp_path: Path) -> None:
    source = read_source(save(tmp_path, "time_s,a,a,a_2\n" + "".join(f"0.{i},1.5,2.5,3.5\n" for i in range(1, 9))))
    assert source.recording.names == ("a", "a_3", "a_2")


@pytest.mark.parametrize(
    "marker", ["", "NaN", "nan", "NA", "N/A", "null", "#N/A", "-", "--", "---", " ", " NA ", "1.#QNAN"]
)
def test_missing_markers_become_nan(marker: str, tmp_path: Path) -> None:
    text = "time_s,a,b\n" + "".join(f"0.{i},{marker if i == 4 else 1.5},2.5\n" for i in range(1, 9))
    source = read_source(save(tmp_path, text))
    assert np.flatnonzero(np.isnan(source.recording.channel("a"))).tolist() == [3]
    assert next(c.missing for c in source.layout.columns if c.name == "a") == 1


def test_inf_stays_inf_and_a_column_may_be_all_missing(tmp_path: Path) -> None:
    text = "time_s,a,b\n" + "".join(
        f"0.{i},{'inf' if i == 2 else '-Infinity' if i == 3 else 1},\n" for i in range(1, 9)
    )
    recording = read(save(tmp_path, text))
    assert recording.channel("a")[:4].tolist() == [1, np.inf, -np.inf, 1]
    assert np.isnan(recording.channel("b")).all()


def test_an_empty_line_in_a_file_of_one_column_is_a_missing_sample(tmp_path: Path) -> None:
    recording = read(save(tmp_path, "Force [N]\n1.5\n\n2.5\n3.5\n"), rate_hz=10)
    np.testing.assert_array_equal(recording.samples[:, 0], [1.5, np.nan, 2.5, 3.5])


def test_decimal_commas_that_begin_late_are_found(tmp_path: Path) -> None:
    text = "time_s;a\n" + "".join(f"{i};{i % 7}{',25' if i > 20_000 else ''}\n" for i in range(20_100))
    source = read_source(save(tmp_path, text))
    assert source.recording.samples[-1, 0] == 20_099 % 7 + 0.25
    assert source.layout.decimal == ","


def test_one_column_with_decimal_commas_is_told_by_its_header(tmp_path: Path) -> None:
    one = read(save(tmp_path, "Force [N]\n" + "1,234\n5,678\n" * 10), rate_hz=5)
    assert one.samples[:2, 0].tolist() == [1.234, 5.678]
    two = read(save(tmp_path, "a,b\n" + "1,234\n5,678\n" * 10), rate_hz=5)
    assert two.samples[:2].tolist() == [[1, 234], [5, 678]]


def test_thousandths_behind_a_semicolon_are_fractions(tmp_path: Path) -> None:
    recording = read(save(tmp_path, "1,234;5,678\n2,345;6,789\n1,456;7,890\n"), rate_hz=1)
    assert recording.samples[0].tolist() == [1.234, 5.678]


AMBIGUOUS = {
    "one or two columns": ("1,234\n5,678\n9,101\n", "one column with decimal commas"),
    "decimal commas between commas": ("time_s,a\n0,10,1,5\n0,20,1,6\n0,30,1,7\n", "decimal commas"),
    "both decimal signs": ("time_s;a\n0.1;1,5\n0.2;1,6\n0.3;1,7\n", "same decimal separator"),
    "thousands in quotes": ('t (ms),a (N)\n0,"999"\n1,"1,002"\n2,"1,005"\n', "1,002.*thousands"),
    "thousands beside hundreds": ("t (ms);a (N)\n0;999\n1;1,002\n2;1,005\n", "1,002.*thousands"),
    "thousands that begin late": (
        "t (ms);a (N)\n" + "".join(f"{i};{i + 300:,}\n" for i in range(710)),
        "1,000.*thousands",
    ),
    "too few names": ("time_s,a\n0.1,1,5\n0.2,1,6\n0.3,1,7\n", "2 names"),
}


@pytest.mark.parametrize(("text", "says"), AMBIGUOUS.values(), ids=AMBIGUOUS.keys())
def test_two_readings_are_refused(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        read(save(tmp_path, text))


def test_text_columns_counters_flags_and_sigmas_pass_through(tmp_path: Path) -> None:
    text = "time_s,row,on,note,a,a_sigma,day\n" + "".join(
        f"0.{i},{i},{i % 2},{'NA' if i == 3 else 'ok, fine' if i == 4 else 'x'},1.{i},0.1,2022-03-0{i}\n".replace(
            "ok, fine", '"ok, fine"'
        )
        for i in range(1, 9)
    )
    source = read_source(save(tmp_path, text))
    assert source.recording.names == ("a",)
    assert source.table["note"].to_pylist()[2:4] == ["NA", "ok, fine"]
    why = {column.name: column.why for column in source.layout.columns}
    assert "counter" in why["row"]
    assert "flag" in why["on"]
    assert why["note"] == "text"
    assert "uncertainty" in why["a_sigma"]
    asked = read_source(save(tmp_path, text), ReadOptions(channels=("on", "row")))
    assert asked.recording.names == ("on", "row")


def test_a_constant_column_is_a_channel(tmp_path: Path) -> None:
    text = "time_s,zero,one\n" + "".join(f"0.{i},0,1\n" for i in range(1, 9))
    assert read(save(tmp_path, text)).names == ("zero", "one")


def test_channels_are_named_with_or_without_unit(tmp_path: Path) -> None:
    text = "time_s,Gyro X (deg/s),Gyro Y (deg/s)\n" + "".join(f"0.{i},1.5,2.5\n" for i in range(1, 9))
    path = save(tmp_path, text)
    assert read(path, channels=["Gyro Y", "Gyro X (deg/s)"]).names == ("Gyro Y (deg/s)", "Gyro X (deg/s)")
    assert read(path, channels="Gyro Y").units == ("deg/s",)


def test_full_precision_is_kept(tmp_path: Path) -> None:
    values = np.random.default_rng(5).normal(size=500) * 10.0 ** np.random.default_rng(6).integers(-200, 200, 500)
    text = "time_s,a\n" + "".join(f"{i / 8!r},{float(v)!r}\n" for i, v in enumerate(values))
    np.testing.assert_array_equal(read(save(tmp_path, text)).samples[:, 0], values)


def test_ten_thousand_columns_are_read(tmp_path: Path) -> None:
    names = ",".join(f"c{i}" for i in range(10_000))
    line = ",".join(f"{i}.5" for i in range(10_000))
    recording = read(save(tmp_path, f"{names}\n" + f"{line}\n" * 3), rate_hz=1.0)
    assert recording.samples.shape == (3, 10_000)


def test_the_layout_is_plain_data(tmp_path: Path) -> None:
    import json

    layout = read_source(save(tmp_path, VARIANTS["semicolon, decimal comma"])).layout
    plain = json.loads(json.dumps(layout.as_dict()))
    assert plain["separator"] == ";"
    assert plain["decimal"] == ","
    assert plain["time_columns"] == ["time_s"]
    assert [column["role"] for column in plain["columns"]] == ["time", "channel", "channel"]


def test_covariances_that_a_driver_states_are_no_signals(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv"
    lines = (f"{t:.2f},{a:.5f},{1 + n % 3}\n" for n, (t, a) in enumerate(zip(TIMES, ACC, strict=True)))
    path.write_text("time_s,acc.x,acc_covariance_0\n" + "".join(lines))
    assert read_source(path).recording.names == ("acc.x",)
    asked = ReadOptions(channels=("acc_covariance_0",))
    assert read_source(path, asked).recording.names == ("acc_covariance_0",)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_long_whole_numbers_keep_all_digits(separator: str, tmp_path: Path) -> None:
    ids = [9_007_199_254_740_991 + 2 * row for row in range(60)]  # from the second on, no float64
    lines = [separator.join((f"{row / 100}", f"{row % 7}.25", str(one))) for row, one in enumerate(ids)]
    text = separator.join(("time_s", "a", "id")) + "\n" + "\n".join(lines) + "\n"
    assert read_source(save(tmp_path, text), ReadOptions(channels=("a",))).table["id"].to_pylist() == ids


@pytest.mark.parametrize(
    ("first", "second", "kept"),
    [
        ("12345678901234567890", "12345678901234567891", None),
        ("1700000000000000003", "1700000000000000005.5", None),
        ("+1700000000000000003", "+1700000000000000005", [1_700_000_000_000_000_003, 1_700_000_000_000_000_005]),
        ("10000000000000000000", "2.5e20", [1e19, 2.5e20]),
    ],
)
def test_whole_numbers_are_never_rounded(first: str, second: str, kept: list[float] | None, tmp_path: Path) -> None:
    rows = "".join(f"{row / 4},{second if row % 2 else first},{row % 3}.5\n" for row in range(6))
    source = read_source(save(tmp_path, "time_s,id,a\n" + rows))
    assert source.table["id"].to_pylist()[:2] == ([first, second] if kept is None else kept)
    assert "a" in source.recording.names
    if kept is None:
        assert source.layout.columns[1].why == "whole numbers that float64 would round"


def test_a_time_that_would_be_rounded_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{17 * 10**17 + 10**7 * row + 3}{'.5' if row == 3 else ''},{row % 3}.5\n" for row in range(6))
    with pytest.raises(InputError, match="would round"):
        read(save(tmp_path, "timestamp_ns,a\n" + rows))


def test_a_column_of_lists_does_not_divide_the_rows(tmp_path: Path) -> None:
    text = "device,load,flags\n" + "".join(f"rig A,{row % 7}.25,0;1;0;2;2;1\n" for row in range(20))
    recording = read(save(tmp_path, text), rate_hz=1.0)
    assert recording.names == ("load",)
    assert recording.samples[3, 0] == 3.25


def test_lines_that_end_in_cr_only_may_be_separated_by_spaces(tmp_path: Path) -> None:
    text = "time_s force\r" + "".join(f"  {row / 8}   {row % 7}.5  \r" for row in range(20))
    assert read(save(tmp_path, text.encode())).samples[:2, 0].tolist() == [0.5, 1.5]
