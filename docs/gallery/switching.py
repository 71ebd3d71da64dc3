"""
Still when it is still, quick when it moves
===========================================

A fixed gain trades noise for lag. Where a record shows rest between motions, becalm takes a filter that switches
between modes: at rest it averages long, and at a motion it does not wait.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.metrics.truth import rms_error

rate_hz = 200.0
rng = np.random.default_rng(6)
t = np.arange(12_000) / rate_hz
moving = ((t > 15) & (t < 22)) | ((t > 40) & (t < 46))
truth = np.cumsum(np.where(moving, rng.normal(0.0, 0.08, t.size), 0.0))
noisy = truth + rng.normal(0.0, 0.3, t.size)
recording = becalm.Recording(noisy, names=["level"], units=["mm"], rate_hz=rate_hz)

# %%
# `tune` looks for modes by itself. Taken out of the recipe again, they leave the fixed filter.

recipe = becalm.tune(recording, causal=True)
channel = recipe.channel[0]
fixed_recipe = recipe.model_copy(update={"channel": (channel.model_copy(update={"switching": None}),)})
out, fixed = becalm.clean(recording, recipe, split=True), becalm.clean(recording, fixed_recipe)
print("modes:", ", ".join(mode.name for mode in channel.switching.mode))
for name, cleaned in (("fixed", fixed), ("switching", out)):
    signal = cleaned.signal.samples[:, 0]
    rest, motion = rms_error(signal[~moving], truth[~moving]), rms_error(signal[moving], truth[moving])
    print(f"{name}: rms error {rest:.4f} mm at rest, {motion:.4f} mm in motion")

# %%
# How probable each mode was is a part of the output.

part = (t > 12) & (t < 26)
figure, (above, below) = plt.subplots(2, 1, sharex=True, height_ratios=(2, 1))
above.plot(t[part], noisy[part], ".", color="0.85", markersize=1)
above.plot(t[part], fixed.signal.samples[part, 0], linewidth=0.8, label="fixed")
above.plot(t[part], out.signal.samples[part, 0], label="switching")
above.plot(t[part], truth[part], "k--", linewidth=0.8, label="truth")
above.set(ylabel="level (mm)")
above.legend()
for mode in channel.switching.mode:
    below.plot(t[part], out.parts.channel(f"level_probability_{mode.name}")[part], label=mode.name)
below.set(xlabel="time (s)", ylabel="probability")
below.legend(loc="center right")
