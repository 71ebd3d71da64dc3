/* Keep products of many factors in range, so that only the whole product needs a logarithm. */
#ifndef BECALM_PRODUCT_H
#define BECALM_PRODUCT_H

#include "kernel.h"

enum { POWER = 60 }; /* exponent of LARGE */

#define LARGE ((real)1152921504606846976) /* 2^POWER: products are kept between it and its inverse */

/* Scale a factor by a power of two into the range from 1 / LARGE to LARGE, and add the opposite power to the exponent; 0
   and infinity do not change. */
static inline real near_one(real factor, int64_t *exponent) {
    for (; factor > LARGE && factor < INFINITE; *exponent += POWER) factor *= 1 / LARGE;
    for (; factor < 1 / LARGE && factor > 0; *exponent -= POWER) factor *= LARGE;
    return factor;
}

#endif
