/* The filter of a controller with several modes: one channel at its own rate, one row at a time. */
#ifndef BECALM_DEVICE_MODES_H
#define BECALM_DEVICE_MODES_H

#include "imm.h"

/* The constants of a channel; imm.h describes the numbers of the modes. */
typedef struct {
    settings_t settings; /* without a gate */
    int64_t modes;
    int64_t keeps_level; /* whether a constant added to the measurements is added to the signal */
    int64_t rejects;     /* whether the estimate leaves out outliers */
    real largest_level;
    real noise_variance; /* variance of a measurement in the first mode, in unit^2 */
    real V;
    real F[MODES_MAX * NN_MAX], Q[MODES_MAX * NN_MAX], T[MODES_MAX * MODES_MAX]; /* matrices of one step */
    real h[N_MAX], c[N_MAX];
    real R[MODES_MAX], tail[MODES_MAX], start[MODES_MAX * (1 + N_MAX)];
} device_modes_t;

enum { BELIEFS_MAX = MODES_MAX * (1 + N_MAX + NN_MAX) };

/* The state that later rows depend on, and the sigma of the last row. */
typedef struct {
    sensor_t sensor;
    real now[sizeof(imm_state_t) / sizeof(real) + BELIEFS_MAX]; /* the modes */
    real sigma;                                                 /* in unit; inf while the signal is undetermined */
} device_modes_state_t;

void device_modes_start(const device_modes_t *device, device_modes_state_t *state);
/* Start with `signal` as the first measurement; if it is no possible measurement, start without it. */
void device_modes_start_at(const device_modes_t *device, device_modes_state_t *state, real signal);
/* Process a measurement, NaN if it is missing; return the verdict. The signal is always a number: in a hole it is the
   prediction of the modes, otherwise, without an estimate, the last used measurement, or 0 before the first. */
int device_modes_step(const device_modes_t *device, device_modes_state_t *state, real z, real *signal);
/* Process this many rows without measurements: the first thousand one by one, all others as one step. */
void device_modes_gap(const device_modes_t *device, device_modes_state_t *state, uint32_t rows);
/* Return the probability of a mode; 0 before the first measurement, and for a mode that does not exist. */
real device_modes_probability(const device_modes_t *device, const device_modes_state_t *state, uint32_t mode);

#endif
