"""What is kept of a stream as a table."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.errors import UsageError
from becalm.live.block import Head
from becalm.live.tables import output_table, table_schema
from streams import head_of, outputs_of


def test_every_column_has_its_place_its_unit_and_its_bits() -> None:
    head, outputs = head_of("a", "b"), outputs_of([3, 0, 4], channels=2)
    table = output_table(head, outputs)
    assert table.column_names == ["row", "time_s", *(c + e for c in "ab" for e in ("", "_raw", "_sigma", "_verdict"))]
    assert table.schema.equals(table_schema(head), check_metadata=True)
    assert table.schema.field("b_raw").metadata == {b"unit": b"m"}
    assert table.schema.metadata[b"recipe"] == head.recipe.encode()
    assert table["row"].to_pylist() == list(range(7))
    raw = np.concatenate([one.values for one in outputs])
    np.testing.assert_array_equal(
        table["b_raw"].to_numpy().view(np.int64), np.ascontiguousarray(raw[:, 1]).view(np.int64)
    )
    assert table["a_raw"].null_count == 0  # NaN is a number here, no hole
    assert table["a_verdict"].to_pylist()[:3] == ["used", "missing", "spike"]


def test_no_outputs_are_an_empty_table() -> None:
    assert output_table(head_of("a"), []).num_rows == 0


@pytest.mark.parametrize("names", [("row",), ("time_s",), ("a", "a_raw"), ("b", "b_sigma")])
def test_two_columns_of_one_name_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="would be called"):
        table_schema(Head(names, ("",) * len(names), 1.0, ""))
