/* Interacting multiple models (IMM): several modes, of which one is in force at a time.

   Every mode j is a model of the same n states, x' = F_j x + w_j, z = h x + v_j. Outliers are measurements whose noise
   has the variance R_j + V; in names they are `wild`, and their share is `tail`. Equations are numbered as
   in core/reference/imm.py. Times are in steps, values in the channel's unit. */
#ifndef BECALM_IMM_H
#define BECALM_IMM_H

#include "kernel.h"

enum { IMM_LAYOUT = 1 };   /* version of the state: raise it with every change, so that older checkpoints are refused */
enum { IMM_BLOCK = 256 };  /* number of rows in a block, which a smoother filters again as a whole */
enum { NOTED = 3 };        /* number of reals in the note on a measurement, for each mode */

/* The matrices of the modes, for steps of several lengths. */
typedef struct {
    int64_t states, modes;       /* n, M */
    const real *F, *Q;           /* for each step, (M, n, n) */
    const real *T;               /* for each step, (M, M): the probability of going from mode i to mode j */
    const real *h, *c;           /* (n,) output of the measurement, and of the signal */
    const real *R;               /* (M,) variance of a measurement, in unit^2 */
    const real *tail;            /* (M,) share of outliers */
    const real *start;           /* (M, 1 + n) probability, and variances of the states, at the first measurement */
    real V;                      /* extra variance of outliers, in unit^2 */
    int64_t rejects;             /* whether the estimate leaves out outliers */
    real largest, largest_level; /* largest magnitude of a measurement, and of a level, in unit */
} imm_t;

/* The state: everything that later rows depend on. Its bytes are a checkpoint. */
typedef struct {
    int64_t layout, states, modes;
    int64_t has_level;
    real level;     /* subtracted from every measurement, in unit */
    real beliefs[]; /* mu (M,), x (M, n), P (M, n, n) of all modes; mu is 0 before the first measurement */
} imm_state_t;

/* A block of rows. */
typedef struct {
    const real *z;       /* measurements, in unit; NaN where missing */
    const int32_t *step; /* index of the step before each row; ignored before the first measurement */
    int64_t rows;
} imm_block_t;

/* Output arrays for each row from the first measurement on; NULL: not written. */
typedef struct {
    real *signal, *sigma;                 /* in unit */
    real *innovation, *innovation_sigma;  /* normal score times innovation_sigma; std of the mixture, in unit */
    real *probability;                    /* (M, rows) probability of each mode */
    real *wild;                           /* probability that the measurement is an outlier */
    real *mean;                           /* (n, rows) mean state of the mixture, without the level */
    int64_t rows;                         /* second dimension of the arrays */
} imm_estimate_t;

/* Results of the forward pass that the backward pass needs; NULL: not written. */
typedef struct {
    real *before; /* filter states before each block of IMM_BLOCK rows */
    real *notes;  /* filter state after each row, and the likelihoods of its measurement */
} imm_passed_t;

/* Return the number of reals in a filter state, in the note on a row, in the information of later rows, and in the
   working memory of the filter and of the smoother. */
int64_t imm_beliefs_size(int64_t states, int64_t modes);
int64_t imm_note_size(int64_t states, int64_t modes);
int64_t imm_later_size(int64_t states, int64_t modes);
int64_t imm_filter_room(int64_t states, int64_t modes);
int64_t imm_smooth_room(int64_t states, int64_t modes);

/* Return whether a state, which may come from a file, is possible for these modes. */
int imm_is_sound(const imm_t *imm, const imm_state_t *state);
/* Filter rows; update the score: exp(-squares / 2) product is the product of the densities of all measurements except
   the very first, each times the root of 2 pi. */
void imm_filter(const imm_t *imm, imm_state_t *state, const imm_block_t *block, const imm_estimate_t *estimate,
                const imm_passed_t *passed, real *room, score_t *score);
/* Smooth filtered rows, given the filter states before each block of rows, and the information `later` of all rows
   after these rows. Afterwards `later` includes these rows. At the end of a record pass 0 in all of `later`. */
void imm_smooth(const imm_t *imm, real level, const imm_block_t *block, const real *before,
                const imm_estimate_t *estimate, real *later, real *room);
/* Smooth filtered rows with a fixed lag: pass back over `lag` rows from row `turn` - 1, and then from every `every`-th
   row after it. A row may be written more than once; its last estimate uses at most `lag` and at least
   `lag` - `every` + 1 rows after it. */
void imm_smooth_late(const imm_t *imm, real level, const int32_t *step, real *notes, int64_t rows, int64_t turn,
                     int64_t every, int64_t lag, const imm_estimate_t *estimate, real *room);

#endif
