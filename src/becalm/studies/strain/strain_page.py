"""Write the page of the strain study; every number on it comes from the study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from becalm.files.atomic_file import make_folder, write_text
from becalm.studies.sheets import NOT_DRAWN, draw
from becalm.studies.strain.strain import NOISES, RUNS, SHOWN, SLOPE, StrainStudy, study
from becalm.studies.strain.strain_figures import sheets
from becalm.studies.strain.strain_gauge import CUTOFF_HZ, DRIFT_S, Gauge, Trial
from becalm.studies.strain.strain_methods import (
    AVERAGE,
    BECALM,
    BUTTERWORTH,
    G_BY_TRIAL,
    KALMAN,
    KALMAN_FLAT,
    LIKELIEST,
    LIKELIEST_G,
    SMOOTHED,
)

REFERENCE_RUNS = 20  # number of runs over which the errors in `REFERENCE` are averaged
REFERENCE = {
    KALMAN: (0.0089, 0.0184, 0.0309),
    BUTTERWORTH: (0.0433, 0.0453, 0.0494),
    AVERAGE: (0.1455, 0.146, 0.1465),
}
"""Rms errors at each noise from an earlier simulation with the paper's equations; the paper itself prints none."""


def page(study: StrainStudy, drawn: Mapping[str, str]) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    study : StrainStudy
        Results of the study.
    drawn : mapping of str to str
        Title and file name of each figure, in order; empty if there are none.
    """
    parts = [
        "# Quasi-static strain, re-run",
        _simulation(),
        _errors(study),
        _lags(study),
        _settings(study),
        _gauge(study.gauge) if study.gauge else f"## A real gauge\n\n{study.why_no_gauge}",
        _figures(drawn),
    ]
    return "\n\n".join(parts) + "\n"


def _simulation() -> str:
    return f"""\
The strain paper filters slow strain by a Kalman filter: the third derivative of the strain is constant between two
readings and random, with variance G; the noise of a reading has variance R. R is measured beforehand, G found by trial
and error. Its simulation is repeated here: 10 readings a second for 100 s; strain is zero, rises from 20 to 40 s from
0 to 1, stays, falls from 60 to 80 s to zero ({SLOPE:g} a second); white noise is added. {RUNS} records of each noise,
with fixed seeds.

Then G, and also R, are estimated from the readings: G by likelihood with R given; G and R both by likelihood; and
becalm's own choice, which has no settings at all, not even the model."""


def _errors(study: StrainStudy) -> str:
    head = [f"noise {noise:g}" for noise in NOISES]
    rows = []
    for name, found in study.quality.items():
        rows.append([name, *(f"{found[noise].rms:.4f} ± {found[noise].rms_error:.4f}" for noise in NOISES)])
        if name in REFERENCE:
            rows.append(["  an earlier re-run", *(f"{value:.4f}" for value in REFERENCE[name])])
    return f"""\
## Errors

Rms error, mean of the runs and its standard error.

{_table(["filter", *head], rows)}

"An earlier re-run" used the same equations with other noise; mean of {REFERENCE_RUNS} runs.

{_verdict(study)} {_start(study)}"""


def _verdict(study: StrainStudy) -> str:
    own = [study.quality[BECALM][noise].rms for noise in NOISES]
    limits = REFERENCE[KALMAN]
    kept = all(got <= limit for got, limit in zip(own, limits, strict=True))
    return (
        f"becalm's causal filter, without settings, errs by {_listed(own)};"
        f" that is {'' if kept else 'not '}within {_listed(limits)}, those of the paper's filter with G and R given."
    )


def _start(study: StrainStudy) -> str:
    flat = [study.quality[KALMAN_FLAT][noise].rms for noise in NOISES]
    from_zero = [study.quality[KALMAN][noise].rms for noise in NOISES]
    return (
        f"The paper does not print a start. A filter with a known start at zero errs by {_listed(from_zero)}; one"
        f" that starts from the first readings alone, as becalm's does, by {_listed(flat)}. The known start has P0 = R,"
        " because it is nearer to the earlier re-run than P0 = 0 and P0 = 1."
    )


def _lags(study: StrainStudy) -> str:
    rows = []
    for name, found in study.quality.items():
        m = found[SHOWN]
        rows.append([name, f"{m.noise_share:.0%}", _lag(m.ramp_lag_s), _lag(m.record_lag_s), f"{m.overshoot:.1%}"])
    head = ["filter", "noise's share of the error", "lag on the ramp, s", "lag over the record, s", "overshoot"]
    butterworth, average = study.quality[BUTTERWORTH][SHOWN], study.quality[AVERAGE][SHOWN]
    return f"""\
## Lag and overshoot, at noise {SHOWN:g}

The first column is the share of the mean square error that differs from run to run; the rest, lag and overshoot, is the
same in all. The other columns are for the signal without noise: the lag of the output at the end of the ramps; the
delay at which it differs least from the signal over the whole record; and by how much it exceeds 0 and 1.

{_table(head, rows)}

The Butterworth filter lags by {butterworth.ramp_lag_s:.2f} s and the average by {average.ramp_lag_s:.2f} s: as the
paper says, their errors are mostly delay, so that less noise hardly helps them. A Kalman filter with a slope in its
state has no lag on a ramp; it errs at the corners, where the model is wrong for a moment."""


def _settings(study: StrainStudy) -> str:
    rows = []
    for noise in NOISES:
        g, found, own = (study.quality[name][noise].identified for name in (LIKELIEST_G, LIKELIEST, BECALM))
        rows.append(
            [f"{noise:g}", f"{g[0]:.2g}", f"{found[0]:.2g}", f"{found[1]:.4f}", f"{own[1]:.4f}", f"{own[2]:.0f}"]
        )
    head = ["noise", "G, R given", "G, both estimated", "noise estimated with it", "noise by becalm", "order by becalm"]
    smoothed, both, flat = (
        [study.quality[name][noise].rms for noise in NOISES] for name in (SMOOTHED, LIKELIEST, KALMAN_FLAT)
    )
    return f"""\
## Identified settings

Medians over the records, to compare with G = {G_BY_TRIAL:g} by trial.

{_table(head, rows)}

With both estimated, the paper's filter errs by {_listed(both)}; with G by trial, R given and the same start, by
{_listed(flat)}. The paper's model is of order 3, for curved strain; becalm chooses
the order too. Its smoother, which uses the whole record, errs by {_listed(smoothed)}."""


def _gauge(gauge: Gauge) -> str:
    rest, unit = gauge.rest, gauge.unit
    length_s, duration_s = rest.end_s - rest.begin_s, len(gauge.readings) / gauge.rate_hz
    rows = [[name, *_trial(trial)] for name, trial in gauge.trials.items()]
    head = ["filter", "G", "noise, std", "residual, std", f"residual, {DRIFT_S:g} s mean", "NIS", "predictable", "fits"]
    says = "\n".join(f"- {name}: {trial.judgement.says}" for name, trial in gauge.trials.items())
    return f"""\
## A real gauge on a bridge

{duration_s:.0f} s at {gauge.rate_hz:.0f} Hz in {unit}, while the supports are moved. R is measured beforehand, as in
the paper: in the longest quiet stretch of another record, {rest.begin_s:.0f} to {rest.end_s:.0f} s
({length_s:.0f} s). Readings there have a standard deviation of {rest.std:.3f} {unit}; but {rest.moved_share:.0%} of
their power is drift, slower than {CUTOFF_HZ:g} Hz ({rest.drift_std:.3f} {unit}), and {rest.noise_std:.3f} {unit} is
left above. R from the total power contains the noise and the drift of a quiet bridge, and is too large.

{_table(head, rows)}

Standard deviations in {unit}, G in ({unit})²/s⁶. The residual is reading minus output; its largest mean over
{DRIFT_S:g} s shows how far the output drifted: for white noise of {rest.noise_std:.3f} {unit}, one mean in 370 exceeds
{3 * rest.noise_std / np.sqrt(DRIFT_S * gauge.rate_hz):.3f}. NIS is the mean square of the normalised innovations, 1 if
R and G are right; "predictable" is the share of their power that earlier innovations predict.

becalm's judgement of each filter:

{says}

{_vibrations(gauge)}{_warning(gauge)}"""


def _vibrations(gauge: Gauge) -> str:
    """Return sentences about the filters that count vibrations as signal; empty if no filter does."""
    sentences = [
        f'"{name}" counts a vibration near {", ".join(f"{tone:.1f}" for tone in trial.tones_hz)} Hz as signal, which a'
        " quasi-static filter does not want: its residual is therefore smaller. "
        for name, trial in gauge.trials.items()
        if trial.tones_hz
    ]
    return "".join(sentences)


def _warning(gauge: Gauge) -> str:
    worst_name, worst = max(gauge.trials.items(), key=lambda item: item[1].residual_drift)
    refused = [name for name, trial in gauge.trials.items() if not trial.judgement.describes]
    return (
        "The paper warns that a wrong model gives very wrong output. Here the worst filter is"
        f' "{worst_name}", whose output is off by {worst.residual_drift:.2f} {gauge.unit} for {DRIFT_S:g} s, and it is'
        f" {'refused' if worst_name in refused else 'passed'}; {len(refused)} of {len(gauge.trials)} filters are"
        " reported not to fit."
    )


def _trial(trial: Trial) -> Sequence[str]:
    judged = trial.judgement
    return (
        "-" if np.isnan(trial.jerk_variance) else f"{trial.jerk_variance:.2g}",
        f"{trial.noise_std:.3f}",
        f"{trial.residual_std:.3f}",
        f"{trial.residual_drift:.3f}",
        _number(judged.nis_mean, ".2f"),
        _number(judged.predictable_share, ".0%"),
        judged.verdict,
    )


def _figures(drawn: Mapping[str, str]) -> str:
    if not drawn:
        return f"## Figures\n\n{NOT_DRAWN}"
    return "## Figures\n\n" + "\n\n".join(f"![{title}]({name})\n\n{title}" for title, name in drawn.items())


def _lag(seconds: float) -> str:
    return f"{round(seconds, 2) + 0.0:.2f}"  # no -0.00


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"


def _listed(values: Sequence[float]) -> str:
    first, second, third = (f"{value:.4f}" for value in values)
    return f"{first}, {second} and {third}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def run(folder: Path) -> str:
    """Repeat the paper and write the page into a folder, with figures if matplotlib is installed.

    Parameters
    ----------
    folder : Path
        Folder for `strain.md` and its figures; created if it does not exist.

    Returns
    -------
    str
        The text of the page.
    """
    make_folder(folder)
    found = study()
    planned = sheets(found)
    drawn = {sheet.figures[0].title: path.name for sheet, path in zip(planned, draw(planned, folder), strict=False)}
    text = page(found, drawn)
    write_text(folder / "strain.md", text)
    return text
