"""Write the page of the car study; every number in it comes from the study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from becalm.files.atomic_file import make_folder, write_text
from becalm.metrics.decibels import snr_db
from becalm.metrics.spectrum import VEHICLE_BANDS_HZ
from becalm.studies.car.car import PER_CHANNEL, PER_CHANNEL_DISTURBANCE, PRINTED, CarScore, CarStudy, study
from becalm.studies.car.car_drive import (
    BODY_HZ,
    COLOURED_HZ,
    DURATION_S,
    INPUT_SNR_PAPER_DB,
    KMH,
    OUTPUT_SNR_PAPER_DB,
    SENSITIVITY_V_PER_G,
    SHARES,
    SPEED_NOISE_MPS,
    TRANSVERSE,
)
from becalm.studies.car.car_figures import sheets
from becalm.studies.drive import RATE_HZ
from becalm.studies.recordings import RECORDINGS
from becalm.studies.sheets import NOT_DRAWN, draw


def page(result: CarStudy, drawn: Sequence[Path] = ()) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    result : CarStudy
        Numbers of the study.
    drawn : sequence of Path
        Paths of the figures in the page's folder; if there are none, the page gives the reason.
    """
    parts = [
        _opening(),
        _drive(result),
        _forms(result),
        _white(result),
        _scores(result),
        _others(result),
        _reasons(result),
        _error_parts(result),
    ]
    return "\n\n".join([*parts, _bands(result), _real(result), _figures(drawn)]) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _opening() -> str:
    return (
        "# Two accelerometers in a car\n\n"
        "A paper in Sensors (2001) filters the longitudinal and the vertical acceleration of a car under test, and"
        " its speed, with a Kalman filter of three states. Its recordings are not public: a simulated drive with all"
        " printed properties replaces them, and a real car follows. *Paper's dB* are 20 log10 of a ratio of powers,"
        " as in the paper's equations (12) to (14); *dB* are the usual 10 log10, half as many."
    )


def _drive(result: CarStudy) -> str:
    x, z = result.input_snr_paper_db
    shares = ", ".join(f"{name} {share:.0%}" for name, share in SHARES.items())
    return (
        f"## The drive\n\n{DURATION_S:.0f} s at {RATE_HZ:.0f} Hz, in volts: {SENSITIVITY_V_PER_G[0] * 1e3:.1f} and"
        f" {SENSITIVITY_V_PER_G[1] * 1e3:.1f} mV/g, transverse sensitivity {TRANSVERSE[0]:.2%} and {TRANSVERSE[1]:.2%},"
        f" a range of 2 g, which {result.drive.beyond_range} readings exceeded. Input: {x:.1f} and {z:.1f} paper's dB"
        f" (paper: {INPUT_SNR_PAPER_DB[0]} and {INPUT_SNR_PAPER_DB[1]}), {x / 2:.2f} and {z / 2:.2f} dB. Of the noise's"
        f" power {shares}: coloured is a band from {COLOURED_HZ[0]:.0f} to {COLOURED_HZ[1]:.0f} Hz, disturbances are"
        f" wheels and masses. The body's own motion is signal.\n\nChosen here, because the paper does not print it:"
        f" the manoeuvres, these shares, and the speedometer's noise ({SPEED_NOISE_MPS * KMH:.1f} km/h)."
    )


def _forms(result: CarStudy) -> str:
    forms, K = result.forms, result.gain
    rows = [[f"{value:.8f}" for value in row] for row in K]
    return (
        "## One-step prediction and filtering\n\nAppendix B carries x(n+1 | n) with a gain that includes F. Over the"
        f" whole drive it is F x(n | n) of the filtered form to {forms.state:.1e} of the largest state; the"
        f" covariances P(n) and P(n+1, n) agree to {forms.filtered_cov:.1e} and {forms.ahead_cov:.1e}. F leaves"
        " the accelerations unchanged, so that both forms estimate them equally.\n\nThe steady-state gain of the"
        f" filtered form, within {result.gain_difference:.1e} of the one computed beforehand:\n\n"
        + _table(["speed", "a_x", "a_z"], rows)
    )


def _white(result: CarStudy) -> str:
    rows = []
    for axis, gain, seen in zip(("a_x", "a_z"), result.noise_gain, result.noise_gain_measured, strict=True):
        decibels = [f"{-per * np.log10(share):.2f}" for share in (gain, seen) for per in (20, 10)]
        rows.append([axis, "> 30", *decibels])
    head = ["", "paper, paper's dB", "steady-state gain, paper's dB", "dB", "measured on noise, paper's dB", "dB"]
    return (
        "## White noise\n\nThe paper's headline follows from its matrices alone, whatever was recorded:\n\n"
        + _table(head, rows)
    )


def _scores(result: CarStudy) -> str:
    head = ["", "filter", "output, paper's dB", "dB", "lag from the filter", "lag measured", "rms error"]
    rows = []
    for axis, printed in zip(("a_x", "a_z"), OUTPUT_SNR_PAPER_DB, strict=True):
        rows.append([axis, "paper, as printed", f"{printed:.0f}", f"{printed / 2:.1f}", "", "", ""])
        rows += [_row(score) for score in result.scores if score.axis == axis]
    Q, R = (np.diag(values) for values in (result.own.model.Q, result.own.model.R))
    own = (
        f"becalm's own choice keeps the paper's F, G and H and estimates Q = diag({Q[0]:.3g}, {Q[1]:.3g}) and"
        f" R = diag({R[0]:.3g}, {R[1]:.3g}, {R[2]:.3g}) by likelihood, from the readings alone; it is causal too. Its"
        " longitudinal acceleration follows the speed more than the accelerometer: less error, more lag. How much"
        " that gains depends on the speedometer's noise, which the paper does not print."
    )
    return f"## The table\n\n{_table(head, rows)}\n\nRms errors are in m/s².\n\n{own}{_per_channel(result)}"


def _others(result: CarStudy) -> str:
    head = [
        "white",
        "coloured",
        "disturbances",
        "a_x, paper's matrices",
        "a_x, three sensors",
        "a_z",
        "a_z, three sensors",
    ]
    rows = [
        [
            *(f"{share:.0%}" for share in other.shares.values()),
            *(f"{e:.3f}" for k in (0, 1) for e in (other.printed[k], other.own[k])),
        ]
        for other in result.others
    ]
    lost = sum(o > p for other in result.others for o, p in zip(other.own, other.printed, strict=True))
    return (
        "## Other shares of noise\n\nThe shares above are a choice. Rms errors in m/s² with others; in"
        f" {lost} of {2 * len(rows)} cases the three sensors with likelihood err more than the paper's matrices. Their"
        " model has white noise only: other strong noise is taken for motion.\n\n" + _table(head, rows)
    )


def _per_channel(result: CarStudy) -> str:

    if PER_CHANNEL not in result.estimates:
        return ""
    errors = {(score.filter, score.axis): score.rms_error for score in result.scores}

    def compared(name: str) -> str:
        return " and ".join(
            f"{'worse' if errors[name, axis] > errors[PRINTED, axis] else 'better'} on {axis}"
            for axis in ("a_x", "a_z")
        )

    return (
        f"\n\nChannel by channel, without settings, becalm is {compared(PER_CHANNEL)} than with the paper's matrices:"
        " it models narrow bands of vibration as tones, and tones are signal. If tones above"
        f" {BODY_HZ[1]:.0f} Hz are set as disturbances, it is {compared(PER_CHANNEL_DISTURBANCE)}."
    )


def _row(score: CarScore) -> list[str]:
    described = f"{score.described_lag_s * 1e3:.1f} ms" if np.isfinite(score.described_lag_s) else "unknown"
    measured = f"{score.measured_lag_s * 1e3:.1f} ms"
    ratios = [f"{score.snr_paper_db:.1f}", f"{score.snr_db:.1f}"]
    return [score.axis, score.filter, *ratios, described, measured, f"{score.rms_error:.3f}"]


def _reasons(result: CarStudy) -> str:
    reasons = []
    for k, axis in enumerate(("a_x", "a_z")):
        limits, snr_in, snr_out = result.limits[k], INPUT_SNR_PAPER_DB[k], OUTPUT_SNR_PAPER_DB[k]
        here = next(score for score in result.scores if score.axis == axis and score.filter == "paper's matrices")
        parts = next(one for one in result.error_parts if one.axis == axis and one.filter == "paper's matrices")
        largest = sorted(parts.power_after, key=lambda kind: -parts.power_after[kind])[:2]
        total = sum(parts.power_after.values())
        shares = " and ".join(f"{_label(kind)} ({parts.power_after[kind] / total:.0%})" for kind in largest)
        reasons.append(
            f"- **{axis}: {snr_out:.0f} printed, {here.snr_paper_db:.1f} here.** From {snr_in} to {snr_out:.0f} the"
            f" ratio gains {snr_out - snr_in:.1f} paper's dB, but white noise loses only"
            f" {-20 * np.log10(result.noise_gain[k]):.1f}. With these matrices, noise of one frequency would have to"
            f" be at {limits.noise_above_hz:.0f} Hz or above to be reduced so much; and a sine in the signal at"
            f" {limits.signal_below_hz:.2f} Hz or below, because a faster one is followed less well even without noise."
            f" Here most of the error is {shares}."
        )
    return (
        "## Why the printed matrices do not reach 17 and 39 here\n\n"
        + "\n".join(reasons)
        + "\n\nThe paper does not say how it knew the signal z without its noise. Its equation (13) holds for a filter"
        " that is optimal for its input; for any other, the output alone does not give the error."
    )


def _label(kind: str) -> str:
    return {"signal": "lag and damping of the signal", "speed's": "the speed's noise", "white": "white noise"}.get(
        kind, kind
    )


def _error_parts(result: CarStudy) -> str:
    rows = []
    for parts in result.error_parts:
        for kind, after in parts.power_after.items():
            before = parts.power_before.get(kind, 0.0)
            ratio = f"{snr_db(np.sqrt([before]), np.sqrt([after])):.1f}" if before else ""
            rows.append(
                [parts.axis, parts.filter, _label(kind), f"{before:.3g}" if before else "", f"{after:.2g}", ratio]
            )
    head = ["", "filter", "part", "before, (m/s²)²", "after, (m/s²)²", "dB removed"]
    return (
        "## Parts of the error\n\nThe filters are linear, so each kind of noise, and the signal, can be filtered"
        " alone.\n\n" + _table(head, rows)
    )


def _bands(result: CarStudy) -> str:
    head = ["", "", *(f"{name}, {low:.0f} to {high:.0f} Hz" for name, (low, high) in VEHICLE_BANDS_HZ.items())]
    rows = [
        [axis, name, *(f"{powers[k][band]:.3g}" for band in VEHICLE_BANDS_HZ)]
        for k, axis in enumerate(("a_x", "a_z"))
        for name, powers in result.bands.items()
    ]
    return "## Power in the vehicle's bands\n\nBefore and after, by Welch's method, in (m/s²)².\n\n" + _table(
        head, rows
    )


def _real(result: CarStudy) -> str:
    real = result.real
    if real is None:
        return "## A real car\n\nSkipped: the recordings of the car (comma2k19) are not on this machine."
    noise, jerk = real.fitted.noise_std, real.fitted.jerk_density
    return (
        f"## A real car\n\nA minute of comma2k19: the CAN bus gives the speed, an accelerometer the acceleration, each"
        f" on its own clock, {len(real.record.times_s)} times in all. The model is the paper's with exact steps over"
        f" the time between two readings; by likelihood the noise is {noise[0]:.3f} m/s, {noise[1]:.2f} and"
        f" {noise[2]:.2f} m/s², the densities of jerk {jerk[0]:.2g} and {jerk[1]:.2g} (m/s³)²/Hz. A constant"
        f" {real.record.offset:.2f} m/s² was subtracted from the longitudinal acceleration, so that its mean is that of"
        " the speed's gain. It comes from tilt and from the road's mean slope.\n\n"
        + _table(
            ["longitudinal acceleration against the derivative of the speed", "rms difference, m/s²", "correlation"],
            [
                ["as read", f"{real.raw_rms:.3f}", f"{real.raw_correlation:.3f}"],
                ["three sensors", f"{real.estimate_rms:.3f}", f"{real.estimate_correlation:.3f}"],
                ["the same filter without the speed", f"{real.accelerometer_rms:.3f}", f"{real.alone_correlation:.3f}"],
            ],
        )
        + "\n\nThe filter of three sensors uses the speed that it is compared with; that of the last row does not."
        f" Another check: {real.hidden_count} speeds, one second in four, were hidden from the filter (not from the"
        f" likelihood). It estimated them from the accelerometer with an rms error of {real.hidden_rms:.3f} m/s; the"
        f" last speed, held, has one of {real.held_rms:.3f} m/s."
    )


def _figures(drawn: Sequence[Path]) -> str:
    if not drawn:
        return f"## Figures\n\n{NOT_DRAWN}"
    return "## Figures\n\n" + "\n\n".join(f"![{path.stem}]({path.name})" for path in drawn)


def run(folder: Path, recordings: Path = RECORDINGS) -> str:
    """Write the page `car.md` and, where matplotlib is installed, its figures into a folder; return the page's text.

    Parameters
    ----------
    folder : Path
        Folder for the page; created if it does not exist.
    recordings : Path
        Folder of real recordings.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    make_folder(folder)
    result = study(recordings)
    text = page(result, draw(sheets(result), folder))
    write_text(folder / "car.md", text)
    return text
