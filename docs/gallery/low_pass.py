"""
The scalar filter is this low-pass
==================================

"A scalar Kalman filter is just a low-pass." Of a level that wanders, in steady noise and even time, that is exactly
right, and here is which: one pole, told by q/r in closed form. The next order is a low-pass of two poles, near to
Butterworth's, that keeps slopes.
"""

import matplotlib.pyplot as plt
import numpy as np

from becalm.core.closed_forms import butterworth_response, order_one
from becalm.core.steady.dials import motion_filter, ratio_for_bandwidth
from becalm.core.steady.response import describe

rate_hz, bandwidth_hz = 500.0, 5.0
ratio = ratio_for_bandwidth(1, bandwidth_hz, 1 / rate_hz)

# %%
# The gain K that the recursion settles at, found by a Riccati solver, beside K\ :sup:`2` / (1 - K) = q/r; and so
# with the bandwidth and the noise that is left.

found, formula = motion_filter(1, ratio), order_one(ratio)
print(f"gain       {found.gain[0, 0]:.9f}  closed form {formula.gain:.9f}")
print(f"noise left {found.noise_gain():.9f}  closed form {formula.noise_gain:.9f}")
print(f"-3 dB at   {describe(found.model, 1 / rate_hz).bandwidth_hz:.9f} Hz; asked for {bandwidth_hz} Hz")
np.testing.assert_allclose(found.gain[0, 0], formula.gain, rtol=1e-9)

# %%
# Over frequency it is the exponential average x += K (z - x), and nothing else. Butterworth's of order 1 differs from
# it only near half the rate, where its bilinear transform has a zero. That of order 2 falls twice as steeply as the
# Kalman filter, which pays with that slope, and with a peak, for passing ramps without lag.

f = np.geomspace(0.05, 0.5 * rate_hz, 600)
exponential = formula.gain / (1 - (1 - formula.gain) * np.exp(-2j * np.pi * f / rate_hz))
np.testing.assert_allclose(found.filter_response(f / rate_hz), exponential, rtol=1e-9)

figure, axes = plt.subplots()
for order in (1, 2):
    own = motion_filter(order, ratio_for_bandwidth(order, bandwidth_hz, 1 / rate_hz))
    twin = butterworth_response(order, bandwidth_hz / rate_hz, f / rate_hz)
    (line,) = axes.semilogx(f, 20 * np.log10(np.abs(own.filter_response(f / rate_hz))), label=f"Kalman, order {order}")
    axes.semilogx(f, 20 * np.log10(np.abs(twin)), "--", color=line.get_color(), label=f"Butterworth, order {order}")
axes.set(xlabel="frequency (Hz)", ylabel="gain (dB)", ylim=(-50, 5))
axes.legend()

# %%
# What the other half of the truth is, the other pages show: that the cut-off came from the readings, that sigma grows
# across a gap, that a gain may change.
