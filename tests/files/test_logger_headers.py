"""Heads that loggers and measuring programs write above the rows: names, units and times come from the right line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError
from becalm.files import open_source, read_source

COUNT = 60
TIMES = np.arange(COUNT) / 100
A, B = np.round(np.sin(TIMES * 9), 4) + 0.0001, np.round(np.cos(TIMES * 7), 4) + 0.0001

LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Multi_Headings\tNo
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t60\t60\t
Date\t2024/03/05\t2024/03/05\t
Time\t14:02:03.12\t14:02:03.12\t
Y_Unit_Label\tVolts\tg\t
X_Dimension\tTime\tTime\t
X0\t0.0\t0.0\t
Delta_X\t0.01\t0.01\t
***End_of_Header***\t\t\t
X_Value\ta\tb\tComment
"""
CAMPBELL = (
    '"TOA5","CR6","CR6","12","CR6.Std.12","CPU:run.CR6","1","fast"\n"TIMESTAMP","RECORD","a","b"\n"TS","RN","V","g"\n'
    '"","","Smp","Avg"\n'
)


def table(separator: str, tail: str = "") -> str:
    lines = zip(TIMES, A, B, strict=True)
    return "".join(separator.join((f"{t:.2f}", f"{a:.4f}", f"{b:.4f}")) + tail + "\n" for t, a, b in lines)


WITHOUT_X = LABVIEW.replace("X_Columns\tOne", "X_Columns\tNo").replace("X_Value\t", "")
RACE = "Format,3\nTrack name,X\nNote,\n\ntimestamp,a,b\nunix time,V,G\ncalc,100: gps,102: acc\n"
WAVEFORM = "waveform\t[0]\t[1]\nt0\t3/25/2024 2:02:03 PM\t3/25/2024 2:02:03 PM\ndelta t\t0.010000\t0.010000\n\n"
CONCEPTS = ";Title, X16-1D\n;Temperature, 20.00, deg C, Vbat, 1526, mv\n;SampleRate, 100,Hz\n;Headers, time,a,b\n"


def pair(separator: str) -> str:
    return "".join(f"{a:.4f}{separator}{b:.4f}\n" for a, b in zip(A, B, strict=True))


def counted(tail: str) -> str:
    return "".join(f"{row},{a:.4f},{b:.4f}{tail}\n" for row, (a, b) in enumerate(zip(A, B, strict=True)))


@pytest.mark.parametrize("head", ["Sample interval (ms): 10 ms", "Sample interval (ms): 10", "Sample interval: 10 ms"])
def test_a_step_in_milliseconds_is_one(head: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{head}\na,b\n" + pair(","), encoding="utf-8")
    with open_source(tmp_path / "a.csv") as source:
        assert source.rate_hz == pytest.approx(100.0)


HEADS = {
    "LabVIEW, no X": WITHOUT_X + pair("\t"),
    "LabVIEW, no X, no 0": WITHOUT_X.replace("\t0.01", "\t.01") + pair("\t"),
    "RaceChrono": RACE
    + "".join(f"{1709647323 + t:.2f},{a:.4f},{b:.4f}\n" for t, a, b in zip(TIMES, A, B, strict=True)),
    "INCA": "ETASAsciiItemFile\trecord\t\nsampleCount\t60\ntime\ta\tb\nf8\tf8\tf8\ns\tV\tg\n" + table("\t"),
    "units above": "s,V,g\nTime,a,b\n" + table(","),
    "Siglent": "Sample Interval,Analog:0.01\nVertical Units,CH1:V,CH2:g\nSource,a,b\nSecond,Volt,g\n" + table(","),
    "Rigol": "X,a,b,Start,Increment,\nSequence,Volt,g,-3.00e-01,1.000000e-02\n" + counted(","),
    "Rigol, in one row": "a (V),b (g),t0 = -0.3, tInc = 0.01,\n" + pair(",").replace("\n", ",,\n"),
    "a waveform of LabVIEW": WAVEFORM + "a (V)\tb (g)\n" + pair("\t"),
    "a waveform of LabVIEW with times": WAVEFORM
    + "time\ta (V)\tb (g)\n"
    + "".join(
        f"3/25/2024 2:02:03.{row:02d} PM\t{a:.4f}\t{b:.4f}\n" for row, (a, b) in enumerate(zip(A, B, strict=True))
    ),
    "a rate above": "Sample rate: 100 Hz\n\na (V);b (g)\n" + pair(";"),
    "a commented step": "# dt = 10 ms\n# a (V), b (g)\n" + pair(","),
    "LabVIEW, comments left out": LABVIEW + table("\t"),
    "LabVIEW, comments empty": LABVIEW + table("\t", "\t"),
    "Campbell": CAMPBELL
    + "".join(
        f'"2024-03-05 14:02:0{n // 100}.{n % 100:02d}",{n},{a:.4f},{b:.4f}\n'
        for n, (a, b) in enumerate(zip(A, B, strict=True))
    ),
    "a list of events above": "Event\tEvent type\tTime\tNote\n1\tstart\t0\t\n2\tstop\t4\t\n\nTime\ta [V]\tb [g]\n"
    + table("\t"),
    "notes with numbers above": "Name,Run,1\nSample rate,100,Hz\nTime (s),a (V),b (g)\n" + table(","),
    "notes, and units below": '"Run","7"\n"Duration","4.0","s"\n\n"Time","a","b"\n"s","V","g"\n\n' + table(","),
    "units in brackets": "Time,a,b\n(s),(V),(g)\n" + table(","),
    "units in words": "Time,a,b\nsecond,Volt,g\n" + table(","),
    "fewer names than trailing separators": "Time\ta\tb\ns\tV\tg\n" + table("\t", "\t\t"),
}


@pytest.mark.parametrize("text", HEADS.values(), ids=HEADS)
def test_names_and_units_come_from_the_right_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    recording = read_source(path).recording
    assert [name.split(" ")[0] for name in recording.names[:2]] == ["a", "b"]
    assert recording.units[:2] == ("V", "g")
    assert recording.rate_hz == pytest.approx(100)
    np.testing.assert_array_equal(recording.samples[:, 0], A.round(4))
    np.testing.assert_array_equal(recording.samples[:, 1], B.round(4))


def test_a_head_of_comments_with_semicolons_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(CONCEPTS + table(","))
    recording = read_source(path).recording
    assert recording.names == ("a", "b")
    assert recording.rate_hz == pytest.approx(100)


@pytest.mark.parametrize(
    "above", ["Sample rate: 100 Hz\nSample rate: 50 Hz\n\n", "Sample rate: 0 Hz\n\n", "Rate of x: 100\n\n", ""]
)
def test_a_rate_that_is_none_is_not_taken(above: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(above + "a (V);b (g)\n" + pair(";"))
    with pytest.raises(InputError, match="no time column"):
        read_source(path)


@pytest.mark.parametrize("above", ["Sampling rate: 1,000 Hz", "rate = 12,800", "# Sample interval: 1,5 ms"])
def test_a_rate_with_a_comma_among_commas_is_not_taken(above: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(above + "\na (V),b (g)\n" + pair(","))
    with pytest.raises(InputError, match=r"no time column.*give --rate HZ"):
        read_source(path)


def test_times_count_more_than_a_rate_above(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Sample rate: 50 Hz\n\nTime (s),a,b\n" + table(","))
    assert read_source(path).recording.rate_hz == pytest.approx(100)


def test_a_large_file_takes_its_rate_as_a_small_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Sample rate: 100 Hz\n\na (V);b (g)\n" + pair(";"))
    monkeypatch.setattr("becalm.files.csv.blocks.WHOLE_BYTES", 100)
    with open_source(path) as source:
        assert source.rate_hz == pytest.approx(100)
        assert [chunk.table.column("time_s")[0].as_py() for chunk in source.chunks(25)] == [0.0, 0.25, 0.5]


@pytest.mark.parametrize(("separator", "decimal", "thousands"), [(";", ".", ","), (";", ",", "."), ("\t", ".", ",")])
def test_thousands_may_be_parted(separator: str, decimal: str, thousands: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    signs = str.maketrans({".": decimal, ",": thousands})
    lines = [
        separator.join((f"{t:.2f}", f"{4e3 * a:,.2f}", f"{b:.4f}")).translate(signs)
        for t, a, b in zip(TIMES, A, B, strict=True)
    ]
    path.write_text(f"Time (s){separator}a (N){separator}b (g)\n" + "\n".join(lines) + "\n")
    recording = read_source(path).recording
    np.testing.assert_array_equal(recording.samples[:, 0], [float(f"{4e3 * a:.2f}") for a in A])


def test_the_month_is_first_where_halves_of_the_day_are_told(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    days = [f"3/{5 + hour // 24}/2024 {(hour - 1) % 12 + 1}:00:00 {'AP'[hour % 24 // 12]}M" for hour in range(COUNT)]
    path.write_text("Date,a (V)\n" + "".join(f"{day},{a:.4f}\n" for day, a in zip(days, A, strict=True)))
    with open_source(path) as source:
        assert source.layout.time_start == "2024-03-05T00:00:00.000000000"
        assert source.rate_hz == pytest.approx(1 / 3600)


@pytest.mark.parametrize("head", ["Time 1 (s),a,Time 2 (s),b", "X [s],a,X [s],b"])
def test_a_second_column_of_times_is_never_overlooked(head: str, tmp_path: Path) -> None:
    path = tmp_path / "two_rates.csv"
    cells = [f"{n / 100:.2f},{a:.4f}," for n, a in enumerate(A)]
    slow = [f"{n / 50:.2f},{b:.4f}" if n < COUNT // 2 else "," for n, b in enumerate(B)]
    path.write_text(head + "\n" + "\n".join(one + other for one, other in zip(cells, slow, strict=True)) + "\n")
    with pytest.raises(InputError, match="2 columns could be the time"):
        read_source(path)


def test_a_repeated_column_of_the_same_times_is_no_other_time(tmp_path: Path) -> None:
    path = tmp_path / "pasted.csv"
    lines = (f"{n / 100:.2f},{a:.4f},{n / 100:.2f},{b:.4f}\n" for n, (a, b) in enumerate(zip(A, B, strict=True)))
    path.write_text("X [s],a,X [s],b\n" + "".join(lines))
    assert read_source(path).recording.rate_hz == pytest.approx(100)
