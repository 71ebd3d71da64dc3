/* What a channel, a smoother and a likelihood have in common: the filter of one channel, block by block. */
#ifndef BECALM_FILTER_H
#define BECALM_FILTER_H

#include "becalm.h"

enum { BLOCK = SMOOTHED, FIRST_CHECK = 32 }; /* rows; rows until a gain may have settled */

enum { GOES_ON = 16 }; /* measurements used since a jump: before so many a rejected one still belongs to it */

#define BEYOND_ANY_SENSOR ((real)1e100)

enum { ANEW = 1, JUMPS = 2 }; /* the filter starts anew before a row; a measurement that is rejected is a jump at once */

/* What the passes over a block hand on to each other. */
typedef struct {
    real usable[BLOCK]; /* measurements, NaN where none may enter the filter */
    int8_t starts[BLOCK]; /* ANEW, JUMPS or 0 */
} pass_t;

/* Forget all that was measured. */
void filter_forget(filter_t *state);
/* Return what measurements are relative to: the first of them, unless that would round their noise away. */
real filter_level(const settings_t *settings, const coefficients_t *model, real first);
/* Filter at most BLOCK rows. */
void filter_block(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *block,
                  const estimate_t *estimate, pass_t *pass);

#endif
