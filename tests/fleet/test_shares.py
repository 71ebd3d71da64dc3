"""Which small tasks are one of Spark's: all of them, in order, and so that no core works long after the others."""

from __future__ import annotations

from itertools import chain

from hypothesis import given
from hypothesis import strategies as st

from becalm.fleet.spark_tasks import _SHARED_BYTES, _group_tasks


@given(st.lists(st.integers(0, 1 << 40), min_size=1, max_size=300), st.integers(1, 64))
def test_each_task_is_in_one_share_and_none_is_too_large(sizes: list[int], cores: int) -> None:
    shares = _group_tasks(sizes, cores)
    assert list(chain.from_iterable(shares)) == list(range(len(sizes)))
    assert all(len(share) == 1 or sum(sizes[k] for k in share) <= _SHARED_BYTES for share in shares)


def test_shares_become_smaller_to_the_end() -> None:
    shares = _group_tasks([3_200_000] * 200, 2)
    assert len(shares[0]) == 10
    assert [len(share) for share in shares] == sorted(map(len, shares), reverse=True)
    assert len(shares[-1]) == 1


def test_large_tasks_are_alone() -> None:
    assert _group_tasks([10**9, 10**8, 5, 5, 5], 2) == [range(k, k + 1) for k in range(5)]
