/* becalm's filter in C99: no heap, no globals; it needs only sqrt and fabs of libm.

   A channel is one sensor signal: z = h x + v, x' = F x + w. Times are in steps, values in the channel's unit. */
#ifndef BECALM_KERNEL_H
#define BECALM_KERNEL_H

#include <math.h>
#include <stdint.h>

#include "sizes.h"

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "becalm's filter marks missing readings by NaN, and -ffast-math assumes that there is no NaN: compile without it."
#endif

typedef double real;

#define NOT_A_NUMBER ((real)NAN)
#define INFINITE ((real)INFINITY)

enum { NN_MAX = N_MAX * N_MAX };

/* The verdict on a measurement; the values of `becalm.core.reading_verdicts.Verdict`. */
enum {
    USED = 0, MISSING = 1, NONFINITE = 2, OVERRANGE = 3, SPIKE = 4, STEP = 5, CLIPPED = 6, STUCK = 7, DEAD = 8,
    DRIFT = 9, OUTLIER = 13, HOLE = 14, RUNAWAY = 15, VERDICTS = 16
};

enum { NEIGHBOURS = 6, SIDE = 3, FEWEST_NEIGHBOURS = 3 }; /* by which an outlier is judged: all, a side, least */
enum { REACH = 256 };       /* rows: a measurement farther away is not a neighbour */
enum { SPREADS = 8 };       /* least distance of an outlier from its neighbours' median, over their spread */
enum { SHORTEST_FILL = 3, LONGEST_FILL = 64 }; /* rows of one value that stands in for missing measurements */
enum { LONGEST_0 = 128 };   /* rows (in a stream: measurements) of 0 that are true readings if 0 ends the range */
enum { EVERY_REPEAT = 2 };  /* `stuck` of a channel that repeats its last measurement for each missing one */
enum { PARTS = 1 << 16 };   /* parts of a sigma: innovations are rounded to whole parts, so that sums are exact */
enum { MOST_SIGMA = 6 };    /* sigma: a larger innovation counts as this */
enum { HOP = 16 };          /* innovations that are summed together */
enum { WINDOW_HOPS = 4 };   /* hops in a window, whose variance is tested */
enum { KEPT_HOPS = 32 };    /* number of last hops whose powers are kept, to see how large innovations are now */

/* The settings of a channel, from its recipe. */
typedef struct {
    int64_t states;           /* n */
    /* limits */
    real low, high;           /* saturation limits of the converter, in unit */
    real largest;             /* magnitude beyond which a value is not a measurement, in unit */
    real largest_accepted;    /* the same for the filter: beyond it, float64 would round the noise away */
    int64_t stuck;            /* equal measurements in a row that are stuck; 0: any number may be equal */
    /* gross outliers */
    real outlier_distance;    /* from the median of the measurements before, in unit; inf: no outliers */
    real plausible_low, plausible_high; /* bounds of first measurements, and of estimates, in unit */
    int64_t repeats_are_one;  /* whether equal measurements in a row count as one */
    real blank;               /* value that marks a missing measurement, in unit; inf: no such value */
    real far_from_0;          /* a 0 whose neighbours are all farther from 0 is not a measurement, in unit; 0: off */
    /* longest gap that the filter bridges, in steps */
    real longest_gap;
    real gap_spans;           /* the same, over the time that the measurements before span */
    int64_t gap_measurements; /* number of measurements from which on `gap_spans` applies */
    /* innovation gate */
    int64_t gated;            /* whether there is a gate */
    real gate_threshold;      /* largest |innovation| over its standard deviation */
    int64_t gate_agree;       /* this many rejects in a row that agree mean that the signal has jumped */
    int64_t gate_most;        /* this many rejects in a row are accepted in any case */
    int64_t gate_level;       /* the state that a jump adds to; -1: all states */
    /* monitor */
    int64_t drift_threshold;  /* threshold of the cumulative sums, in 2^-16 sigma */
    real dead_variance;       /* variance of a window's innovations below which the sensor is dead, in sigma^2 */
    /* uncertainty */
    int64_t timed;            /* whether times are uncertain */
    real step_s;              /* one step, in s */
    real time_std_s;          /* standard uncertainty of a measurement's time, in s */
    real time_variance;       /* the part of its effect that R already includes, in unit^2 */
    real factor;              /* sigma with the uncertainty of the tuning, over sigma without it */
    int64_t calibrated;       /* whether the sensitivity or the zero is uncertain */
    real relative_std, offset_std; /* standard uncertainty of the sensitivity, relative; of the zero, in unit */
    real unknown_from;        /* a row without a measurement is a hole from this sigma on, in unit */
} settings_t;

/* The coefficients of a channel, computed once; the matrices of its steps come with every call. */
typedef struct {
    real h[N_MAX];       /* output of the measurement */
    real c[N_MAX];       /* output of the signal */
    real R;              /* variance of a measurement, in unit^2 */
    real widest;         /* the state is determined once the next measurement is predicted with this variance, over R */
    real prior[NN_MAX];  /* upper triangular root of the model's own information; mostly 0 */
    int64_t keeps_level; /* whether a constant added to the measurements is added to the signal */
    int64_t disturbed;   /* whether c differs from h: the signal leaves out disturbances */
} coefficients_t;

/* The state of the limits: the last measurements. */
typedef struct {
    real last_value;       /* the last measurement */
    int64_t run;           /* how often it came in a row */
    real least, most;      /* extremes so far */
    int64_t outlier;       /* 1: the last value is one; 2: it stands in for missing measurements, or is stuck */
    real past[NEIGHBOURS]; /* ring buffer of the last different measurements */
    real waits[NEIGHBOURS]; /* for each of them, steps since the measurement before */
    int64_t at;            /* index of the oldest one, which the next one replaces */
    real since;            /* steps since the last measurement */
    real now, last;        /* last row, and last measurement, in steps from the first measurement since a start */
    int64_t measurements;  /* number of measurements since the start */
    int64_t impossible;    /* number of values in a row that no motion of this channel reaches */
} limits_t;

/* The state of the filter and its gate. Of each array, the first n or n * n numbers are used; arrays come last, see
   pack.h. */
typedef struct {
    int64_t phase;            /* UNKNOWN, GATHERING, DETERMINED */
    real level;               /* subtracted from every measurement, in unit */
    int64_t has_level;        /* whether the level is set */
    real S;                   /* innovation variance */
    real sigma;               /* standard uncertainty of the signal, in unit */
    /* settling */
    real S_then, sigma_then;  /* at the last check */
    int64_t settled;          /* whether gain and sigma are the steady-state ones for this step */
    int64_t steady, next_check, agreed; /* complete rows of equal steps; at the next check; agreeing checks in a row */
    real last_step;           /* length of the step before the last complete row; -1: none */
    int64_t predicted;        /* whether `ahead` and L belong to the last row */
    int64_t rows, settled_row; /* number of rows; the first with the steady-state gain, -1: none */
    /* gate */
    int64_t rejected, agreeing; /* number of rejects in a row; of those that agree */
    real last_rejected, wandered; /* innovation of the last reject; how far predictions may have moved since */
    int64_t since_jump;       /* measurements used since the last jump; below 0 all are accepted */
    int64_t jumped;           /* whether there was a jump */
    real burst;               /* largest innovation since the jump, in unit */
    real x[N_MAX];            /* state; while GATHERING, right-hand side of the information */
    real ahead[N_MAX];        /* predicted state, once the gain has settled */
    real K[N_MAX], L[N_MAX];  /* gains of the filtered and of the predicted state */
    real K_then[N_MAX], variance_then[N_MAX]; /* at the last check */
    real P[NN_MAX];           /* covariance; while GATHERING, root of the information */
} filter_t;

/* The state of the monitor of innovations; sums are in 2^-16 sigma. */
typedef struct {
    int64_t rows;             /* number of rows */
    /* cumulative sums on either side; rows where these began, and where the first drift began, -1: none */
    int64_t above, below, above_since, below_since, drift_since;
    /* innovations in the open hop, their sum and sum of squares; complete hops; whether the last window is too quiet */
    int64_t hop_count, hop_total, hop_squares, hops, silent;
    int64_t totals[WINDOW_HOPS - 1], squares[WINDOW_HOPS - 1]; /* of the last complete hops */
    real hop_power, powers[KEPT_HOPS]; /* sums of squares of the open hop and of the last ones, in sigma^2 */
} monitor_t;

/* The state of a monitor without a filter; it includes the times of the last row, and of the first row in the open
   hop. */
typedef struct {
    monitor_t monitor;
    real now, opened; /* in steps from the very first row */
} record_monitor_t;

/* The sums over each complete hop. */
typedef struct {
    int64_t *totals, *squares; /* in parts of a sigma, and in parts^2 */
    real *powers;              /* sums of squares, in sigma^2 */
    real *steps;               /* from the very first row to the hop's first innovation */
} hops_t;

/* Faults of measurements and of their times, by verdict; independent of what is estimated there. */
typedef struct {
    int64_t rows;                 /* number of rows */
    real steps;                   /* from the first row to the last */
    int64_t met[VERDICTS], first_row[VERDICTS]; /* number of faults; row of the first one */
    real first_step[VERDICTS];    /* steps from the first row to there */
} faults_t;

/* The state around a filter: limits before it, monitor after it. */
typedef struct {
    limits_t limits;
    monitor_t monitor;
    real last_signal, slope; /* in unit, and in unit/s */
    real entered;            /* the last measurement that entered the filter */
    int64_t missed;          /* whether the last row had no measurement */
    /* no later estimate depends on the following */
    int64_t counts[VERDICTS];
    faults_t faults;
    real timing_share;       /* the largest relative increase of sigma by uncertain times */
} sensor_t;

enum { LAYOUT = 4 }; /* version of the state: raise it with every change, so that older checkpoints are refused */

/* Everything that later rows depend on. */
typedef struct {
    int64_t layout, states;
    sensor_t sensor;
    filter_t filter;
} state_t;

enum { UNKNOWN, GATHERING, DETERMINED, LOST }; /* LOST: the state of several channels is undetermined for good */

/* A block of rows. */
typedef struct {
    const real *z;        /* measurements, in unit; NaN where missing */
    const real *elapsed;  /* steps since the row before; after 0 steps the state is unchanged, whatever F and Q are */
    const int32_t *step;  /* index, in F and Q, of the step since the row before */
    const real *F, *Q;    /* matrices of the steps, (n, n) each */
    int64_t rows;
} block_t;

/* The estimates of a block of rows. */
typedef struct {
    real *signal, *sigma;         /* in unit */
    int8_t *verdict;              /* on input, the verdict on each row's time; on output, that on the row */
    real *innovation, *deviation; /* measurement minus its prediction, and its expected standard deviation, in unit; NaN
                                     where there is no prediction, or the measurement is rejected */
    real *x;                      /* filtered state without the level, n per row, NaN while undetermined; NULL: not
                                     written */
} estimate_t;

/* The information of later rows on a state: the smoothed state is x + P r, its covariance P - P M P. */
typedef struct {
    int64_t settled, steady, next_check; /* whether M is the steady-state one; the others as in filter_t */
    int64_t later;                 /* whether P, or x and P, are those of the row after */
    real level;                    /* that of the row after, in unit */
    real r[N_MAX], x[N_MAX];       /* x, P: smoothed */
    real M[NN_MAX], P[NN_MAX];
    real M_then[NN_MAX];           /* at the last check */
    real F[NN_MAX], Q[NN_MAX];     /* those of the step to the row after */
} future_t;

/* The state of a forward pass between two blocks. */
typedef struct {
    limits_t limits;
    filter_t filter;
} forward_t;

/* The terms of a likelihood; the product of all S is `product` times 2^exponent. */
typedef struct {
    real squares; /* sum of nu^2 / S */
    real product;
    int64_t exponent;
    int64_t used; /* number of measurements */
} score_t;

void channel_start(const settings_t *settings, state_t *state);
/* Set the history before the first row, as for a smoother, with its least and its greatest measurement. */
void channel_begin_after(const settings_t *settings, const coefficients_t *model, state_t *state, real first,
                         int64_t rows, real steps, real least, real most);
/* Reduce a state to what later estimates depend on: if these bytes are equal, so are the estimates. The hops are left
   out if the sensor is known to be alive. */
void channel_reduce(const settings_t *settings, state_t *state, int alive);
/* Reset the counts of verdicts and faults, and the first row with the steady-state gain. */
void channel_forget_counts(state_t *state);
int channel_is_sound(const settings_t *settings, const state_t *state);
void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate);

/* Return the number of bytes of a state without the unused part of its arrays; these bytes are a checkpoint. */
int64_t channel_packed_size(int64_t states);
void channel_pack(const state_t *state, char *packed);
void channel_unpack(int64_t states, const char *packed, state_t *state);
int64_t smoother_packed_size(int64_t states);
void smoother_pack(int64_t states, const forward_t *forward, char *packed);
void smoother_unpack(int64_t states, const char *packed, forward_t *forward);

/* The arguments of `channel_process` in one struct, because each argument costs time in Python. Verdicts start as USED.
   */
typedef struct {
    const settings_t *settings;
    const coefficients_t *model;
    state_t *state;
    const block_t *block;
    const estimate_t *estimate;
} call_t;

void channel_call(const call_t *call);

/* Return whether the state of a forward pass, which may come from a file, is possible. */
int smoother_is_sound(const settings_t *settings, const forward_t *forward);

/* A smoother passes forward, then back. `z` of its block holds NaN where no measurement may enter; `verdict` is 0.
   Between the passes it needs memory: `smoother_room` reals in `room`, and one byte per row in `starts`, which marks
   where the filter restarts or jumps. If rejected measurements turn out to be a jump, the first of them is marked, and
   all are used. So the last rows of a block may be left for the next one. `smoother_forward` returns how many rows it
   filtered: a multiple of SMOOTHED, or all of them at the end of the record. */
int64_t smoother_room(int64_t states, int64_t rows);
void smoother_start(forward_t *forward, future_t *future);
/* Set the history before the first row: its first measurement, and its number of rows, none missing, and of steps. */
void smoother_begin_after(const settings_t *settings, const coefficients_t *model, forward_t *forward, real first,
                          int64_t rows, real steps);
int64_t smoother_forward(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                         const block_t *block, const estimate_t *estimate, real *room, int8_t *starts, int ends);
/* Pass back over a block. With `only_future` its estimates stay those of the forward pass. */
void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                       int only_future);

/* Smooth with a fixed lag. A block has the waiting rows again, and then the new ones; `forward` is the state before
   them, and afterwards that after the first `ready` rows. These are smoothed with the rows up to `lag` after each; do
   not pass them again. z and verdict are as for a smoother. `room` has `lag_room` reals, `places` two numbers per row,
   `starts` one. Return the first row with the steady-state gain, counted from the very first row; or -1. */
int64_t lag_room(int64_t states, int64_t rows, int64_t lag);
int64_t lag_smooth(const settings_t *settings, const coefficients_t *model, forward_t *forward, const block_t *block,
                   const estimate_t *estimate, int64_t lag, int64_t ready, real *room, int64_t *places, int8_t *starts);

/* The verdict on a stamp: taken; before the last one; equal to it; far ahead; taken after a jump of the clock; none. */
enum { TAKEN_STAMP = 0, LATE_STAMP = 1, REPEATED_STAMP = 2, FAR_STAMP = 3, CLOCK_RESET = 4, NO_STAMP = 5 };
enum { AGREEING = 8 }; /* this many ascending stamps in a row, before the last one or far ahead: the clock has jumped */

/* The clock of a stream. */
typedef struct {
    real grid, last, started; /* even time of the last row, and its stamp, in s; whether there was a stamp */
    real step;                /* in s */
    real slack;               /* largest distance of a stamp from the even grid, in steps */
    real farthest;            /* longest gap that a single stamp can show, in s */
    real pace;                /* steps of the sender's clock in one of ours */
    real held, held_last;     /* stamps held back in a row; the last of them, in s */
    real opened;              /* whether the source was opened again since the last stamp */
    real coarse;              /* whether rows may share a stamp */
} stamps_t;

/* Write the steps before each row, 0 for the first, and the verdict on its stamp; `doubled` marks rows that have the
   same measurements as the row before. */
void clock_walk(stamps_t *state, const real *stamps, const int8_t *doubled, int64_t rows, real *elapsed, int8_t *codes);

void scan_start(limits_t *limits, record_monitor_t *watched);
/* Return whether these states, which may come from a file, are possible. */
int scan_is_sound(const limits_t *limits, const record_monitor_t *watched);
/* Write faults of measurements over those of their times; return how many verdicts are then not 0. */
int64_t scan_faults(const settings_t *settings, limits_t *state, const real *z, const real *elapsed, int64_t rows,
                    int8_t *verdict);
/* Reduce the state of the limits to what later verdicts depend on. */
void scan_reduce(const settings_t *settings, limits_t *state);
/* Monitor innovations over their standard deviations, NaN where there is none; return how many hops ended. */
int64_t scan_innovations(const settings_t *settings, record_monitor_t *state, const real *normalised, const real *elapsed,
                         int64_t rows, int8_t *verdict, const hops_t *hops);
/* Write OUTLIER for each measurement, NaN where missing, that is farther than `distance` from its neighbours on both
   sides. Write STUCK for `stuck` or more equal ones in a row, from the first on, unless the signal rests; 0: any number
   may be equal. Rows before `begun` have their verdict already; the others must be 0. `values`, one number per row, and
   `ends`, two per row, are memory. Return the first row that has to wait for later ones; if `whole`, none does. */
int64_t scan_outliers(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                      int64_t begun, int whole, real *values, int64_t *ends, int8_t *verdict);
/* The same, but each row waits for at most `ahead` rows. If too few measurements come within them, the measurements
   before decide, with the settings' distance. Return how many rows are written. */
int64_t scan_outliers_soon(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                           int64_t begun, int64_t ahead, int whole, real *values, int64_t *ends, int8_t *verdict);
/* Write the distance of measurements, more than NEIGHBOURS of them, from the median of their neighbours on both sides,
   and the spread of these. */
void measure_distances(const real *z, int64_t rows, int64_t *ends, real *distances, real *spreads);
/* Write the distance of measurements from the median of the six before them, from the seventh on. */
void measure_jumps(const real *z, int64_t rows, real *jumps);

/* Add nu^2 / S and log S of rows `from` and later to a score. */
void likelihood_add(const settings_t *settings, const coefficients_t *model, const block_t *block, int64_t from,
                    score_t *score);

#endif
