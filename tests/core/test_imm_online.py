"""Online of a bank: the numbers of ImmFlow; the same bits for any chunks, and after any pause."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from banks import bank_of, record
from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.online import Online
from becalm.errors import ModelError
from bits import same_bits

ROWS = 300
BANKS = {"2 of 1": bank_of(1, 2), "3 of 2": bank_of(2, 3), "wild": bank_of(2, 3, share=0.05, rejects=True)}
names = st.sampled_from(sorted(BANKS))
cuts = st.lists(st.integers(0, ROWS), max_size=6).map(sorted)
anything = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300])


def readings() -> Floats:
    return record(ROWS, "holes")[0] + 100.0


def flow(
    switching: InteractingModels, z: Floats, at: list[int], *, causal: bool = True
) -> tuple[Floats, Floats, Floats]:
    """Return signal, sigma and probabilities of a record that is cut."""
    made = ImmFlow(switching, causal=causal, split=True)
    told = [part for rows in np.split(z, at) for part in made.push(rows, np.ones(len(rows)))] + made.finish()
    signal, sigma = (np.concatenate([part[field] for part in told]) for field in (0, 1))
    return signal, sigma, np.hstack([part.parts for part in told if len(part.signal)])[-len(switching.modes) :]


@pytest.mark.parametrize("name", BANKS)
def test_live_is_the_file(name: str) -> None:
    online = Online(BANKS[name])
    signal, sigma = online.run(readings())
    expected = flow(BANKS[name], readings(), [])
    np.testing.assert_allclose(signal[:, 0], expected[0], rtol=1e-12)
    np.testing.assert_allclose(sigma[:, 0], expected[1], rtol=1e-12)
    np.testing.assert_allclose(list(online.modes.values()), expected[2][:, -1], rtol=1e-10)
    assert list(online.modes) == [mode.name for mode in BANKS[name].modes]


@given(name=names, at=cuts)
@settings(max_examples=40)
def test_any_chunks_and_pauses_are_one_block_to_the_bit(name: str, at: list[int]) -> None:
    z, online = readings(), Online(BANKS[name])
    expected, told = Online(BANKS[name]).run(z), []
    for rows in np.split(z, at):
        told.append(online.run(rows))
        online = Online.resume(online.snapshot())
    assert same_bits(np.vstack([part[0] for part in told]), expected[0])
    assert same_bits(np.vstack([part[1] for part in told]), expected[1])


@pytest.mark.parametrize("name", BANKS)
def test_one_by_one_is_one_block_to_the_bit(name: str) -> None:
    online, z = Online(BANKS[name]), readings()
    told = np.array([online.step(reading) for reading in z.tolist()])
    assert same_bits(told.T[:, :, np.newaxis], np.array(Online(BANKS[name]).run(z)))
    again = Online(BANKS[name])
    assert same_bits(np.array([again.step(np.float64(reading)) for reading in z]), told)


def test_before_the_first_reading_nothing_is_known_but_how_modes_begin() -> None:
    online = Online(BANKS["3 of 2"])
    signal, sigma = online.step(np.nan)
    assert np.isnan(signal)
    assert np.isinf(sigma)
    assert online.modes == dict(zip(online.modes, BANKS["3 of 2"].start[:, 0], strict=True))


def test_a_filter_that_does_not_switch_has_no_modes() -> None:
    assert Online(BANKS["2 of 1"].component.to_model(1.0, 1.0)).modes == {}


def test_a_gate_is_refused() -> None:
    with pytest.raises(ModelError, match="leave the gate out"):
        Online(BANKS["2 of 1"], gate=Gate(5.0))


def test_a_spoilt_snapshot_is_refused() -> None:
    blob = Online(BANKS["2 of 1"]).snapshot()
    with pytest.raises(ModelError, match="snapshot"):
        Online.resume(blob[: len(blob) // 2])


@given(at=cuts, causal=st.booleans())
@settings(max_examples=30)
def test_stretches_are_the_whole_to_the_bit(at: list[int], causal: bool) -> None:
    z = readings()
    whole, parts = (flow(BANKS["3 of 2"], z, cut, causal=causal) for cut in ([], at))
    assert all(same_bits(one, other) for one, other in zip(whole, parts, strict=True))


def test_groups_are_smoothed_as_one_record() -> None:
    """What a group has not seen was forgotten before it could matter; any cut gives the same bits."""
    z = np.tile(readings(), 180)[: 3 * 64 * 256 + 77]
    flown = flow(BANKS["2 of 1"], z, [1000, 40_000], causal=False)
    whole = flow(BANKS["2 of 1"], z, [], causal=False)
    assert all(same_bits(one, other) for one, other in zip(flown, whole, strict=True))
    last = flow(BANKS["2 of 1"], z[: 2 * 64 * 256], [], causal=False)
    rows = slice(0, 64 * 256)
    np.testing.assert_allclose(last[0][rows], whole[0][rows], rtol=1e-9)
    np.testing.assert_allclose(last[1][rows], whole[1][rows], rtol=1e-9)


@given(name=names, odd=st.dictionaries(st.integers(0, 79), anything, max_size=30), causal=st.booleans())
@settings(max_examples=60)
def test_nothing_that_arrives_spoils_it(name: str, odd: dict[int, float], causal: bool) -> None:
    z = readings()[50:130].copy()
    z[np.isnan(z)] = 100.0
    z[list(odd)] = list(odd.values())
    signal, sigma, probability = flow(BANKS[name], z, [], causal=causal)
    first = next((k for k in range(80) if k not in odd), 80)
    assert np.isfinite(signal[first:]).all()
    assert np.isfinite(sigma[first:]).all()
    assert np.isnan(signal[:first]).all()
    np.testing.assert_allclose(probability[:, first:].sum(axis=0), 1.0, rtol=1e-12)


@given(name=names, at=st.integers(0, 79), size=st.sampled_from([1e6, -1e20, 1e50, 9e99]), causal=st.booleans())
@settings(max_examples=40)
def test_a_huge_reading_leaves_numbers(name: str, at: int, size: float, causal: bool) -> None:
    """From the first reading on that a sensor of this noise may give."""
    z = readings()[50:130].copy()
    z[np.isnan(z)], z[at] = 100.0, size
    signal, sigma, probability = flow(BANKS[name], z, [], causal=causal)
    first = int(at == 0 and abs(size) > largest_magnitude_for_noise(BANKS[name].least_noise_variance))
    assert np.isnan(signal[:first]).all()
    assert np.isfinite(signal[first:]).all()
    assert np.isfinite(sigma[first:]).all()
    np.testing.assert_allclose(probability[:, first:].sum(axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", BANKS)
def test_steps_of_any_length_are_the_same_in_any_company(name: str) -> None:
    """So that a record of uneven steps may be cut anywhere."""
    lengths = np.unique(np.random.default_rng(1).exponential(size=40) * np.repeat([1.0, 30.0], 20))
    modes, whole = len(BANKS[name].modes), BANKS[name].matrices(lengths)
    for first in range(0, 40, 3):
        some = BANKS[name].matrices(lengths[first : first + 5])
        count = len(some.T)
        assert same_bits(some.T, whole.T[first : first + count])
        assert same_bits(some.F, whole.F[first * modes : (first + count) * modes])
        assert same_bits(some.Q, whole.Q[first * modes : (first + count) * modes])
