"""
Spikes left out, steps followed
===============================

A linear filter spreads a spike over all readings near it. A gate looks at each innovation, reading minus prediction,
and leaves out what is too far away; but four rejects in a row are motion, and the filter follows at once.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.core.filter.gate import Gate, threshold_for
from becalm.core.reading_verdicts import AT_MOST, Verdict

rate_hz = 100.0
rng = np.random.default_rng(2)
t = np.arange(6000) / rate_hz
truth = np.sin(2 * np.pi * 0.1 * t) + np.where(t > 35, 4.0, 0.0)
noisy = truth + rng.normal(0.0, 0.1, t.size)
struck = rng.choice(t.size, 30, replace=False)
noisy[struck] += rng.choice([-3.0, 3.0], struck.size)

# %%
# The gate's width is told as a rate of false alarms.

threshold = threshold_for(false_alarms_per_hour=1.0, readings_per_second=rate_hz)
print(f"one false alarm an hour at {rate_hz:.0f} Hz: {threshold:.2f} standard deviations")
print(f"{AT_MOST} rejects in a row are motion")

# %%
# The same filter twice, with and without a gate, as live filters. (`becalm.clean` finds out by itself whether a channel
# has such readings.)

model = becalm.components.motion(2, noise_density=0.02).to_model(step_s=1 / rate_hz, noise_variance=0.01)
gated = becalm.Online(model, gate=Gate(threshold)).run(noisy)[0][:, 0]
plain = becalm.Online(model).run(noisy)[0][:, 0]
for name, signal in (("without a gate", plain), ("with a gate", gated)):
    print(f"{name}: rms error {np.sqrt(np.nanmean((signal - truth) ** 2)):.4f}")

figure, all_axes = plt.subplots(1, 2)
step_at = int(35 * rate_hz)
spike = int(struck[(struck > 1000) & (struck < 3000)][0])
for axes, middle, title in zip(all_axes, (spike, step_at), ("a spike", "a step"), strict=True):
    part = slice(middle - 30, middle + 60)
    axes.plot(t[part], noisy[part], ".", color="0.6", label="readings")
    axes.plot(t[part], plain[part], label="without a gate")
    axes.plot(t[part], gated[part], label="with a gate")
    axes.plot(t[part], truth[part], "k--", linewidth=0.8, label="truth")
    axes.set(title=title, xlabel="time (s)")
all_axes[0].legend()

# %%
# Of a file, what became of each reading comes beside the signal.

out = becalm.clean(becalm.Recording(noisy, names=["load"], rate_hz=rate_hz))
verdicts = out.verdicts["load"]
found = np.flatnonzero(verdicts == Verdict.SPIKE)
print(
    f"{struck.size} readings were struck; {np.isin(found, struck).sum()} of the {found.size} spikes told are among them"
)
