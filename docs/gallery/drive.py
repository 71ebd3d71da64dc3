"""
Nothing chosen
==============

A simulated test drive of a car, 60 s at 500 Hz, goes in; the signal comes out with its uncertainty. Nobody chose a
cut-off, an order, Q or R.
"""

import matplotlib.pyplot as plt

import becalm
from becalm.metrics.truth import coverage, rms_error
from becalm.studies.drive import simulate

drive = simulate()
out = becalm.clean(drive.measured)

# %%
# A verdict stands beside each channel: whether its model describes the signal. Because the drive is simulated, its
# truth is known, and becalm can be held to what it says.

for i, report in enumerate(out.reports):
    truth, measured = drive.truth.samples[:, i], drive.measured.samples[:, i]
    signal, sigma = out.signal.samples[:, i], out.sigma.samples[:, i]
    print(f"{report.name}: {report.says}")
    print(f"  noise found: {report.noise_std:.3g}; rms error {rms_error(measured, truth):.3g}", end=" ")
    print(f"before, {rms_error(signal, truth):.3g} after; {coverage(signal, sigma, truth):.0%} within one sigma")

# %%
# Two seconds of the longitudinal acceleration, as braking begins. The band is two standard uncertainties to either
# side.

t = drive.truth.times_s
part = slice(12_300, 13_300)
truth, measured = drive.truth.samples[part, 1], drive.measured.samples[part, 1]
signal, sigma = out.signal.samples[part, 1], out.sigma.samples[part, 1]

figure, axes = plt.subplots()
axes.plot(t[part], measured, ".", color="0.75", markersize=2, label="readings")
axes.fill_between(t[part], signal - 2 * sigma, signal + 2 * sigma, alpha=0.3, linewidth=0)
axes.plot(t[part], signal, label="becalm")
axes.plot(t[part], truth, "k--", linewidth=0.8, label="truth")
axes.set(xlabel="time (s)", ylabel=drive.truth.names[1])
axes.legend()
