/* Vectors of two numbers, so that one instruction processes both. GCC and Clang have such types for any processor. */
#ifndef BECALM_PAIR_H
#define BECALM_PAIR_H

#include "linear.h"

#define SIDE_BY_SIDE __attribute__((vector_size(2 * sizeof(real)), aligned(sizeof(real)), may_alias))

typedef real pair_t SIDE_BY_SIDE;
typedef int64_t mask_t SIDE_BY_SIDE; /* the result of a comparison of pairs */
typedef uint64_t bits_t SIDE_BY_SIDE;

/* Return a pointer to two numbers of an array as a pair. */
INLINE pair_t *at(real *numbers) { return (pair_t *)numbers; }

INLINE pair_t both(const real value) { return (pair_t){value, value}; }
INLINE pair_t first_of(const pair_t pair) { return (pair_t){pair[0], pair[0]}; }
INLINE pair_t second_of(const pair_t pair) { return (pair_t){pair[1], pair[1]}; }
INLINE pair_t roots(const pair_t pair) { return (pair_t){sqrt(pair[0]), sqrt(pair[1])}; }

INLINE pair_t choose(const mask_t which, const pair_t a, const pair_t b) {
    return (pair_t){which[0] ? a[0] : b[0], which[1] ? a[1] : b[1]};
}

#endif
