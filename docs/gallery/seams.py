"""
Where an endless recording may be cut
=====================================

A filter that begins in the middle of a recording soon stands where the one stands that saw all of it: their difference
shrinks with each row by the same factor, until nothing is left of it, to the last bit. That is how `becalm fleet` cuts
a sensor's year into stretches which are cleaned side by side.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm

rate_hz, rows = 100.0, 6000
rng = np.random.default_rng(1)
signal = 0.05 * np.cumsum(rng.normal(size=rows))
noisy = signal + rng.normal(0.0, 0.5, rows)

# %%
# The same filter over all rows, and begun anew at row 2048, for three bandwidths.

figure, axes = plt.subplots()
for noise_density in (1.0, 0.1, 0.01):
    model = becalm.components.motion(1, noise_density=noise_density).to_model(step_s=1 / rate_hz, noise_variance=0.25)
    whole, begun = becalm.kalman_filter(model, noisy), becalm.kalman_filter(model, noisy[2048:])
    apart = np.abs(whole.signal[2048:, 0] - begun.signal[:, 0])
    alike = int(np.flatnonzero(apart)[-1]) + 1
    shrinks = (apart[30] / apart[10]) ** (1 / 20)
    print(f"q = {noise_density:g}: each row leaves {shrinks:.4f} of it; the same to the last bit from row {alike} on")
    axes.semilogy(apart, label=f"q = {noise_density:g}")

# %%
# The curves end where the difference is exactly 0. A stretch warms up on many more rows than that, and still nobody
# hopes: it tells where its filter stood at the seam, and if that is not, bit for bit, where the one before it ended, it
# is run again from there.

axes.set(xlabel="rows since it began", ylabel="difference of the two signals", ylim=(1e-17, 3))
axes.legend()
