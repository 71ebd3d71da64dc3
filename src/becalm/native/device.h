/* The filter of a controller: one channel at its own rate, one row at a time. */
#ifndef BECALM_DEVICE_H
#define BECALM_DEVICE_H

#include "kernel.h"

/* The constants of a channel. */
typedef struct {
    settings_t settings;
    coefficients_t model;
    real F[NN_MAX], Q[NN_MAX]; /* matrices of one step, (n, n) */
    real P[NN_MAX];            /* steady-state covariance of the state, (n, n) */
    real still[N_MAX];         /* the state at rest, per unit of the signal */
} device_t;

/* The state that later rows depend on, and the sigma of the last row. */
typedef struct {
    state_t channel;
    real sigma; /* in unit; inf while the signal is undetermined */
} device_state_t;

enum { STARTING = 32 }; /* verdict: used, and returned as the signal, because the signal is undetermined */

void device_start(const device_t *device, device_state_t *state);
/* Start at a signal that has been constant for a long time; if it is no possible measurement, start without it. */
void device_start_at(const device_t *device, device_state_t *state, real signal);
/* Process a measurement, NaN if it is missing; return the verdict. The signal is always a number: in a hole it is the
   model's prediction, otherwise, without an estimate, the last used measurement, or 0 before the first. */
int device_step(const device_t *device, device_state_t *state, real z, real *signal);
/* Process this many rows without measurements as one step. */
void device_gap(const device_t *device, device_state_t *state, uint32_t rows);

#endif
