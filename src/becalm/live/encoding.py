"""Rows as a message: what sinks send, and what `messages` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats
from becalm.live.block import Head, Output

FORMATS = ("arrow", "json")


@dataclass
class Encoder:
    """Makes messages of rows.

    Parameters
    ----------
    form : str
        "arrow" or "json".
    units : dict of str to str
        Units of columns.
    """

    form: str = "arrow"
    units: Mapping[str, str] = field(default_factory=dict)
    _last: tuple[tuple[tuple[str, str], ...], object, bytes] | None = field(default=None, repr=False)

    @classmethod
    def of(cls, head: Head, form: str) -> Encoder:
        """Return the one of a stream's outputs."""
        pairs = dict(zip(head.names, head.units, strict=True))
        return cls(form, pairs | {f"{name}_sigma": unit for name, unit in pairs.items()})

    def output(self, output: Output, head: Head) -> bytes:
        """Return an output: seq, time, and of each channel NAME, NAME_sigma and NAME_verdict."""
        columns: dict[str, NDArray[np.float64] | Codes] = {"time": output.time_s}
        for channel, name in enumerate(head.names):
            columns[name] = output.signal[:, channel]
            columns[f"{name}_sigma"] = output.sigma[:, channel]
            columns[f"{name}_verdict"] = output.verdicts[:, channel]
        return self.message(columns, output.first_row)

    def message(self, columns: Mapping[str, Floats | Codes], seq: int | None = None) -> bytes:
        """Return rows as a message.

        Parameters
        ----------
        columns : dict of str to (B,) arrays
            In the order they are to have.
        seq : int or None
            The number of the first row; None of a stream without numbers.
        """
        if self.form == "json":
            return self._json(columns, seq)
        import pyarrow as pa

        arrays = {name: np.ascontiguousarray(column) for name, column in columns.items()}
        if seq is not None:
            rows = len(next(iter(arrays.values())))
            arrays = {"seq": np.arange(seq, seq + rows, dtype=np.int64), **arrays}
        schema, head = self._schema(arrays)
        batch = pa.RecordBatch.from_arrays([pa.array(column) for column in arrays.values()], schema=schema)
        return head + bytes(batch.serialize())

    def _schema(self, arrays: Mapping[str, NDArray[np.generic]]) -> tuple[object, bytes]:
        """Return the schema and its bytes, made once for all messages of the same columns."""
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
        """Return columns as lists; what is no finite number is null, as JSON has no word for it."""
        held: dict[str, object] = {} if seq is None else {"seq": seq}
        if self.units:
            held["units"] = {name: self.units[name] for name in columns if self.units.get(name)}
        for name, column in columns.items():
            whole = bool(np.isfinite(column).all())
            held[name] = column.tolist() if whole else [x if np.isfinite(x) else None for x in column.tolist()]
        return json.dumps(held, separators=(",", ":")).encode()
