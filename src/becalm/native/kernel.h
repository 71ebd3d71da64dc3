/* becalm's filter in C99: no heap, no globals, of libm only sqrt and fabs.

   A channel is one sensor signal: z = h x + v, x' = F x + w. Times are in steps, values in the channel's unit. */
#ifndef BECALM_KERNEL_H
#define BECALM_KERNEL_H

#include <math.h>
#include <stdint.h>

#include "sizes.h"

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "becalm's filter tells what is missing by NaN, which -ffast-math forgets: leave that out."
#endif

typedef double real;

#define NOT_A_NUMBER ((real)NAN)
#define INFINITE ((real)INFINITY)

enum { NN_MAX = N_MAX * N_MAX };

/* What became of a measurement; the values of `becalm.core.verdict.Verdict`. */
enum {
    USED = 0, MISSING = 1, NONFINITE = 2, OVERRANGE = 3, SPIKE = 4, STEP = 5, CLIPPED = 6, STUCK = 7, DEAD = 8,
    DRIFT = 9, OUTLIER = 13, HOLE = 14, RUNAWAY = 15, VERDICTS = 16
};

enum { NEIGHBOURS = 6, SIDE = 3, FEWEST_NEIGHBOURS = 3 }; /* measurements that a gross outlier is held against */
enum { REACH = 256 };       /* rows beyond which a measurement is no neighbour */
enum { SPREADS = 8 };       /* of its neighbours, that an outlier is away from their median */
enum { SHORTEST_FILL = 3, LONGEST_FILL = 64 }; /* rows of one value that fill in for measurements */
enum { LONGEST_0 = 128 };   /* rows of 0, causally measurements of it, beyond which it is what the sensor reads */
enum { EVERY_REPEAT = 2 };  /* equal measurements in a row that are stuck where a channel holds its last one */
enum { PARTS = 1 << 16 };   /* of a sigma: innovations are summed in whole ones, so that sums are exact */
enum { MOST_SIGMA = 6 };    /* what one innovation may say */
enum { HOP = 16 };          /* innovations that are summed together */
enum { WINDOW_HOPS = 4 };   /* hops whose variance is looked at together */
enum { KEPT_HOPS = 32 };    /* the last ones, whose power says how large innovations are now */

/* What a recipe says of a channel. */
typedef struct {
    int64_t states;           /* n */
    /* limits */
    real low, high;           /* saturation limits of the converter, in unit */
    real largest;             /* magnitude beyond which a value is no measurement, in unit */
    real largest_accepted;    /* the same, beside the filter's noise: beyond, float64 would round the noise away */
    int64_t stuck;            /* equal measurements in a row that are stuck; 0: any number may be equal */
    /* gross outliers */
    real outlier_distance;    /* from the median of the measurements before, in unit; inf finds none */
    real plausible_low, plausible_high; /* first measurements, and estimates, in unit */
    int64_t repeats_are_one;  /* whether equal measurements in a row count as one */
    real blank;               /* what is written where there is no measurement; inf where nothing is */
    real far_from_0;          /* in unit: a 0 whose neighbours are all farther away is none; 0: every 0 is one */
    /* gaps that are bridged, in steps */
    real longest_gap;
    real gap_spans;           /* times the time that the measurements before span */
    int64_t gap_measurements; /* so many have to come before that counts */
    /* innovation gate */
    int64_t gated;
    real gate_threshold;      /* |innovation| over its standard deviation */
    int64_t gate_agree;       /* rejected ones in a row that agree: the signal has jumped */
    int64_t gate_most;        /* rejected ones in a row, whatever they are */
    int64_t gate_level;       /* the state that a jump adds to; -1: all of them */
    /* monitor */
    int64_t drift_threshold;  /* of a cumulative sum, in 2^-16 sigma */
    real dead_variance;       /* of the innovations in a window, in sigma^2 */
    /* uncertainty */
    int64_t timed;
    real step_s;              /* one step, in s */
    real time_std_s;          /* standard uncertainty of a measurement's time, in s */
    real time_variance;       /* what of it R holds already, in unit^2 */
    real factor;              /* sigma of an uncertain tuning over that of a certain one */
    int64_t calibrated;
    real relative_std, offset_std; /* of the sensitivity, as a share; of the zero, in unit */
    real unknown_from;        /* sigma from which on a row without a measurement is a hole, in unit */
} settings_t;

/* What is computed once for a channel; the matrices of its steps come with every call. */
typedef struct {
    real h[N_MAX];       /* what is measured of the state */
    real c[N_MAX];       /* what of the state is the signal */
    real R;              /* variance of a measurement, in unit^2 */
    real widest;         /* variance of the next measurement's prediction, in R: beyond, the state is not known yet */
    real prior[NN_MAX];  /* upper triangular root of the information that the model itself has; mostly 0 */
    int64_t keeps_level; /* whether a constant added to the measurements is added to the signal */
    int64_t disturbed;   /* whether c is not h: the signal is less than what is measured */
} coefficients_t;

/* What the limits remember of the measurements before. */
typedef struct {
    real last_value;       /* the last measurement */
    int64_t run;           /* how often it came in a row */
    real least, most;      /* so far */
    int64_t outlier;       /* whether the last value is an outlier; 2: it fills in for measurements, and may be stuck */
    real past[NEIGHBOURS]; /* the last measurements that differ, in a ring */
    real waits[NEIGHBOURS]; /* steps before each of them since the measurement before */
    int64_t at;            /* where the oldest of them is, and the next will be */
    real since;            /* steps since the last measurement */
    real now, last;        /* steps from the first measurement since a start to the last row, and measurement */
    int64_t measurements;  /* since the start */
    int64_t impossible;    /* values in a row that are no motion of this channel */
} limits_t;

/* What the filter and its gate know. Of each array the first n, or n * n, count; they come last, see pack.h. */
typedef struct {
    int64_t phase;            /* UNKNOWN, GATHERING, DETERMINED */
    real level;               /* that is subtracted from every measurement, in unit */
    int64_t has_level;        /* whether it is known */
    real S;                   /* innovation variance */
    real sigma;               /* of the signal */
    /* settling */
    real S_then, sigma_then;  /* at the last check */
    int64_t settled;          /* whether the gain, and sigma, are those of all later rows like the last */
    int64_t steady, next_check, agreed; /* rows since the last gap; when to look again; checks that agreed in a row */
    real last_step;           /* in steps; -1: none */
    int64_t predicted;        /* whether `ahead` and L are those of the last row */
    int64_t rows, settled_row; /* so far; the first that was filtered with a settled gain, -1: none */
    /* gate */
    int64_t rejected, agreeing; /* in a row */
    real last_rejected, wandered; /* innovation, and how far predictions may have moved since */
    int64_t since_jump;       /* measurements used since; below 0 all are believed */
    int64_t jumped;
    real burst;               /* largest innovation since the jump, in unit */
    real x[N_MAX];            /* state; while GATHERING right-hand side of the information */
    real ahead[N_MAX];        /* predicted state, of a filter that has settled */
    real K[N_MAX], L[N_MAX];  /* gains of the filtered and of the predicted state */
    real K_then[N_MAX], variance_then[N_MAX]; /* at the last check */
    real P[NN_MAX];           /* covariance; while GATHERING root of the information */
} filter_t;

/* What the monitor remembers of innovations; sums are in 2^-16 sigma. */
typedef struct {
    int64_t rows;             /* so far */
    int64_t above, below, above_since, below_since, drift_since;
    int64_t hop_count, hop_total, hop_squares, hops, silent;
    int64_t totals[WINDOW_HOPS - 1], squares[WINDOW_HOPS - 1];
    real hop_power, powers[KEPT_HOPS]; /* in sigma^2 */
} monitor_t;

/* Innovations that are watched by themselves, with the time of the last row, and of the first in the hop that is open. */
typedef struct {
    monitor_t monitor;
    real now, opened; /* in steps from the first row of all */
} watched_t;

/* What is told of each whole hop. */
typedef struct {
    int64_t *totals, *squares; /* in parts of a sigma, and in parts^2 */
    real *powers;              /* sums of squares, in sigma^2 */
    real *steps;               /* from the first row of all to that of its first innovation */
} hops_t;

/* What was wrong with measurements, or with their times, whatever is estimated there; for each verdict. */
typedef struct {
    int64_t rows;                 /* so far */
    real steps;                   /* from the first row to the last */
    int64_t met[VERDICTS], first_row[VERDICTS];
    real first_step[VERDICTS];    /* steps from the first row to there */
} faults_t;

/* What is remembered around a filter: of measurements, and of innovations. */
typedef struct {
    limits_t limits;
    monitor_t monitor;
    real last_signal, slope; /* in unit, and in unit/s */
    real entered;            /* the last measurement that entered */
    int64_t missed;          /* whether the last row had none */
    /* what no later estimate depends on */
    int64_t counts[VERDICTS];
    faults_t faults;
    real timing_share;       /* the largest share that uncertain times have added to sigma */
} sensor_t;

enum { LAYOUT = 4 }; /* of a state: raise it with every change, for a checkpoint of another one is refused */

/* All that later rows depend on. */
typedef struct {
    int64_t layout, states;
    sensor_t sensor;
    filter_t filter;
} state_t;

enum { UNKNOWN, GATHERING, DETERMINED };

/* A block of rows. */
typedef struct {
    const real *z;        /* measurements, in unit; NaN where missing */
    const real *elapsed;  /* steps since the row before; of 0 the state is that of the row before, whatever F and Q are */
    const int32_t *step;  /* which step that is */
    const real *F, *Q;    /* of the steps, (n, n) each */
    int64_t rows;
} block_t;

/* What is estimated of it. */
typedef struct {
    real *signal, *sigma;         /* in unit */
    int8_t *verdict;              /* comes with what is wrong with a row's time */
    real *innovation, *deviation; /* what a measurement differs from its prediction by, and is expected to, in unit; NaN
                                     where there is no prediction, or the measurement is not believed */
    real *x;                      /* filtered state without the level, n a row, NaN while nothing determines it; NULL: not
                                     wanted */
} estimate_t;

/* What later rows say of a state: its smoothed value is x + P r, its covariance P - P M P. */
typedef struct {
    int64_t settled, steady, next_check; /* of M: whether it is that of all rows before like the last; see filter_t */
    int64_t later;                 /* whether P, or x and P, are those of the row after */
    real level;                    /* of the row after, in unit */
    real r[N_MAX], x[N_MAX];       /* x, P: smoothed */
    real M[NN_MAX], P[NN_MAX];
    real M_then[NN_MAX];           /* at the last check */
    real F[NN_MAX], Q[NN_MAX];     /* of the step to the row after */
} future_t;

/* What a pass forward knows between two blocks. */
typedef struct {
    limits_t limits;
    filter_t filter;
} forward_t;

/* What makes a likelihood; the product of all S is `product` times 2^exponent. */
typedef struct {
    real squares; /* sum of nu^2 / S */
    real product;
    int64_t exponent;
    int64_t used; /* measurements */
} score_t;

void channel_start(const settings_t *settings, state_t *state);
/* Say, before the first row, what went before, as of a smoother; and the least and the most that was measured. */
void channel_begin_after(const settings_t *settings, const coefficients_t *model, state_t *state, real first,
                         int64_t rows, real steps, real least, real most);
/* Leave of a state only what later estimates depend on: where these bytes are the same, so are they. Of a sensor that is
   surely alive where its hops begin does not matter. */
void channel_reduce(const settings_t *settings, state_t *state, int alive);
void channel_forget_counts(state_t *state);
int channel_is_sound(const settings_t *settings, const state_t *state);
void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate);

/* Without the room that its arrays do not need, a state has so many bytes; they are a checkpoint. */
int64_t channel_packed_size(int64_t states);
void channel_pack(const state_t *state, char *packed);
void channel_unpack(int64_t states, const char *packed, state_t *state);
int64_t smoother_packed_size(int64_t states);
void smoother_pack(int64_t states, const forward_t *forward, char *packed);
void smoother_unpack(int64_t states, const char *packed, forward_t *forward);

/* A call of `channel_process`, in one argument: from Python each costs time. Verdicts begin as USED. */
typedef struct {
    const settings_t *settings;
    const coefficients_t *model;
    state_t *state;
    const block_t *block;
    const estimate_t *estimate;
} call_t;

void channel_call(const call_t *call);

/* Return whether what a pass forward knows, which may come from a file, can be. */
int smoother_is_sound(const settings_t *settings, const forward_t *forward);

/* A smoother passes forward, then back. `z` of its block holds NaN where no measurement may enter; `verdict` is 0.
   Between the passes it needs room for so many reals, and for where the filter starts anew, or jumps. Where measurements
   that are rejected turn out to be a jump, the first of them is, and all are used; so the last rows of a block may be
   left for the next. Return how many rows were taken: a multiple of SMOOTHED, or all of them where the record ends. */
int64_t smoother_room(int64_t states, int64_t rows);
void smoother_start(forward_t *forward, future_t *future);
/* Say, before the first row, what went before: the first measurement, and how many rows and steps, all measured. */
void smoother_begin_after(const settings_t *settings, const coefficients_t *model, forward_t *forward, real first,
                          int64_t rows, real steps);
int64_t smoother_forward(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                         const block_t *block, const estimate_t *estimate, real *room, int8_t *starts, int ends);
/* Come back over a block. With `only_future` its estimates stay those of the pass forward. */
void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, const int8_t *starts,
                       int only_future);

/* A fixed lag: rows that wait come again, before the new ones; `forward` is what was known before them. The first `told`
   rows are smoothed by those up to `lag` after each, and do not come again. z and verdict as of a smoother. `room` has so
   many reals, `places` two a row, `starts` one. Return the first row, of all that came, with a settled gain; or -1. */
int64_t lag_room(int64_t states, int64_t rows, int64_t lag);
int64_t lag_smooth(const settings_t *settings, const coefficients_t *model, forward_t *forward, const block_t *block,
                   const estimate_t *estimate, int64_t lag, int64_t told, real *room, int64_t *places, int8_t *starts);

/* What became of a stamp: taken; before or at the row before; far ahead; taken, though the clock jumped; none. */
enum { TAKEN_STAMP = 0, LATE_STAMP = 1, REPEATED_STAMP = 2, FAR_STAMP = 3, CLOCK_RESET = 4, NO_STAMP = 5 };
enum { AGREEING = 8 }; /* stamps in a row, behind or far ahead of the clock, that ascend: then it is the clock that jumped */

/* The clock of a stream. */
typedef struct {
    real grid, last, started; /* where the even grid stands, and the last stamp, in s; whether there was one */
    real step;                /* in s */
    real slack;               /* how far off the grid a stamp may lie, in steps */
    real farthest;            /* longest gap that one stamp is believed, in s */
    real pace;                /* steps of the sender's clock in one of ours */
    real held, held_last;     /* stamps held back in a row; the last of them, in s */
    real opened;              /* whether the source was opened anew since */
    real coarse;              /* whether rows may share a stamp */
} stamps_t;

/* Write the steps before each row, 0 of the first, and what becomes of it; `doubled` says which rows have the very
   measurements of the row before. */
void clock_walk(stamps_t *state, const real *stamps, const int8_t *doubled, int64_t rows, real *elapsed, int8_t *codes);

void scan_start(limits_t *limits, watched_t *watched);
/* Return whether what is remembered, which may come from a file, can be. */
int scan_is_sound(const limits_t *limits, const watched_t *watched);
/* Write what is wrong with measurements over what is wrong with their times; return how many verdicts are not 0. */
int64_t scan_faults(const settings_t *settings, limits_t *state, const real *z, const real *elapsed, int64_t rows,
                    int8_t *verdict);
/* Leave of what limits remember only what later verdicts depend on. */
void scan_reduce(const settings_t *settings, limits_t *state);
/* Watch innovations over their standard deviations, NaN where there is none; return how many hops ended. */
int64_t scan_innovations(const settings_t *settings, watched_t *state, const real *normalised, const real *elapsed,
                         int64_t rows, int8_t *verdict, const hops_t *hops);
/* Write OUTLIER for each measurement, NaN where missing, that is farther than a distance from its neighbours on both
   sides, and STUCK for so many equal ones in a row, from the first on, unless they are a rest; 0: any number may be
   equal. Rows before `begun` are written already; the others come with 0. `values`, one a row, and `ends`, two a row,
   are room. Return the first row that has to wait for later ones: none where the record is whole. */
int64_t scan_outliers(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                      int64_t begun, int whole, real *values, int64_t *ends, int8_t *verdict);
/* The same where each row waits for so many after it, and no more: where hardly a measurement comes within them, the
   settings' distance counts, which is for those before. Return how many rows are written. */
int64_t scan_outliers_soon(const settings_t *settings, real distance, int64_t stuck, const real *z, int64_t rows,
                           int64_t begun, int64_t ahead, int whole, real *values, int64_t *ends, int8_t *verdict);
/* Write how far measurements, more than NEIGHBOURS, are from the median of their neighbours on both sides, and how far
   these spread. */
void measure_distances(const real *z, int64_t rows, int64_t *ends, real *distances, real *spreads);
/* Write how far measurements are from the median of the six before them, from the seventh on. */
void measure_jumps(const real *z, int64_t rows, real *jumps);

/* Add nu^2 / S and log S of rows `from` and later to a score. */
void likelihood_add(const settings_t *settings, const coefficients_t *model, const block_t *block, int64_t from,
                    score_t *score);

#endif
