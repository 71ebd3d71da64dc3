"""The cost of the IMU paper, by its definition, its closed forms and its printed optimum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.reference import kalman as reference
from becalm.errors import ModelError, RecordingError
from becalm.identification.several.step_spectrum import SEGMENT, Sensor, SpectrumKind, StepTrial, imu_component
from becalm.identification.several.step_tuning import tune_by_simplex, tune_by_step

ONES = np.ones((2, 2))
SENSORS: tuple[Sensor, ...] = ("accelerometer", "gyroscope")
TABLE_1 = {"accelerometer": 1.8472e-4, "gyroscope": 1.3872e-6}
TABLE_2 = {"accelerometer": 1.3458e-11 / 5.8631e-13, "gyroscope": 1.9674e-7 / 1.9148e-10}


def white(sensor: Sensor, seed: int = 0, **how: Any) -> StepTrial:
    """Ten seconds at 10 kHz of white noise with the variance of table 1."""
    record = np.random.default_rng(seed).normal(0, np.sqrt(TABLE_1[sensor]), 100_000)
    return StepTrial(record, 1e4, sensor, **how)


def by_definition(trial: StepTrial, R: float, Q: float) -> tuple[float, float]:
    """Both integrals of (10), the filter in plain equations, the spectrum by hand."""
    model, P0 = trial.model(R, Q), trial.initial_covariance
    assert P0 is not None
    calm = trial.record - trial.record.mean()
    t = np.arange(len(calm)) / trial.rate_hz
    S = np.where(t >= trial.step_at_s, trial.step, 0.0)

    def filtered(z: Floats) -> Floats:
        start = reference.StateEstimate(np.zeros(2), P0)
        steps = reference.filter_readings(start, model.F, model.process_covariance, (model.H, model.R), z[:, None])
        return np.array([float((model.H @ step.filtered.mean)[0]) for step in steps])

    x, lag, before = filtered(calm + S), 0.0, np.nan
    for k in np.flatnonzero(t >= trial.step_at_s):
        square = (S[k] - x[k]) ** 2
        lag += 0.0 if np.isnan(before) else (before + square) / 2 / trial.rate_hz
        before = square
        if x[k] >= S[k]:
            break
    X = filtered(calm)
    window = np.sin(np.pi * np.arange(SEGMENT) / SEGMENT) ** 2
    pieces = [X[start : start + SEGMENT] for start in range(0, len(X) - SEGMENT + 1, SEGMENT // 2)]
    power = np.mean([np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2 for piece in pieces], axis=0)
    density = 2 * power / trial.rate_hz / np.sum(window**2)
    density[[0, -1]] /= 2
    size = np.sqrt(density) if trial.spectrum == "amplitude" else density
    return lag, float(np.sum(size[1:] + size[:-1]) / 2 * trial.rate_hz / SEGMENT)


@pytest.mark.parametrize(
    ("ratio", "sensor", "spectrum"),
    [
        (0.1, "accelerometer", "amplitude"),
        (0.1, "gyroscope", "power"),
        (10.0, "accelerometer", "power"),
        (10.0, "gyroscope", "amplitude"),
        (1e4, "gyroscope", "power"),
    ],
)
def test_the_cost_is_that_of_its_definition(ratio: float, sensor: Sensor, spectrum: SpectrumKind) -> None:
    record = 5 + 0.05 * np.random.default_rng(1).normal(size=2500)
    trial = StepTrial(record, 300.0, sensor, spectrum, initial_covariance=ONES)
    cost = trial.cost(2.5e-3, ratio * 2.5e-3)
    lag, noise = by_definition(trial, 2.5e-3, ratio * 2.5e-3)
    assert cost.lag == pytest.approx(lag, rel=1e-9)
    assert cost.noise == pytest.approx(noise, rel=1e-9)
    assert cost.total == cost.lag + cost.noise


def test_the_lag_of_the_accelerometer_is_a_geometric_series() -> None:
    """a is a random walk of q = T^2 Q; with the gain K of facts 3.3 its error is S (1 - K)^(k + 1)."""
    trial = StepTrial(np.zeros(10_000), 1e3, "accelerometer")
    cost = trial.cost(3.0, 3e4)
    q_over_r = 1e-6 * 1e4
    K = (np.sqrt(q_over_r**2 + 4 * q_over_r) - q_over_r) / 2
    squares = (0.2 * (1 - K) ** np.arange(1, 5001)) ** 2
    assert cost.lag == pytest.approx(1e-3 * (squares.sum() - squares[[0, -1]].mean()), rel=1e-9)
    assert cost.noise == 0.0
    assert np.isnan(cost.reached_after_s)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e9])
def test_only_the_ratio_matters(sensor: Sensor, scale: float) -> None:
    for P0 in (None, ONES):
        trial = white(sensor, initial_covariance=P0)
        scaled = white(sensor, initial_covariance=None if P0 is None else scale * P0)
        one, other = trial.cost(1.0, 500.0), scaled.cost(scale, 500.0 * scale)
        np.testing.assert_allclose(other, one, rtol=1e-9)


def test_a_louder_record_and_a_higher_step_cost_as_their_units_say() -> None:
    for spectrum, power in (("amplitude", 1), ("power", 2)):
        one = white("gyroscope", spectrum=spectrum).cost(1.0, 1e3)
        loud = StepTrial(8 * white("gyroscope").record, 1e4, "gyroscope", spectrum, step=1.6).cost(1.0, 1e3)  # type: ignore[arg-type]
        assert loud.lag == pytest.approx(64 * one.lag, rel=1e-12)
        assert loud.noise == pytest.approx(8**power * one.noise, rel=1e-12)
        assert loud.reached_after_s == one.reached_after_s


@pytest.mark.parametrize(("seed", "P0"), [(0, None), (1, ONES)], ids=["from the first readings", "as in the paper"])
def test_the_printed_optimum_of_the_gyroscope(seed: int, P0: Floats | None) -> None:
    """Table 2 has 1027.5; its noise was nearly white."""
    found = tune_by_step(white("gyroscope", seed, initial_covariance=P0), TABLE_1["gyroscope"])
    assert 900 < found.ratio < 1200
    assert found.at_edge == ""
    assert found.process_variance == pytest.approx(found.ratio * TABLE_1["gyroscope"])


def test_the_accelerometer_of_white_noise_is_faster_than_the_printed_one() -> None:
    """Table 2 has 22.95, of a record with harmonics; white noise gives about four times as much."""
    found = tune_by_step(white("accelerometer"), TABLE_1["accelerometer"])
    assert 80 < found.ratio < 105
    assert found.cost.total < white("accelerometer").cost(1.0, TABLE_2["accelerometer"]).total


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_optimum_is_a_minimum(sensor: Sensor) -> None:
    trial = white(sensor)
    found = tune_by_step(trial)
    others = [trial.cost(1.0, found.ratio * factor).total for factor in np.geomspace(1e-4, 1e4, 33)]
    assert min(others) > found.cost.total * (1 - 1e-4)
    assert others[0] > 2 * found.cost.total
    assert others[-1] > 2 * found.cost.total


def test_the_power_density_has_its_minimum_five_decades_away() -> None:
    amplitude, power = (tune_by_step(white("gyroscope", spectrum=spectrum)) for spectrum in ("amplitude", "power"))
    assert np.log10(power.ratio / amplitude.ratio) == pytest.approx(5, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
def test_the_simplex_ends_somewhere_on_the_floor_of_the_valley(sensor: Sensor) -> None:
    trial = StepTrial(white(sensor).record[:20_000], 2e3, sensor)
    line = tune_by_step(trial)
    ends = [tune_by_simplex(trial, R, Q) for R, Q in ((TABLE_1[sensor], 1e-8), (1.0, 1.0), (1e-3, 1e3))]
    for end in ends:
        assert end.ratio == pytest.approx(line.ratio, rel=0.05)
        assert end.cost.total == pytest.approx(line.cost.total, rel=1e-3)
        assert end.ratio == pytest.approx(end.process_variance / end.noise_variance)
    scales = [end.noise_variance for end in ends]
    assert max(scales) > 100 * min(scales)


def test_without_noise_the_fastest_filter_wins() -> None:
    assert tune_by_step(StepTrial(np.zeros(4000), 400.0, "gyroscope")).at_edge == "high"


def test_noise_free_readings_or_a_state_that_never_changes_can_be_asked_for() -> None:
    trial = white("gyroscope", initial_covariance=ONES)
    through, stuck = trial.cost(0.0, 1e-9), trial.cost(1e-6, 0.0)
    assert through.reached_after_s <= 1e-3
    assert stuck.lag > through.lag
    assert stuck.noise < through.noise


def test_the_models_are_the_papers() -> None:
    for sensor, H in (("accelerometer", [[0.0, 1.0]]), ("gyroscope", [[1.0, 0.0]])):
        model = imu_component(sensor, 3.0).to_model(1e-4, 1.0, "euler")  # type: ignore[arg-type]
        assert np.array_equal(model.F, [[1.0, 1e-4], [0.0, 1.0]])
        assert np.array_equal(model.H, H)
        np.testing.assert_allclose(model.process_covariance, 3e-8 * np.eye(2), rtol=1e-14)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"record": np.zeros(SEGMENT - 1)}, "1024 readings or more"),
        ({"record": np.full(4000, np.nan)}, "none missing"),
        ({"record": np.zeros((4000, 2))}, "one channel"),
        ({"rate_hz": 0.0}, "must be positive"),
        ({"rate_hz": np.nan}, "must be positive"),
        ({"step": -0.2}, "must be positive"),
        ({"step_at_s": 10.0}, "The step at 10 s is not within the record of 10 s"),
        ({"step_at_s": -1.0}, "The step at -1 s"),
        ({"spectrum": "phase"}, "spectrum = 'phase' is not known; use 'amplitude' or 'power'"),
        ({"sensor": "compass"}, "sensor = 'compass' is not known; use 'accelerometer' or 'gyroscope'"),
    ],
)
def test_what_is_no_trial_is_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises((RecordingError, ModelError), match=words):
        StepTrial(**{"record": np.zeros(4000), "rate_hz": 400.0, "sensor": "gyroscope", **changed})


@pytest.mark.parametrize(("R", "Q"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0), (np.nan, 1.0)])
def test_the_simplex_starts_from_positive_variances(R: float, Q: float) -> None:
    with pytest.raises(ModelError, match="needs positive starting values"):
        tune_by_simplex(StepTrial(np.zeros(4000), 400.0, "gyroscope"), R, Q)
