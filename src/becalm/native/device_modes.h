/* Several modes of a channel at its own rate, one row at a time: what a controller runs. */
#ifndef BECALM_DEVICE_MODES_H
#define BECALM_DEVICE_MODES_H

#include "imm.h"

/* All that is known of a channel before its first row; of the modes' arrays see imm.h. */
typedef struct {
    settings_t settings; /* without a gate */
    int64_t modes;
    int64_t keeps_level; /* whether a constant added to the measurements is added to the signal */
    int64_t rejects;
    real largest_level;
    real noise_variance; /* of a measurement in the first mode, in unit^2 */
    real V;
    real F[MODES_MAX * NN_MAX], Q[MODES_MAX * NN_MAX], T[MODES_MAX * MODES_MAX]; /* of one step */
    real h[N_MAX], c[N_MAX];
    real R[MODES_MAX], tail[MODES_MAX], start[MODES_MAX * (1 + N_MAX)];
} device_modes_t;

enum { BELIEFS_MAX = MODES_MAX * (1 + N_MAX + NN_MAX) };

/* All that later rows depend on, and how well the signal of the last row is known. */
typedef struct {
    sensor_t sensor;
    real now[sizeof(imm_state_t) / sizeof(real) + BELIEFS_MAX]; /* the modes */
    real sigma;                                                 /* in unit; inf while nothing tells the signal */
} device_modes_state_t;

void device_modes_start(const device_modes_t *device, device_modes_state_t *state);
/* Begin as after a first measurement; at one that is no measurement, at nothing. */
void device_modes_start_at(const device_modes_t *device, device_modes_state_t *state, real signal);
/* Take a measurement, NaN where none came; return what became of it. The signal is a number, whatever comes: where none
   is estimated, the last measurement that was used; in a hole, what the modes predict. */
int device_modes_step(const device_modes_t *device, device_modes_state_t *state, real z, real *signal);
/* Go on for rows without a measurement: one by one up to a thousand, and the rest as one step. */
void device_modes_gap(const device_modes_t *device, device_modes_state_t *state, uint32_t rows);
/* Return how probable a mode is; 0 before the first measurement, and of one that does not exist. */
real device_modes_probability(const device_modes_t *device, const device_modes_state_t *state, uint32_t mode);

#endif
