/* The filter of one channel, block by block, for the channel, the smoothers and the likelihood. */
#ifndef BECALM_FILTER_H
#define BECALM_FILTER_H

#include <stddef.h>

#include "kernel.h"

enum { BLOCK = SMOOTHED, FIRST_CHECK = 32 }; /* number of rows in a block, and before the first check of the gain */

enum { GOES_ON = 16 }; /* after fewer measurements since a jump, a rejected measurement may be part of the jump */

#define WIDE 1000000000 /* largest variance that a jump adds, over R; measurements then keep some digits */
#define BEYOND_ANY_SENSOR ((real)1e100) /* no sensor measures larger magnitudes */

enum { RESTARTS = 1, JUMPS = 2 }; /* the filter restarts at the row; a rejected measurement of the row is a jump */

/* The results of one pass over a block that the next pass needs. */
typedef struct {
    real usable[BLOCK]; /* measurements, NaN where none may enter the filter */
    int8_t starts[BLOCK]; /* for each row: RESTARTS, JUMPS or 0 */
} pass_t;

/* Discard all measurements so far. */
void filter_forget(filter_t *state);
/* Set the history before the first row: first measurement, number of rows (none missing), and number of steps. */
void filter_begin_after(const settings_t *settings, const coefficients_t *model, limits_t *limits, filter_t *state,
                        real first, int64_t rows, real steps);
/* Return the level to subtract from measurements: the first measurement, or 0 if the model does not keep a level or
   if rounding would hide the noise. */
real filter_level(const settings_t *settings, const coefficients_t *model, real first);
/* Return at most `count` rows of a block from `row` on; the next function returns the estimates from `row` on. */
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
/* Filter a part of at most BLOCK rows whose measurements may all enter; `starts` holds its restarts and jumps. If the
   filter loses all digits at a row, it restarts and marks the row in `starts`. */
void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *part,
                 const estimate_t *estimate, int8_t *starts);

#endif
