/* Checkpoints of a channel, or of a smoother's forward pass: reduce a state to what later rows depend on, check a state
   from a file, and pack a state without the unused parts of its arrays. */
#include <string.h>

#include "filter.h"
#include "limits.h"
#include "monitor.h"
#include "pack.h"

/* Reduce the state of the filter; once the gain has settled, the numbers of the checks have no influence. */
static void reduce_filter(const settings_t *settings, filter_t *filter) {
    const int64_t longest = settings->gate_most > GOES_ON ? settings->gate_most : GOES_ON;
    filter->rows = filter->settled_row = 0;
    if (filter->since_jump >= longest) filter->since_jump = longest, filter->jumped = 0, filter->burst = 0;
    if (!filter->rejected) filter->last_rejected = filter->wandered = 0;
    if (!filter->predicted) memset(filter->ahead, 0, sizeof filter->ahead), memset(filter->L, 0, sizeof filter->L);
    if (!filter->settled) return;
    filter->steady = filter->next_check = filter->agreed = 0;
    filter->S_then = filter->sigma_then = 0;
    memset(filter->K_then, 0, sizeof filter->K_then);
    memset(filter->variance_then, 0, sizeof filter->variance_then);
}

void channel_reduce(const settings_t *settings, state_t *state, const int alive) {
    monitor_t *monitor = &state->sensor.monitor, watched = {0};
    reduce_limits(settings, &state->sensor.limits);
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
    state->sensor.faults.rows = 0, state->sensor.faults.steps = 0;
    if (!settings->timed) state->sensor.last_signal = state->sensor.slope = 0;
}

void channel_forget_counts(state_t *state) {
    sensor_t *sensor = &state->sensor;
    const faults_t blank = {.rows = sensor->faults.rows, .steps = sensor->faults.steps};
    memset(sensor->counts, 0, sizeof sensor->counts);
    sensor->faults = blank;
    sensor->timing_share = 0;
    state->filter.settled_row = -1;
}

static int are_finite(const real *numbers, const int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(numbers[i])) return 0;
    return 1;
}

/* Return whether the state of a filter is possible: no counter can overflow, and no number is NaN. */
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

/* If the state is possible, every index is also within its array. */
int channel_is_sound(const settings_t *settings, const state_t *state) {
    const int n = (int)state->states;
    const sensor_t *sensor = &state->sensor;
    int sound = state->layout == LAYOUT && state->states == settings->states && n >= 1 && n <= N_MAX;
    sound = sound && limits_are_sound(&sensor->limits) && monitor_is_sound(&sensor->monitor);
    sound = sound && filter_is_sound(n, &state->filter);
    for (int k = 0; k < VERDICTS; k++)
        sound = sound && is_count(sensor->counts[k], EVER) && is_count(sensor->faults.met[k], EVER);
    sound = sound && is_count(sensor->faults.rows, EVER) && isfinite(sensor->faults.steps);
    return sound;
}

int64_t channel_packed_size(const int64_t states) { return size_after(states, offsetof(state_t, filter)); }

void channel_pack(const state_t *state, char *packed) {
    pack_after(state->states, state, offsetof(state_t, filter), packed);
}

void channel_unpack(const int64_t states, const char *packed, state_t *state) {
    memset(state, 0, sizeof *state);
    unpack_after(states, packed, offsetof(state_t, filter), state);
}

int64_t smoother_packed_size(const int64_t states) { return size_after(states, offsetof(forward_t, filter)); }

void smoother_pack(const int64_t states, const forward_t *forward, char *packed) {
    pack_after(states, forward, offsetof(forward_t, filter), packed);
}

void smoother_unpack(const int64_t states, const char *packed, forward_t *forward) {
    memset(forward, 0, sizeof *forward);
    unpack_after(states, packed, offsetof(forward_t, filter), forward);
}
