"""Call other Kalman libraries so that they compute the same results as becalm.

x0 and P0 are the prior of the first reading. A library that predicts before every reading gets the state one step
earlier, from `before`. Each library is called as its documentation says, without results that are not needed. A library
that compiles does so before it is timed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm import Model

Floats = NDArray[np.float64]

SETTLED = 1e-28
"""Tolerance of statsmodels, the squared change of P in units of the noise, at which its results agree to 1e-6."""


@dataclass(frozen=True)
class Peer:
    """A library that filters a record.

    Attributes
    ----------
    package : str
        Name of the library on PyPI.
    count : int
        Largest number of samples to time; it is smaller for slow libraries.
    means : callable
        Function that filters z (N, m) with a model, and returns the states (N, n).
    label : str
        Name in the table; by default that of the package.
    needs : str
        Another package that `means` needs.
    """

    package: str
    count: int
    means: Callable[[Model, Floats], Floats]
    label: str = ""
    needs: str = "numpy"

    @property
    def name(self) -> str:
        """Return the name in the table."""
        return self.label or self.package


@cache
def installed(package: str) -> str:
    """Return the version of a package; "" if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def start(model: Model) -> tuple[Floats, Floats]:
    """Return x0 and P0, which every model here has."""
    if model.x0 is None or model.P0 is None:
        raise SystemExit("The benchmark's models need x0 and P0; give them to Model(...).")
    return model.x0, model.P0


def before(model: Model) -> tuple[Floats, Floats]:
    """Return the mean and covariance one step earlier, from which one prediction gives x0 and P0."""
    x0, P0 = start(model)
    back = np.linalg.inv(model.F)
    return back @ x0, back @ (P0 - model.process_covariance) @ back.T


def in_noise_units(model: Model, z: Floats) -> tuple[Model, Floats, float]:
    """Return model and readings in units of the first channel's noise, and that unit.

    Two libraries have absolute constants, whatever the unit of the readings: statsmodels treats a gain as settled if
    the squared change of P is less than 1e-19 (here SETTLED), and dynamax adds 1e-9 to S.
    """
    unit = float(np.sqrt(model.R[0, 0]))
    x0, P0 = start(model)
    Q, R = model.process_covariance / unit**2, model.R / unit**2
    return Model(F=model.F, H=model.H, Q=Q, R=R, x0=x0 / unit, P0=P0 / unit**2), z / unit, unit


def statsmodels_filter(model: Model, z: Floats, keep: Sequence[str] = ()) -> Any:
    """Return a compiled filter of statsmodels that stores only the results in `keep`."""
    module = import_module("statsmodels.tsa.statespace.kalman_filter")
    conserve = module.MEMORY_CONSERVE
    for name in keep:
        conserve &= ~getattr(module, name)
    one = module.KalmanFilter(
        k_endog=model.channels,
        k_states=model.states,
        design=model.H,
        obs_cov=model.R,
        transition=model.F,
        selection=np.eye(model.states),
        state_cov=model.process_covariance,
        conserve_memory=conserve,
        tolerance=SETTLED,
    )
    one.bind(z)
    one.initialize_known(*start(model))
    return one


def statsmodels_means(model: Model, z: Floats) -> Floats:
    """Filter with statsmodels, storing the states only."""
    scaled, numbers, unit = in_noise_units(model, z)
    results = statsmodels_filter(scaled, numbers, keep=("MEMORY_NO_FILTERED_MEAN",)).filter()
    return np.asarray(results.filtered_state.T * unit)


def statsmodels_log_likelihood(model: Model, z: Floats) -> float:
    """Return the log-likelihood by statsmodels in the original unit; the filter stores no results."""
    scaled, numbers, unit = in_noise_units(model, z)
    return float(statsmodels_filter(scaled, numbers).loglike()) - z.size * float(np.log(unit))


@cache
def dynamax() -> Any:
    """Import dynamax with 64-bit numbers, which JAX needs as a setting before."""
    import_module("jax").config.update("jax_enable_x64", True)
    return import_module("dynamax.linear_gaussian_ssm.inference")


@cache
def dynamax_compiled(result: str, batch: bool) -> Any:
    """Compile the filter of dynamax to store only one result; with `batch`, for readings with a leading axis."""
    jax, inference = import_module("jax"), dynamax()

    def one(params: Any, z: Any) -> Any:
        return getattr(inference.lgssm_filter(params, z), result)

    return jax.jit(jax.vmap(one, in_axes=(None, 0)) if batch else one)


def dynamax_params(model: Model) -> Any:
    """Return a model as parameters of dynamax."""
    x0, P0 = start(model)
    return dynamax().make_lgssm_params(x0, P0, model.F, model.process_covariance, model.H, model.R)


def dynamax_means(model: Model, z: Floats) -> Floats:
    """Filter with dynamax, compiled: z (N, m) or (B, N, m)."""
    scaled, numbers, unit = in_noise_units(model, z)
    return np.asarray(dynamax_compiled("filtered_means", z.ndim == 3)(dynamax_params(scaled), numbers)) * unit


def dynamax_log_likelihood(model: Model, z: Floats) -> float:
    """Return the log-likelihood by dynamax, compiled, in the original unit."""
    scaled, numbers, unit = in_noise_units(model, z)
    found = dynamax_compiled("marginal_loglik", False)(dynamax_params(scaled), numbers)
    return float(found) - z.size * float(np.log(unit))


def kalman_py_means(model: Model, z: Floats) -> Floats:
    """Filter with kalman-py on JAX, compiled, which predicts before the first reading."""
    import_module("jax").config.update("jax_enable_x64", True)
    x, P = before(model)
    one = import_module("kalman_py").KalmanFilter(model.F, model.H, model.process_covariance, model.R, x, P)
    return np.asarray(one.filter(z, backend="jax").means)


def kalman_py_numpy_means(model: Model, z: Floats) -> Floats:
    """Filter with kalman-py on NumPy, which predicts before the first reading."""
    x, P = before(model)
    one = import_module("kalman_py").KalmanFilter(model.F, model.H, model.process_covariance, model.R, x, P)
    return np.asarray(one.filter(z).means)


def fast_kalman_filter(model: Model) -> Any:
    """Return a filter of fast-kalman, which needs flat lists."""
    x0, P0 = start(model)
    one = import_module("kalman").LinearKalmanFilter(model.states, model.channels)
    one.x, one.P, one.F, one.Q = (a.ravel().tolist() for a in (x0, P0, model.F, model.process_covariance))
    one.H, one.R = model.H.ravel().tolist(), model.R.ravel().tolist()
    return one


def fast_kalman_means(model: Model, z: Floats) -> Floats:
    """Filter with fast-kalman, one call per reading: its `update_many` returns only the last state."""
    one = fast_kalman_filter(model)
    means = np.empty((len(z), model.states))
    rows = z.tolist()
    one.correct(rows[0])
    means[0] = one.x
    for k, row in enumerate(rows[1:], start=1):
        one.update(row)
        means[k] = one.x
    return means


def filterpy_filter(model: Model) -> Any:
    """Return a filter of filterpy."""
    one = import_module("filterpy.kalman").KalmanFilter(dim_x=model.states, dim_z=model.channels)
    one.x, one.P = (np.array(a) for a in start(model))
    one.F, one.Q = np.array(model.F), np.array(model.process_covariance)
    one.H, one.R = np.array(model.H), np.array(model.R)
    return one


def filterpy_means(model: Model, z: Floats) -> Floats:
    """Filter with filterpy, which updates with the first reading before it predicts."""
    means, *_ = filterpy_filter(model).batch_filter(z, update_first=True)
    return np.asarray(means)


def pykalman_means(model: Model, z: Floats) -> Floats:
    """Filter with pykalman."""
    x0, P0 = start(model)
    one = import_module("pykalman").KalmanFilter(
        transition_matrices=model.F,
        observation_matrices=model.H,
        transition_covariance=model.process_covariance,
        observation_covariance=model.R,
        initial_state_mean=x0,
        initial_state_covariance=P0,
    )
    return np.asarray(one.filter(z)[0])


def simdkalman_means(model: Model, z: Floats) -> Floats:
    """Filter with simdkalman: z (N, m) or (B, N, m)."""
    x0, P0 = start(model)
    one = import_module("simdkalman").KalmanFilter(model.F, model.process_covariance, model.H, model.R)
    batch = z if z.ndim == 3 else z[np.newaxis]
    found = one.compute(batch, 0, x0, P0, smoothed=False, filtered=True, observations=False)
    means: Floats = found.filtered.states.mean
    return means if z.ndim == 3 else means[0]


def torch_kf_means(model: Model, z: Floats) -> Floats:
    """Filter with torch-kf, which updates before it predicts: z (N, m) or (B, N, m)."""
    torch, torch_kf = import_module("torch"), import_module("torch_kf")
    torch.set_num_threads(1)
    x0, P0 = (torch.from_numpy(np.array(a)) for a in start(model))
    matrices = (model.F, model.H, model.process_covariance, model.R)
    one = torch_kf.KalmanFilter(*(torch.from_numpy(np.array(a)) for a in matrices))
    batch = z if z.ndim == 3 else z[np.newaxis]
    state = torch_kf.GaussianState(x0[:, None].expand(len(batch), -1, 1), P0.expand(len(batch), -1, -1))
    readings = torch.from_numpy(batch).transpose(0, 1)[..., None]
    means = one.filter(state, readings, return_all=True).mean[..., 0].transpose(0, 1).numpy()
    return np.asarray(means if z.ndim == 3 else means[0])


PEERS = (
    Peer("statsmodels", 1_000_000, statsmodels_means),
    Peer("dynamax", 1_000_000, dynamax_means),
    Peer("kalman-py", 1_000_000, kalman_py_means, "kalman-py, JAX", needs="jax"),
    Peer("fast-kalman", 100_000, fast_kalman_means),
    Peer("kalman-py", 20_000, kalman_py_numpy_means, "kalman-py, NumPy"),
    Peer("filterpy", 20_000, filterpy_means),
    Peer("simdkalman", 10_000, simdkalman_means),
    Peer("torch-kf", 10_000, torch_kf_means, needs="torch"),
    Peer("pykalman", 10_000, pykalman_means),
)

BATCH_PEERS = (
    Peer("dynamax", 10_000, dynamax_means, "dynamax, vmap"),
    Peer("simdkalman", 1_000, simdkalman_means),
    Peer("torch-kf", 1_000, torch_kf_means, needs="torch"),
)


def present(peers: Sequence[Peer]) -> list[Peer]:
    """Return the peers that are installed."""
    return [peer for peer in peers if installed(peer.package) and installed(peer.needs)]
