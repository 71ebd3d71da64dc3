"""
A book example: the level of the Nile
=====================================

Durbin and Koopman, *Time Series Analysis by State Space Methods* (2nd edition, 2012), chapter 2: the yearly flow of the
Nile at Aswan, 1871 to 1970, as a level that wanders, read with noise. Both variances come from the readings by maximum
likelihood, without an assumption on where the level begins.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.identification.several.joint import tune_model

# %%
# In 10\ :sup:`8` m³, as in the book (and in R's ``datasets::Nile``).

# fmt: off
flow = np.array([
    1120, 1160, 963, 1210, 1160, 1160, 813, 1230, 1370, 1140, 995, 935, 1110, 994, 1020, 960, 1180, 799, 958, 1140,
    1100, 1210, 1150, 1250, 1260, 1220, 1030, 1100, 774, 840, 874, 694, 940, 833, 701, 916, 692, 1020, 1050, 969,
    831, 726, 456, 824, 702, 1120, 1100, 832, 764, 821, 768, 845, 864, 862, 698, 845, 744, 796, 1040, 759,
    781, 865, 845, 944, 984, 897, 822, 1010, 771, 676, 649, 846, 812, 742, 801, 1040, 860, 874, 848, 890,
    744, 749, 838, 1050, 918, 986, 797, 923, 975, 815, 1020, 906, 901, 1170, 912, 746, 919, 718, 714, 740,
], dtype=float)
# fmt: on
years = np.arange(1871, 1971)
tuned = tune_model(becalm.Model(F=1, H=1, Q=1000.0, R=10_000.0), flow)
noise_variance, level_variance = tuned.model.R[0, 0], tuned.model.Q[0, 0]

# %%
# Beside the book's numbers (section 2.10.3, and table 2.1 for the likelihood, which leaves out constants and counts
# the first reading).

constants = np.log(2 * np.pi) * (flow.size - 1) / 2 + (flow.size - 1) / 2
rows = (
    ("variance of a reading", noise_variance, 15_099),
    ("variance of a year's step", level_variance, 1469.1),
    ("their ratio q", level_variance / noise_variance, 0.0973),
    ("log-likelihood", tuned.log_likelihood + constants, -492.07),
)
for name, here, book in rows:
    print(f"{name:26} {here:10.6g}   book {book:g}")
    np.testing.assert_allclose(here, book, rtol=4e-4)

# %%
# The book's figure 2.1 shows the filtered level, its figure 2.2 the smoothed one, both with a band of 90 %.

figure, all_axes = plt.subplots(2, 1, sharex=True, sharey=True)
for axes, run in zip(all_axes, (becalm.kalman_filter, becalm.kalman_smoother), strict=True):
    found = run(tuned.model, flow)
    level, sigma = found.signal[:, 0], found.sigma[:, 0]
    axes.plot(years, flow, ".", color="0.6")
    axes.fill_between(years, level - 1.645 * sigma, level + 1.645 * sigma, alpha=0.3, linewidth=0)
    axes.plot(years, level)
    axes.set(ylabel="flow (10⁸ m³)", title=run.__name__)
all_axes[1].set(xlabel="year")
