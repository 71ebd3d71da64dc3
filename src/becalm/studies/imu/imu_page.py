"""Write the page of the IMU study; every number in it comes from the study, or from the paper's two tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from becalm.core.closed_forms import butterworth_noise_gain
from becalm.files.atomic_file import make_folder, write_text
from becalm.identification.several.step_spectrum import Sensor
from becalm.studies.imu import imu_switching
from becalm.studies.imu.imu import Study, study
from becalm.studies.imu.imu_figures import sheets
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ, RECORD_S, SPLIT_HZ, SPLIT_ORDER, noise_parts
from becalm.studies.imu.imu_responses import STEP, FilterResponse
from becalm.studies.imu.imu_valley import least_ratio
from becalm.studies.recordings import RECORDINGS
from becalm.studies.sheets import NOT_DRAWN, draw

_FIGURE: dict[Sensor, int] = {"accelerometer": 5, "gyroscope": 6}


def write_page(study: Study, drawn: Sequence[Path]) -> str:
    """Return the page as Markdown; `drawn` are the paths of the figures in its folder, empty if there are none."""
    names = {path.stem: path.name for path in drawn}

    def figure(name: str, caption: str) -> str:
        return f"![{caption}]({names[key]})\n" if (key := f"imu-{name}") in names else ""

    without = "" if drawn else f"\n{NOT_DRAWN}\n"
    parts = [
        _opening() + without,
        _measured(study) + figure("record", "Figure 3: motionless records") + figure("spectra", "Figure 4: spectra"),
        _rests(study),
        _varied(study)
        + figure("accelerometer", "Figure 5: R, Q and P0 of the accelerometer's filter, one at a time")
        + figure("gyroscope", "Figure 6: R and Q of the gyroscope's filter, one at a time"),
        _valley(study) + figure("surface", "Figure 8: the cost over R and Q"),
        _steps(study) + figure("optimum", "Figure 9: step responses at the optimum"),
        _why(study),
        _switching(study) + figure("contest", "Noise at rest against the time to nine tenths of a step"),
    ]
    return "\n".join(part for part in parts if part)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(head)
    lines = [heads, ["---"] * len(heads), *map(list, rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _ms(time_ms: float) -> str:
    return f"{time_ms:.3g} ms" if np.isfinite(time_ms) else "never"


def _opening() -> str:
    return """# The IMU paper, re-run

Kownacki (2010) tunes a Kalman filter for an accelerometer, state [V, a], and one for a gyroscope, state
[omega, epsilon], at 10 kHz. R and Q measured on a motionless record make filters that are far too slow; so he searches
for the R and Q of least cost, lag plus noise. His records are not public: simulated ones replace them, made so that his
own method gives his table 1 for them. The page is written by `becalm.studies.imu.imu`, every number by code.
"""


def _measured(study: Study) -> str:
    rows, made = [], {sensor: noise_parts(PRINTED[sensor]) for sensor in study.sensors}
    for sensor, each in study.sensors.items():
        found = np.array(each.identified)
        mean, error = found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))
        printed = PRINTED[sensor]
        for name, paper, column in (("R", printed.measured_noise, 0), ("Q", printed.measured_process, 1)):
            rows.append([sensor, name, f"{paper:.4e}", f"{mean[column]:.4e} +- {error[column]:.1e}"])
    kept = butterworth_noise_gain(SPLIT_ORDER, SPLIT_HZ / RATE_HZ)
    times = PRINTED["gyroscope"].measured_process / (kept * made["gyroscope"].white)
    white = made["accelerometer"].white / PRINTED["accelerometer"].measured_noise
    return f"""## Table 1: R and Q of a motionless record

R is the variance after a 1 Hz high-pass, Q that after a 1 Hz low-pass, with the mean subtracted before. A known share
of the variance of white noise is below 1 Hz, so that both figures together give the parts of the record, if the filters
were Butterworth's of second order (their order is not printed): the accelerometer's Q is that of a record of which
{white:.0%} was white, and the rest is put into equal harmonics of 50 to 500 Hz, as the paper's spectrum shows them; the
gyroscope's is {times:.1f} times that of white noise, and the difference is put into drift below 1 Hz, of which
subtracting the mean removes a part. Mean of {len(found)} simulated records of {RECORD_S:g} s, with its standard error:

{_table(["sensor", "", "paper", "here"], rows)}
"""


def _rests(study: Study) -> str:
    rows = [
        [
            rest.source.split("/")[0] + ", " + rest.source.split("/")[1].split("_")[0],
            f"{rest.start_s:.1f} to {rest.stop_s:.1f} s at {rest.rate_hz:.4g} Hz",
            name,
            f"{found.noise_variance:.3g}",
            f"{found.process_variance:.3g}",
            f"{found.process_variance / found.white_process:.2f} +- {rest.chance:.2f}",
        ]
        for rest in study.rests
        for name, found in rest.found.items()
    ]
    head = ["recording", "rest", "channel", "R", "Q", "Q over that of white noise"]
    table = _table(head, rows) if rows else ""
    skipped = "".join(f"- {sentence}\n" for sentence in study.skipped)
    return f"""### Real rests

The same method on the longest rest of real recordings, which becalm detected by itself. The last column has a ratio
with its standard deviation by chance. Where the ratio is near 1, Q is only the part of white noise below 1 Hz: it
depends on the width of the low-pass, and not on how the sensor will move. That is why a filter with table 1 is too
slow.

{table}{skipped}"""


def _varied(study: Study) -> str:
    tables = "\n".join(
        f"Figure {_FIGURE[sensor]}, {sensor}:\n\n{_responses(each.responses)}" for sensor, each in study.sensors.items()
    )
    return f"""## Figures 5 and 6: R, Q and P0 one at a time

The record plus a step of {STEP:g} after 5 s; every entry of P0 is the given number. R = 0 returns the readings. R = 1,
Q = 0 and table 1 itself weigh all readings equally: the accelerometer's filter averages them since the start, and needs
another 5 s for half of the step; the gyroscope's fits a line to them. Q = 1 follows the step, and keeps noise. P0 = 0
trusts the start at zero so much that five seconds of step change little.

{tables}
"""


def _responses(responses: Iterable[FilterResponse]) -> str:
    head = ["", "R", "Q", "P0", "noise at rest", "nine tenths after", "height after 5 s"]
    rows = [
        [
            each.setting.name,
            f"{each.setting.noise_variance:.4g}",
            f"{each.setting.process_variance:.4g}",
            f"{each.setting.start:g}",
            f"{each.rest_noise:.2e}",
            _ms(each.reached_ms),
            f"{each.risen:.0%}",
        ]
        for each in responses
    ]
    return _table(head, rows)


def _valley(study: Study) -> str:
    rows, ends = [], []
    for sensor, each in study.sensors.items():
        found, printed = each.optimum, PRINTED[sensor]
        span = f"**{found.ratio:.4g}** ({found.ratios.min():.4g} to {found.ratios.max():.4g})"
        tuned = f"{printed.tuned_noise:.4e}, {printed.tuned_process:.4e}"
        rows.append([sensor, tuned, f"{printed.ratio:.5g}", span, f"{found.excess:.3f}"])
        for how, end in zip(("Q/R", *["R and Q"] * (len(found.ends) - 1)), found.ends, strict=True):
            place = [f"{end.noise_variance:.3g}", f"{end.process_variance:.3g}", f"{end.ratio:.5g}"]
            ends.append([sensor, how, *place, f"{end.cost.total:.6g}", str(end.evaluations)])
    floors = " and ".join(f"{each.optimum.surface.unevenness:.0e} ({sensor})" for sensor, each in study.sensors.items())
    optima = _table(["sensor", "R, Q of the paper", "its Q/R", "Q/R here", "J at its Q/R over the least"], rows)
    searches = _table(["sensor", "search over", "R", "Q", "Q/R", "J", "filters tried"], ends)
    return f"""## Table 2 and figure 8: the valley

The cost is the squared lag behind a step, summed over time until the output reaches it, plus the amplitude density of
the output at rest, summed over frequency. Only Q/R sets the gain. So J is a valley: along Q/R = constant, over the
decades of figure 8, it varies by {floors}, relative, and the R and Q of table 2 are one point of many with
the same gain. Only Q/R is determined. (Filters start from their first readings here; the paper's P0 of ones would tilt
the floor a little.) On white noise of table 1's variance, {len(found.ratios)} records, median (least to most):

{optima}
A search over Q/R ends at one place. Nelder and Mead's simplex in R and Q (in their logarithms) finds the same ratio,
and stops at a place on the floor that depends on its start:

{searches}
"""


def _steps(study: Study) -> str:
    rows = []
    for sensor, each in study.sensors.items():
        times = each.optimum.paper_reached_ms, each.optimum.reached_ms
        for whose, time_ms, one in zip(("paper", "here"), times, each.tuned, strict=True):
            ratio = f"{one.setting.process_variance / one.setting.noise_variance:.5g}"
            rows.append([sensor, whose, ratio, _ms(time_ms), _ms(one.reached_ms), f"{one.rest_noise:.2e}"])
    late = study.sensors["accelerometer"].optimum.paper_reached_ms
    head = ["sensor", "optimum", "Q/R", "nine tenths, without noise", "on the record", "noise at rest"]
    return f"""## Figure 9: steps at the optimum

{_table(head, rows)}
The paper's accelerometer needs **{late:.0f} ms** to reach nine tenths of a step.
"""


def _why(study: Study) -> str:
    rows = [[each.made_of, f"{each.ratio:.4g}"] for each in study.coloured_records]
    paper = PRINTED["accelerometer"].ratio
    below = study.coloured_records[-1]
    return f"""## Why the accelerometer's ratio differs

The gyroscope's noise was nearly white, and its printed ratio is reproduced. The accelerometer's was not. Records of the
same variance, with different spectra:

{_table(["record", "Q/R of least cost"], rows)}
Power at low frequencies passes the filter best, and requires a slower one. But between 50 and 500 Hz, where the paper
shows its harmonics, no spectrum of that variance can require much less than {least_ratio():.0f} (by Cauchy and Schwarz,
for the filter in steady state). The printed {paper:.4g} needs noise below 50 Hz too: with power from 5 Hz on it is
{below.ratio:.4g}. Such a record is possible, but not known.
"""


def _switching(study: Study) -> str:
    got, noises = study.comparison, {sensor: np.sqrt(PRINTED[sensor].measured_noise) for sensor in study.sensors}
    rows = [
        [f"{each.step_std:.2f}", f"**{_ms(each.reached_ms)}**", f"**{each.rest_gain:.4f}**"] for each in got.switched
    ]
    fixed = [
        [one.sensor, _ms(one.reached_ms), f"{one.rest_gain:.4f}", f"{one.rest_gain * noises[one.sensor]:.2g}",
         f"{got.rest_gain * noises[one.sensor]:.2g}"]
        for one in got.fixed
    ]  # fmt: skip
    return f"""## Beyond a fixed gain

A fixed gain trades noise for lag, and the cost only weighs them. A filter with the modes still and moving does not have
to. becalm identifies the modes in each record by itself and filters causally: {imu_switching.REST_S:g} s of
white noise at rest, then a step, medians of {len(imu_switching.SEEDS)} records for each step (longer and more records:
[switching](../switching.md)). Steps are in standard deviations of a reading, noise at rest is relative to that of one:

{_table(["step", "nine tenths after", "noise at rest"], rows)}
The paper's optimum on records of the same noise; the last two columns are in each sensor's own unit:

{_table(["sensor", "nine tenths after", "noise at rest", "in unit", "switching, in unit"], fixed)}
"""


def run(folder: Path, recordings: Path = RECORDINGS) -> str:
    """Write the page `imu.md` and, where matplotlib is installed, its figures into a folder; return the page."""
    found = study(recordings)
    make_folder(folder)
    text = write_page(found, draw(sheets(found), folder))
    write_text(folder / "imu.md", text)
    return text
