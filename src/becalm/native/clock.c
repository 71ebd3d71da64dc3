/* The clock of a stream: count the steps before each row, and detect impossible stamps. It works row by row, so that
   the boundaries between blocks have no influence. */
#include "kernel.h"

#define PULL ((real)0.75)     /* correction of the even grid, over the distance of a stamp from the grid */
#define PULL_PACE ((real)0.1) /* correction of the sender's pace, over this distance */
#define LEAST_PACE ((real)0.98) /* limits of the sender's pace, see stamps_t */
#define GREATEST_PACE ((real)1.02)
#define WHOLE_FROM ((real)4503599627370496) /* 2^52: numbers from here on are whole */

static real nearest_whole(const real x) {
    if (!(fabs(x) < WHOLE_FROM)) return x;
    const real whole = (real)(int64_t)(x + (real)0.5);
    return whole > x + (real)0.5 ? whole - 1 : whole;
}

/* Count an impossible stamp; after AGREEING such stamps in ascending order, the clock has jumped: continue from it. */
static int8_t reject_stamp(stamps_t *state, const real t, real *elapsed) {
    const real passed = t - state->last;
    const int agrees = state->held > 0 && t > state->held_last && t - state->held_last <= state->farthest;
    state->held = agrees ? state->held + 1 : 1;
    state->held_last = t;
    if (state->held < AGREEING) return passed < 0 ? LATE_STAMP : FAR_STAMP;
    *elapsed = passed < 0 ? 1 : passed / state->step;
    state->grid = state->last = t;
    state->pace = 1;
    state->held = state->opened = 0;
    return CLOCK_RESET;
}

/* Count the steps to a stamp that is not before the last stamp; the number is whole if the stamp lies on the grid. */
static int8_t count_steps(stamps_t *state, const real t, const int doubled, real *elapsed) {
    const real steps = (t - state->grid) / state->step, off = steps - state->pace;
    const real whole = nearest_whole(steps / state->pace);
    if (t == state->last && (doubled || state->coarse == 0)) return REPEATED_STAMP;
    if (fabs(off) <= state->slack) {
        *elapsed = 1;
        state->grid += state->step * (state->pace + PULL * off);
        const real pace = state->pace + PULL_PACE * off;
        state->pace = pace < LEAST_PACE ? LEAST_PACE : pace > GREATEST_PACE ? GREATEST_PACE : pace;
    } else if (t == state->last)
        *elapsed = 1;
    else {
        const int on_grid =
            whole >= 1 && fabs(steps / state->pace - whole) <= state->slack && state->slack < (real)0.5;
        *elapsed = on_grid ? whole : (t - state->last) / state->step;
        state->grid = t;
    }
    state->last = t;
    state->held = state->opened = 0;
    return TAKEN_STAMP;
}

void clock_walk(stamps_t *state, const real *stamps, const int8_t *doubled, const int64_t rows, real *elapsed,
                int8_t *codes) {
    for (int64_t k = 0; k < rows; k++) {
        const real t = stamps[k], passed = t - state->last;
        elapsed[k] = 0;
        if (!isfinite(t))
            codes[k] = NO_STAMP;
        else if (state->started == 0) {
            codes[k] = TAKEN_STAMP;
            state->started = 1;
            state->grid = state->last = t;
        } else if (passed < 0 || (passed > state->farthest && state->opened == 0))
            codes[k] = reject_stamp(state, t, elapsed + k);
        else
            codes[k] = count_steps(state, t, doubled[k], elapsed + k);
    }
}
