"""Heads that loggers and measuring programs write above the rows: names, units and times come from the right line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError
from becalm.files import read_source

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


HEADS = {
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
