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

/* The verdict on a measurement; the values are those of `becalm.core.reading_verdicts.Verdict`. */
enum {
    USED = 0, MISSING = 1, NONFINITE = 2, OVERRANGE = 3, SPIKE = 4, STEP = 5, CLIPPED = 6, STUCK = 7, DEAD = 8,
    DRIFT = 9, OUTLIER = 13, HOLE = 14, RUNAWAY = 15, VERDICTS = 16
};

enum { NEIGHBOURS = 6, SIDE = 3, FEWEST_NEIGHBOURS = 3 }; /* numbers of neighbours: all, on one side, least */
enum { REACH = 256 };       /* rows: a measurement farther away is not a neighbour */
enum { SPREADS = 8 };       /* least distance of an outlier from its neighbours' median, over their spread */
enum { SHORTEST_FILL = 3, LONGEST_FILL = 64 }; /* rows in a run of one value that may replace missing measurements */
enum { LONGEST_0 = 128 };   /* rows (in a stream: measurements) of 0 that are readings if 0 is an end of the range */
enum { EVERY_REPEAT = 2 };  /* value of `stuck` if a channel repeats its last measurement for each missing one */
enum { PARTS = 1 << 16 };   /* parts of a sigma: innovations are rounded to whole parts, so that sums are exact */
enum { MOST_SIGMA = 6 };    /* largest innovation of the monitor, in sigma; larger ones are reduced to this */
enum { HOP = 16 };          /* innovations that are summed together */
enum { WINDOW_HOPS = 4 };   /* hops in a window, whose variance is tested */
enum { KEPT_HOPS = 32 };    /* number of last hops whose powers are kept: the present size of innovations */

/* The settings of a channel, from its recipe. */
typedef struct {
    int64_t states;           /* n */
    /* limits */
    real low, high;           /* saturation limits of the converter, in unit */
    real largest;             /* magnitude beyond which a value is not a measurement, in unit */
    real largest_accepted;    /* largest magnitude in the filter: beyond it, float64 rounds the noise away, in unit */
    int64_t stuck;            /* this many equal measurements in a row are stuck; 0: any number may be equal */
    /* gross outliers */
    real outlier_distance;    /* largest distance from the median of earlier measurements, in unit; inf: no outliers */
    real plausible_low, plausible_high; /* bounds of estimates and of the first measurements, in unit */
    int64_t repeats_are_one;  /* whether equal measurements in a row count as one */
    real blank;               /* value that marks a missing measurement, in unit; inf: no such value */
    real far_from_0;          /* a 0 whose neighbours are all farther from 0 is not a measurement, in unit; 0: off */
    /* longest gap that the filter bridges, in steps */
    real longest_gap;
    real gap_spans;           /* longest gap over the time from the first to the last earlier measurement */
    int64_t gap_measurements; /* number of measurements from which on `gap_spans` applies */
    /* innovation gate */
    int64_t gated;            /* whether there is a gate */
    real gate_threshold;      /* largest |innovation| over its standard deviation */
    int64_t gate_agree;       /* this many rejected measurements in a row that agree with each other are a jump */
    int64_t gate_most;        /* this many rejected measurements in a row are accepted in any case */
    int64_t gate_level;       /* the state that a jump adds to; -1: all states */
    /* monitor */
    int64_t drift_threshold;  /* threshold of the cumulative sums, in 2^-16 sigma */
    real dead_variance;       /* variance of a window's innovations below which the sensor is dead, in sigma^2 */
    /* uncertainty */
    int64_t timed;            /* whether times are uncertain */
    real step_s;              /* one step, in s */
    real time_std_s;          /* standard uncertainty of a measurement's time, in s */
    real time_variance;       /* variance by uncertain times that R already includes, in unit^2 */
    real factor;              /* sigma with the uncertainty of the tuning, over sigma without this uncertainty */
    int64_t calibrated;       /* whether the sensitivity or the zero is uncertain */
    real relative_std, offset_std; /* standard uncertainty of the sensitivity, relative; of the zero, in unit */
    real hole_sigma;        /* a row without a measurement is a hole if its sigma is at least this, in unit */
} settings_t;

/* The coefficients of a channel, computed once; the matrices of its steps are passed with every call. */
typedef struct {
    real h[N_MAX];       /* output of the measurement */
    real c[N_MAX];       /* output of the signal */
    real R;              /* variance of a measurement, in unit^2 */
    real widest;         /* largest variance of the next measurement's prediction, over R, for a determined state */
    real prior[NN_MAX];  /* upper triangular root of the model's prior information; mostly 0 */
    int64_t keeps_level; /* whether a constant added to the measurements is added to the signal */
    int64_t disturbed;   /* whether c differs from h: the signal leaves out disturbances */
} coefficients_t;

/* The state of the checks of measurements. */
typedef struct {
    real last_value;       /* the last measurement */
    int64_t run;           /* number of equal measurements in a row */
    real least, most;      /* smallest and largest measurement so far */
    int64_t outlier;       /* 1: the last value is an outlier; 2: it replaces missing measurements, or is stuck */
    real past[NEIGHBOURS]; /* ring buffer of the last different measurements */
    real waits[NEIGHBOURS]; /* for each of these measurements, steps since the previous measurement */
    int64_t at;            /* index in the ring buffer of the oldest measurement, which the next one replaces */
    real since;            /* steps since the last measurement */
    real now, last;        /* times of last row and last measurement, in steps since the first one after a restart */
    int64_t measurements;  /* number of measurements since the restart */
    int64_t impossible;    /* number of values in a row that are beyond any motion of the channel */
} limits_t;

/* The state of the filter and its gate. The arrays are the last fields, see pack.h; their first n or n * n numbers are
   used. */
typedef struct {
    int64_t phase;            /* UNKNOWN, GATHERING, DETERMINED */
    real level;               /* subtracted from every measurement, in unit */
    int64_t has_level;        /* whether the level is set */
    real S;                   /* innovation variance */
    real sigma;               /* standard uncertainty of the signal, in unit */
    /* settling */
    real S_then, sigma_then;  /* S and sigma at the last check */
    int64_t settled;          /* whether gain and sigma are the steady-state ones for this step */
    int64_t steady, next_check, agreed; /* number of complete rows with equal steps, now and at the next check; number
                                           of checks in a row without a change */
    real last_step;           /* length of the step before the last complete row; -1: none */
    int64_t predicted;        /* whether `ahead` and L are those of the last row */
    int64_t rows, settled_row; /* number of rows; first row with the steady-state gain, -1: none */
    /* gate */
    int64_t rejected, agreeing; /* number of rejected measurements in a row, and of those that agree with each other */
    real last_rejected, wandered; /* innovation of the last rejected one; sum of the stds of prediction changes since */
    int64_t since_jump;       /* number of measurements used since the last jump; below 0 all are accepted */
    int64_t jumped;           /* whether there was a jump */
    real burst;               /* largest magnitude of an innovation since the jump, in unit */
    real x[N_MAX];            /* state; while GATHERING, right-hand side b of the information */
    real ahead[N_MAX];        /* predicted state, once the gain has settled */
    real K[N_MAX], L[N_MAX];  /* gains of the filtered and of the predicted state */
    real K_then[N_MAX], variance_then[N_MAX]; /* K and the variances in P at the last check */
    real P[NN_MAX];           /* covariance; while GATHERING, root U of the information */
} filter_t;

/* The state of the monitor of innovations; sums are in 2^-16 sigma. */
typedef struct {
    int64_t rows;             /* number of rows */
    /* cumulative sums of positive and of negative innovations; rows at which these sums, and the first drift, began */
    int64_t above, below, above_since, below_since, drift_since;
    /* number of innovations in the incomplete hop, their sum and sum of squares; number of complete hops; whether the
       last window is too quiet */
    int64_t hop_count, hop_total, hop_squares, hops, silent;
    int64_t totals[WINDOW_HOPS - 1], squares[WINDOW_HOPS - 1]; /* of the last complete hops */
    real hop_power, powers[KEPT_HOPS]; /* sums of squares of the incomplete and of the last hops, in sigma^2 */
} monitor_t;

/* The state of a monitor without a filter. */
typedef struct {
    monitor_t monitor;
    real now, opened; /* times of the last row and of the incomplete hop's first row, in steps from the first row */
} record_monitor_t;

/* The sums over each complete hop. */
typedef struct {
    int64_t *totals, *squares; /* in parts of a sigma, and in parts^2 */
    real *powers;              /* sums of squares, in sigma^2 */
    real *steps;               /* time of the hop's first innovation, in steps from the first row */
} hops_t;

/* The numbers of faults of measurements and of their times, by verdict; estimates have no influence. */
typedef struct {
    int64_t rows;                 /* number of rows */
    real steps;                   /* time from the first row to the last, in steps */
    int64_t met[VERDICTS], first_row[VERDICTS]; /* number of faults; row of the first fault */
    real first_step[VERDICTS];    /* time of the first fault, in steps from the first row */
} faults_t;

/* The state of the checks around a filter: limits before it, monitor after it. */
typedef struct {
    limits_t limits;
    monitor_t monitor;
    real last_signal, slope; /* the last signal, in unit, and its slope, in unit/s */
    real entered;            /* the last measurement that entered the filter */
    int64_t missed;          /* whether the last row had no measurement */
    /* no later estimate depends on the following fields */
    int64_t counts[VERDICTS];
    faults_t faults;
    real timing_share;       /* the largest relative increase of sigma by uncertain times */
} sensor_t;

enum { LAYOUT = 4 }; /* version of the state: raise it with every change, so that older checkpoints are refused */

/* The state of a channel: everything that later rows depend on. */
typedef struct {
    int64_t layout, states;
    sensor_t sensor;
    filter_t filter;
} state_t;

enum { UNKNOWN, GATHERING, DETERMINED, LOST }; /* LOST: the state of several channels is undetermined for good */

/* A block of rows. */
typedef struct {
    const real *z;        /* measurements, in unit; NaN where missing */
    const real *elapsed;  /* steps since the previous row; for 0 the prediction is the state, whatever F and Q are */
    const int32_t *step;  /* index, in F and Q, of the step since the previous row */
    const real *F, *Q;    /* matrices of the steps, (n, n) each */
    int64_t rows;
} block_t;

/* The estimates of a block of rows. */
typedef struct {
    real *signal, *sigma;         /* in unit */
    int8_t *verdict;              /* input: the verdict on each row's time; output: the verdict on the row */
    real *innovation, *deviation; /* measurement minus its prediction, and its expected standard deviation, in unit; NaN
                                     where there is no prediction, or the measurement is rejected */
    real *x;                      /* filtered state without the level, n per row, NaN while undetermined; NULL: not
                                     written */
} estimate_t;

/* The information of later rows on a state: the smoothed state is x + P r, its covariance P - P M P. */
typedef struct {
    int64_t settled, steady, next_check; /* whether M has reached its steady state; the others as in filter_t */
    int64_t later;                 /* whether P, or x and P, of the next row are known, see future.h */
    real level;                    /* level of the next row, in unit */
    real r[N_MAX], x[N_MAX];       /* x: smoothed state of the next row */
    real M[NN_MAX], P[NN_MAX];     /* P: smoothed covariance of the next row */
    real M_then[NN_MAX];           /* M at the last check */
    real F[NN_MAX], Q[NN_MAX];     /* matrices of the step to the next row */
} future_t;

/* The state of a smoother's forward pass between two blocks. */
typedef struct {
    limits_t limits;
    filter_t filter;
} forward_t;

/* The terms of a likelihood, summed over measurements; the product of all S is `product` times 2^exponent. */
typedef struct {
    real squares; /* sum of nu^2 / S */
    real product;
    int64_t exponent;
    int64_t used; /* number of measurements */
} score_t;

void channel_start(const settings_t *settings, state_t *state);
/* Set the history before the first row, as `smoother_begin_after`, with its least and its greatest measurement. */
void channel_begin_after(const settings_t *settings, const coefficients_t *model, state_t *state, real first,
                         int64_t rows, real steps, real least, real most);
/* Reduce a state to what later estimates depend on: states with equal bytes give equal estimates. If the sensor is
   known to be `alive`, leave out the hops. */
void channel_reduce(const settings_t *settings, state_t *state, int alive);
/* Reset the counts of verdicts and faults, and the first row with the steady-state gain. */
void channel_forget_counts(state_t *state);
/* Return whether a state, which may come from a file, is possible for this channel. */
int channel_is_sound(const settings_t *settings, const state_t *state);
void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate);

/* Return the number of bytes of a packed state: a state without the unused part of its arrays, for a checkpoint. */
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

/* A smoother passes forward, then back. `z` of its block is NaN where no measurement may enter the filter; `verdict`
   is 0. The passes share working memory: `smoother_room` reals in `room`, and one byte per row in `starts`, which marks
   the rows at which the filter restarts or the signal jumps. If rejected measurements turn out to be a jump, the first
   is marked, and all of them are used. So the last rows of a block may have to wait for the next block.
   `smoother_forward` returns how many rows it filtered: a multiple of SMOOTHED, or at the end of the record all. */
int64_t smoother_room(int64_t states, int64_t rows);
void smoother_start(forward_t *forward, future_t *future);
/* Set the history before the first row: first measurement, number of rows (none missing), and number of steps. */
void smoother_begin_after(const settings_t *settings, const coefficients_t *model, forward_t *forward, real first,
                          int64_t rows, real steps);
int64_t smoother_forward(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                         const block_t *block, const estimate_t *estimate, real *room, int8_t *starts, int ends);
/* Pass back over a block. With `only_future` only `future` changes, and not the estimates. */
void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                       int only_future);

/* Smooth with a fixed lag. The block holds the waiting rows, then the new rows; z and verdict are as for a smoother.
   The first `ready` rows are smoothed with the rows up to `lag` after each; do not pass these rows again. `forward` is
   the state before the block, and afterwards the state after the first `ready` rows. As working memory, `room` has
   `lag_room` reals, `places` two numbers per row, and `starts` one per row. Return the first row with the steady-state
   gain, counted from the very first row, or -1. */
int64_t lag_room(int64_t states, int64_t rows, int64_t lag);
int64_t lag_smooth(const settings_t *settings, const coefficients_t *model, forward_t *forward, const block_t *block,
                   const estimate_t *estimate, int64_t lag, int64_t ready, real *room, int64_t *places, int8_t *starts);

/* The verdict on a stamp: used; before the last one; equal to it; far ahead; used after a jump of the clock; none. */
enum { TAKEN_STAMP = 0, LATE_STAMP = 1, REPEATED_STAMP = 2, FAR_STAMP = 3, CLOCK_RESET = 4, NO_STAMP = 5 };
enum { AGREEING = 8 }; /* this many ascending stamps in a row, before the last one or far ahead: the clock has jumped */

/* The clock of a stream. */
typedef struct {
    real grid, last, started; /* even time and stamp of the last row, in s; whether there was a stamp */
    real step;                /* in s */
    real slack;               /* largest distance of a stamp from the even grid, in steps */
    real farthest;            /* longest gap that a single stamp can show, in s */
    real pace;                /* steps of the sender's clock in one of ours */
    real held, held_last;     /* number of impossible stamps in a row; the last of these stamps, in s */
    real opened;              /* whether the stream was interrupted since the last stamp */
    real coarse;              /* whether rows may share a stamp */
} stamps_t;

/* Write the steps before each row, 0 for the first row, and the verdict on its stamp; `doubled` marks rows with the
   same measurements as the previous row. */
void clock_walk(stamps_t *state, const real *stamps, const int8_t *doubled, int64_t rows, real *elapsed, int8_t *codes);

void scan_start(limits_t *limits, record_monitor_t *watched);
/* Return whether these states, which may come from a file, are possible. */
int scan_is_sound(const limits_t *limits, const record_monitor_t *watched);
/* Write faults of measurements over faults of their times; return how many verdicts are not 0 afterwards. */
int64_t scan_faults(const settings_t *settings, limits_t *state, const real *z, const real *elapsed, int64_t rows,
                    int8_t *verdict);
/* Reduce the state of the limits to what later verdicts depend on. */
void scan_reduce(const settings_t *settings, limits_t *state);
/* Monitor innovations over their standard deviations, NaN where there is none; return how many hops ended. */
int64_t scan_innovations(const settings_t *settings, record_monitor_t *state, const real *normalised,
                         const real *elapsed, int64_t rows, int8_t *verdict, const hops_t *hops);
/* Write OUTLIER for each measurement that is farther than `distance` from its neighbours on both sides; z is NaN where
   it is missing. Write STUCK for all of `stuck` or more equal measurements in a row, unless the signal rests; with
   `stuck` 0 any number may be equal. The verdicts of rows before `judged_rows` are final; the other verdicts must be 0.
   `values`, with one number per row, and `ends`, with two per row, are working memory. Return the first row that has to
   wait for later rows; if the record is `whole`, no row waits. */
int64_t scan_outliers(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                      int64_t judged_rows, int whole, real *values, int64_t *ends, int8_t *verdict);
/* Do the same, but let each row wait for at most `ahead` rows. If these have too few measurements, compare only earlier
   measurements, with the distance of the settings. Return the number of rows with final verdicts. */
int64_t scan_outliers_soon(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                           int64_t judged_rows, int64_t ahead, int whole, real *values, int64_t *ends, int8_t *verdict);
/* Write the distance of each measurement from the median of its neighbours on both sides, and the spread of these
   neighbours; there must be more than NEIGHBOURS measurements. */
void measure_distances(const real *z, int64_t rows, int64_t *ends, real *distances, real *spreads);
/* Write the distance of each measurement, from the seventh on, from the median of the six before it. */
void measure_jumps(const real *z, int64_t rows, real *jumps);

/* Add nu^2 / S and log S of rows `from` and later to a score. */
void likelihood_add(const settings_t *settings, const coefficients_t *model, const block_t *block, int64_t from,
                    score_t *score);

#endif
