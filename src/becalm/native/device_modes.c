/* Run a channel with several modes at its own rate, one row at a time; the filter itself is in imm.c. */
#include "device_modes.h"

#include <string.h>

#include "doubling.h"
#include "sensor.h"

enum { SINGLE = 1000 }; /* rows of a gap that are processed one by one; then the mode probabilities are constant */
enum { ROOM = 2 * ((MODES_MAX + 1) / 2 * (4 * NN_MAX + 3 * N_MAX) + NN_MAX) };

static imm_state_t *modes_of(device_modes_state_t *state) { return (imm_state_t *)(void *)state->now; }

static const real *probabilities(const device_modes_state_t *state) {
    return ((const imm_state_t *)(const void *)state->now)->beliefs;
}

/* Discard all measurements so far. */
static void forget(const device_modes_t *device, device_modes_state_t *state) {
    imm_state_t *now = modes_of(state);
    memset(state->now, 0, sizeof state->now);
    now->layout = IMM_LAYOUT, now->states = device->settings.states, now->modes = device->modes;
    now->has_level = !device->keeps_level;
}

void device_modes_start(const device_modes_t *device, device_modes_state_t *state) {
    start_sensor(&state->sensor);
    forget(device, state);
    state->sigma = INFINITE;
}

/* Process the row after a step; return the signal, NaN if there is no estimate. Write the signal of the filter to
   `filtered`, also in a hole. */
static real process_row(const device_modes_t *device, device_modes_state_t *state, const real z, const real elapsed,
                 const real *F, const real *Q, const real *T, int8_t *verdict, real *filtered) {
    const settings_t *settings = &device->settings;
    const int32_t step = 0;
    const imm_t imm = {settings->states, device->modes, F, Q, T, device->h, device->c, device->R, device->tail,
                       device->start, device->V, device->rejects, settings->largest_accepted, device->largest_level};
    const imm_passed_t nothing = {NULL, NULL};
    real signal = NOT_A_NUMBER, innovation = NOT_A_NUMBER, deviation = NOT_A_NUMBER, wild = 0, room[ROOM];
    score_t score = {.product = 1};
    const block_t block = {&z, &elapsed, &step, F, Q, 1};
    const estimate_t estimate = {&signal, &state->sigma, verdict, &innovation, &deviation, NULL};
    const imm_estimate_t imm_estimate = {&signal, &state->sigma, &innovation, &deviation, NULL, &wild, NULL, 1};
    pass_t pass;
    state->sigma = INFINITE;
    judge_rows(settings, &state->sensor, &block, verdict, &pass);
    if (pass.starts[0] == RESTARTS) forget(device, state);
    const imm_block_t row = {pass.usable, &step, 1};
    imm_filter(&imm, modes_of(state), &row, &imm_estimate, &nothing, room, &score);
    if (device->rejects && wild > (real)0.5 && *verdict == USED) *verdict = SPIKE;
    *filtered = signal;
    watch_rows(settings, device->noise_variance, &state->sensor, &block, &estimate, &pass);
    if (isnan(signal)) state->sigma = INFINITE;
    return signal;
}

int device_modes_step(const device_modes_t *device, device_modes_state_t *state, const real z, real *signal) {
    int8_t verdict = USED;
    real filtered;
    *signal = process_row(device, state, z, 1, device->F, device->Q, device->T, &verdict, &filtered);
    if (isnan(*signal)) *signal = verdict == HOLE ? filtered : isnan(state->sensor.entered) ? 0 : state->sensor.entered;
    return verdict;
}

void device_modes_start_at(const device_modes_t *device, device_modes_state_t *state, const real signal) {
    real estimate;
    device_modes_start(device, state);
    (void)device_modes_step(device, state, signal, &estimate);
}

/* Write T^rows, the transition probabilities over this many steps. */
static void power_of_transitions(const int m, const real *T, uint32_t rows, real *power) {
    real B[MODES_MAX * MODES_MAX], more[MODES_MAX * MODES_MAX];
    copy(m * m, T, B);
    for (int i = 0; i < m * m; i++) power[i] = i % (m + 1) == 0;
    for (; rows; rows >>= 1) {
        multiply(m, B, power, more);
        if (rows & 1) copy(m * m, more, power);
        multiply(m, B, B, more);
        copy(m * m, more, B);
    }
}

void device_modes_gap(const device_modes_t *device, device_modes_state_t *state, const uint32_t rows) {
    const int n = (int)device->settings.states, m = (int)device->modes;
    const uint32_t single = rows < SINGLE ? rows : SINGLE;
    real F[MODES_MAX * NN_MAX], Q[MODES_MAX * NN_MAX], T[MODES_MAX * MODES_MAX], estimate;
    int8_t verdict = USED;
    for (uint32_t row = 0; row < single; row++) (void)device_modes_step(device, state, NOT_A_NUMBER, &estimate);
    if (rows == single) return;
    for (int j = 0; j < m; j++)
        many_steps(n, device->F + j * n * n, device->Q + j * n * n, rows - single, F + j * n * n, Q + j * n * n);
    power_of_transitions(m, device->T, rows - single, T);
    (void)process_row(device, state, NOT_A_NUMBER, rows - single, F, Q, T, &verdict, &estimate);
}

real device_modes_probability(const device_modes_t *device, const device_modes_state_t *state, const uint32_t mode) {
    return mode < device->modes ? probabilities(state)[mode] : 0;
}
