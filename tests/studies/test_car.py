"""The car study shows what it must, from the volts on."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from becalm.core.filter.filtering import kalman_filter
from becalm.identification.several.joint import tune_model
from becalm.metrics.truth import rms_error
from becalm.report.data.description import Curve, Figure
from becalm.studies.car.car import CANCELLER, MEASURED, OWN, PRINTED, TRUTH, CarStudy, study
from becalm.studies.car.car_drive import SENSITIVITY_V_PER_G, SHARES, simulate
from becalm.studies.car.car_figures import sheets
from becalm.studies.car.car_filters import computed_noise_gain, printed_model, response, settled_gain
from becalm.studies.car.car_page import page
from becalm.studies.car.car_real import slope_of_speed, study_real_car
from becalm.studies.recordings import RECORDINGS
from becalm.studies.sheets import NOT_DRAWN

CAR = RECORDINGS / "comma2k19"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> CarStudy:
    return study(tmp_path_factory.mktemp("nothing"), channel_by_channel=False)


def error(found: CarStudy, name: str, axis: str) -> float:
    return next(score.rms_error for score in found.scores if (score.filter, score.axis) == (name, axis))


def curves(figure: Figure) -> list[Curve]:
    return [layer for layer in figure.layers if isinstance(layer, Curve)]


class TestDrive:
    def test_it_has_the_papers_input_ratios(self, found: CarStudy) -> None:
        assert found.input_snr_paper_db == pytest.approx((-17.9, -1.6), abs=1e-9)

    def test_readings_are_volts_of_the_truth_and_every_noise(self) -> None:
        drive = simulate(5)
        truth = drive.truth.samples[:, 1:]
        felt = truth + truth[:, ::-1] * (0.0067, 0.0078) + sum(drive.noise.values())
        assert drive.beyond_range == 0
        np.testing.assert_allclose(drive.volts, felt / 9.81 * SENSITIVITY_V_PER_G, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(drive.measured.samples[:, 1:], felt, rtol=1e-12, atol=1e-12)

    def test_the_kinds_of_noise_have_their_shares(self) -> None:
        noise = simulate(5).noise
        total = np.mean(sum(noise.values()) ** 2, axis=0)
        for kind, share in SHARES.items():
            np.testing.assert_allclose(np.mean(noise[kind] ** 2, axis=0) / total, share, rtol=0.05)

    def test_speed_is_the_integral_of_its_acceleration_and_never_backwards(self) -> None:
        truth = simulate(5).truth.samples
        np.testing.assert_allclose(np.diff(truth[:, 0]) * 500, truth[1:, 1], atol=1e-9)
        assert truth[:, 0].min() >= 0


class TestPrintedMatrices:
    def test_the_one_step_form_is_the_filtered_form(self, found: CarStudy) -> None:
        assert max(found.forms) <= 1e-12

    def test_the_settled_gain_is_the_checked_one(self, found: CarStudy) -> None:
        assert found.gain_difference <= 5e-9

    def test_white_noise_is_reduced_by_30_decibels_of_the_paper(self, found: CarStudy) -> None:
        for share in (found.noise_gain, found.noise_gain_measured):
            np.testing.assert_allclose(-20 * np.log10(share), 30.0, rtol=0, atol=0.3)
            np.testing.assert_allclose(-10 * np.log10(share), 15.0, rtol=0, atol=0.15)

    def test_the_response_leaves_as_much_white_noise_as_the_gain_says(self) -> None:
        model = printed_model()
        f = np.linspace(0, 250, 50_001)
        power = np.sum(np.abs(response(model, f)) ** 2, axis=2)
        np.testing.assert_allclose(np.trapezoid(power, f, axis=0)[1:] / 250, computed_noise_gain(model)[1:], rtol=1e-3)
        filtered = kalman_filter(model, np.ones((4000, 3)) * [0, 0, 1]).signal[-1, 2]
        assert abs(response(model, np.array([0.0]))[0, 2, 2]) == pytest.approx(filtered, rel=1e-9)
        assert settled_gain(model).shape == (3, 3)

    def test_where_the_papers_ratios_are_within_reach(self, found: CarStudy) -> None:
        """Neither white noise nor body motion of 1 to 3 Hz can have given the paper's 39 dB."""
        along, up = found.limits
        assert along.noise_above_hz > 20
        assert up.noise_above_hz > along.noise_above_hz
        assert up.signal_below_hz < 1.0


class TestOwnChoice:
    @pytest.mark.parametrize("axis", ["a_x", "a_z"])
    def test_it_errs_less_than_the_papers_matrices_and_the_canceller(self, found: CarStudy, axis: str) -> None:
        assert error(found, OWN, axis) < error(found, PRINTED, axis)
        assert error(found, OWN, axis) < error(found, CANCELLER, axis)

    @pytest.mark.parametrize("seed", [2, 3, 4])
    def test_it_errs_less_in_other_drives(self, seed: int) -> None:
        drive = simulate(seed)
        z, truth = drive.measured.samples, drive.truth.samples
        own = tune_model(printed_model(known_start=False), z).model
        ours, theirs = (kalman_filter(model, z).signal for model in (own, printed_model()))
        for axis in (1, 2):
            assert rms_error(ours[:, axis], truth[:, axis]) < rms_error(theirs[:, axis], truth[:, axis])

    def test_what_is_left_of_each_kind_makes_up_the_error(self, found: CarStudy) -> None:
        for left in found.error_parts:
            whole = error(found, left.filter, left.axis) ** 2
            assert sum(left.power_after.values()) == pytest.approx(whole, rel=0.1)

    def test_the_measured_lag_is_near_the_one_told_by_the_filter(self, found: CarStudy) -> None:
        told = [score for score in found.scores if np.isfinite(score.described_lag_s)]
        assert len(told) == 2
        for score in told:
            assert score.measured_lag_s == pytest.approx(score.described_lag_s, rel=0.2)


class TestPage:
    def test_printed_and_own_ratios_stand_side_by_side(self, found: CarStudy) -> None:
        text = page(found)
        scores = {(score.filter, score.axis): score for score in found.scores}
        for axis, printed in (("a_x", "17"), ("a_z", "39")):
            assert f"**{axis}: {printed} printed, {scores[PRINTED, axis].snr_paper_db:.1f} here.**" in text
            assert f"| {axis} | paper, as printed | {printed} |" in text
        assert "comma2k19) are not on this machine" in text
        assert NOT_DRAWN in text
        assert "nan" not in text.lower()

    def test_figures_6_to_10_show_all_that_was_measured(self, found: CarStudy) -> None:
        *numbered, shown = sheets(found)
        figures = [figure for sheet in numbered for figure in sheet.figures]
        assert [int(re.findall(r"\d+", figure.name)[0]) for figure in figures] == [6, 7, 8, 9, 10]
        assert [figure.name for figure in shown.figures] == ["car-spectrogram-1", "car-spectrogram-2"]
        (along,) = curves(figures[1])
        np.testing.assert_array_equal(along.y, found.estimates[MEASURED][:, 1])
        assert [curve.name for curve in curves(figures[3])] == [PRINTED, OWN, TRUTH]


class TestRealCar:
    def test_without_the_recording_there_is_none(self, tmp_path: Path) -> None:
        assert study_real_car(tmp_path) is None
        (tmp_path / "comma2k19").mkdir()
        (tmp_path / "comma2k19" / "accelerometer.csv").touch()
        assert study_real_car(tmp_path) is None

    def test_the_slope_of_a_line_is_its_slope(self) -> None:
        times = np.sort(np.random.default_rng(1).uniform(0, 10, 900))
        speed = 5 + 0.7 * times
        speed[::3] = np.nan
        slope = slope_of_speed(times, speed)
        assert np.isfinite(slope).mean() > 0.9
        np.testing.assert_allclose(slope[np.isfinite(slope)], 0.7, rtol=1e-6)

    @pytest.mark.skipif(not CAR.exists(), reason=f"no real recording at {CAR}")
    def test_acceleration_is_the_derivative_of_the_speed(self) -> None:
        real = study_real_car(RECORDINGS)
        assert real is not None
        assert real.estimate_correlation > 0.95
        assert real.estimate_rms < real.accelerometer_rms < real.raw_rms
        assert real.hidden_rms < real.held_rms / 2
