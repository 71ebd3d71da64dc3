/* One channel, row by row: limits, gap, predict, gate, update, monitor, estimate.

   A block passes three times: its measurements are judged, filtered, and their innovations watched. No pass knows what
   is in the block but by its rows, so that a stream gives the same bits wherever it is cut.

   Equations are numbered as in core/reference.py. */
#include <string.h>

#include "filter.h"
#include "pack.h"
#include "gap.h"
#include "limits.h"
#include "linear.h"
#include "monitor.h"

/* Count a fault that is met in the row that comes now. */
static void meet(faults_t *faults, const int verdict) {
    if (!faults->met[verdict]++) faults->first_row[verdict] = faults->rows, faults->first_step[verdict] = faults->steps;
}

static void judge_rows(const settings_t *settings, state_t *state, const block_t *block, const estimate_t *estimate,
                       pass_t *pass) {
    faults_t *faults = &state->faults;
    for (int64_t row = 0; row < block->rows; row++) {
        const real z = block->z[row], elapsed = block->elapsed[row];
        const int verdict = judge(settings, &state->limits, z, elapsed);
        faults->steps += faults->rows ? elapsed : 0;
        if (verdict) estimate->verdict[row] = (int8_t)verdict;
        if (estimate->verdict[row]) meet(faults, estimate->verdict[row] & (VERDICTS - 1));
        faults->rows++;
        pass->usable[row] = verdict ? NOT_A_NUMBER : z;
        pass->starts[row] = (int8_t)check_gap(settings, &state->limits, elapsed, verdict == USED);
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
        const real share = more > 0 ? sqrt(1 + more / model->R) - 1 : 0;
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

static void watch_rows(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                       const estimate_t *estimate, const pass_t *pass) {
    const real low = settings->plausible_low, high = settings->plausible_high;
    for (int64_t row = 0; row < block->rows; row++) {
        const real deviation = estimate->deviation[row];
        const real normalised = deviation > 0 ? estimate->innovation[row] / deviation : NOT_A_NUMBER;
        const int alarm = watch(settings, &state->monitor, normalised);
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
        state->counts[verdict & (VERDICTS - 1)]++;
        estimate->verdict[row] = (int8_t)verdict;
        estimate->signal[row] = signal;
        estimate->sigma[row] = widened(settings, model, state, signal, sigma, block->elapsed[row]);
    }
}

void channel_start(const settings_t *settings, state_t *state) {
    memset(state, 0, sizeof *state);
    state->layout = LAYOUT, state->states = settings->states;
    start_limits(&state->limits);
    state->last_signal = state->entered = NOT_A_NUMBER;
    state->monitor.drift_since = state->filter.settled_row = -1;
    filter_forget(&state->filter);
}

void channel_begin_after(const settings_t *settings, const coefficients_t *model, state_t *state, const real first,
                         const int64_t rows, const real steps, const real least, const real most) {
    filter_begin_after(settings, model, &state->limits, &state->filter, first, rows, steps);
    state->limits.least = least, state->limits.most = most;
    state->monitor.rows = state->faults.rows = rows, state->faults.steps = steps;
    state->monitor.hop_count = rows % HOP;
}

/* Reduce what the filter knows: how it came to a gain that has settled matters no more. */
static void reduce_filter(const settings_t *settings, filter_t *filter) {
    const int64_t longest = settings->gate_most > GOES_ON ? settings->gate_most : GOES_ON;
    filter->rows = filter->settled_row = 0;
    if (filter->since_jump >= longest) filter->since_jump = longest, filter->jumped = 0;
    if (!filter->rejected) filter->last_rejected = filter->wandered = 0;
    if (!filter->predicted) memset(filter->ahead, 0, sizeof filter->ahead), memset(filter->L, 0, sizeof filter->L);
    if (!filter->settled) return;
    filter->steady = filter->next_check = filter->agreed = 0;
    filter->S_then = filter->sigma_then = 0;
    memset(filter->K_then, 0, sizeof filter->K_then);
    memset(filter->variance_then, 0, sizeof filter->variance_then);
}

void channel_reduce(const settings_t *settings, state_t *state, const int alive) {
    monitor_t *monitor = &state->monitor, watched = {0};
    reduce_limits(settings, &state->limits);
    reduce_filter(settings, &state->filter);
    watched.above = monitor->above, watched.below = monitor->below;
    if (!alive) {
        watched.hop_count = monitor->hop_count, watched.hop_total = monitor->hop_total;
        watched.hop_squares = monitor->hop_squares, watched.silent = monitor->silent;
        watched.hops = monitor->hops < WINDOW_HOPS ? monitor->hops : WINDOW_HOPS;
        memcpy(watched.totals, monitor->totals, sizeof watched.totals);
        memcpy(watched.squares, monitor->squares, sizeof watched.squares);
    }
    *monitor = watched;
    channel_forget_counts(state);
    state->faults.rows = 0, state->faults.steps = 0;
    if (!settings->timed) state->last_signal = state->slope = 0;
}

void channel_forget_counts(state_t *state) {
    const faults_t blank = {.rows = state->faults.rows, .steps = state->faults.steps};
    memset(state->counts, 0, sizeof state->counts);
    state->faults = blank;
    state->timing_share = 0;
    state->filter.settled_row = -1;
}

static int are_finite(const real *numbers, const int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(numbers[i])) return 0;
    return 1;
}

/* Return whether what a filter knows can be: no counter overflows, and no number is NaN for good. */
static int filter_is_sound(const int n, const filter_t *filter) {
    int sound = filter->phase >= UNKNOWN && filter->phase <= DETERMINED && are_finite(filter->x, n) &&
                are_finite(filter->P, n * n) && isfinite(filter->level);
    if (sound && filter->phase == DETERMINED)
        sound = are_finite(filter->K, n) && are_finite(filter->L, n) && are_finite(filter->ahead, n) &&
                isfinite(filter->S) && isfinite(filter->sigma) && filter->S >= 0 && filter->sigma >= 0;
    const int64_t counts[] = {filter->rows, filter->steady, filter->next_check, filter->agreed,
                              filter->rejected, filter->agreeing, filter->since_jump};
    for (int k = 0; k < 7; k++) sound = sound && is_count(counts[k], EVER);
    return sound;
}

int smoother_is_sound(const settings_t *settings, const forward_t *forward) {
    return limits_are_sound(&forward->limits) && filter_is_sound((int)settings->states, &forward->filter);
}

/* Return whether a state, which may come from a file, is one that this channel can have: then no place is outside of
   its array, either. */
int channel_is_sound(const settings_t *settings, const state_t *state) {
    const int n = (int)state->states;
    int sound = state->layout == LAYOUT && state->states == settings->states && n >= 1 && n <= N_MAX;
    sound = sound && limits_are_sound(&state->limits) && monitor_is_sound(&state->monitor);
    sound = sound && filter_is_sound(n, &state->filter);
    for (int k = 0; k < VERDICTS; k++)
        sound = sound && is_count(state->counts[k], EVER) && is_count(state->faults.met[k], EVER);
    sound = sound && is_count(state->faults.rows, EVER) && isfinite(state->faults.steps);
    return sound;
}

static void process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                    const estimate_t *estimate) {
    pass_t pass;
    judge_rows(settings, state, block, estimate, &pass);
    filter_block(settings, model, &state->filter, block, estimate, &pass);
    watch_rows(settings, model, state, block, estimate, &pass);
}

void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate) {
    for (int64_t row = 0; row < block->rows; row += BLOCK) {
        const block_t part = rows_from(block, row, BLOCK);
        const estimate_t out = estimate_from(estimate, row, settings->states);
        process(settings, model, state, &part, &out);
    }
}

void channel_call(const call_t *call) {
    channel_process(call->settings, call->model, call->state, call->block, call->estimate);
}

int64_t channel_packed_size(const int64_t states) { return size_around(states, sizeof(state_t)); }

void channel_pack(const state_t *state, char *packed) {
    pack_around(state->states, (const char *)state, sizeof *state, offsetof(state_t, filter), packed);
}

void channel_unpack(const int64_t states, const char *packed, state_t *state) {
    unpack_around(states, packed, sizeof *state, offsetof(state_t, filter), (char *)state);
}

int64_t smoother_packed_size(const int64_t states) { return size_around(states, sizeof(forward_t)); }

void smoother_pack(const int64_t states, const forward_t *forward, char *packed) {
    pack_around(states, (const char *)forward, sizeof *forward, offsetof(forward_t, filter), packed);
}

void smoother_unpack(const int64_t states, const char *packed, forward_t *forward) {
    unpack_around(states, packed, sizeof *forward, offsetof(forward_t, filter), (char *)forward);
}
