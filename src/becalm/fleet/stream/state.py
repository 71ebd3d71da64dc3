"""Pack the state of one sensor's stream into the bytes that Spark stores."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from becalm.core.snapshot_bytes import packed, unpacked
from becalm.errors import ModelError
from becalm.live.block import Block, Checkpoint

_VERSION = 2


@dataclass(frozen=True)
class SensorState:
    """The state of a sensor's stream after a micro-batch.

    Attributes
    ----------
    heard_ms : int
        Time at which rows last arrived, by Spark's clock, in milliseconds since 1970.
    is_silent : bool
        Whether the sensor was reported as silent after `heard_ms`.
    is_watched : bool
        Whether a timer is set to check for silence.
    asked : str
        Hash of the recipe that the book last returned for the sensor, or of its error message.
    taken : str
        Hash of the recipe that the filters use.
    stream : Checkpoint or None
        The state of the filters; None before the first estimate.
    held : Block
        Rows that wait for enough rows to start the filters, or for rows with earlier stamps.
    messages : mapping
        The state of the numbering of messages, as `MessageStream.state`.
    """

    heard_ms: int
    is_silent: bool = False
    is_watched: bool = False
    asked: str = ""
    taken: str = ""
    stream: Checkpoint | None = None
    held: Block = field(default_factory=Block.of_losses)
    messages: Mapping[str, Any] = field(default_factory=dict)

    def packed(self) -> bytes:
        """Return the state as bytes; equal states give equal bytes."""
        words = {
            "asked": self.asked,
            "taken": self.taken,
            "recipe": self.stream.recipe if self.stream else "",
            "names": self.held.names,
            "units": self.held.units,
            "messages": dict(self.messages),
        }
        rows = -1 if self.stream is None else self.stream.rows
        return packed(
            {
                "told": np.array([_VERSION, self.heard_ms, self.is_silent, self.is_watched, rows], np.int64),
                "words": np.frombuffer(json.dumps(words, separators=(",", ":")).encode(), np.int8),
                "stream": np.frombuffer(self.stream.snapshot if self.stream else b"", np.int8),
                "held_s": self.held.time_s,
                "held": self.held.values,
            }
        )

    @classmethod
    def unpacked(cls, blob: bytes) -> SensorState:
        """Return the state from the bytes that `packed` returned.

        Raises
        ------
        ModelError
            If the bytes are damaged, or of another version.
        """
        try:
            arrays = unpacked(blob)
            version, *numbers = (int(number) for number in arrays["told"])
            if version != _VERSION:
                raise ModelError(f"A sensor's state has version {version}; this becalm reads {_VERSION}.")
            heard_ms, is_silent, is_watched, rows = numbers
            words = json.loads(arrays["words"].tobytes())
            stream = Checkpoint(rows, "", arrays["stream"].tobytes(), words["recipe"], "") if rows >= 0 else None
            held = Block(tuple(words["names"]), tuple(words["units"]), arrays["held_s"], arrays["held"])
            asked, taken, messages = words["asked"], words["taken"], words["messages"]
        except ModelError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as cause:
            raise ModelError("A sensor's state is damaged; start a new stream with another checkpoint.") from cause
        return cls(heard_ms, bool(is_silent), bool(is_watched), asked, taken, stream, held, messages)
