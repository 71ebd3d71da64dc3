/* What a channel, a smoother and a likelihood have in common: the filter of one channel, block by block. */
#ifndef BECALM_FILTER_H
#define BECALM_FILTER_H

#include <stddef.h>

#include "kernel.h"

enum { BLOCK = SMOOTHED, FIRST_CHECK = 32 }; /* rows; rows until a gain may have settled */

enum { GOES_ON = 16 }; /* measurements used since a jump: before so many a rejected one still belongs to it */

#define WIDE 1000000000 /* times R, the most that a jump adds: a measurement then keeps some digits */
#define BEYOND_ANY_SENSOR ((real)1e100)

enum { ANEW = 1, JUMPS = 2 }; /* the filter starts anew before a row; a measurement that is rejected is a jump at once */

/* What the passes over a block hand on to each other. */
typedef struct {
    real usable[BLOCK]; /* measurements, NaN where none may enter the filter */
    int8_t starts[BLOCK]; /* ANEW, JUMPS or 0 */
} pass_t;

/* Forget all that was measured. */
void filter_forget(filter_t *state);
/* Say what went before the first row: the first measurement, and how many rows and steps, all measured. */
void filter_begin_after(const settings_t *settings, const coefficients_t *model, limits_t *limits, filter_t *state,
                        real first, int64_t rows, real steps);
/* Return what measurements are relative to: the first of them, unless that would round their noise away. */
real filter_level(const settings_t *settings, const coefficients_t *model, real first);
/* Return at most so many rows of a block from one on, and where what is estimated of them goes. */
static inline block_t rows_from(const block_t *block, const int64_t row, const int64_t count) {
    block_t part = *block;
    part.z += row, part.elapsed += row, part.step += row;
    part.rows = block->rows - row < count ? block->rows - row : count;
    return part;
}

static inline estimate_t estimate_from(const estimate_t *estimate, const int64_t row, const int64_t n) {
    const estimate_t part = {estimate->signal + row, estimate->sigma + row, estimate->verdict + row,
                             estimate->innovation + row, estimate->deviation + row,
                             estimate->x ? estimate->x + row * n : NULL};
    return part;
}

/* Filter at most BLOCK rows. */
void filter_block(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *block,
                  const estimate_t *estimate, pass_t *pass);
/* The same where all measurements of a part may enter, and it was found where the filter starts anew, or jumps. */
void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *part,
                 const estimate_t *estimate, const int8_t *starts);

#endif
