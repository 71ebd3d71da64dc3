"""The strain paper: errors no worse than the paper's filter has, without being told anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.studies.recordings import RECORDINGS
from becalm.studies.sheets import NOT_DRAWN, draw
from becalm.studies.strain import strain
from becalm.studies.strain.strain import (
    NOISES,
    RUNS,
    SHOWN,
    SLOPE,
    FilterQuality,
    ShownRecord,
    StrainStudy,
    assess,
    ramps,
    records,
    simulate,
)
from becalm.studies.strain.strain_figures import sheets
from becalm.studies.strain.strain_gauge import AT_REST, LOADED, Gauge, measure_gauge, missing_recordings
from becalm.studies.strain.strain_methods import (
    AVERAGE,
    AVERAGED,
    BECALM,
    BUTTERWORTH,
    G_BY_TRIAL,
    KALMAN,
    LIKELIEST,
    METHODS,
    SMOOTHED,
    STEP_S,
    MethodOutcome,
)
from becalm.studies.strain.strain_model import Noise, likeliest, strain_model
from becalm.studies.strain.strain_page import page

ASKED = dict(zip(NOISES, (0.0089, 0.0184, 0.0309), strict=True))
NEAR = 3.5  # standard errors of the difference of two means of 20 runs
FEW = 5  # runs of becalm, which takes a hundred times as long as the others

Simulated = dict[str, dict[float, FilterQuality]]


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    found: Simulated = {}
    with pytest.MonkeyPatch.context() as patch:
        for runs, names in ((RUNS, METHODS.keys() - {BECALM, SMOOTHED}), (FEW, {BECALM, SMOOTHED})):
            patch.setattr(strain, "METHODS", {name: METHODS[name] for name in METHODS if name in names})
            found |= simulate(runs)[0]
    return found


@pytest.fixture(scope="module")
def gauge() -> Gauge:
    if missing_recordings(RECORDINGS):
        pytest.skip(missing_recordings(RECORDINGS))
    return measure_gauge(RECORDINGS)


def drawn_strain(noise: Noise, count: int, seed: int) -> Floats:
    """Draw readings from the paper's model itself."""
    rng, model = np.random.default_rng(seed), strain_model(noise, STEP_S)
    jerks = rng.normal(0.0, np.sqrt(noise.jerk_variance), count)
    x, truth = np.zeros(3), np.empty(count)
    for k, jerk in enumerate(jerks):
        truth[k] = x[0]
        x = model.F @ x + model.G[:, 0] * jerk
    return truth + rng.normal(0.0, np.sqrt(noise.noise_variance), count)


def test_the_ramps_are_those_of_the_paper() -> None:
    time_s, truth = ramps()
    assert len(time_s) == 1000
    np.testing.assert_allclose(truth[[0, 200, 300, 400, 600, 700, 800, 999]], [0, 0, 0.5, 1, 1, 0.5, 0, 0], atol=1e-12)
    assert np.max(np.diff(truth)) / STEP_S == pytest.approx(SLOPE)


def test_records_are_seeded_and_noisy_as_said() -> None:
    first, again = records(0.05), records(0.05)
    np.testing.assert_array_equal(first.readings, again.readings)
    assert np.std(first.readings - first.truth[:, np.newaxis]) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("given", [True, False])
def test_likelihood_finds_the_noise_that_a_record_was_drawn_with(given: bool) -> None:
    true = Noise(2.0, 0.01)
    z = drawn_strain(true, 4000, 1)
    found = likeliest(z, STEP_S, true.noise_variance if given else None)
    assert found.noise_variance == pytest.approx(true.noise_variance, rel=0.0 if given else 0.1)
    assert abs(np.log10(found.jerk_variance / true.jerk_variance)) < 0.3


def test_no_other_noise_is_likelier() -> None:
    z = drawn_strain(Noise(0.5, 0.02), 800, 2)
    best = likeliest(z, STEP_S)

    def log_likelihood(noise: Noise) -> float:
        return kalman_filter(strain_model(noise, STEP_S), z).log_likelihood

    top = log_likelihood(best)
    for g, r in ((1.3, 1.0), (0.75, 1.0), (1.0, 1.05), (1.0, 0.95), (1.2, 1.05)):
        assert log_likelihood(Noise(best.jerk_variance * g, best.noise_variance * r)) < top


def test_a_delay_is_measured_as_lag_alone() -> None:
    _, truth = ramps()
    late = np.concatenate([np.zeros(7), truth[:-7]])[:, np.newaxis]
    found = assess(MethodOutcome(np.hstack([late, late]), late, np.full((2, 3), np.nan)), truth)
    assert found.ramp_lag_s == pytest.approx(0.7)
    assert found.record_lag_s == pytest.approx(0.7, abs=0.01 * STEP_S)  # told by a parabola
    assert (found.noise_share, found.overshoot, found.rms_error) == (0.0, 0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
def test_becalm_told_nothing_is_no_worse_than_the_papers_filter(simulated: Simulated, noise: float) -> None:
    assert simulated[BECALM][noise].rms <= ASKED[noise]
    assert simulated[SMOOTHED][noise].rms < simulated[BECALM][noise].rms < simulated[KALMAN][noise].rms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "checked"),
    [
        (KALMAN, (0.0089, 0.0184, 0.0309)),
        (BUTTERWORTH, (0.0433, 0.0453, 0.0494)),
        (AVERAGE, (0.1455, 0.146, 0.1465)),
    ],
)
def test_the_papers_filters_err_as_checked(simulated: Simulated, name: str, checked: tuple[float, ...]) -> None:
    for noise, value in zip(NOISES, checked, strict=True):
        got = simulated[name][noise]
        assert abs(got.rms - value) < NEAR * np.sqrt(2) * got.rms_error + 5e-5


@pytest.mark.slow
def test_classic_filters_trail_and_kalman_filters_do_not(simulated: Simulated) -> None:
    found = {name: values[SHOWN] for name, values in simulated.items()}
    assert found[AVERAGE].ramp_lag_s == pytest.approx((AVERAGED - 1) / 2 * STEP_S)
    assert found[BUTTERWORTH].ramp_lag_s > 1.3
    for name, most_s in ((KALMAN, 0.05), (LIKELIEST, 0.05), (BECALM, 0.15), (SMOOTHED, 0.05)):
        assert abs(found[name].ramp_lag_s) < most_s  # a motion that returns to a level trails a ramp a little
        assert 0 < found[name].overshoot < 0.05


@pytest.mark.slow
def test_likelihood_finds_what_the_paper_tried(simulated: Simulated) -> None:
    for noise, found in simulated[LIKELIEST].items():
        jerk_variance, noise_std, _ = found.identified
        assert G_BY_TRIAL / 3 < jerk_variance < G_BY_TRIAL * 3
        assert noise_std == pytest.approx(noise, rel=0.03)


@pytest.mark.slow
def test_a_wrong_model_of_a_real_gauge_is_told(gauge: Gauge) -> None:
    wrong = gauge.trials["G of the simulation, R at rest"]
    assert wrong.judgement.verdict == "does not fit"
    assert wrong.residual_drift > 3 * gauge.rest.noise_std
    for mode in ("causal", "smoothed"):
        assert gauge.trials[f"becalm, {mode}"].judgement.verdict == "fits"
        assert gauge.trials[f"becalm, {mode}"].residual_drift < gauge.rest.noise_std / 5


@pytest.mark.slow
def test_noise_at_rest_is_told_from_drift(gauge: Gauge) -> None:
    assert gauge.rest.noise_std == pytest.approx(0.2, abs=0.05)
    assert gauge.rest.std > 2 * gauge.rest.noise_std


def test_an_absent_gauge_is_left_out_with_a_sentence(tmp_path: Path) -> None:
    said = missing_recordings(tmp_path)
    assert AT_REST in said
    assert LOADED in said


def told_study(rms: float) -> StrainStudy:
    """Make up a study in which becalm errs so much."""
    found = FilterQuality(0.01, 0.001, 0.5, 0.0, 0.0, 0.0, (1.0, 1.0, 3.0))
    measured = {name: dict.fromkeys(NOISES, found) for name in METHODS}
    measured[BECALM] = dict.fromkeys(NOISES, found._replace(rms=rms))
    return StrainStudy(measured, ShownRecord(np.zeros(2), np.zeros(2), {}), None, "Left out.")


@pytest.mark.parametrize(("rms", "says"), [(0.0071, "that is within"), (0.0234, "that is not within")])
def test_the_page_says_what_was_measured(rms: float, says: str) -> None:
    text = page(told_study(rms), {})
    assert f"{rms:.4f}" in text
    assert says in text
    assert "Left out." in text
    assert NOT_DRAWN in text


def test_figures_are_drawn_where_they_can_be(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    time_s, truth = ramps()
    study = told_study(0.01)._replace(shown=ShownRecord(time_s, truth, dict.fromkeys(METHODS, truth)))
    drawn = draw(sheets(study), tmp_path)
    assert [path.name for path in drawn] == [f"strain-{number}.svg" for number in range(1, 7)]
    assert all(path.stat().st_size > 5000 for path in drawn)
