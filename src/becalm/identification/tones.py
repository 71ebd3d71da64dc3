"""Find tones in a record, where its spectrum exceeds that of the motion model, and tune them with the motion.

A motion model that is fast enough to follow a tone passes much noise; a slower motion plus an oscillator does not. All
parameters are fitted at once to the periodogram, by Fisher scoring with Levenberg-Marquardt damping. The ordinates are
treated as independent, although a Hann window correlates neighbours by 0.44, and as exponentially distributed about the
model's spectrum. Source: Whittle, Ark. Mat. 2 (1953) 423.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, motion_power, ratio_to_cutoff
from becalm.identification.imputation import completed
from becalm.identification.likelihood import FEWEST_FOR_TONES, Evidence, Tuning
from becalm.identification.spectrum import BinnedPeriodogram, ToneOscillator, binned, periodogram, tone_power

MOST_TONES = 5
"""Largest number of tones in a model."""

_CYCLES = 8  # least frequency of a tone, and least distance from half the rate, in cycles per record
_PARTS = 8  # parts of the band; the part with the least power bounds the noise
_RESOLUTIONS = ((3, 15.0), (31, 3.0), (311, 1.5))  # width in bins; least ratio of its mean power to its surroundings
_AROUND, _APART = 13, 2  # surroundings: on each side, from 2 to 13 widths away
_FEWEST_WIDTHS = 8  # least width of the band, in widths of a peak
_MOST_CANDIDATES = 5  # bins with the highest power, per resolution
_GAIN = 100.0  # least gain in log-likelihood of a tone: it adds three parameters and two states
_GAIN_NAMED = 10.0  # least gain in log-likelihood of a tone whose frequency was given
_NEAR = 0.02  # a tone is near a given frequency if it differs by no more than this share of it, ...
_NEAR_CYCLES = 4  # ... or by no more than twice this number of cycles per record
_ORDERS = (1, 2, 3)  # of a motion with tones ...
_MOST_STATES = 12  # ... and most states of both together
_HIGHEST = np.pi * (1 - 1e-9)  # radians a step
_LEAST_NOISE = 1e-3  # least noise variance, as a share of the least power of a part of the band
_MOST_ITERATIONS, _LEAST_GAIN = 60, 0.03  # a smaller gain in log-likelihood ends the iterations
_LONGEST_STEP = 1.0  # longest step of the logarithm of a parameter, and of a frequency in spacings of the spectrum


class SpectralPeak(NamedTuple):
    """A peak of a spectrum."""

    angle: float  # frequency, radians a step
    width: float  # radians a step


class Fit(NamedTuple):
    """A fitted spectrum: white noise, a motion and tones."""

    order: int
    noise_variance: float
    density: float  # of the motion, unit^2/step^(2n - 1)
    tones: tuple[ToneOscillator, ...]
    cost: float  # minus the Whittle log-likelihood over the bins of this fit, up to a constant

    @property
    def tuning(self) -> Tuning:
        """Return the fit as a tuning, whose `count` of scored readings is 0."""
        return Tuning(self.order, self.density / self.noise_variance, self.noise_variance, 0, tones=self.tones)


def add_tones(tuning: Tuning, evidence: Evidence, removed: Sequence[float] = ()) -> Tuning:
    """Add the tones of a record to a motion model; a record without tones leaves the tuning unchanged.

    Parameters
    ----------
    tuning : Tuning
        The best motion model without tones.
    evidence : Evidence
        The readings it was tuned on; the tuning stays unchanged if fewer than 256 are evenly sampled, apart from short
        holes.
    removed : sequence of float
        Angles in radians per step near which a tone is a disturbance; weaker tones are accepted there.
    """
    whole = completed(evidence, tuning)
    toned = _with_tones(tuning, whole, removed)
    if whole is evidence or not toned.tones:
        return toned
    return _with_tones(tuning, completed(evidence, toned), removed)  # now the draws in holes contain the tones


def _with_tones(tuning: Tuning, evidence: Evidence, removed: Sequence[float]) -> Tuning:
    """Add tones to a motion model by the spectrum of the longest complete stretch."""
    longest = max(evidence.even, key=lambda part: part.stop - part.start, default=slice(0))
    z = evidence.z[longest, 0]
    if len(z) < FEWEST_FOR_TONES or not np.var(z) > 0:
        return tuning
    spectrum, step = periodogram(z), evidence.mean_step(longest)
    angles = [angle * step for angle in removed]
    if angles:
        now = _fit_disturbances(angles, _fit_best_order(tuning, spectrum), spectrum)
    else:
        now = _fit_motion(tuning, spectrum)
    while len(now.tones) < MOST_TONES and (peaks := find_peaks(spectrum, now)):
        more = [_with_tone(now, peak, spectrum) for peak in peaks]
        best = max(more, key=lambda fit: _gain(now, fit, spectrum))
        if _gain(now, best, spectrum) < _GAIN:
            break
        now = best
    if not now.tones:
        return tuning
    named = (tone._replace(disturbance=_is_near(tone, angles, spectrum)) for tone in now.tones)
    tones = tuple(tone._replace(angle=min(tone.angle / step, _HIGHEST)) for tone in named)
    return replace(now.tuning, count=tuning.count, tones=tones)


def find_peaks(spectrum: BinnedPeriodogram, fit: Fit) -> list[SpectralPeak]:
    """Find the peaks of a spectrum relative to the spectrum of a fit.

    Parameters
    ----------
    spectrum : BinnedPeriodogram
        The spectrum with one frequency per bin, as `periodogram` returns it; powers in unit^2.
    fit : Fit
        The model so far.

    Returns
    -------
    list of SpectralPeak
        At most one peak per resolution, the finest resolution first, without repetitions.
    """
    excess, peaks = spectrum.power / _power(fit, spectrum.angle), list[SpectralPeak]()
    for how in _RESOLUTIONS:
        peak = _peak(excess, spectrum, *how)
        if peak is not None and not any(abs(peak.angle - one.angle) <= peak.width for one in peaks):
            peaks.append(peak)
    return peaks


def _peak(excess: Floats, spectrum: BinnedPeriodogram, width: int, least_ratio: float) -> SpectralPeak | None:
    """Return the highest peak of the mean over `width` bins that exceeds its surroundings; None if none does."""
    if len(excess) < _FEWEST_WIDTHS * width:
        return None
    raised = np.convolve(excess, np.full(width, 1 / width), mode="same")  # too small at both ends
    spacing = float(spectrum.angle[1] - spectrum.angle[0])
    raised[np.minimum(spectrum.angle, np.pi - spectrum.angle) < max(_CYCLES, width) * spacing] = 0.0
    reach, apart = _AROUND * width, _APART * width
    highest = np.argpartition(raised, -_MOST_CANDIDATES)[-_MOST_CANDIDATES:]
    for place in highest[np.argsort(raised[highest])[::-1]].tolist():
        around = np.concatenate(
            [excess[max(0, place - reach) : max(0, place - apart)], excess[place + apart + 1 : place + reach + 1]]
        )
        background = float(np.median(around)) / np.log(2)  # of exponential noise, the median is log 2 times the mean
        if raised[place] > least_ratio * max(1.0, background):
            return SpectralPeak(float(spectrum.angle[place]), width * spacing)
    return None


def _fit_disturbances(removed: Sequence[float], now: Fit, spectrum: BinnedPeriodogram) -> Fit:
    """Fit a tone at each given angle; keep it if the log-likelihood gains enough and the fitted angle is near."""
    for angle in removed:
        more = _with_tone(now, SpectralPeak(angle, float(spectrum.angle[1] - spectrum.angle[0])), spectrum)
        if _gain(now, more, spectrum) > _GAIN_NAMED and _is_near(more.tones[-1], (angle,), spectrum):
            now = more
    return now


def _is_near(tone: ToneOscillator, angles: Sequence[float], spectrum: BinnedPeriodogram) -> bool:
    """Return whether a tone is near one of the angles."""
    spacing = float(spectrum.angle[1] - spectrum.angle[0])
    return any(abs(tone.angle - angle) <= max(_NEAR * angle, 2 * _NEAR_CYCLES * spacing) for angle in angles)


def least_band_power(spectrum: BinnedPeriodogram) -> float:
    """Return the least mean power, unit^2, of an eighth of the bins, an upper bound of the white noise."""
    return min(float(part.mean()) for part in np.array_split(spectrum.power, _PARTS))


def fit_spectrum(start: Fit, spectrum: BinnedPeriodogram) -> Fit:
    """Fit white noise, a motion and tones to a spectrum.

    Parameters
    ----------
    start : Fit
        The starting point; its order and its number of tones do not change.
    spectrum : BinnedPeriodogram
        The spectrum, binned or not; powers in unit^2.

    Returns
    -------
    Fit
        The likeliest fit that was reached, with its cost.
    """
    motion = motion_power(start.order, spectrum.angle)
    spacing = np.pi / float(spectrum.weight.sum())  # radians per step between frequencies
    least = _LEAST_NOISE * least_band_power(spectrum)
    now, cost, damping = start, _whittle(start, spectrum, motion), 1e-2
    for _ in range(_MOST_ITERATIONS):
        slopes, modelled = _slopes(now, spectrum, motion, spacing)
        curvature = (slopes * spectrum.weight) @ slopes.T
        uphill = (slopes * spectrum.weight) @ (spectrum.power / modelled - 1)
        step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature) + 1e-12), uphill)
        step = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        moved = _moved(now, step, spacing, least)
        new = _whittle(moved, spectrum, motion)
        if not new < cost:
            damping *= 10
            if damping > 1e8:  # no step helps any more
                break
            continue
        gained, now, cost, damping = cost - new, moved, new, max(damping / 5, 1e-6)
        if gained < _LEAST_GAIN:
            break
    return now._replace(cost=cost)


def _fit_motion(tuning: Tuning, spectrum: BinnedPeriodogram) -> Fit:
    """Fit a motion without tones, starting from its tuning."""
    start = Fit(tuning.order, tuning.noise_variance, tuning.ratio * tuning.noise_variance, (), 0.0)
    return fit_spectrum(start, binned(spectrum, ()))


def _fit_best_order(tuning: Tuning, spectrum: BinnedPeriodogram) -> Fit:
    """Fit a motion of the best order; with a wrong order, a tone would be fitted to the difference."""
    cutoff = ratio_to_cutoff(tuning.order, tuning.ratio)
    tunings = [replace(tuning, order=order, ratio=cutoff_to_ratio(order, cutoff)) for order in {tuning.order, *_ORDERS}]
    return min((_fit_motion(one, spectrum) for one in tunings), key=lambda fit: fit.cost)


def _with_tone(now: Fit, peak: SpectralPeak, spectrum: BinnedPeriodogram) -> Fit:
    """Fit one more tone, with a motion of the order that fits best."""
    angle, width = peak
    at = int(np.argmin(np.abs(spectrum.angle - angle)))
    noise, fits = max(now.noise_variance, least_band_power(spectrum)), []
    for damping in (width, 10 * width):
        new = ToneOscillator(angle, damping, float(spectrum.power[at]) * damping**2)
        bins = binned(spectrum, (*now.tones, new))
        for order in [n for n in _ORDERS if n + 2 * (len(now.tones) + 1) <= _MOST_STATES]:
            cutoff = ratio_to_cutoff(now.order, now.density / noise)
            density = noise * cutoff_to_ratio(order, min(cutoff, angle / 2))
            fits.append(fit_spectrum(Fit(order, noise, density, (*now.tones, new), 0.0), bins))
    return min(fits, key=lambda fit: fit.cost)


def _gain(now: Fit, more: Fit, spectrum: BinnedPeriodogram) -> float:
    """Return the gain in log-likelihood of a fit with one more tone, over bins around its tones."""
    bins = binned(spectrum, more.tones)
    return _whittle(now, bins, motion_power(now.order, bins.angle)) - more.cost


def _power(fit: Fit, angle: Floats) -> Floats:
    return _power_given_motion(fit, angle, motion_power(fit.order, angle))


def _power_given_motion(fit: Fit, angle: Floats, motion: Floats) -> Floats:
    """Return the power (k,), unit^2, of a fit.

    `tuning_spread.powers` computes the same for a tuning, with signal and noise apart. Here a fit changes hundreds of
    times at the same angles, so the motion's power, the most expensive part, is computed once by the caller.
    """
    return sum((tone_power(tone, angle) for tone in fit.tones), fit.noise_variance + fit.density * motion)


def _whittle(fit: Fit, spectrum: BinnedPeriodogram, motion: Floats) -> float:
    """Return minus the log-likelihood of a spectrum, up to a constant."""
    modelled = _power_given_motion(fit, spectrum.angle, motion)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        cost = float(spectrum.weight @ (np.log(modelled) + spectrum.power / modelled))
    return cost if np.isfinite(cost) else np.inf


def _slopes(fit: Fit, spectrum: BinnedPeriodogram, motion: Floats, spacing: float) -> tuple[Floats, Floats]:
    """Return the derivatives (p, k) of the log power of the model by its parameters, and that power (k,)."""
    modelled = _power_given_motion(fit, spectrum.angle, motion)
    rows = [np.full_like(modelled, fit.noise_variance), fit.density * motion]
    for tone in fit.tones:
        rows.append(tone_power(tone, spectrum.angle))
        for i in (0, 1):
            step = np.eye(2)[i] * 1e-3
            ahead, behind = (tone_power(_moved_tone(tone, sign * step, spacing), spectrum.angle) for sign in (1, -1))
            rows.append((ahead - behind) / 2e-3)
    return np.array(rows) / modelled, modelled


def _moved(fit: Fit, step: Floats, spacing: float, least: float) -> Fit:
    """Return the fit after a step; its noise variance is at least `least`, hardly distinguishable from 0."""
    tones = []
    for k, tone in enumerate(fit.tones):
        own = step[2 + 3 * k : 5 + 3 * k]
        tones.append(_moved_tone(tone._replace(density=tone.density * float(np.exp(own[0]))), own[1:], spacing))
    r, density = max(fit.noise_variance * float(np.exp(step[0])), least), fit.density * float(np.exp(step[1]))
    return fit._replace(noise_variance=r, density=density, tones=tuple(tones))


def _moved_tone(tone: ToneOscillator, step: Floats, spacing: float) -> ToneOscillator:
    """Move a tone's frequency by `step[0]` spacings and its log damping by `step[1]`, within the range of tones."""
    angle = float(np.clip(tone.angle + float(step[0]) * spacing, spacing, np.pi - spacing))
    damping = float(np.clip(tone.damping * float(np.exp(step[1])), 0.1 * spacing, angle))
    return tone._replace(angle=angle, damping=damping)
