/* A channel at its own rate, one row at a time: what a controller runs. */
#ifndef BECALM_DEVICE_H
#define BECALM_DEVICE_H

#include "kernel.h"

/* All that is known of a channel before its first row. */
typedef struct {
    settings_t settings;
    coefficients_t model;
    real F[NN_MAX], Q[NN_MAX]; /* of one step, (n, n) */
    real P[NN_MAX];            /* covariance of a state that was filtered for long, (n, n) */
    real still[N_MAX];         /* the state, for each unit of a signal that stays */
} device_t;

/* All that later rows depend on, and how well the signal of the last row is known. */
typedef struct {
    state_t channel;
    real sigma; /* in unit; inf while nothing tells the signal */
} device_state_t;

enum { STARTING = 32 }; /* beside the verdicts: used, and told as it is, for measurements do not tell the signal yet */

void device_start(const device_t *device, device_state_t *state);
/* Begin at a signal that has been so for long; at one that is no measurement, at nothing. */
void device_start_at(const device_t *device, device_state_t *state, real signal);
/* Take a measurement, NaN where none came; return what became of it. The signal is a number, whatever comes: where none
   is estimated, the last measurement that was used; in a hole, what the model predicts. */
int device_step(const device_t *device, device_state_t *state, real z, real *signal);
/* Go on for rows without a measurement, as one step. */
void device_gap(const device_t *device, device_state_t *state, uint32_t rows);

#endif
