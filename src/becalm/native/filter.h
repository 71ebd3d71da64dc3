/* The filter of one channel, block by block; a channel, a smoother and a likelihood all use it. */
#ifndef BECALM_FILTER_H
#define BECALM_FILTER_H

#include <stddef.h>

#include "kernel.h"

enum { BLOCK = SMOOTHED, FIRST_CHECK = 32 }; /* rows in a block; rows before the first check of the gain */

enum { GOES_ON = 16 }; /* a reject after fewer measurements since a jump may belong to the jump */

#define WIDE 1000000000 /* largest variance that a jump adds, over R; measurements then keep some digits */
#define BEYOND_ANY_SENSOR ((real)1e100) /* no sensor measures larger magnitudes */

enum { RESTARTS = 1, JUMPS = 2 }; /* the filter restarts before this row; a rejected measurement is a jump at once */

/* Data from one pass over a block to the next. */
typedef struct {
    real usable[BLOCK]; /* measurements, NaN where none may enter the filter */
    int8_t starts[BLOCK]; /* RESTARTS, JUMPS or 0 */
} pass_t;

/* Discard all measurements so far. */
void filter_forget(filter_t *state);
/* Set the history before the first row: its first measurement, and its number of rows, none missing, and of steps. */
void filter_begin_after(const settings_t *settings, const coefficients_t *model, limits_t *limits, filter_t *state,
                        real first, int64_t rows, real steps);
/* Return the level to subtract from measurements: the first one, or 0 if the model does not keep a level, or if their
   noise would be rounded away. */
real filter_level(const settings_t *settings, const coefficients_t *model, real first);
/* Return at most `count` rows of a block from `row` on; the next function does so for their estimates. */
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
/* The same for a part whose measurements may all enter; `starts` holds its known restarts and jumps. Where the filter
   loses all digits, it restarts and marks this in `starts`, too. */
void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *part,
                 const estimate_t *estimate, int8_t *starts);

#endif
