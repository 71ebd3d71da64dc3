"""The IMU paper re-run shows what the paper shows, and what it leaves open."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from becalm.core.closed_forms import butterworth_noise_gain
from becalm.identification.several.step_spectrum import Sensor
from becalm.report import printing
from becalm.studies.imu import imu, imu_page, imu_switching, imu_valley
from becalm.studies.imu.imu_records import (
    HARMONICS_HZ,
    PRINTED,
    RATE_HZ,
    SENSORS,
    find_rests,
    identify,
    motionless,
    noise_parts,
)
from becalm.studies.imu.imu_responses import FilterResponse, reached_ms
from becalm.studies.recordings import RECORDINGS
from becalm.studies.sheets import NOT_DRAWN


@pytest.fixture(scope="module")
def studied() -> dict[Sensor, imu.SensorStudy]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imu_valley, "SEEDS", range(2))  # of the records of white noise that are tuned
        return {sensor: imu.study_sensor(sensor) for sensor in SENSORS}


@pytest.fixture(scope="module")
def contest() -> imu_switching.ImmComparison:
    """Compare on the first of the records with the largest step, and of those with the smallest."""
    steps = imu_switching.STEPS[:: len(imu_switching.STEPS) - 1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imu_switching, "STEPS", steps)
        patch.setattr(imu_switching, "SEEDS", range(1))
        return imu_switching.compare_imm()


def panels(study: imu.SensorStudy) -> dict[str, FilterResponse]:
    return {each.setting.name: each for each in study.responses}


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
def test_the_method_finds_table_1_in_the_simulated_records(
    studied: dict[Sensor, imu.SensorStudy], sensor: Sensor
) -> None:
    R, Q, _ = np.mean(studied[sensor].identified, axis=0)
    assert pytest.approx(PRINTED[sensor].measured_noise, rel=0.005) == R
    assert pytest.approx(PRINTED[sensor].measured_process, rel=0.15) == Q


def test_white_noise_leaves_its_known_share_below_one_hertz() -> None:
    found = identify(np.random.default_rng(1).normal(size=100_000), 100.0)
    kept = butterworth_noise_gain(2, 0.01)
    assert found.white_process == pytest.approx(kept, rel=0.02)
    assert found.process_variance == pytest.approx(kept, rel=0.1)
    assert found.noise_variance == pytest.approx(1 - kept, rel=0.02)


def test_the_record_is_made_of_what_table_1_tells() -> None:
    accelerometer, gyroscope = (noise_parts(PRINTED[sensor]) for sensor in SENSORS)
    assert accelerometer.harmonic > accelerometer.white > 0 == accelerometer.drift
    assert gyroscope.white == PRINTED["gyroscope"].measured_noise
    assert gyroscope.harmonic == 0 < gyroscope.drift
    z = motionless("accelerometer", 3, 2.0)
    power = np.abs(np.fft.rfft(z)) ** 2 * 2 / len(z) ** 2
    lines = power[np.round(2 * HARMONICS_HZ).astype(int)]
    np.testing.assert_allclose(lines, accelerometer.harmonic / len(HARMONICS_HZ), rtol=0.2)
    assert lines.sum() == pytest.approx(accelerometer.harmonic, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
def test_each_of_r_q_and_p0_does_what_the_paper_says(studied: dict[Sensor, imu.SensorStudy], sensor: Sensor) -> None:
    shown = panels(studied[sensor])
    assert shown["a"].differs < 1e-12  # R = 0 gives the readings back
    assert shown["c"].rest_noise < shown["d"].rest_noise < shown["a"].rest_noise
    assert shown["d"].reached_ms < 40 < 3000 < min(shown["b"].reached_ms, shown["c"].reached_ms)
    if sensor == "accelerometer":
        assert shown["f"].risen == pytest.approx(0.5, abs=0.01)  # table 1 averages all since the start
        assert abs(shown["e"].risen) < 0.01  # P0 = 0 believes its start
        z = studied[sensor].record - studied[sensor].record.mean()
        z[round(5 * RATE_HZ) :] += 0.2
        average = np.cumsum(z) / np.arange(1, len(z) + 1)
        np.testing.assert_allclose(shown["c"].output[1:], average[::50][1:], atol=1e-4)  # Q = 0 averages


@pytest.mark.slow
def test_the_optimum_is_the_gyroscopes_of_the_paper(studied: dict[Sensor, imu.SensorStudy]) -> None:
    gyroscope, accelerometer = studied["gyroscope"].optimum, studied["accelerometer"].optimum
    assert 900 <= gyroscope.ratios.min() <= gyroscope.ratios.max() <= 1200
    assert 91 <= accelerometer.ratio <= 96
    assert gyroscope.excess == pytest.approx(1, abs=1e-3)
    assert accelerometer.excess > 1.2


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
def test_only_q_over_r_is_told_by_the_cost(studied: dict[Sensor, imu.SensorStudy], sensor: Sensor) -> None:
    found = studied[sensor].optimum
    assert found.surface.unevenness < 1e-9
    assert found.surface.floor_decade == round(np.log10(found.ratio))
    ends = found.ends[1:]
    np.testing.assert_allclose([end.ratio for end in ends], found.ends[0].ratio, rtol=1e-3)
    scales = np.log10([end.noise_variance for end in ends])
    assert scales.max() - scales.min() > 5  # arbitrary points of one valley


def test_the_papers_optimum_needs_480_ms() -> None:
    assert reached_ms("accelerometer", PRINTED["accelerometer"].ratio) == pytest.approx(480, abs=20)
    slow_pole = 1e3 * np.log(10) / np.sqrt(PRINTED["accelerometer"].ratio)
    assert reached_ms("accelerometer", PRINTED["accelerometer"].ratio) == pytest.approx(slow_pole, rel=1e-3)


@pytest.mark.slow
def test_the_papers_optimum_needs_480_ms_on_the_record(studied: dict[Sensor, imu.SensorStudy]) -> None:
    paper, _ = studied["accelerometer"].tuned
    assert paper.reached_ms == pytest.approx(480, abs=20)


@pytest.mark.slow
def test_noise_of_the_shown_band_alone_does_not_explain_the_accelerometer() -> None:
    ratios = [each.ratio for each in imu_valley.tune_coloured_records()]
    white, *banded, below = ratios
    least = imu_valley.least_ratio()
    assert white == pytest.approx(93, abs=3)
    assert min(banded) == pytest.approx(least, rel=0.1)
    assert min(banded) > 2 * PRINTED["accelerometer"].ratio
    assert below < PRINTED["accelerometer"].ratio


@pytest.mark.slow
def test_a_filter_that_switches_is_quieter_and_quicker(contest: imu_switching.ImmComparison) -> None:
    for each in contest.switched:
        for fixed in contest.fixed:
            assert each.reached_ms < fixed.reached_ms
            assert each.rest_gain < fixed.rest_gain


def test_rests_that_are_not_there_are_named(tmp_path: Path) -> None:
    rests, skipped = find_rests(tmp_path)
    assert rests == ()
    assert len(skipped) == 4
    assert all(sentence.endswith("is absent, and is left out.") for sentence in skipped)


@pytest.mark.skipif(not (RECORDINGS / "imu_tk").exists(), reason="the real recordings are not there")
def test_a_missing_reader_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    rests, skipped = find_rests(RECORDINGS)
    assert ["h5py" in sentence for sentence in skipped] == [True]
    assert not any("hdf5" in rest.source for rest in rests)


@pytest.mark.skipif(not (RECORDINGS / "imu_tk").exists(), reason="the real recordings are not there")
def test_real_rests_tell_little_but_their_white_noise() -> None:
    rests, _ = find_rests(RECORDINGS)
    assert {"imu_tk", "broad"} <= {rest.source.split("/")[0] for rest in rests}
    shares = [found.process_variance / found.white_process for rest in rests for found in rest.found.values()]
    assert all(rest.stop_s - rest.start_s > 25 for rest in rests)
    assert 0.5 < np.median(shares) < 2


@pytest.mark.slow
def test_the_page_tells_the_numbers_and_shows_the_figures(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    studied: dict[Sensor, imu.SensorStudy],
    contest: imu_switching.ImmComparison,
) -> None:
    held = imu.Study(studied, (imu_valley.ColouredRecord("white", 92.0),), *find_rests(tmp_path), contest)
    monkeypatch.setattr(imu_page, "study", lambda data: held)
    with monkeypatch.context() as alone:
        alone.setattr(printing, "find_spec", lambda name: None)
        page = imu_page.run(tmp_path / "plain", tmp_path)
    assert NOT_DRAWN in page
    assert "](imu-" not in page
    assert f"**{studied['accelerometer'].optimum.paper_reached_ms:.0f} ms**" in page
    assert f"**{studied['gyroscope'].optimum.ratio:.4g}**" in page
    assert "nan" not in page.lower().split()

    pytest.importorskip("matplotlib")
    page = imu_page.run(tmp_path / "drawn", tmp_path)
    named = re.findall(r"\]\((imu-\w+\.svg)\)", page)
    assert len(named) == 7
    assert sorted(named) == sorted(file.name for file in (tmp_path / "drawn").glob("*.svg"))
    assert (tmp_path / "drawn" / "imu.md").read_text(encoding="utf-8") == page
