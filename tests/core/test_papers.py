"""The three papers that becalm grew from, with their printed numbers: car, IMU and strain."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.classic.causal import butterworth, moving_average
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.components import Component, Part
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.reference import kalman as reference
from becalm.metrics.truth import rms_error


class TestCar:
    """Sensors 2001: speed, longitudinal and vertical acceleration at 500 Hz."""

    T = 1 / 500
    F = ((1, T, 0), (0, 1, 0), (0, 0, 1))
    G = ((T**2 / 2, 0), (T, 0), (0, T))

    def model(self) -> Model:
        P0 = np.diag([1000, 100, 100])
        return Model(self.F, np.eye(3), 1e5 * np.eye(2), 100 * np.eye(3), G=self.G, x0=np.zeros(3), P0=P0)

    def steady_gain(self) -> Floats:
        model = self.model()
        cov = kalman_filter(model, np.zeros((5000, 3)), covariances=True).cov
        assert cov is not None
        P = model.F @ cov[-1] @ model.F.T + model.process_covariance
        gain: Floats = np.linalg.solve(P + model.R, P).T
        return gain

    def test_the_printed_steady_gain(self) -> None:
        printed = [[0.00199524, 0.00187742, 0], [0.00187742, 0.06124743, 0], [0, 0, 0.06127717]]
        np.testing.assert_allclose(self.steady_gain(), printed, rtol=0, atol=5e-9)

    def test_the_one_step_prediction_form_is_the_filtered_form(self) -> None:
        model = self.model()
        assert model.x0 is not None
        assert model.P0 is not None
        z = 10 * np.random.default_rng(2).normal(size=(400, 3))
        got = kalman_filter(model, z, states=True, covariances=True)
        assert got.mean is not None
        assert got.cov is not None
        belief = reference.StateEstimate(model.x0, model.P0)
        size = np.abs(got.mean).max(axis=0)
        for k, reading in enumerate(z):
            sensor = (model.H, model.R)
            step = reference.predict_one_step(belief, model.F, model.process_covariance, sensor, reading)
            assert (np.abs(step.state - model.F @ got.mean[k]) <= 1e-12 * size).all()
            np.testing.assert_allclose(step.filtered_cov, got.cov[k], rtol=1e-12, atol=1e-12 * got.cov[k].max())
            S = belief.cov + model.R
            filtered_gain = belief.cov @ np.linalg.inv(S)
            np.testing.assert_allclose(step.gain, model.F @ filtered_gain, rtol=1e-12, atol=1e-14)
            belief = reference.StateEstimate(step.state, step.cov)

    def test_white_noise_leaves_with_the_printed_share_of_its_power(self) -> None:
        """The sum of squares of the impulse responses; 30.02 dB and 30.00 dB in the paper's convention."""
        model = self.model()
        rest = 3000
        power = np.zeros(3)
        for channel in range(3):
            z = np.zeros((2 * rest, 3))
            z[rest, channel] = 1.0
            power += np.sum(kalman_filter(model, z).signal ** 2, axis=0)
        np.testing.assert_allclose(power[1:], [0.03156, 0.03161], rtol=0, atol=5e-6)
        np.testing.assert_allclose(-20 * np.log10(power[1:]), [30.02, 30.00], rtol=0, atol=5e-3)

    def test_complex_hermitian_signals_are_one_real_filter_a_part(self) -> None:
        model = self.model()
        sensor = (model.H, model.R)
        rng = np.random.default_rng(3)
        z = rng.normal(size=(50, 3)) + 1j * rng.normal(size=(50, 3))
        whole, real = (reference.StateEstimate(np.zeros(3), 100 * np.eye(3)) for _ in range(2))
        for reading in z:
            both = reference.predict_one_step(whole, model.F, model.process_covariance, sensor, reading)
            part = reference.predict_one_step(real, model.F, model.process_covariance, sensor, reading.real)
            np.testing.assert_allclose(both.state.real, part.state, rtol=1e-12, atol=1e-12)
            whole, real = reference.StateEstimate(both.state, both.cov), reference.StateEstimate(part.state, part.cov)


def imu(output: tuple[float, float], density: float) -> Component:
    """F_c = [[0, 1], [0, 0]], B = I: noise on both states."""
    drift = np.array([[0.0, 1.0], [0.0, 0.0]])
    return Component(drift, np.eye(2), density * np.eye(2), np.array([output]), (Part("drift", ("first", "second")),))


ACCELEROMETER, GYROSCOPE = (0.0, 1.0), (1.0, 0.0)
IMU_CASES = {
    "accelerometer, table 1": (ACCELEROMETER, 1.1859e-8, 1.8472e-4),
    "accelerometer, table 2": (ACCELEROMETER, 1.3458e-11, 5.8631e-13),
    "accelerometer, R = 0": (ACCELEROMETER, 1.1859e-8, 0.0),
    "accelerometer, Q = 0": (ACCELEROMETER, 0.0, 1.8472e-4),
    "accelerometer, Q = 0 and R = 0": (ACCELEROMETER, 0.0, 0.0),
    "gyroscope, table 1": (GYROSCOPE, 2.4907e-9, 1.3872e-6),
    "gyroscope, table 2": (GYROSCOPE, 1.9674e-7, 1.9148e-10),
    "gyroscope, R = 0": (GYROSCOPE, 2.4907e-9, 0.0),
    "gyroscope, Q = 0": (GYROSCOPE, 0.0, 1.3872e-6),
}


class TestImu:
    """A paper of 2010: accelerometer [V, a] and gyroscope [omega, epsilon] at 10 kHz."""

    T = 1e-4

    def model(self, output: tuple[float, float], Q: float, R: float) -> Model:
        euler = imu(output, Q).to_model(self.T, R, discretisation="euler")
        return Model(euler.F, euler.H, euler.Q, euler.R, G=euler.G, x0=[0, 0], P0=np.ones((2, 2)))

    def test_the_papers_discretisation(self) -> None:
        model = imu(ACCELEROMETER, 3.0).to_model(self.T, 1.0, discretisation="euler")
        assert np.array_equal(model.F, [[1.0, self.T], [0.0, 1.0]])
        assert np.array_equal(model.G, self.T * np.eye(2))
        np.testing.assert_allclose(model.process_covariance, self.T**2 * 3.0 * np.eye(2), rtol=1e-15)

    @pytest.mark.parametrize("name", IMU_CASES)
    def test_the_papers_filters_run(self, name: str) -> None:
        output, Q, R = IMU_CASES[name]
        z = 0.2 + np.sqrt(1.8472e-4) * np.random.default_rng(5).normal(size=20_000)
        got = kalman_filter(self.model(output, Q, R), z, states=True, covariances=True)
        assert got.mean is not None
        assert got.cov is not None
        assert np.isfinite(got.mean).all()
        assert np.isfinite(got.cov).all()
        assert np.linalg.eigvalsh(got.cov).min() >= -1e-12 * got.cov.max()
        if R == 0 and Q > 0:
            np.testing.assert_allclose(got.signal[:, 0], z, rtol=1e-12)
        if name == "accelerometer, Q = 0":
            steps = np.arange(1, len(z) + 1)
            np.testing.assert_allclose(got.signal[:, 0], np.cumsum(z) / (steps + R), rtol=1e-9)

    def test_the_speed_of_the_accelerometer_is_never_observed(self) -> None:
        assert self.model(ACCELEROMETER, 1.0, 1.0).observable_states == (False, True)
        assert self.model(GYROSCOPE, 1.0, 1.0).observable_states == (True, True)

    @pytest.mark.slow
    def test_ten_million_steps_of_a_state_that_is_never_observed(self) -> None:
        """V's variance grows without end; the state stays finite, and a is that of the one-state filter."""
        Q, R = 1.1859e-8, 1.8472e-4
        model = self.model(ACCELEROMETER, Q, R)
        alone = Model(F=[[1]], H=[[1]], Q=[[self.T**2 * Q]], R=[[R]], x0=[0], P0=[[1]])
        both, one = Online(model), Online(alone)
        rng = np.random.default_rng(6)
        for _ in range(10):
            z = np.sqrt(R) * rng.normal(size=1_000_000)
            signal, sigma = both.run(z)
            expected, spread = one.run(z)
            assert np.isfinite(signal).all()
            assert np.abs(signal - expected).max() <= 1e-9 * np.sqrt(R)
            np.testing.assert_allclose(sigma, spread, rtol=1e-9)


class TestStrain:
    """Quasi-static strain at 10 Hz: noise on the third derivative, G = 1e-4, R known."""

    T = 0.1
    RUNS = 20

    def truth(self) -> Floats:
        t = np.arange(0, 100, self.T)
        ramps: Floats = np.interp(t, [0, 20, 40, 60, 80, 100], [0, 0, 1, 1, 0, 0])
        return ramps

    def model(self, noise: float) -> Model:
        T = self.T
        F = np.array([[1, T, T**2 / 2], [0, 1, T], [0, 0, 1]])
        G = [[T**3 / 6], [T**2 / 2], [T]]
        return Model(F, [[1, 0, 0]], [[1e-4]], [[noise**2]], G=G)

    def readings(self, noise: float) -> list[Floats]:
        rng = np.random.default_rng(2002)
        return [self.truth() + noise * rng.normal(size=1000) for _ in range(self.RUNS)]

    @pytest.mark.parametrize(("noise", "printed"), [(0.02, 0.0089), (0.05, 0.0184), (0.1, 0.0309)])
    def test_the_papers_simulation(self, noise: float, printed: float) -> None:
        model, truth = self.model(noise), self.truth()
        errors = [rms_error(kalman_filter(model, z).signal[:, 0], truth) for z in self.readings(noise)]
        assert np.mean(errors) == pytest.approx(printed, rel=0.03)

    @pytest.mark.parametrize(
        ("noise", "low_pass", "average"), [(0.02, 0.0433, 0.1455), (0.05, 0.0453, 0.146), (0.1, 0.0494, 0.1465)]
    )
    def test_the_papers_competitors(self, noise: float, low_pass: float, average: float) -> None:
        truth, records = self.truth(), self.readings(noise)
        filtered = [rms_error(butterworth(z, 0.3 * self.T, 4), truth) for z in records]
        averaged = [rms_error(moving_average(z, 100), truth) for z in records]
        assert np.mean(filtered) == pytest.approx(low_pass, rel=0.03)
        assert np.mean(averaged) == pytest.approx(average, rel=0.03)
