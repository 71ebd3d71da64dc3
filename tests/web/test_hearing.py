"""What a page says is one JSON object, with numbers that are numbers."""

from __future__ import annotations

from typing import Any

import pytest

from becalm.errors import UsageError
from becalm.web.hearing import heard


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        ({"bytes": b"{}"}, "sent bytes"),
        ({"bytes": b"{}", "text": None}, "sent bytes"),
        ({"text": ""}, "no JSON"),
        ({"text": "{"}, "no JSON"),
        ({"text": '{"do": "look"} {}'}, "no JSON"),
        ({"text": "[1]"}, "no object"),
        ({"text": '"look"'}, "no object"),
        ({"text": "null"}, "no object"),
        ({"text": '{"q": NaN}'}, "NaN is no finite number"),
        ({"text": '{"q": -Infinity}'}, "-Infinity is no finite number"),
        ({"text": '{"q": 1e999}'}, "1e999 is no finite number"),
        ({"text": '{"q": [-1e999]}'}, "-1e999 is no finite number"),
        ({"text": '{"q": ' + "9" * 5000 + "}"}, "no JSON"),
        ({"text": "[" * 100_000}, "no JSON"),
        ({"text": '{"q": ' + "9" * 5000 + ".0}"}, "999... is no finite number"),
    ],
    ids=range(15),
)
def test_what_is_no_message_is_refused_in_a_short_sentence(frame: dict[str, Any], says: str) -> None:
    with pytest.raises(UsageError) as refused:
        heard({"type": "websocket.receive", **frame})
    assert says in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_message_is_read() -> None:
    assert heard({"text": '{"do": "look", "from_s": -1.5e3, "to_s": null}'}) == {
        "do": "look",
        "from_s": -1500.0,
        "to_s": None,
    }
