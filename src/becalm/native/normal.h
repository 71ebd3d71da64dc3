/* exp, log and the normal distribution, computed only by arithmetic: the results of C libraries differ in the last
   digit, so that IMM estimates would differ between machines. */
#ifndef BECALM_NORMAL_H
#define BECALM_NORMAL_H

#include <string.h>

#include "pair.h"

#define LEAST_EXPONENT ((real)-708)    /* least argument of exp; below this, the result is 0 */
#define LEAST_TAIL ((real)1e-300)      /* least probability, whose normal quantile is -37 */
#define ROOT_2 ((real)1.41421356237309504880)
#define ROOT_2_PI ((real)2.50662827463100050242)

/* ln 2 in two parts; a whole multiple of the first part is exact. */
static const real LN_2_HIGH = (real)0x1.62e42fefap-1, LN_2_LOW = (real)0x1.cf79abc9e3b3ap-40;

/* Return e^x of two numbers below 709: x = k ln 2 + r, and e^r is a quotient of polynomials (Pade, order 6). */
INLINE pair_t exponentials(const pair_t x) {
    const pair_t shift = both((real)6755399441055744); /* 1.5 * 2^52: adding it rounds a number to a whole one */
    const pair_t shifted = x * (real)1.44269504088896340736 + shift, k = shifted - shift;
    const pair_t r = (x - k * LN_2_HIGH) - k * LN_2_LOW, s = r * r;
    const pair_t even = (real)665280 + s * ((real)75600 + s * ((real)840 + s));
    const pair_t odd = r * ((real)332640 + s * ((real)10080 + s * (real)42));
    const pair_t power = (pair_t)(((bits_t)shifted + 1023) << 52); /* 2^k */
    return choose(x < both(LEAST_EXPONENT), both(0), power * (1 + 2 * odd / (even - odd)));
}

INLINE real exponential(const real x) { return exponentials(both(x))[0]; }

/* Return log x of two numbers that are normal, 0 or infinite: x = 2^k m, log m = 2 artanh f, f = (m - 1) / (m + 1). */
INLINE pair_t logarithms(const pair_t x) {
    const uint64_t root_half = 0x3FE6A09E667F3BCDu, one = 0x3FF0000000000000u;
    const bits_t bits = (bits_t)x, powers = (bits + (one - root_half)) >> 52;
    const pair_t m = (pair_t)(bits - ((powers - 1023) << 52)), k = {(real)powers[0] - 1023, (real)powers[1] - 1023};
    const pair_t f = (m - 1) / (m + 1), s = f * f;
    pair_t p = both(0);
    UNROLL
    for (int i = 21; i >= 3; i -= 2) p = s * ((real)1 / i + p);
    const pair_t found = k * LN_2_HIGH + (2 * f + (2 * f * p + k * LN_2_LOW));
    if (x[0] > 0 && x[0] < INFINITE && x[1] > 0 && x[1] < INFINITE) return found;
    return choose(x < both(INFINITE), choose(x > both(0), found, both(-INFINITE)), x);
}

INLINE real logarithm(const real x) { return logarithms(both(x))[0]; }

INLINE real polynomial(const int n, const real *coefficients, const real x) {
    real s = 0;
    for (int i = 0; i < n; i++) s = s * x + coefficients[i];
    return s;
}

/* Return the probability of a standard normal number larger than u >= 0, times e^(u^2 / 2). Source: Cody, Mathematics
   of Computation 23 (1969) 631, of erfc. */
static inline real scaled_tail(const real u) {
    static const real A[] = {1.85777706184603153e-1, 3.16112374387056560, 1.13864154151050156e2, 3.77485237685302021e2,
                             3.20937758913846947e3};
    static const real B[] = {1, 2.36012909523441209e1, 2.44024637934444173e2, 1.28261652607737228e3,
                             2.84423683343917062e3};
    static const real C[] = {2.15311535474403846e-8, 5.64188496988670089e-1, 8.88314979438837594, 6.61191906371416295e1,
                             2.98635138197400131e2, 8.81952221241769090e2, 1.71204761263407058e3,
                             2.05107837782607147e3, 1.23033935479799725e3};
    static const real D[] = {1, 1.57449261107098347e1, 1.17693950891312499e2, 5.37181101862009858e2,
                             1.62138957456669019e3, 3.29079923573345963e3, 4.36261909014324716e3,
                             3.43936767414372164e3, 1.23033935480374942e3};
    static const real P[] = {1.63153871373020978e-2, 3.05326634961232344e-1, 3.60344899949804439e-1,
                             1.25781726111229246e-1, 1.60837851487422766e-2, 6.58749161529837803e-4};
    static const real Q[] = {1, 2.56852019228982242, 1.87295284992346725, 5.27905102951428412e-1,
                             6.05183413124413191e-2, 2.33520497626869185e-3};
    const real y = u / ROOT_2, square = y * y;
    if (y <= (real)0.46875)
        return (real)0.5 * exponential(square) * (1 - y * polynomial(5, A, square) / polynomial(5, B, square));
    if (y <= 4) return (real)0.5 * polynomial(9, C, y) / polynomial(9, D, y);
    const real part = polynomial(6, P, 1 / square) / (square * polynomial(6, Q, 1 / square));
    return (real)0.5 * ((real)0.56418958354775628695 - part) / y;
}

/* Return the probability of a standard normal number larger than u >= 0. */
static inline real upper_tail(const real u) { return scaled_tail(u) * exponential((real)-0.5 * u * u); }

/* Return the normal quantile of a value, given the probabilities of smaller and of larger values. The error of the
   first approximation is below 5e-4 (Hastings 1955; Abramowitz and Stegun 26.2.23); two steps of Newton's method each
   double the number of correct digits. */
static inline real normal_score(const real below, const real above) {
    static const real A[] = {(real)0.010328, (real)0.802853, (real)2.515517};
    static const real B[] = {(real)0.001308, (real)0.189269, (real)1.432788, 1};
    real tail = below < above ? below : above;
    tail = tail > LEAST_TAIL ? tail < (real)0.5 ? tail : (real)0.5 : LEAST_TAIL;
    const real wanted = logarithm(tail), t = sqrt(-2 * wanted);
    real u = t - polynomial(3, A, t) / polynomial(4, B, t);
    for (int k = 0; k < 2; k++) {
        u = u > 0 ? u : 0;
        const real scaled = scaled_tail(u);
        u += (logarithm(scaled) - (real)0.5 * u * u - wanted) * scaled * ROOT_2_PI;
    }
    return above < below ? u : -u;
}

#endif
