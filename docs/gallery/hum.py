"""
Hum taken off
=============

Mains hum is a tone, and tones are part of a signal unless a person says otherwise. Said so, it is an oscillator of
its own in the model: it is taken off without a notch, and without the lag or the hole in the band that one has.
"""

import matplotlib.pyplot as plt
import numpy as np

import becalm
from becalm.metrics.spectrum import welch
from becalm.metrics.truth import rms_error

rate_hz, mains_hz = 1000.0, 50.0
rng = np.random.default_rng(4)
t = np.arange(20_000) / rate_hz
truth = np.cumsum(rng.normal(0.0, 0.01, t.size))
hum = 0.3 * np.sin(2 * np.pi * mains_hz * t + 0.02 * np.cumsum(rng.normal(size=t.size)))
noisy = truth + hum + rng.normal(0.0, 0.1, t.size)

recording = becalm.Recording(noisy, names=["force"], units=["N"], rate_hz=rate_hz)
kept = becalm.clean(recording)
wishes = becalm.Wishes(removed_hz=(mains_hz,))
out = becalm.clean(recording, becalm.tune(recording, wishes=wishes), split=True)

# %%
# In the same units, for somebody who knows the truth; the phase of this hum wanders.

for name, cleaned in (("hum kept", kept), ("hum removed", out)):
    print(f"{name}: rms error {rms_error(cleaned.signal.samples[:, 0], truth):.4f} N; {cleaned.reports[0].says}")
print("parts:", ", ".join(out.parts.names))

# %%
# `split=True` returns the parts: the motion, and the tone that was taken off.

figure, (above, below) = plt.subplots(2, 1)
part = slice(5000, 5400)
above.plot(t[part], noisy[part], ".", color="0.75", markersize=3, label="readings")
above.plot(t[part], kept.signal.samples[part, 0], linewidth=0.8, label="hum kept")
above.plot(t[part], out.signal.samples[part, 0], label="hum removed")
above.plot(t[part], truth[part], "k--", linewidth=0.8, label="truth")
above.set(xlabel="time (s)", ylabel="force (N)")
above.legend(loc="upper right", ncols=2)
for name, samples in (("readings", noisy), ("hum removed", out.signal.samples[:, 0])):
    spectrum = welch(samples, rate_hz)
    below.loglog(spectrum.frequency_hz[1:], spectrum.density[1:], label=name)
below.set(xlabel="frequency (Hz)", ylabel="density (N²/Hz)")
below.legend()
