"""
A gap, and a sigma that grows
=============================

A low-pass has no idea of a missing reading: something must be put in its place first. A Kalman filter predicts
across a gap and says how little it knows there.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.classic.register import CLASSICS

rate_hz = 100.0
t = np.arange(2000) / rate_hz
truth = np.sin(2 * np.pi * 0.2 * t) + 0.4 * np.sin(2 * np.pi * 0.07 * t)
noisy = truth + np.random.default_rng(1).normal(0.0, 0.15, t.size)
noisy[900:1100] = np.nan

recording = becalm.Recording(noisy, names=["angle"], units=["rad"], rate_hz=rate_hz)
filtered, smoothed = becalm.clean(recording, causal=True), becalm.clean(recording)

# %%
# NaN is a reading that did not arrive. Sigma is told in the middle of the gap as anywhere else; the filter knows one
# side of it, the smoother both.

for name, out in (("filter", filtered), ("smoother", smoothed)):
    sigma, error = out.sigma.samples[:, 0], out.signal.samples[:, 0] - truth
    print(
        f"{name}: sigma {sigma[800]:.3f} before the gap, {sigma[1000]:.3f} in its middle; errs {error[1000]:+.3f} there"
    )

# %%
# The Butterworth filter, which is given the readings joined by a line, has the bandwidth of becalm's own smoother.

butterworth = CLASSICS["Butterworth 2 both ways"].clean(noisy, smoothed.reports[0].bandwidth_hz / rate_hz)
part = (t > 7) & (t < 13)
figure, all_axes = plt.subplots(2, 1, sharex=True, sharey=True)
for axes, (name, out) in zip(all_axes, (("filter", filtered), ("smoother", smoothed)), strict=True):
    signal, sigma = out.signal.samples[part, 0], out.sigma.samples[part, 0]
    axes.plot(t[part], noisy[part], ".", color="0.8", markersize=2)
    axes.fill_between(t[part], signal - 2 * sigma, signal + 2 * sigma, alpha=0.3, linewidth=0)
    axes.plot(t[part], signal, label=name)
    axes.plot(t[part], truth[part], "k--", linewidth=0.8, label="truth")
    axes.set(ylabel="angle (rad)", ylim=(-2.5, 2.5))
all_axes[1].plot(t[part], butterworth[part], ":", label="Butterworth, both ways")
all_axes[1].set(xlabel="time (s)")
for axes in all_axes:
    axes.legend(loc="upper right")
