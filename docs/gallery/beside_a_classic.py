"""
At equal noise, beside a classic
================================

Any filter looks calm if it is slow enough. A fair comparison holds one thing equal: here the noise that is left, at
which the lag and the error of each filter can be read.
"""

import matplotlib.pyplot as plt

from becalm.cleaning.comparison import compare
from becalm.studies.drive import simulate

drive = simulate()
name = drive.measured.names[1]
found = compare(drive.measured, truth=drive.truth, causal=True, channels=[name])
contenders = found.channels[0].contenders

# %%
# The first is becalm's, which nobody tuned. "Best with truth" is the setting that errs least, which only somebody who
# knows the truth can find.

wanted = ("Butterworth 1", "Butterworth 2", "moving average", "alpha-beta")
for each in contenders:
    if each.name == "becalm" or (each.name in wanted and each.rule in ("equal noise", "best with truth")):
        lag = "lag not told" if each.lag_s is None else f"lag {1e3 * each.lag_s:6.1f} ms"
        removed = "" if each.noise_removed_db is None else f"noise down {each.noise_removed_db:4.1f} dB"
        print(f"{each.name:15} {each.rule:15} {removed:18} {lag:14} rms error {each.rms_error:.4f}")

# %%
# Further left is sooner, further down is nearer to the truth.

figure, axes = plt.subplots()
markers = {"": "*", "equal noise": "o", "equal lag": "s", "best with truth": "^"}
for rule, marker in markers.items():
    told = [each for each in contenders if each.rule == rule and each.lag_s is not None]
    lags_ms, errors = [1e3 * each.lag_s for each in told], [each.rms_error for each in told]
    axes.plot(lags_ms, errors, marker, markersize=12 if not rule else 6, label=rule or "becalm, nothing chosen")
axes.set(xlabel="lag (ms)", ylabel=f"rms error of {name}", xscale="log", yscale="log")
axes.legend()
