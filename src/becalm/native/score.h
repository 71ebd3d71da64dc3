/* What makes a likelihood (8), added up. No logarithm is needed: what it is taken of is multiplied. */
#ifndef BECALM_SCORE_H
#define BECALM_SCORE_H

#include "becalm.h"

enum { POWER = 60 };

#define LARGE ((real)1152921504606846976) /* 2^POWER: products are kept between it and its inverse */

/* Return a factor without powers of two that are counted in an exponent. */
static real near_one(real factor, int64_t *exponent) {
    for (; factor > LARGE; *exponent += POWER) factor *= 1 / LARGE;
    for (; factor < 1 / LARGE; *exponent -= POWER) factor *= LARGE;
    return factor;
}

/* Add an innovation whose variance is S, above 0 and finite. */
static inline void add_score(score_t *score, const real nu, const real S) {
    score->squares += nu * nu / S;
    score->used++;
    score->product = near_one(score->product * near_one(S, &score->exponent), &score->exponent);
}

#endif
