"""What a page says is one JSON object, with numbers that are numbers."""

from __future__ import annotations

from typing import Any

import pytest

from becalm.errors import UsageError
from becalm.web.incoming_messages import number_of, parse_frame
from becalm.web.livepage import messages as of_live_pages
from becalm.web.tuner import messages as of_the_tuner


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        ({"bytes": b"{}"}, "sent bytes"),
        ({"bytes": b"{}", "text": None}, "sent bytes"),
        ({"text": ""}, "not JSON"),
        ({"text": "{"}, "not JSON"),
        ({"text": '{"do": "look"} {}'}, "not JSON"),
        ({"text": "[1]"}, "not an object"),
        ({"text": '"look"'}, "not an object"),
        ({"text": "null"}, "not an object"),
        ({"text": '{"q": NaN}'}, "NaN is not a finite number"),
        ({"text": '{"q": -Infinity}'}, "-Infinity is not a finite number"),
        ({"text": '{"q": 1e999}'}, "1e999 is not a finite number"),
        ({"text": '{"q": [-1e999]}'}, "-1e999 is not a finite number"),
        ({"text": '{"q": ' + "9" * 5000 + "}"}, "not JSON"),
        ({"text": "[" * 100_000}, "not JSON"),
        ({"text": '{"q": ' + "9" * 5000 + ".0}"}, "999... is not a finite number"),
    ],
    ids=range(15),
)
def test_what_is_no_message_is_refused_in_a_short_sentence(frame: dict[str, Any], says: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse_frame({"type": "websocket.receive", **frame})
    assert says in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_message_is_read() -> None:
    assert parse_frame({"text": '{"do": "look", "from_s": -1.5e3, "to_s": null}'}) == {
        "do": "look",
        "from_s": -1500.0,
        "to_s": None,
    }


@pytest.mark.parametrize(("number", "read"), [(7, 7), (True, None), (7.0, None), ("7", None), (None, None)])
def test_a_number_is_one(number: object, read: int | None) -> None:
    assert number_of({"number": number}) == read
    assert number_of({}) is None


@pytest.mark.parametrize("room", [of_live_pages, of_the_tuner])
@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ({"do": "sudo", "number": 1}, "Input tag 'sudo' found"),
        ({"do": "undo"}, "undo.number: Field required"),
        ({"do": "undo", "number": True}, "undo.number: Input should be a valid integer"),
        ({"do": "undo", "number": 1, "more": 2}, "undo.more: Extra inputs are not permitted"),
    ],
)
def test_both_pages_hear_in_the_same_words_what_is_wrong(room: Any, said: dict[str, Any], wrong: str) -> None:
    with pytest.raises(UsageError) as refused:
        room.parse_message(said)
    assert str(refused.value).startswith(f"A page sent a message that becalm does not know ({wrong}")
    assert str(refused.value).endswith("); reload it.")


@pytest.mark.parametrize("said", [{"do": "undo", "number": 1, "k" * 100_000: 2}, {"do": "k" * 100_000, "number": 1}])
def test_what_is_wrong_is_not_repeated_in_full(said: dict[str, Any]) -> None:
    with pytest.raises(UsageError) as refused:
        of_live_pages.parse_message(said)
    assert len(str(refused.value)) < 500
