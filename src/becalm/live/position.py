"""Parse the position of a source, JSON text that a checkpoint holds."""

from __future__ import annotations

import json
from typing import Any

from becalm.errors import InputError


def parse_position(kind: str, position: str, needed: str) -> dict[str, Any]:
    """Return the fields of a position; {} for "", the start of a stream.

    Parameters
    ----------
    kind : str
        Kind of the source that continues from the position.
    position : str
        Position as a source wrote it.
    needed : str
        Key that only positions of this kind of source have.

    Raises
    ------
    InputError
        If a source of another kind wrote the position.
    """
    if not position:
        return {}
    try:
        fields = json.loads(position)
    except ValueError:
        fields = None
    if not isinstance(fields, dict) or needed not in fields:
        raise InputError(
            f"The position of this stream, {position[:80]!r}, is not a position of {kind}:; continue with the source "
            "that the stream had, or start a new stream in another place."
        )
    return fields
