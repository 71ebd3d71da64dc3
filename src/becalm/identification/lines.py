"""Tones in a record: found where the spectrum stands out of what a motion leaves, and tuned beside it.

A motion that follows a tone lets the noise around it through; an oscillator beside a calmer motion does
not. All parameters are fitted to the periodogram at once, whose ordinates are nearly independent and
exponentially distributed about the model's spectrum. Sources: Whittle, Ark. Mat. 2 (1953) 423; the
scoring of Fisher with the damping of Levenberg and Marquardt.
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
from becalm.identification.spectrum import BinnedPeriodogram, ToneOscillator, binned, line_power, periodogram

MOST_TONES = 5
"""Tones that are looked for."""

_CYCLES = 8  # in the record: what is slower belongs to the motion, and as near to half the rate it is mirrored
_PARTS = 8  # of the band, the quietest of which bounds the noise
_RESOLUTIONS = ((3, 15.0), (31, 3.0), (311, 1.5))  # frequencies in a row, and their mean power over what lies around
_AROUND, _APART = 13, 2  # widths on each side of a tone that lie around it, but for the nearest
_FEWEST_WIDTHS = 8  # in the band
_MOST_TRIED = 5
_GAIN = 100.0  # in log-likelihood, that a tone must bring: it adds three parameters and two states
_GAIN_NAMED = 10.0  # and one that was looked for by name
_NEAR = 0.02  # of its frequency, about which a named one is looked for, or
_NEAR_CYCLES = 4  # in the record
_CALMEST = (1, 2, 3)  # orders of the motion beside tones ...
_MOST_STATES = 12  # ... so that there are no more states in all
_HIGHEST = np.pi * (1 - 1e-9)  # radians a step
_LEAST_NOISE = 1e-3  # of the power of the quietest part of the band
_ROUNDS, _ENOUGH = 60, 0.03
_LONGEST_STEP = 1.0  # of a logarithm, and of a frequency in frequencies of the record


class SpectralPeak(NamedTuple):
    """Where a spectrum stands out."""

    angle: float  # radians a step
    width: float  # radians a step


class Fit(NamedTuple):
    """A spectrum fitted: white noise, a motion and tones."""

    order: int
    noise_variance: float
    density: float  # of the motion, unit^2/step^(2n - 1)
    lines: tuple[ToneOscillator, ...]
    cost: float  # minus the log-likelihood

    @property
    def tuning(self) -> Tuning:
        """The fit as a tuning, not judged yet."""
        return Tuning(self.order, self.density / self.noise_variance, self.noise_variance, 0, lines=self.lines)


def add_lines(tuning: Tuning, evidence: Evidence, removed: Sequence[float] = ()) -> Tuning:
    """Put tones beside a motion where the record has some; a tuning without any comes back as it is.

    Parameters
    ----------
    tuning : Tuning
        The best motion alone.
    evidence : Evidence
        What it was tuned on; of fewer than 256 readings in even time, but for short holes, the tuning stays.
    removed : sequence of float
        Angles, radians a step, near which a tone is a disturbance; a weaker one is found there.
    """
    whole = completed(evidence, tuning)
    found = _with_tones(tuning, whole, removed)
    if whole is evidence or not found.lines:
        return found
    return _with_tones(tuning, completed(evidence, found), removed)  # whose draws hold the tones


def _with_tones(tuning: Tuning, evidence: Evidence, removed: Sequence[float]) -> Tuning:
    """Put tones beside a motion by the spectrum of the longest complete stretch."""
    longest = max(evidence.even, key=lambda part: part.stop - part.start, default=slice(0))
    z = evidence.z[longest, 0]
    if len(z) < FEWEST_FOR_TONES or not np.var(z) > 0:
        return tuning
    spectrum, step = periodogram(z), evidence.mean_step(longest)
    removed = [angle * step for angle in removed]
    now = _without(removed, _plainest(tuning, spectrum), spectrum) if removed else _plain(tuning, spectrum)
    while len(now.lines) < MOST_TONES and (peaks := find_lines(spectrum, now)):
        more = [_with_line(now, peak, spectrum) for peak in peaks]
        best = max(more, key=lambda fit: _gain(now, fit, spectrum))
        if _gain(now, best, spectrum) < _GAIN:
            break
        now = best
    if not now.lines:
        return tuning
    judged = (_judged(line, removed, spectrum) for line in now.lines)
    lines = tuple(line._replace(angle=min(line.angle / step, _HIGHEST)) for line in judged)
    return replace(now.tuning, count=tuning.count, lines=lines)


def find_lines(spectrum: BinnedPeriodogram, fit: Fit) -> list[SpectralPeak]:
    """Find what stands out of what a fit leaves.

    Parameters
    ----------
    spectrum : BinnedPeriodogram
        Every frequency for itself, as `periodogram` gives it; powers in unit^2.
    fit : Fit
        What is there already.

    Returns
    -------
    list of SpectralPeak
        Of each resolution, the finest first, where it stands out most, if it does; none twice.
    """
    left, found = spectrum.power / _power(fit, spectrum.angle), list[SpectralPeak]()
    for how in _RESOLUTIONS:
        peak = _peak(left, spectrum, *how)
        if peak is not None and not any(abs(peak.angle - one.angle) <= peak.width for one in found):
            found.append(peak)
    return found


def _peak(left: Floats, spectrum: BinnedPeriodogram, width: int, stands_out: float) -> SpectralPeak | None:
    """Return the frequency whose neighbourhood of some width stands out of what lies around it."""
    if len(left) < _FEWEST_WIDTHS * width:
        return None
    raised = np.convolve(left, np.full(width, 1 / width), mode="same")  # at the ends, where it is less, is no tone
    spacing = float(spectrum.angle[1] - spectrum.angle[0])
    raised[np.minimum(spectrum.angle, np.pi - spectrum.angle) < max(_CYCLES, width) * spacing] = 0.0
    reach, apart = _AROUND * width, _APART * width
    highest = np.argpartition(raised, -_MOST_TRIED)[-_MOST_TRIED:]
    for place in highest[np.argsort(raised[highest])[::-1]].tolist():
        around = np.concatenate(
            [left[max(0, place - reach) : max(0, place - apart)], left[place + apart + 1 : place + reach + 1]]
        )
        if raised[place] > stands_out * max(1.0, float(np.median(around)) / np.log(2)):
            return SpectralPeak(float(spectrum.angle[place]), width * spacing)
    return None


def _without(removed: Sequence[float], now: Fit, spectrum: BinnedPeriodogram) -> Fit:
    """Fit the tones that were named, where there is something."""
    for angle in removed:
        more = _with_line(now, SpectralPeak(angle, float(spectrum.angle[1] - spectrum.angle[0])), spectrum)
        if _gain(now, more, spectrum) > _GAIN_NAMED and _judged(more.lines[-1], (angle,), spectrum).disturbance:
            now = more
    return now


def _judged(line: ToneOscillator, removed: Sequence[float], spectrum: BinnedPeriodogram) -> ToneOscillator:
    """Say whether a tone is one of those that are to be taken off."""
    spacing = float(spectrum.angle[1] - spectrum.angle[0])
    near = any(abs(line.angle - angle) <= max(_NEAR * angle, 2 * _NEAR_CYCLES * spacing) for angle in removed)
    return line._replace(disturbance=near)


def quietest(spectrum: BinnedPeriodogram) -> float:
    """Return the mean power, unit^2, of the quietest part of the band: white noise is no louder."""
    return min(float(part.mean()) for part in np.array_split(spectrum.power, _PARTS))


def fit_spectrum(start: Fit, spectrum: BinnedPeriodogram) -> Fit:
    """Fit white noise, a motion and tones to a spectrum.

    Parameters
    ----------
    start : Fit
        Where the search begins; its order and the number of its tones stay.
    spectrum : BinnedPeriodogram
        Powers in unit^2, in bins or singly.

    Returns
    -------
    Fit
        The likeliest that was reached, with its cost.
    """
    motion = motion_power(start.order, spectrum.angle)
    spacing = 2 * np.pi / (2 * float(spectrum.weight.sum()))
    least = _LEAST_NOISE * quietest(spectrum)
    now, cost, damping = start, _whittle(start, spectrum, motion), 1e-2
    for _ in range(_ROUNDS):
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
        if gained < _ENOUGH:
            break
    return now._replace(cost=cost)


def _plain(tuning: Tuning, spectrum: BinnedPeriodogram) -> Fit:
    """Fit a motion alone, from where its tuning is."""
    start = Fit(tuning.order, tuning.noise_variance, tuning.ratio * tuning.noise_variance, (), 0.0)
    return fit_spectrum(start, binned(spectrum, ()))


def _plainest(tuning: Tuning, spectrum: BinnedPeriodogram) -> Fit:
    """Fit a motion alone, of the order that serves best, so that a tone is not paid for what another order does."""
    cutoff = ratio_to_cutoff(tuning.order, tuning.ratio)
    alike = [replace(tuning, order=order, ratio=cutoff_to_ratio(order, cutoff)) for order in {tuning.order, *_CALMEST}]
    return min((_plain(one, spectrum) for one in alike), key=lambda fit: fit.cost)


def _with_line(now: Fit, peak: SpectralPeak, spectrum: BinnedPeriodogram) -> Fit:
    """Fit one tone more, beside a motion of the calmest order that serves."""
    angle, width = peak
    at = int(np.argmin(np.abs(spectrum.angle - angle)))
    noise, fits = max(now.noise_variance, quietest(spectrum)), []
    for damping in (width, 10 * width):
        new = ToneOscillator(angle, damping, float(spectrum.power[at]) * damping**2)
        bins = binned(spectrum, (*now.lines, new))
        for order in [n for n in _CALMEST if n + 2 * (len(now.lines) + 1) <= _MOST_STATES]:
            cutoff = ratio_to_cutoff(now.order, now.density / noise)
            density = noise * cutoff_to_ratio(order, min(cutoff, angle / 2))
            fits.append(fit_spectrum(Fit(order, noise, density, (*now.lines, new), 0.0), bins))
    return min(fits, key=lambda fit: fit.cost)


def _gain(now: Fit, more: Fit, spectrum: BinnedPeriodogram) -> float:
    """Return what a fit with a tone more gains in log-likelihood, over its own bins."""
    bins = binned(spectrum, more.lines)
    return _whittle(now, bins, motion_power(now.order, bins.angle)) - more.cost


def _power(fit: Fit, angle: Floats) -> Floats:
    return _sum(fit, angle, motion_power(fit.order, angle))


def _sum(fit: Fit, angle: Floats, motion: Floats) -> Floats:
    """Return the power (k,), unit^2, of a fit.

    As `excess.powers` has it of a tuning, signal and noise apart; but a fit is moved hundreds of times at the same
    angles, of which the motion's power, the dearest part, is found once.
    """
    return sum((line_power(line, angle) for line in fit.lines), fit.noise_variance + fit.density * motion)


def _whittle(fit: Fit, spectrum: BinnedPeriodogram, motion: Floats) -> float:
    """Return minus the log-likelihood of a spectrum, but for a constant."""
    modelled = _sum(fit, spectrum.angle, motion)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        cost = float(spectrum.weight @ (np.log(modelled) + spectrum.power / modelled))
    return cost if np.isfinite(cost) else np.inf


def _slopes(fit: Fit, spectrum: BinnedPeriodogram, motion: Floats, spacing: float) -> tuple[Floats, Floats]:
    """Return how the logarithm of the modelled power changes with each parameter (p, k), and that power (k,)."""
    modelled = _sum(fit, spectrum.angle, motion)
    rows = [np.full_like(modelled, fit.noise_variance), fit.density * motion]
    for line in fit.lines:
        rows.append(line_power(line, spectrum.angle))
        for i in (0, 1):
            step = np.eye(2)[i] * 1e-3
            ahead, behind = (line_power(_turned(line, sign * step, spacing), spectrum.angle) for sign in (1, -1))
            rows.append((ahead - behind) / 2e-3)
    return np.array(rows) / modelled, modelled


def _moved(fit: Fit, step: Floats, spacing: float, least: float) -> Fit:
    """Take a step; white noise is at least so much, for less cannot be told from none."""
    lines = []
    for k, line in enumerate(fit.lines):
        own = step[2 + 3 * k : 5 + 3 * k]
        lines.append(_turned(line._replace(density=line.density * float(np.exp(own[0]))), own[1:], spacing))
    r, density = max(fit.noise_variance * float(np.exp(step[0])), least), fit.density * float(np.exp(step[1]))
    return fit._replace(noise_variance=r, density=density, lines=tuple(lines))


def _turned(line: ToneOscillator, step: Floats, spacing: float) -> ToneOscillator:
    """Move a tone by fractions of a frequency, and of the logarithm of its damping, within what can be told a tone."""
    angle = float(np.clip(line.angle + float(step[0]) * spacing, spacing, np.pi - spacing))
    damping = float(np.clip(line.damping * float(np.exp(step[1])), 0.1 * spacing, angle))
    return line._replace(angle=angle, damping=damping)
