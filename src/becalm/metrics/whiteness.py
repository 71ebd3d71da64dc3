"""Tests of innovations: whether they are white, how predictable they are, and whether their variance is right."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from becalm.core.arrays import Floats, frozen
from becalm.core.closed_forms import autoregressive_power

# The autocovariance of a sequence that comes in pieces; products across the boundaries of pieces are included.

MOST_LAGS = 32  # largest lag of the sums
_ROW = 8  # shortest row of a matrix for which BLAS is fast
_SHIFTS = MOST_LAGS // _ROW + 1


class LaggedSums(NamedTuple):
    """Sums over a sequence e, and over products of its values with values up to 32 places earlier.

    Attributes
    ----------
    seen : int
        Number of values so far.
    shift : float
        Mean of the first piece; the sums are over c = e - shift.
    total : float
        Sum of c.
    products : (5, 8, 8) float array
        Sums of products of c with values of c up to 32 places earlier, in rows of 8; see `about_mean`.
    head, tail : (32,) float array
        The first and the last 32 values of c; zero if there are fewer.
    varies : bool
        True if not all c are equal.

    Notes
    -----
    The sums about the shift are accurate: n var = sum (e - mean)^2 >= P (shift - mean)^2 for a first piece of P values,
    so that rounding errors grow at most by the factor n/P, whatever the mean.
    """

    seen: int = 0
    shift: float = 0.0
    total: float = 0.0
    products: Floats = frozen(np.zeros((_SHIFTS, _ROW, _ROW)))
    head: Floats = frozen(np.zeros(MOST_LAGS))
    tail: Floats = frozen(np.zeros(MOST_LAGS))
    varies: bool = False

    def extended(self, piece: Floats) -> LaggedSums:
        """Return the sums with a piece (n,) of finite values added; the first of several pieces needs 32 values."""
        n = len(piece)
        shift = self.shift if self.seen else float(np.mean(piece))
        rows = -(-n // _ROW)
        own = np.zeros(rows * _ROW)
        np.subtract(piece, shift, out=own[:n])
        c = np.append(self.tail, own)  # a copy, because BLAS is slower for the product of an array with itself
        step = c.itemsize
        earlier = np.ndarray((_SHIFTS, rows, _ROW), float, c, strides=(_ROW * step, _ROW * step, step))
        head = self.head if self.seen else np.append(own[:MOST_LAGS], np.zeros(MOST_LAGS))[:MOST_LAGS]
        return LaggedSums(
            self.seen + n,
            shift,
            self.total + float(own.sum()),
            self.products + own.reshape(rows, _ROW).T @ earlier,
            head,
            c[n : n + MOST_LAGS].copy(),
            self.varies or bool(np.any(own[:n] != head[0])),
        )

    def about_mean(self, lags: int) -> Floats:
        """Return the sum of (e[i] - mean) (e[i - j] - mean) over i, for j = 0 to `lags`, up to 32."""
        # products[k, a, b] is the sum of c[i] c[i - j] over every eighth i, with j = 32 + a - 8 k - b
        by_row = self.products.transpose(1, 0, 2).reshape(_ROW, _SHIFTS * _ROW)
        diagonals = np.array([by_row[a, a : a + MOST_LAGS + 1] for a in range(_ROW)])
        j = np.arange(lags + 1)
        first = np.append(0.0, np.cumsum(self.head))[: lags + 1]
        last = np.append(0.0, np.cumsum(self.tail[::-1]))[: lags + 1]
        mean = self.total / self.seen
        with np.errstate(over="ignore", invalid="ignore"):  # squares that overflow give inf or NaN
            lagged = diagonals.sum(axis=0)[::-1][: lags + 1]
            about: Floats = lagged - mean * (2 * self.total - first - last) + (self.seen - j) * mean * mean
        return about


# Sums over a sequence of any length that comes in blocks, in constant memory.

PIECE = 8000
"""Values per piece, a multiple of 50: a piece fits into the cache, and BLAS uses one thread for it."""

Sums = TypeVar("Sums")


class Running(Generic[Sums]):
    """Sums over the finite values of a sequence that comes in blocks of any length.

    The finite values are split into pieces of `PIECE` values, counted from the first finite value. So the sums depend
    neither on the boundaries of the blocks nor on the places of missing values.

    Parameters
    ----------
    initial : Sums
        The sums before the first value.
    extended : callable
        Function of sums and a piece, which returns the sums with the piece added. A piece has `PIECE` values; only the
        last piece may have fewer. The array of the piece is reused after the call.
    """

    def __init__(self, initial: Sums, extended: Callable[[Sums, Floats], Sums]) -> None:
        self._sums = initial
        self._extended = extended
        self._buffer = np.empty(PIECE)  # buffer for an incomplete piece
        self._buffered = 0  # values in the buffer

    def add(self, values: Floats) -> None:
        """Add a block (B,); NaN and inf are ignored."""
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(values), PIECE):
                part = values[start : start + PIECE]
                finite = np.isfinite(part)
                self._add_part(part if finite.all() else part[finite])

    def sums(self) -> Sums:
        """Return the sums of all values so far; more may follow."""
        if not self._buffered:
            return self._sums
        with np.errstate(over="ignore", invalid="ignore"):
            return self._extended(self._sums, self._buffer[: self._buffered])

    def _add_part(self, part: Floats) -> None:
        """Add up to `PIECE` finite values; a whole piece is not copied if the buffer is empty."""
        if len(part) == PIECE and not self._buffered:
            self._sums = self._extended(self._sums, part)
            return
        fitting, excess = part[: PIECE - self._buffered], part[PIECE - self._buffered :]
        self._buffer[self._buffered : self._buffered + len(fitting)] = fitting
        self._buffered += len(fitting)
        if self._buffered == PIECE:
            self._sums = self._extended(self._sums, self._buffer)
            self._buffer[: len(excess)] = excess
            self._buffered = len(excess)


LAGS = 20  # number of lags of the Ljung-Box test
_PREDICTOR_LAGS = MOST_LAGS  # largest number of lags of a linear predictor
_CYCLES = np.linspace(0.0, 0.5, 501)  # frequencies in cycles per value
_READINGS_PER_LAG = 8  # least number of values per lag; a short sequence uses fewer lags


class Predictor(NamedTuple):
    """A linear predictor: it predicts a value as the sum of coefficients[j] times the value j + 1 places earlier.

    Attributes
    ----------
    coefficients : (j,) float array
        Coefficients; empty for white noise.
    error : float
        Variance of the prediction error over the variance of the sequence.
    """

    coefficients: Floats
    error: float

    def share_outside(self, cycles: float, width: float) -> float:
        """Return the predictable share of the variance outside a band about a frequency.

        Parameters
        ----------
        cycles, width : float
            Centre and half width of the band, in cycles per value.
        """
        outside = self.power(2 * np.pi * _CYCLES[np.abs(_CYCLES - cycles) > width])
        return 1 - float(np.exp(np.log(outside).mean()) / outside.mean())

    def power(self, angle: Floats) -> Floats:
        """Return the power (k,) of the predictor's autoregressive process at angles (k,), in radians per value.

        The average of the power over all angles is 1.
        """
        return autoregressive_power(self.coefficients, self.error, angle)


NO_PREDICTOR = Predictor(np.zeros(0), 1.0)


@dataclass(frozen=True)
class Whiteness:
    """Measures of the whiteness of a sequence.

    Attributes
    ----------
    p_value : float
        Ljung-Box test over 20 lags: probability that white noise looks at least as coloured. It is nearly 0 for all
        long real records; `predictable_share` is the size of the effect.
    first_correlation : float
        Correlation of consecutive values. If it is positive the filter is too slow, if negative too fast.
    predictable_share : float
        Share of the innovation power that a linear predictor of 32 lags predicts, minus the share that it predicts by
        chance for white noise; 0 to 1.
    loudest : float or None
        Frequency at which the spectrum, computed from 32 lags, has its maximum, in cycles per value, 0 to 0.5; None if
        there are too few values.
    predictor : Predictor
        The predictor whose number of lags, up to 32, an information criterion selects; it has 0 lags for white noise.
    """

    p_value: float
    first_correlation: float
    predictable_share: float
    loudest: float | None = None
    predictor: Predictor = field(default=NO_PREDICTOR, compare=False)


class RunningWhiteness(Running[LaggedSums]):
    """Sums that give the whiteness of a sequence in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(LaggedSums(), LaggedSums.extended)

    def result(self) -> Whiteness:
        """Return the `whiteness` of all values so far; more may follow."""
        return judge_whiteness(self.sums())


def whiteness(normalised: Floats) -> Whiteness:
    """Return the whiteness of normalised innovations (N,); NaN is removed first, so that lags count only values."""
    running = RunningWhiteness()
    running.add(normalised)
    return running.result()


def judge_whiteness(sums: LaggedSums) -> Whiteness:
    """Return the whiteness of a sequence from its lagged sums.

    Notes
    -----
    Ljung and Box, Biometrika 65 (1978) 297. The predictors are computed by the recursion of Levinson and Durbin.
    """
    from scipy.special import gammaincc

    n = sums.seen
    tested, predicted = min(LAGS, n // _READINGS_PER_LAG), min(_PREDICTOR_LAGS, n // _READINGS_PER_LAG)
    if predicted < 1 or not sums.varies:
        return Whiteness(1.0, 0.0, 0.0)
    covariance = sums.about_mean(predicted)
    if not 0 < covariance[0] < np.inf:  # squares too small or too large for float64
        return Whiteness(1.0, 0.0, 0.0)
    correlation = covariance / covariance[0]
    lags = np.arange(1, tested + 1)
    statistic = n * (n + 2) * float((correlation[1 : tested + 1] ** 2 / (n - lags)).sum())
    p_value = float(gammaincc(tested / 2, statistic / 2))
    every = [NO_PREDICTOR, *predictors(correlation)]
    share, chance = 1 - every[-1].error, predicted / n
    return Whiteness(
        p_value,
        float(correlation[1]),
        max(0.0, (share - chance) / (1 - chance)),
        float(_CYCLES[int(np.argmax(smoothed_power(correlation, _CYCLES)))]),
        min(every, key=lambda predictor: _information_criterion(predictor, n)),
    )


def _information_criterion(predictor: Predictor, count: int) -> float:
    """Return the Bayesian information criterion of a predictor (Schwarz, Annals of Statistics 6 (1978) 461)."""
    smallest = np.finfo(float).tiny
    return count * float(np.log(max(predictor.error, smallest))) + len(predictor.coefficients) * float(np.log(count))


def smoothed_power(correlation: Floats, cycles: Floats) -> Floats:
    """Return the power (k,), 1 for white noise, at frequencies (k,) in cycles per value, from correlations (l + 1,).

    Notes
    -----
    The spectrum is smoothed by the window of Parzen, Annals of Mathematical Statistics 32 (1961) 167.
    """
    place = np.arange(len(correlation)) / len(correlation)
    window = np.where(place < 0.5, 1 - 6 * place**2 * (1 - place), 2 * (1 - place) ** 3)
    waves = np.cos(2 * np.pi * np.outer(cycles, np.arange(1, len(correlation))))
    power: Floats = 1 + 2 * waves @ (window * correlation)[1:]
    return power


def predictors(correlation: Floats) -> Iterator[Predictor]:
    """Yield the best linear predictors of 1, 2, ... lags, from correlations (l + 1,) (Durbin 1960)."""
    error, coefficients = 1.0, np.zeros(0)
    for j in range(1, len(correlation)):
        reflection = (correlation[j] - coefficients @ correlation[j - 1 : 0 : -1]) / error
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        error = max(error * (1 - reflection**2), 0.0)
        yield Predictor(coefficients, float(error))
        if not error > 0:
            return


class Power(NamedTuple):
    """Number of values, and sum of their squares."""

    seen: int = 0
    squares: float = 0.0

    def extended(self, piece: Floats) -> Power:
        """Return the sums with a piece (n,) of finite values added."""
        return Power(self.seen + len(piece), self.squares + float(np.dot(piece, piece)))

    def mean(self) -> float:
        """Return the mean square; NaN if there are no values."""
        return self.squares / self.seen if self.seen else float("nan")


class RunningNis(Running[Power]):
    """Sums that give the mean squared normalised innovation of a sequence in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(Power(), Power.extended)

    def result(self) -> float:
        """Return the `mean_nis` of all values so far; more may follow."""
        return self.sums().mean()


def mean_nis(normalised: Floats) -> float:
    """Return the mean squared normalised innovation, NaN ignored; it is 1 if the innovation variances are right."""
    running = RunningNis()
    running.add(normalised)
    return running.result()


# Test whether the variance of the innovations is constant, as a model with one noise variance assumes.

_BLOCK = 50  # number of values in a block
_FACTOR = 4.0  # a block is uneven if its mean power is more than this, or less than 1 over this


class BlockCount(NamedTuple):
    """Number of blocks of 50 values, and number of uneven blocks, see `uneven_share`."""

    blocks: int = 0
    uneven: int = 0

    def extended(self, piece: Floats) -> BlockCount:
        """Return the count with a piece (n,) of finite values added; only the last piece may end within a block."""
        blocks = len(piece) // _BLOCK
        rows = piece[: blocks * _BLOCK].reshape(blocks, _BLOCK)
        power = np.vecdot(rows, rows) / _BLOCK
        even = int(np.count_nonzero((power >= 1 / _FACTOR) & (power <= _FACTOR)))
        return BlockCount(self.blocks + blocks, self.uneven + blocks - even)

    def share(self) -> float:
        """Return the share of uneven blocks."""
        return self.uneven / self.blocks if self.blocks else 0.0


class RunningEvenness(Running[BlockCount]):
    """Counts that give the uneven share of a sequence in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(BlockCount(), BlockCount.extended)

    def result(self) -> float:
        """Return the `uneven_share` of all values so far; more may follow."""
        return self.sums().share()


def uneven_share(normalised: Floats) -> float:
    """Return the share of blocks of 50 values whose mean power differs from 1 by more than a factor of four.

    Parameters
    ----------
    normalised : (N,) float array
        Innovations over their expected standard deviation; NaN is ignored.

    Notes
    -----
    The mean power of 50 white Gaussian innovations is 1 with a standard deviation of 0.2, so that no block is uneven by
    chance. A large share means that sigma is correct only on average.
    """
    running = RunningEvenness()
    running.add(normalised)
    return running.result()


# Compare the distribution of scores with the standard normal distribution.
#
# An IMM predicts a mixture of normal distributions. The score of a reading is the normal quantile of its probability
# under the mixture. It is never large, because one of the modes expects even distant readings. Therefore the test uses
# the whole distribution and not the power.

_EDGES = 0.1 * np.arange(1, 40)  # magnitudes of scores at which the distributions are compared


class ScoreCount(NamedTuple):
    """Number of scores with a magnitude below each edge, and number of all scores."""

    below: Floats = np.zeros(len(_EDGES))  # (39,)
    seen: int = 0

    def extended(self, piece: Floats) -> ScoreCount:
        """Return the count with a piece (n,) of finite values added."""
        return ScoreCount(self.below + np.searchsorted(np.sort(np.abs(piece)), _EDGES), self.seen + len(piece))

    def share(self) -> float:
        """Return the largest difference of the distributions, 0 to 1; 0.16 if all scores are 1.4 times too large."""
        from scipy.special import ndtr

        if not self.seen:
            return 0.0
        return float(np.abs(self.below / self.seen - (2 * ndtr(_EDGES) - 1)).max())
