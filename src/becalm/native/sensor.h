/* The checks around a filter: measurements before it, innovations and estimates after it. */
#ifndef BECALM_SENSOR_H
#define BECALM_SENSOR_H

#include <string.h>

#include "filter.h"
#include "gap.h"
#include "limits.h"
#include "monitor.h"

/* Set the state before the first row. */
static inline void start_sensor(sensor_t *state) {
    memset(state, 0, sizeof *state);
    start_limits(&state->limits);
    state->last_signal = state->entered = NOT_A_NUMBER, state->missed = 1;
    state->monitor.drift_since = -1;
}

/* Count a fault in the current row. */
static inline void count_fault(faults_t *faults, const int verdict) {
    if (!faults->met[verdict]++) faults->first_row[verdict] = faults->rows, faults->first_step[verdict] = faults->steps;
}

/* Check measurements: write verdicts, the measurements that may enter the filter, and the rows at which it restarts. */
static inline void judge_rows(const settings_t *settings, sensor_t *state, const block_t *block, int8_t *verdicts,
                              pass_t *pass) {
    faults_t *faults = &state->faults;
    for (int64_t row = 0; row < block->rows; row++) {
        const real z = block->z[row], elapsed = block->elapsed[row];
        const int verdict = judge(settings, &state->limits, z, elapsed);
        faults->steps += faults->rows ? elapsed : 0;
        if (verdict) verdicts[row] = (int8_t)verdict;
        if (verdicts[row]) count_fault(faults, verdicts[row] & (VERDICTS - 1));
        faults->rows++;
        pass->usable[row] = verdict ? NOT_A_NUMBER : z;
        pass->starts[row] = (int8_t)check_gap(settings, &state->limits, elapsed, verdict == USED);
    }
}

/* Return sigma increased by the uncertainties of times, tuning and calibration; R is the variance of a measurement. */
static inline real widened(const settings_t *settings, const real R, sensor_t *state, const real signal, real sigma,
                           const real elapsed) {
    if (settings->timed) {
        const real seconds = elapsed * settings->step_s, risen = signal - state->last_signal;
        if (seconds > 0 && isfinite(risen)) state->slope = risen / seconds;
        state->last_signal = signal;
        const real moved = state->slope * settings->time_std_s, more = moved * moved - settings->time_variance;
        const real share = more > 0 ? sqrt(1 + more / R) - 1 : 0;
        state->timing_share = share > state->timing_share ? share : state->timing_share;
        sigma *= 1 + share;
    }
    sigma *= settings->factor;
    if (settings->calibrated) {
        const real relative = signal * settings->relative_std;
        const real variance = relative * relative + settings->offset_std * settings->offset_std;
        if (isfinite(variance)) sigma = sqrt(sigma * sigma + variance);
    }
    return sigma;
}

/* Monitor innovations, remove runaway estimates and those in holes, and increase sigma. */
static inline void watch_rows(const settings_t *settings, const real R, sensor_t *state, const block_t *block,
                              const estimate_t *estimate, const pass_t *pass) {
    const real low = settings->plausible_low, high = settings->plausible_high;
    for (int64_t row = 0; row < block->rows; row++) {
        const real deviation = estimate->deviation[row];
        const real normalised = deviation > 0 ? estimate->innovation[row] / deviation : NOT_A_NUMBER;
        const int alarm = watch(settings, &state->monitor, normalised);
        int verdict = estimate->verdict[row];
        if (alarm && verdict == USED) verdict = alarm;
        real signal = estimate->signal[row], sigma = estimate->sigma[row];
        const int missed = isnan(pass->usable[row]), in_hole = missed && state->missed;
        if (!missed && verdict != SPIKE) state->entered = pass->usable[row];
        state->missed = missed;
        if ((signal < low || signal > high) && fabs(signal - state->entered) > high - low)
            signal = sigma = NOT_A_NUMBER, verdict = RUNAWAY;
        else if (in_hole && sigma >= settings->hole_sigma && !isnan(signal))
            signal = sigma = NOT_A_NUMBER, verdict = HOLE;
        state->counts[verdict & (VERDICTS - 1)]++;
        estimate->verdict[row] = (int8_t)verdict;
        estimate->signal[row] = signal;
        estimate->sigma[row] = widened(settings, R, state, signal, sigma, block->elapsed[row]);
    }
}

#endif
