"""The noise report: figures that were put in come out within their errors, and what is not known is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.noise_report import ChannelNoise, report_noise
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import RecordingError, UsageError
from becalm.files.inputs.opening import read

DATA = Path(__file__).parents[2].parent / "shared" / "data"
RATE_HZ = 200.0
COUNT = 60_000
NOISE = np.random.default_rng(11).normal(size=COUNT)
WALK = np.cumsum(np.random.default_rng(12).normal(size=COUNT))


def one(z: Floats, unit: str = "", still: list[tuple[float, float]] | None = None) -> ChannelNoise:
    return report_noise(Recording(z, names=["a"], units=[unit], rate_hz=RATE_HZ), still=still)[0]


def test_white_noise_comes_out_within_its_error() -> None:
    """N is asked twice: as the noise of a reading, and by the Allan deviation."""
    found = one(9.81 + 0.02 * NOISE, "m/s^2")
    assert found.noise_std is not None
    assert found.noise_std_error is not None
    assert found.noise_std_error == pytest.approx(0.02 * np.sqrt(3 / COUNT) / 2, rel=0.05)
    assert found.noise_std == pytest.approx(0.02, abs=4 * found.noise_std_error)
    assert found.allan is not None
    white = found.allan.white_noise
    assert white.standard_error is not None
    assert white.value == pytest.approx(0.02 / np.sqrt(RATE_HZ), abs=4 * white.standard_error)
    assert found.allan.noise_variance == pytest.approx(0.02**2, rel=0.05)
    assert found.stretches_s == ((0.0, COUNT / RATE_HZ),)


def test_a_random_walk_comes_out_as_q() -> None:
    found = one(0.1 * NOISE + 0.002 * WALK, "deg/s", [(0, COUNT / RATE_HZ)]).allan
    assert found is not None
    walk = found.random_walk
    assert walk.value is not None
    assert walk.standard_error is not None
    assert walk.value == pytest.approx(0.002 * np.sqrt(RATE_HZ), abs=4 * walk.standard_error)
    assert found.random_walk_density == pytest.approx(walk.value**2)
    assert walk.quoted[0].value == pytest.approx(walk.value * 3600 * 60)


def test_white_noise_is_split_in_the_ratio_of_the_bands() -> None:
    """A Butterworth low-pass of order 2 passes pi / sqrt(8) of its cut-off, twice that over the rate of the power."""
    found = one(NOISE)
    assert found.above_std is not None
    assert found.below_std is not None
    passed = 2 * np.pi / np.sqrt(8) / RATE_HZ
    assert found.below_std**2 == pytest.approx(passed, rel=0.15)
    assert found.above_std**2 == pytest.approx(1 - passed, rel=0.02)


QUOTES = {
    "g": {"ug/sqrt(Hz)": 1e6 * np.sqrt(2), "m/s/sqrt(h)": 9.80665 * 60},
    "m/s^2": {"ug/sqrt(Hz)": 1e6 * np.sqrt(2) / 9.80665, "m/s/sqrt(h)": 60},
    "deg/s": {"deg/s/sqrt(Hz)": np.sqrt(2), "deg/sqrt(h)": 60},
    "rad/s": {"deg/s/sqrt(Hz)": np.sqrt(2) * 180 / np.pi, "deg/sqrt(h)": 60 * 180 / np.pi},
    "um/m": {"um/m/sqrt(Hz)": np.sqrt(2)},
    "kN": {"kN/sqrt(Hz)": np.sqrt(2)},
    "": {"1/sqrt(Hz)": np.sqrt(2)},
}


@pytest.mark.parametrize("unit", QUOTES)
def test_data_sheets_have_their_units(unit: str) -> None:
    """Per root of hertz is one-sided, sqrt(2) N; per root of an hour two-sided, 60 N of the sum."""
    found = one(NOISE, unit).allan
    assert found is not None
    white = found.white_noise
    assert white.value is not None
    assert {each.unit: each.value for each in white.quoted} == pytest.approx(
        {name: factor * white.value for name, factor in QUOTES[unit].items()}
    )


def test_bias_instability_is_bounded_in_degrees_an_hour() -> None:
    found = one(NOISE, "deg/s").allan
    assert found is not None
    bias = found.bias_instability
    assert bias.value is None
    assert bias.limit is not None
    assert bias.quoted[0].unit == "deg/h"
    assert bias.quoted[0].limit == pytest.approx(3600 * bias.limit)
    assert "no flat stretch" in bias.reason


def test_what_is_said_to_be_still_beats_what_is_found() -> None:
    z = np.where(np.arange(COUNT) < COUNT // 2, 1.0, 5.0) * NOISE
    assert one(z).noise_std == pytest.approx(1, rel=0.02)
    said = one(z, still=[(200.0, 250.0)])
    assert said.noise_std == pytest.approx(5, rel=0.05)
    assert said.stretches_s == ((200.0, 250.0),)


def test_motion_has_no_figures_and_a_reason() -> None:
    t = np.arange(4000) / RATE_HZ
    found = one(np.sin(2 * np.pi * 0.7 * t) + 0.001 * NOISE[:4000])
    assert (found.stretches_s, found.noise_std, found.allan) == ((), None, None)
    assert found.rest.endswith(".")


def held() -> Floats:
    return np.repeat(NOISE[: COUNT // 5], 5)


HIDDEN = {
    "constant": (np.full(COUNT, 2.5), "is the same"),
    "missing": (np.full(COUNT, np.nan), "At rest 0 readings follow"),
    "held": (held(), "80% of the readings repeat"),
    "beyond any sensor": (np.full(COUNT, 1e300), "At rest 0 readings follow"),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_noise_that_does_not_show_is_said(name: str) -> None:
    z, says = HIDDEN[name]
    recording = Recording(np.column_stack([NOISE, z]), names=["noise", "odd"], rate_hz=RATE_HZ)
    noise, odd = report_noise(recording, still=[(0, 100)])
    assert noise.noise_std is not None
    assert (odd.noise_std, odd.above_std, odd.allan) == (None, None, None)
    *left_out, sentence = odd.says
    assert says in sentence
    assert [f"readings left out: {COUNT}" in said for said in left_out] == [True] * (name == "beyond any sensor")


def test_a_channel_of_a_lower_rate_hides_no_rest() -> None:
    slow = np.where(np.arange(COUNT) % 10 == 0, NOISE, np.nan)
    found = report_noise(Recording(np.column_stack([NOISE, slow]), rate_hz=RATE_HZ))
    assert found[0].noise_std == pytest.approx(1, rel=0.02)
    assert "0 readings follow" in found[1].says[0]


def test_coarse_steps_slow_noise_and_spikes_are_said() -> None:
    coarse = np.round(0.35 * NOISE)
    slow = np.convolve(NOISE, np.ones(8) / 8, "same")
    spiked = NOISE + 20 * (np.arange(COUNT) == 777)
    for z, says in ((coarse, "resolution of 1,"), (slow, "slower than the readings"), (spiked, "2 jumps are beyond")):
        assert any(says in sentence for sentence in one(z, still=[(0, 300)]).says), says
    assert not any("jump" in sentence or "slower" in sentence or "steps" in sentence for sentence in one(NOISE).says)


@pytest.mark.parametrize("marker", [50.0, -9999.0, 1e8, 1e30])
def test_a_marker_or_gross_outlier_is_left_out_and_said(marker: float) -> None:
    z = NOISE[:6000].copy()
    z[3000] = marker
    found, clean = one(1e-6 * z if marker == 50 else np.where(z == marker, z, 1e-6 * z)), one(1e-6 * NOISE[:6000])
    assert found.noise_std == pytest.approx(clean.noise_std, rel=1e-2)
    assert found.spikes == 0
    assert found.allan is not None
    assert clean.allan is not None
    assert found.allan.white_noise.value == pytest.approx(clean.allan.white_noise.value, rel=2e-2)
    assert "readings left out: 1." in found.says[0]
    moving = np.where(np.arange(6000) < 2000, 0.1 * z, 5 * np.sin(np.arange(6000) / 100) + 0.1 * z)
    moving[3000] = marker
    assert one(moving).stretches_s == one(np.where(np.arange(6000) == 3000, np.nan, moving)).stretches_s


def test_a_gap_costs_long_clusters_and_nothing_else() -> None:
    """Two stretches, a day and a step apart, are told as if the day were one missing reading."""
    half = COUNT // 2
    z = NOISE + 20.0 * (np.arange(COUNT) >= half)
    times_s = np.arange(COUNT) / RATE_HZ + np.where(np.arange(COUNT) < half, 0.0, 86_400.0)
    gap = Recording(z, times_s=times_s)
    (found,) = report_noise(gap, still=[(0, 90_000)])
    hole = z.copy()
    hole[half] = np.nan
    whole = one(hole, still=[(0, 300)])
    assert found.allan is not None
    assert whole.allan is not None
    assert found.allan.white_noise.value == pytest.approx(whole.allan.white_noise.value, rel=1e-3)
    assert found.above_std == pytest.approx(float(np.sqrt(1 - np.pi / np.sqrt(2) / RATE_HZ)), rel=0.02)


def test_jitter_is_no_gap() -> None:
    rng = np.random.default_rng(3)
    times_s = np.sort(np.arange(6000) / RATE_HZ + rng.uniform(-0.4, 0.4, 6000) / RATE_HZ)
    (found,) = report_noise(Recording(NOISE[:6000], times_s=times_s), still=[(0, 30)])
    assert found.allan is not None
    assert found.above_std == pytest.approx(1, rel=0.05)


def test_too_short_a_rest_is_said() -> None:
    found = one(NOISE, still=[(0, 0.25)])
    assert found.noise_std is not None
    assert found.allan is None
    assert found.below_std is None
    assert any("too short to be split at 1 Hz" in sentence for sentence in found.says)
    assert any("64 readings or more" in sentence for sentence in found.says)


def test_readings_slower_than_the_cutoff_are_said() -> None:
    (found,) = report_noise(Recording(NOISE[:2000], rate_hz=0.1))
    assert found.noise_std == pytest.approx(1, rel=0.1)
    assert found.below_std is None
    assert "A rate of 0.1 Hz does not show the noise above 1 Hz." in found.says


def test_mistakes_are_said() -> None:
    recording = Recording(NOISE, rate_hz=RATE_HZ)
    for cutoff_hz in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(UsageError, match="not a cut-off"):
            report_noise(recording, cutoff_hz=cutoff_hz)
    for span, words in {(30.0, 0.0): "is not a stretch", (400.0, 500.0): "0 samples", (0.0, 0.1): "20 samples"}.items():
        with pytest.raises(RecordingError, match=words):
            report_noise(recording, still=[span])


def test_as_dict_is_json_without_nan() -> None:
    done: list[str] = []
    recording = Recording(np.column_stack([NOISE, np.full(COUNT, 2.5)]), names=["a", "b"], rate_hz=RATE_HZ)
    told = report_noise(recording, progress=done.append)
    assert done == ["a", "b"]
    text = json.dumps([channel.as_dict() for channel in told], allow_nan=False)
    assert json.loads(text)[0]["allan"]["white_noise"]["quoted"][0]["unit"] == "1/sqrt(Hz)"


@pytest.mark.parametrize(
    ("file", "channel", "lowest", "highest"),
    [
        ("fusion/sensor_data.csv", "Gyroscope X (deg/s)", 0.09, 0.12),
        ("munich_bridge/reference_state_strain.csv.gz", "DMS_CN (um\\m)", 0.15, 0.25),
    ],
)
def test_real_sensors_agree_with_themselves(file: str, channel: str, lowest: float, highest: float) -> None:
    """R from neighbours, R from the Allan deviation, and the noise above the cut-off are one noise."""
    if not (DATA / file).exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    found = {each.name: each for each in report_noise(read(DATA / file))}[channel]
    assert found.allan is not None
    assert found.noise_std is not None
    assert found.allan.noise_variance is not None
    assert lowest < found.noise_std < highest
    assert np.sqrt(found.allan.noise_variance) == pytest.approx(found.noise_std, rel=0.1)
    assert found.above_std == pytest.approx(found.noise_std, rel=0.25)


def test_a_sensor_slower_than_its_rows_is_seen_in_a_real_file() -> None:
    file = DATA / "fusion/sensor_data.csv"
    if not file.exists():
        pytest.skip("the recordings are not beside the project (fusion/sensor_data.csv)")
    magnetic = report_noise(read(file))[6:]
    assert all("repeat the previous one" in channel.says[0] for channel in magnetic)


def test_a_car_on_the_road_has_no_rest() -> None:
    file = DATA / "comma2k19/accelerometer.csv"
    if not file.exists():
        pytest.skip("the recordings are not beside the project (comma2k19/accelerometer.csv)")
    for channel in report_noise(read(file)):
        assert channel.stretches_s == ()
        assert "still move" in channel.rest
