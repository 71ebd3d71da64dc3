"""
A book example: the alpha-beta tracker
======================================

A target that flies straight, pushed by an acceleration that is constant between two readings: once its gain has
settled, the Kalman filter is the alpha-beta tracker of every radar book, and one number tells both gains, Kalata's
tracking index (IEEE Transactions on Aerospace and Electronic Systems 20, 1984, 174; Bar-Shalom, Li and Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, section 6.5).
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.core.steady.steady_filter import steady


def settled(index: float, step_s: float = 1.0) -> tuple[float, float]:
    """Return alpha and beta of a tracking index, T^2 sigma_a / sigma_z, from the settled Kalman gain."""
    F, G = [[1.0, step_s], [0.0, 1.0]], [[step_s**2 / 2], [step_s]]
    sigma_a = index / step_s**2
    gain = steady(becalm.Model(F=F, H=[[1.0, 0.0]], Q=sigma_a**2, R=1.0, G=G)).gain
    return float(gain[0, 0]), float(gain[1, 0] * step_s)


def printed(index: float) -> tuple[float, float]:
    """Return alpha and beta as the books print them."""
    root = np.sqrt(index**2 + 8 * index)
    return -(index**2 + 8 * index - (index + 4) * root) / 8, (index**2 + 4 * index - index * root) / 4


# %%
# At an index of 1 the formula is easy to work out by hand: alpha is 3/4 and beta 1/2.

alpha, beta = settled(1.0)
print(f"alpha {alpha:.12f}, beta {beta:.12f}")
np.testing.assert_allclose((alpha, beta), (3 / 4, 1 / 2), rtol=1e-9)

# %%
# Over all indices a radar may meet, at another step: the picture of the books, and the same numbers.

indices = np.geomspace(0.01, 10, 200)
here = np.array([settled(index, step_s=0.1) for index in indices])
books = np.array([printed(index) for index in indices])
print(f"largest difference from the formula: {np.abs(here / books - 1).max():.1e}")
np.testing.assert_allclose(here, books, rtol=1e-9)

figure, axes = plt.subplots()
for column, name in enumerate(("alpha", "beta")):
    (line,) = axes.loglog(indices, books[:, column], label=f"{name}, printed formula")
    axes.loglog(indices[::10], here[::10, column], "o", color=line.get_color(), label=f"{name}, settled Kalman gain")
axes.set(xlabel="tracking index", ylabel="gain")
axes.legend()
