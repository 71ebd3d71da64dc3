"""
A published figure: steps at the optimum
========================================

Kownacki, *Optimization approach to adapt Kalman filters for the real-time application of accelerometer and gyroscope
signals' filtering* (Digital Signal Processing 21, 2011, 131), tunes Q and R by a cost of lag and noise, and shows in
its figure 9 how the tuned filters follow a step. Its records are not public: simulated ones of the printed variance
stand in.
"""

import matplotlib.pyplot as plt
import numpy as np

from becalm.identification.several.step_spectrum import StepTrial
from becalm.identification.several.step_tuning import tune_by_step
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ, white
from becalm.studies.imu.imu_responses import FIGURE_STRIDE, STEP, STEP_AT_S, NoiseSetting, compute_response

figure, all_axes = plt.subplots(1, 2, sharey=True)
for axes, sensor in zip(all_axes, ("accelerometer", "gyroscope"), strict=True):
    printed, record = PRINTED[sensor], white(sensor, 0)
    found = tune_by_step(StepTrial(record, RATE_HZ, sensor), printed.measured_noise)
    settings = (
        NoiseSetting("printed Q, R", printed.tuned_noise, printed.tuned_process),
        NoiseSetting("tuned here", printed.measured_noise, found.ratio * printed.measured_noise),
    )
    print(f"{sensor}: Q/R printed {printed.ratio:.4g}, found here {found.ratio:.4g}")
    for setting in settings:
        told = compute_response(sensor, record, setting)
        print(f"  {setting.name}: nine tenths after {told.reached_ms:.1f} ms, noise at rest {told.rest_noise:.2e}")
        after_s = np.arange(len(told.output)) * FIGURE_STRIDE / RATE_HZ - STEP_AT_S
        axes.plot(after_s, told.output / STEP, label=setting.name)
    axes.set(title=sensor, xlabel="time after the step (s)", xlim=(-0.2, 1.5))
    axes.legend(loc="lower right")
all_axes[0].set(ylabel="output over the step")

# %%
# The gyroscope's printed ratio comes out. The accelerometer's does not: its noise was not white, and the
# :doc:`study of this paper </studies/imu>` says what noise would explain it, and what a filter that switches makes of
# the same steps.

np.testing.assert_allclose(found.ratio, PRINTED["gyroscope"].ratio, rtol=0.05)
