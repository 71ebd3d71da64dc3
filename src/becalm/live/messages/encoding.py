"""Encode rows as messages for sinks; `becalm.live.messages` can read them again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats
from becalm.errors import UsageError
from becalm.files.outputs.tables import VERDICT
from becalm.files.roles import SIGMA
from becalm.live.block import Head, Output
from becalm.live.messages.columns import SEQ

TIME = "time"
FORMATS = ("arrow", "json")


@dataclass
class Encoder:
    """An encoder of rows as messages.

    Parameters
    ----------
    form : str
        Format, "arrow" or "json".
    units : dict of str to str
        Units of the columns by name.
    """

    form: str = "arrow"
    units: Mapping[str, str] = field(default_factory=dict)
    _last: tuple[tuple[tuple[str, str], ...], object, bytes] | None = field(default=None, repr=False)  # cached schema

    @classmethod
    def of(cls, head: Head, form: str) -> Encoder:
        """Return the encoder for a stream's outputs.

        Raises
        ------
        UsageError
            If two columns would have the same name: a channel is called `time`, or one `a` and another `a_sigma`.
        """
        names = [SEQ, TIME, *(name + end for name in head.names for end in ("", SIGMA, VERDICT))]
        twice = [name for number, name in enumerate(names) if name in names[:number]]
        if twice:
            raise UsageError(
                f"Two columns of a message would be called {twice[0]!r}: each channel NAME has NAME, NAME{SIGMA} and"
                f" NAME{VERDICT}, next to {SEQ} and {TIME}; rename a channel at its source."
            )
        pairs = dict(zip(head.names, head.units, strict=True))
        return cls(form, pairs | {name + SIGMA: unit for name, unit in pairs.items()})

    def output(self, output: Output, head: Head) -> bytes:
        """Return an output as a message: seq, time, and for each channel NAME, NAME_sigma and NAME_verdict."""
        columns: dict[str, NDArray[np.float64] | Codes] = {TIME: output.time_s}
        for channel, name in enumerate(head.names):
            columns[name] = output.signal[:, channel]
            columns[name + SIGMA] = output.sigma[:, channel]
            columns[name + VERDICT] = output.verdicts[:, channel]
        return self.message(columns, output.first_row)

    def message(self, columns: Mapping[str, Floats | Codes], seq: int | None = None) -> bytes:
        """Return rows as a message.

        Parameters
        ----------
        columns : dict of str to (B,) arrays
            Columns in the order of the message.
        seq : int or None
            Number of the first row; None for a stream without numbers.
        """
        if self.form == "json":
            return self._json(columns, seq)
        import pyarrow as pa

        arrays = {name: np.ascontiguousarray(column) for name, column in columns.items()}
        if seq is not None:
            rows = len(next(iter(arrays.values())))
            arrays = {SEQ: np.arange(seq, seq + rows, dtype=np.int64), **arrays}
        schema, head = self._schema(arrays)
        batch = pa.RecordBatch.from_arrays([pa.array(column) for column in arrays.values()], schema=schema)
        return head + bytes(batch.serialize())

    def _schema(self, arrays: Mapping[str, NDArray[np.generic]]) -> tuple[object, bytes]:
        """Return the schema and its bytes, cached for messages with the same columns."""
        import pyarrow as pa

        key = tuple((name, column.dtype.str) for name, column in arrays.items())
        if self._last is None or self._last[0] != key:
            fields = []
            for name, column in arrays.items():
                unit = self.units.get(name, "")
                fields.append(
                    pa.field(name, pa.from_numpy_dtype(column.dtype), metadata={"unit": unit} if unit else None)
                )
            schema = pa.schema(fields)
            self._last = (key, schema, schema.serialize().to_pybytes())
        return self._last[1], self._last[2]

    def _json(self, columns: Mapping[str, Floats | Codes], seq: int | None) -> bytes:
        """Return a JSON object with columns as lists; NaN and infinities, which JSON does not have, become null."""
        message: dict[str, object] = {} if seq is None else {SEQ: seq}
        if self.units:
            message["units"] = {name: self.units[name] for name in columns if self.units.get(name)}
        for name, column in columns.items():
            is_finite = bool(np.isfinite(column).all())
            message[name] = column.tolist() if is_finite else [x if np.isfinite(x) else None for x in column.tolist()]
        return json.dumps(message, separators=(",", ":")).encode()
