/* One channel, row by row: limits, gap, predict, gate, update, monitor, estimate.

   A block passes three times: its measurements are judged, filtered, and their innovations watched. No pass knows what
   is in the block but by its rows, so that a stream gives the same bits wherever it is cut.

   Equations are numbered as in core/reference.py. */
#include <string.h>

#include "filter.h"
#include "limits.h"
#include "monitor.h"

static void judge_rows(const settings_t *settings, limits_t *state, const block_t *block, const estimate_t *estimate,
                       pass_t *pass) {
    for (int64_t row = 0; row < block->rows; row++) {
        const real z = block->z[row], elapsed = block->elapsed[row];
        const int verdict = judge(settings, state, z, elapsed > 0);
        if (verdict) estimate->verdict[row] = (int8_t)verdict;
        pass->usable[row] = verdict ? NOT_A_NUMBER : z;
        pass->anew[row] = (int8_t)starts_anew(settings, state, elapsed, verdict == USED);
    }
}

/* Return sigma with what the uncertainties of times, tuning and calibration add. */
static real widened(const settings_t *settings, const coefficients_t *model, state_t *state, const real signal,
                    real sigma, const real elapsed) {
    if (settings->timed) {
        const real seconds = elapsed * settings->step_s, risen = signal - state->last_signal;
        if (seconds > 0 && isfinite(risen)) state->slope = risen / seconds;
        state->last_signal = signal;
        const real moved = state->slope * settings->time_std_s, more = moved * moved - settings->time_variance;
        if (more > 0) sigma *= sqrt(1 + more / model->R);
    }
    sigma *= settings->factor;
    if (settings->calibrated) {
        const real relative = signal * settings->relative_std;
        const real variance = relative * relative + settings->offset_std * settings->offset_std;
        if (isfinite(variance)) sigma = sqrt(sigma * sigma + variance);
    }
    return sigma;
}

static void watch_rows(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                       const estimate_t *estimate, const pass_t *pass) {
    const real low = settings->plausible_low, high = settings->plausible_high;
    for (int64_t row = 0; row < block->rows; row++) {
        const real deviation = estimate->deviation[row];
        const int alarm = watch(settings, &state->monitor, deviation > 0 ? estimate->innovation[row] / deviation : NOT_A_NUMBER);
        int verdict = estimate->verdict[row];
        if (alarm && verdict == USED) verdict = alarm;
        real signal = estimate->signal[row], sigma = estimate->sigma[row];
        const int missed = isnan(pass->usable[row]), goes_on = missed && state->missed;
        if (!missed && verdict != SPIKE) state->entered = pass->usable[row];
        state->missed = missed;
        if ((signal < low || signal > high) && fabs(signal - state->entered) > high - low)
            signal = sigma = NOT_A_NUMBER, verdict = RUNAWAY;
        else if (goes_on && sigma >= settings->unknown_from && !isnan(signal))
            signal = sigma = NOT_A_NUMBER, verdict = HOLE;
        state->counts[verdict]++;
        estimate->verdict[row] = (int8_t)verdict;
        estimate->signal[row] = signal;
        estimate->sigma[row] = widened(settings, model, state, signal, sigma, block->elapsed[row]);
    }
}

void channel_start(state_t *state) {
    memset(state, 0, sizeof *state);
    limits_t *limits = &state->limits;
    state->last_signal = state->entered = limits->held = NOT_A_NUMBER;
    limits->least = INFINITE, limits->most = -INFINITE;
    for (int k = 0; k < NEIGHBOURS; k++) limits->past[k] = NOT_A_NUMBER;
    state->monitor.drift_since = state->filter.settled_row = -1;
    forget(&state->filter);
}

/* Return whether a state, which may come from a file, is one that a channel can have. */
int channel_is_sound(const state_t *state) {
    return state->filter.known >= UNKNOWN && state->filter.known <= DETERMINED && state->monitor.hops >= 0;
}

static void process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                    const estimate_t *estimate) {
    pass_t pass;
    judge_rows(settings, &state->limits, block, estimate, &pass);
    filter_block(settings, model, &state->filter, block, estimate, &pass);
    watch_rows(settings, model, state, block, estimate, &pass);
}

void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate) {
    for (int64_t row = 0; row < block->rows; row += BLOCK) {
        block_t part = *block;
        const estimate_t out = {estimate->signal + row, estimate->sigma + row, estimate->verdict + row,
                                estimate->innovation + row, estimate->deviation + row};
        part.z += row, part.elapsed += row, part.step += row;
        part.rows = block->rows - row < BLOCK ? block->rows - row : BLOCK;
        process(settings, model, state, &part, &out);
    }
}
