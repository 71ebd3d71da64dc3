/* Run a channel at its own rate, one row at a time; the filter itself is in channel.c. */
#include "device.h"

#include "doubling.h"
#include "gate.h"
#include "opening.h"
#include "sensor.h"

#define LONG ((real)1e9) /* assumed time for which the signal was constant before the start, in steps */

void device_start(const device_t *device, device_state_t *state) {
    channel_start(&device->settings, &state->channel);
    state->sigma = INFINITE;
}

void device_start_at(const device_t *device, device_state_t *state, const real signal) {
    const settings_t *settings = &device->settings;
    const coefficients_t *model = &device->model;
    filter_t *filter = &state->channel.filter;
    const int n = (int)settings->states;
    real Pc[N_MAX];
    device_start(device, state);
    if (no_measurement(settings, signal) || fabs(signal) > settings->largest_accepted) return;
    if (signal <= settings->low || signal >= settings->high) return;
    filter_begin_after(settings, model, &state->channel.sensor.limits, filter, signal, settings->gap_measurements,
                       LONG);
    filter->phase = DETERMINED;
    for (int i = 0; i < n; i++) filter->x[i] = (signal - filter->level) * device->still[i];
    copy(n * n, device->P, filter->P);
    times(n, filter->P, model->c, Pc);
    filter->sigma = sqrt(dot(n, model->c, Pc));
    state->channel.sensor.entered = signal;
    filter->since_jump = settings->gate_most > GOES_ON ? settings->gate_most : GOES_ON;
    state->sigma = widened(settings, model->R, &state->channel.sensor, signal, filter->sigma, 1);
}

/* Process the row after a step; return the signal, NaN if there is no estimate. */
static real process_row(const device_t *device, device_state_t *state, const real z, const real elapsed, const real *F,
                 const real *Q, int8_t *verdict) {
    const int32_t step = 0;
    real signal, innovation, deviation;
    const block_t block = {&z, &elapsed, &step, F, Q, 1};
    const estimate_t estimate = {&signal, &state->sigma, verdict, &innovation, &deviation, NULL};
    channel_process(&device->settings, &device->model, &state->channel, &block, &estimate);
    if (isnan(signal)) state->sigma = INFINITE;
    return signal;
}

/* Return the model's prediction, even if it is very uncertain; NaN while the signal is undetermined. */
static real predicted(const device_t *device, const filter_t *filter) {
    const int n = (int)device->settings.states;
    real signal = NOT_A_NUMBER, sigma;
    if (filter->phase == DETERMINED) return dot(n, device->model.c, filter->x) + filter->level;
    estimate_from_information(n, device->model.h, filter->P, filter->x, &signal, &sigma);
    return signal + filter->level;
}

int device_step(const device_t *device, device_state_t *state, const real z, real *signal) {
    int8_t verdict = USED;
    *signal = process_row(device, state, z, 1, device->F, device->Q, &verdict);
    if (!isnan(*signal)) return verdict;
    if (verdict == HOLE) *signal = predicted(device, &state->channel.filter);
    const real entered = state->channel.sensor.entered;
    if (isnan(*signal)) *signal = isnan(entered) ? 0 : entered;
    return verdict == USED ? STARTING : verdict;
}

void device_gap(const device_t *device, device_state_t *state, const uint32_t rows) {
    real F[NN_MAX], Q[NN_MAX];
    int8_t verdict = USED;
    if (rows == 0) return;
    many_steps((int)device->settings.states, device->F, device->Q, rows, F, Q);
    (void)process_row(device, state, NOT_A_NUMBER, rows, F, Q, &verdict);
}
