"""becalm beside every classic filter: at equal noise, at equal lag, and knowing the truth."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.classic.register import CAUSAL, CLASSICS, ZERO_PHASE
from becalm.cleaning.comparison import BECALM, ChannelComparison, Contender, compare
from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import RecordingError, UsageError

RATE_HZ = 100.0
RNG = np.random.default_rng(3)
TRUTH = np.cumsum(0.05 * RNG.normal(size=20_000))
Z = TRUTH + RNG.normal(size=20_000)
MEASURED, TRUE = (Recording(z, names=("a",), units=("m/s^2",), rate_hz=RATE_HZ) for z in (Z, TRUTH))


@pytest.fixture(scope="module", params=[True, False], ids=["causal", "smoothed"])
def channel(request: pytest.FixtureRequest) -> ChannelComparison:
    return compare(MEASURED, truth=TRUE, causal=request.param).channels[0]


def ruled(channel: ChannelComparison, rule: str) -> list[Contender]:
    return [contender for contender in channel.contenders if contender.rule == rule]


def test_every_classic_filter_stands_beside_becalm(channel: ChannelComparison) -> None:
    assert channel.contenders[0].name == BECALM
    causal = channel.contenders[0].lag_s != 0
    expected = {classic.name for classic in (CAUSAL if causal else ZERO_PHASE)}
    assert {contender.name for contender in ruled(channel, "best with truth")} == expected
    calm = {name for name in expected if CLASSICS[name].reduces_noise}
    assert {contender.name for contender in ruled(channel, "equal noise")} == calm
    assert bool(ruled(channel, "equal lag")) == causal


def test_equal_noise_and_equal_lag_are_equal(channel: ChannelComparison) -> None:
    own = channel.contenders[0]
    assert own.noise_removed_db is not None
    for contender in ruled(channel, "equal noise"):
        assert contender.noise_removed_db == pytest.approx(own.noise_removed_db, abs=0.3)
    for contender in ruled(channel, "equal lag"):
        assert contender.lag_s == pytest.approx(own.lag_s, abs=1 / RATE_HZ)  # the dial of a window goes in steps


def test_on_its_own_ground_no_classic_filter_errs_less_though_it_knows_the_truth(channel: ChannelComparison) -> None:
    own = channel.contenders[0].rms_error
    assert own is not None
    assert all(own <= 1.01 * contender.rms_error for contender in channel.contenders if contender.rms_error is not None)


def test_without_truth_nothing_is_said_of_errors() -> None:
    measured = Recording(Z[:3000], rate_hz=RATE_HZ)
    found = compare(measured, causal=True)
    assert all(contender.rms_error is None for contender in found.channels[0].contenders)
    assert {contender.rule for contender in found.channels[0].contenders} == {"", "equal noise", "equal lag"}
    assert np.array_equal(found.cleaned.signal.samples, clean(measured, causal=True).signal.samples)


def test_levels_that_jump_are_compared_in_the_mode_that_lasts() -> None:
    z = np.repeat(4 * RNG.normal(size=10), 200) + RNG.normal(size=2000)
    found = compare(Recording(z, rate_hz=RATE_HZ), causal=True)
    assert found.cleaned.reports[0].modes
    removed = found.channels[0].contenders[0].noise_removed_db
    assert removed is not None
    assert removed > 20


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("z", [np.full(500, 2.5), np.full(500, np.nan), np.array([1.0]), np.array([1.0, 2.0, 3.0])])
def test_a_channel_that_passes_unchanged_has_no_rivals(z: Floats, causal: bool) -> None:
    truth = Recording(np.nan_to_num(z), rate_hz=RATE_HZ)
    (channel,) = compare(Recording(z, rate_hz=RATE_HZ), truth=truth, causal=causal).channels
    assert [contender.name for contender in channel.contenders] == [BECALM]
    assert (channel.contenders[0].rms_error is None) == np.isnan(z).all()
    assert channel.contenders[0].noise_removed_db is None


def test_no_filter_is_given_what_is_no_reading() -> None:
    z, truth = Z[:3000].copy(), Recording(TRUTH[:3000], rate_hz=RATE_HZ)
    z[100:2000:500] = np.nan, np.inf, -np.inf, 1e300
    (channel,) = compare(Recording(z, rate_hz=RATE_HZ), truth=truth, causal=True).channels
    errors = [contender.rms_error for contender in channel.contenders if contender.rms_error is not None]
    assert len(errors) == len(channel.contenders)
    assert max(errors) < 1


def test_no_filter_is_given_a_marker_of_missing_readings() -> None:
    z, truth = Z[:300].copy(), Recording(TRUTH[:300], rate_hz=RATE_HZ)
    z[100] = 1e30
    (channel,) = compare(Recording(z, rate_hz=RATE_HZ), truth=truth, causal=True).channels
    assert len(channel.contenders) > 1
    assert max(contender.rms_error or 0.0 for contender in channel.contenders) < 1


def test_where_the_truth_is_not_known_no_error_is_told() -> None:
    measured = Recording(Z[:2000], rate_hz=RATE_HZ)
    some, none = TRUTH[:2000].copy(), np.resize([np.nan, np.inf, 1e300], 2000)
    some[:700] = none[:700]
    (channel,) = compare(measured, truth=Recording(some, rate_hz=RATE_HZ), causal=True).channels
    errors = [contender.rms_error for contender in channel.contenders if contender.rms_error is not None]
    assert len(errors) == len(channel.contenders)
    assert max(errors) < 1
    (channel,) = compare(measured, truth=Recording(none, rate_hz=RATE_HZ), causal=True).channels
    assert all(contender.rms_error is None for contender in channel.contenders)
    assert not ruled(channel, "best with truth")


def test_a_truth_known_only_late_in_a_long_record_finds_the_best_setting_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("becalm.cleaning.comparison._MOST_TRUTH_ROWS", 1000)
    late = np.where(np.arange(3000) < 1500, np.nan, TRUTH[:3000])
    (channel,) = compare(Recording(Z[:3000], rate_hz=RATE_HZ), truth=Recording(late, rate_hz=RATE_HZ)).channels
    told = ruled(channel, "best with truth")
    assert all(one.rms_error is not None and one.rms_error < 1 for one in told if CLASSICS[one.name].reduces_noise)
    assert len(told) == len(ZERO_PHASE)


def test_a_truth_at_other_times_or_in_other_units_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"Row 3 of the truth is 0.01 s after its first row"):
        compare(MEASURED, truth=Recording(TRUTH, names=("a",), units=("m/s^2",), rate_hz=2 * RATE_HZ))
    with pytest.raises(RecordingError, match=r"is in cm/s\^2, the recording in m/s\^2"):
        compare(MEASURED, truth=Recording(TRUTH, names=("a",), units=("cm/s^2",), rate_hz=RATE_HZ))


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(RecordingError, match="no channel 'a'; it has 'b'"):
        compare(MEASURED, truth=Recording(TRUTH, names=("b",), rate_hz=RATE_HZ))
    with pytest.raises(RecordingError, match="5000 rows, the recording 20000"):
        compare(MEASURED, truth=Recording(TRUTH[:5000], names=("a",), rate_hz=RATE_HZ))
    with pytest.raises(UsageError, match="No classic filter waits"):
        compare(MEASURED, tune(MEASURED, wishes=Wishes(lag_s=0.1)))
