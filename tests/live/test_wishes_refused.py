"""Instruments that cannot be asked as an address asks."""

from __future__ import annotations

import pytest

from becalm.errors import UsageError
from becalm.live.registry import open_source


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("serial:", "names no port"),
        ("serial:x?baud=fast", "baud=fast"),
        ("serial:x?parity=mark", "parity=mark"),
        ("serial:x?speed=9600", "no option 'speed'"),
        ("visa:", "names no instrument"),
        ("visa:X?interval=10", "interval 10 is not a time"),
        ("visa:X?query=&interval=1s", "give only one of them"),
        ("visa:X?end=dot", "end=dot"),
        ("visa:X?baud=9600", "no option 'baud'"),
        ("ni:Dev1/ai0", "needs channels and a rate"),
        ("ni:?rate=10", "needs channels and a rate"),
        ("ni:Dev1/ai0?rate=0", "rate=0"),
        ("ni:Dev1/ai0?rate=1&wiring=loose", "wiring=loose"),
        ("ni:Dev1/ai0?rate=1&speed=1", "no option 'speed'"),
    ],
)
def test_impossible_wishes_are_refused(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        open_source(text)
