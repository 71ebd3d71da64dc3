"""Tones in a record: found where the spectrum stands out of what a motion leaves, and tuned beside it.

A motion that follows a tone lets the noise around it through; an oscillator beside a calmer motion does
not. All parameters are fitted to the periodogram at once, whose ordinates are nearly independent and
exponentially distributed about the model's spectrum. Sources: Whittle, Ark. Mat. 2 (1953) 423; the
scoring of Fisher with the damping of Levenberg and Marquardt.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.noise.cross_validation import criterion
from becalm.noise.likelihood import Evidence, Tuning
from becalm.noise.spectrum import Line, Spectrum, gathered, line_power, motion_power, periodogram

MOST = 5
"""Tones that are looked for."""

FEWEST = 2048
"""Readings in even time, none missing, that tones are looked for in."""

_CYCLES = 8  # in the record: what is slower belongs to the motion, and as near to half the rate it is mirrored
_PARTS = 8  # of the band, the quietest of which bounds the noise
_STANDS_OUT = 15.0  # mean power of three frequencies over what lies around them
_AROUND, _APART = 40, 5  # frequencies on each side of a tone that lie around it, but for the nearest
_GAIN = 100.0  # in log-likelihood, that a tone must bring: it adds three parameters and two states
_BEYOND = 10.0  # in log-likelihood, by which the tones' loss must be the lesser
_CALMEST = (1, 2, 3)  # orders of the motion beside tones ...
_MOST_STATES = 12  # ... so that there are no more states in all
_ROUNDS, _ENOUGH = 60, 1e-3
_LONGEST_STEP = 1.0  # of a logarithm, and of a frequency in frequencies of the record


class Fit(NamedTuple):
    """A spectrum fitted: white noise, a motion and tones."""

    order: int
    noise_variance: float
    density: float  # of the motion, unit^2/step^(2n - 1)
    lines: tuple[Line, ...]
    cost: float  # minus the log-likelihood

    @property
    def tuning(self) -> Tuning:
        """The fit as a tuning, not judged yet."""
        return Tuning(self.order, self.density / self.noise_variance, self.noise_variance, 0, lines=self.lines)


def add_lines(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Put tones beside a motion where the record has some; a tuning without any comes back as it is.

    Parameters
    ----------
    tuning : Tuning
        The best motion alone.
    evidence : Evidence
        What it was tuned on; of fewer than 2048 readings in even time the tuning stays.
    """
    longest = max(evidence.complete, key=lambda part: part.stop - part.start, default=slice(0))
    z = evidence.z[longest, 0]
    if len(z) < FEWEST or not np.var(z) > 0:
        return tuning
    spectrum = periodogram(z)
    now = _plain(tuning, spectrum)
    while len(now.lines) < MOST and (angle := find_line(spectrum, now)) is not None:
        more = _with_line(now, angle, spectrum)
        if more.cost > _cost_among(now, more, spectrum) - _GAIN:
            break
        now = more
    if not now.lines:
        return tuning
    gained = len(z) / 2 * (smoother_loss(tuning, spectrum, len(z)) - smoother_loss(now.tuning, spectrum, len(z)))
    return replace(now.tuning, count=tuning.count) if gained > _BEYOND else tuning


def find_line(spectrum: Spectrum, fit: Fit) -> float | None:
    """Return the frequency, radians a step, that stands out most of what a fit leaves; None where none does."""
    left = spectrum.power / _power(fit, spectrum.angle)
    raised = np.convolve(left, np.ones(3) / 3, "same")
    spacing = spectrum.angle[1] - spectrum.angle[0]
    raised[np.minimum(spectrum.angle, np.pi - spectrum.angle) < _CYCLES * spacing] = 0.0
    for place in np.argsort(raised)[:-6:-1].tolist():
        around = left[max(0, place - _AROUND) : place + _AROUND + 1].copy()
        centre = min(place, _AROUND)
        around = np.delete(around, slice(max(0, centre - _APART), centre + _APART + 1))
        if raised[place] > _STANDS_OUT * max(1.0, float(np.median(around))):
            return float(spectrum.angle[place])
    return None


def quietest(spectrum: Spectrum) -> float:
    """Return the mean power, unit^2, of the quietest part of the band: white noise is no louder."""
    return min(float(part.mean()) for part in np.array_split(spectrum.power, _PARTS))


def smoother_loss(tuning: Tuning, spectrum: Spectrum, readings: int) -> float:
    """Return the cross-validated loss of a tuning's smoother, read off a spectrum."""
    r = tuning.noise_variance
    fit = Fit(tuning.order, r, tuning.ratio * r, tuning.lines, 0.0)
    lost = r / _power(fit, spectrum.angle)
    total = float(spectrum.weight.sum())
    squares = float(spectrum.weight @ (lost**2 * spectrum.power)) / total
    return criterion(squares, 1 - float(spectrum.weight @ lost) / total, readings)


def fit_spectrum(start: Fit, spectrum: Spectrum) -> Fit:
    """Fit white noise, a motion and tones to a spectrum, from where they are."""
    motion = motion_power(start.order, spectrum.angle)
    spacing = 2 * np.pi / (2 * float(spectrum.weight.sum()))
    now, cost, damping = start, _whittle(start, spectrum, motion), 1e-2
    for _ in range(_ROUNDS):
        slopes, modelled = _slopes(now, spectrum, motion, spacing)
        curvature = (slopes * spectrum.weight) @ slopes.T
        uphill = (slopes * spectrum.weight) @ (spectrum.power / modelled - 1)
        step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature) + 1e-12), uphill)
        step = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        moved = _moved(now, step, spacing)
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


def _plain(tuning: Tuning, spectrum: Spectrum) -> Fit:
    """Fit a motion alone, from where its tuning is."""
    start = Fit(tuning.order, tuning.noise_variance, tuning.ratio * tuning.noise_variance, (), 0.0)
    return fit_spectrum(start, gathered(spectrum, ()))


def _with_line(now: Fit, angle: float, spectrum: Spectrum) -> Fit:
    """Fit one tone more, beside a motion of the calmest order that serves."""
    spacing = spectrum.angle[1] - spectrum.angle[0]
    at = int(np.argmin(np.abs(spectrum.angle - angle)))
    noise, fits = max(now.noise_variance, quietest(spectrum)), []
    for width in (1.0, 30.0):
        damping = width * spacing
        new = Line(angle, damping, float(spectrum.power[at]) * damping**2)
        binned = gathered(spectrum, (*now.lines, new))
        for order in [n for n in _CALMEST if n + 2 * (len(now.lines) + 1) <= _MOST_STATES]:
            cutoff = (now.density / noise) ** (1 / (2 * now.order))
            density = noise * min(cutoff, angle / 2) ** (2 * order)
            fits.append(fit_spectrum(Fit(order, noise, density, (*now.lines, new), 0.0), binned))
    return min(fits, key=lambda fit: fit.cost)


def _cost_among(now: Fit, more: Fit, spectrum: Spectrum) -> float:
    """Return the cost of a fit over the bins of one that has a tone more."""
    binned = gathered(spectrum, more.lines)
    return _whittle(now, binned, motion_power(now.order, binned.angle))


def _power(fit: Fit, angle: Floats) -> Floats:
    return _sum(fit, angle, motion_power(fit.order, angle))


def _sum(fit: Fit, angle: Floats, motion: Floats) -> Floats:
    return sum((line_power(line, angle) for line in fit.lines), fit.noise_variance + fit.density * motion)


def _whittle(fit: Fit, spectrum: Spectrum, motion: Floats) -> float:
    """Return minus the log-likelihood of a spectrum, but for a constant."""
    modelled = _sum(fit, spectrum.angle, motion)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        cost = float(spectrum.weight @ (np.log(modelled) + spectrum.power / modelled))
    return cost if np.isfinite(cost) else np.inf


def _slopes(fit: Fit, spectrum: Spectrum, motion: Floats, spacing: float) -> tuple[Floats, Floats]:
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


def _moved(fit: Fit, step: Floats, spacing: float) -> Fit:
    lines = []
    for k, line in enumerate(fit.lines):
        own = step[2 + 3 * k : 5 + 3 * k]
        lines.append(_turned(line._replace(density=line.density * float(np.exp(own[0]))), own[1:], spacing))
    r, density = fit.noise_variance * float(np.exp(step[0])), fit.density * float(np.exp(step[1]))
    return fit._replace(noise_variance=r, density=density, lines=tuple(lines))


def _turned(line: Line, step: Floats, spacing: float) -> Line:
    """Move a tone by fractions of a frequency, and of the logarithm of its damping; never narrower than can be told."""
    damping = max(line.damping * float(np.exp(step[1])), 0.1 * spacing)
    return line._replace(angle=line.angle + float(step[0]) * spacing, damping=damping)
