"""Where a source stands, as JSON text that a checkpoint keeps."""

from __future__ import annotations

import json
from typing import Any

from becalm.errors import InputError


def told_by(kind: str, position: str, needed: str) -> dict[str, Any]:
    """Return what a position tells; {} of "", which begins.

    Parameters
    ----------
    kind : str
        Of the source that reads it.
    position : str
        As the source wrote it.
    needed : str
        What only positions of this kind of source hold.

    Raises
    ------
    InputError
        If another kind of source wrote it.
    """
    if not position:
        return {}
    try:
        told = json.loads(position)
    except ValueError:
        told = None
    if not isinstance(told, dict) or needed not in told:
        raise InputError(
            f"This stream was read until {position[:80]!r}, which is no position of {kind}:; go on with the source "
            "that it had, or begin a new stream in another place."
        )
    return told
