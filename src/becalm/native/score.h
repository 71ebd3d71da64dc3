/* Sum the terms of a likelihood: equation (8) of core/reference/kalman.py. */
#ifndef BECALM_SCORE_H
#define BECALM_SCORE_H

#include "product.h"

/* Add an innovation with variance S, which is above 0 and finite. */
static inline void add_score(score_t *score, const real nu, const real S) {
    score->squares += nu * nu / S;
    score->used++;
    score->product = near_one(score->product * near_one(S, &score->exponent), &score->exponent);
}

#endif
