/* Several modes, one of which is in force at a time: interacting multiple models (IMM).

   Every mode j is a model of its own of the same n states, x' = F_j x + w_j, z = h x + v_j. Equations are numbered as in
   core/reference/imm.py. Times are in steps, values in the channel's unit. */
#ifndef BECALM_IMM_H
#define BECALM_IMM_H

#include "kernel.h"

enum { IMM_LAYOUT = 1 };   /* of a state: raise it with every change, for a checkpoint of another one is refused */
enum { IMM_BLOCK = 256 };  /* rows that a smoother filters again at once */
enum { NOTED = 3 };        /* numbers that are noted of a measurement, of each mode */

/* The modes, over steps of several lengths. */
typedef struct {
    int64_t states, modes;       /* n, M */
    const real *F, *Q;           /* of each step, (M, n, n) */
    const real *T;               /* of each step, (M, M): the probability of going from mode i to mode j */
    const real *h, *c;           /* (n,) what is measured of the state; what of it is the signal */
    const real *R;               /* (M,) variance of a measurement, in unit^2 */
    const real *tail;            /* (M,) share of measurements that are wild */
    const real *start;           /* (M, 1 + n) probability, and variances of the states, at the first measurement */
    real V;                      /* by how much the variance of wild measurements exceeds that of others, in unit^2 */
    int64_t rejects;             /* whether wild measurements are left out of the estimate */
    real largest, largest_level; /* magnitudes beyond which a value is no measurement, and no level, in unit */
} imm_t;

/* All that later rows depend on. Its bytes are a checkpoint. */
typedef struct {
    int64_t layout, states, modes;
    int64_t has_level;
    real level;     /* that is subtracted from every measurement, in unit */
    real beliefs[]; /* mu (M,), x (M, n), P (M, n, n) of all modes; mu is 0 before the first measurement */
} imm_state_t;

/* A block of rows. */
typedef struct {
    const real *z;       /* measurements, in unit; NaN where missing */
    const int32_t *step; /* which step precedes each; not looked at before the first measurement */
    int64_t rows;
} imm_block_t;

/* What is written of each row, from the first measurement on; NULL where it is not wanted. */
typedef struct {
    real *signal, *sigma;                 /* in unit */
    real *innovation, *innovation_sigma;  /* in unit, of the mixture: the first is its normal score times the second */
    real *probability;                    /* (M, rows) of each mode */
    real *wild;                           /* probability that the measurement is wild */
    real *mean;                           /* (n, rows) of the mixture's states, without the level */
    int64_t rows;                         /* for which there is room in each of them */
} imm_estimate_t;

/* What the way back needs of a pass forward; NULL where it is not wanted. */
typedef struct {
    real *before; /* beliefs before each block of IMM_BLOCK rows */
    real *notes;  /* beliefs after each row, and what its measurement said */
} imm_passed_t;

/* Return how many reals beliefs take, what is noted of a row, what later rows say, and the room that each door needs. */
int64_t imm_beliefs_size(int64_t states, int64_t modes);
int64_t imm_note_size(int64_t states, int64_t modes);
int64_t imm_later_size(int64_t states, int64_t modes);
int64_t imm_filter_room(int64_t states, int64_t modes);
int64_t imm_smooth_room(int64_t states, int64_t modes);

/* Return whether a state, which may come from a file, is one that such modes can have. */
int imm_is_sound(const imm_t *imm, const imm_state_t *state);
/* Filter rows; add to a score the sum of squares, and the product, of which exp(-squares / 2) product is the density of
   all measurements but the first, each times the root of 2 pi. */
void imm_filter(const imm_t *imm, imm_state_t *state, const imm_block_t *block, const imm_estimate_t *estimate,
                const imm_passed_t *passed, real *room, score_t *score);
/* Come back over rows that were filtered, given the beliefs before each block of them, and what all rows after them say,
   which then is what these say, too; `later` begins with 0 where nothing follows. */
void imm_smooth(const imm_t *imm, real level, const imm_block_t *block, const real *before,
                const imm_estimate_t *estimate, real *later, real *room);
/* Smooth with a fixed lag rows that were noted: come back from row `turn` - 1, and each `every` rows later, over `lag`
   rows more. A row is written more than once; the last time it knows no more than `lag` rows after it, and no fewer than
   `lag` - `every` + 1. */
void imm_smooth_late(const imm_t *imm, real level, const int32_t *step, real *notes, int64_t rows, int64_t turn,
                     int64_t every, int64_t lag, const imm_estimate_t *estimate, real *room);

#endif
