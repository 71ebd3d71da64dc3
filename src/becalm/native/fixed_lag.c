/* Fixed-lag smoother of one channel: smooth each row with the rows up to a lag after it.

   When later rows come, the waiting rows are filtered again from the state before them, so that only this state is
   stored between calls. While the gain is constant, the information of later rows is a weighted sum of their
   innovations. Equations are numbered as in core/reference/kalman.py. */
#include "backward.h"
#include "gap.h"

/* The rows of a block, their filtered states, and their estimates. */
typedef struct {
    const settings_t *settings;
    const coefficients_t *model;
    const block_t *block;
    const estimate_t *estimate;
    int8_t *starts;
    real *states;    /* packed states, with space for one per row */
    int64_t *place;  /* for each row, the index of a stored state with its gain and covariance */
    int64_t *alike;  /* for each row, the number of rows up to this row with the same steady-state gain */
} rows_t;

/* The constants of a stretch of rows with one steady-state gain. */
typedef struct {
    int64_t stretch; /* first row of the stretch; -1: none */
    real sigma;      /* smoothed standard uncertainty of the signal, in unit */
    real Pc[N_MAX], P[NN_MAX];
    real *weights;   /* (lag, n) weights of the innovations of later rows: r is the sum of weight times innovation */
} steady_t;

int64_t lag_room(const int64_t states, const int64_t rows, const int64_t lag) {
    return rows * packed_size(states) + lag * states;
}

INLINE const real *steps_of(const int n, const block_t *block, const real *matrices, const int64_t row) {
    return matrices + (int64_t)block->step[row] * n * n;
}

/* Filter one row, and store the state after it. */
static void filter_one(const int n, const rows_t *rows, filter_t *state, const int64_t row) {
    const block_t one = rows_from(rows->block, row, 1);
    const estimate_t out = estimate_from(rows->estimate, row, n);
    const int64_t settled = state->settled, steady = state->steady;
    filter_part(rows->settings, rows->model, state, &one, &out, rows->starts + row);
    pack(n, state, rows->states + row * packed_size(n));
    const int continues = settled && state->settled && steady == state->steady && row;
    rows->place[row] = row;
    rows->alike[row] = state->settled ? 1 + (continues ? rows->alike[row - 1] : 0) : 0;
}

/* Filter the rows from `row` to before `until`. */
static void filter_until(const int n, const rows_t *rows, filter_t *state, int64_t row, const int64_t until) {
    while (row < until) {
        const int64_t count = !state->settled ? 1 : until - row < SMOOTHED ? until - row : SMOOTHED;
        const block_t part = rows_from(rows->block, row, count);
        const estimate_t out = estimate_from(rows->estimate, row, n);
        real *before = rows->states + row * packed_size(n);
        const int64_t steady = state->steady;
        if (count > 1) {
            pack(n, state, before);
            filter_part(rows->settings, rows->model, state, &part, &out, rows->starts + row);
        }
        if (count > 1 && state->settled && state->steady == steady) { /* all rows have the same gain */
            for (int64_t k = row; k < row + count; k++)
                rows->place[k] = row, rows->alike[k] = 1 + (k ? rows->alike[k - 1] : 0);
        } else {
            if (count > 1) unpack(n, before, state);
            for (int64_t k = row; k < row + count; k++) filter_one(n, rows, state, k);
        }
        row += count;
    }
}

/* Smooth a row, given the information of the later rows. */
INLINE int smooth_at(const int n, const rows_t *rows, const int64_t row, future_t *future, real *signal, real *sigma,
                     real *x) {
    filter_t state;
    unpack(n, rows->states + rows->place[row] * packed_size(n), &state);
    if (x && state.phase == DETERMINED) copy(n, x, state.x); /* the row's own state, not that of its place */
    const real *Q = steps_of(n, rows->block, rows->block->Q, row);
    const int kept = smooth_row(n, rows->model, &state, Q, future, signal, sigma);
    if (x && kept && future->later) copy(n, future->x, x);
    return kept;
}

/* Smooth row `from` with the rows up to `last`. All rows between are also smoothed, which preserves digits; with
   `every` their estimates are also written. */
static void smooth_all(const int n, const rows_t *rows, const int64_t from, const int64_t last, const int every,
                       real *signal, real *sigma, real *x) {
    const estimate_t *out = rows->estimate;
    future_t future;
    forget_future(n, &future);
    for (int64_t k = last; k >= from; k--) {
        const real *F = steps_of(n, rows->block, rows->block->F, k), *Q = steps_of(n, rows->block, rows->block->Q, k);
        const real *packed = rows->states + rows->place[k] * packed_size(n);
        real ignored[2] = {0, 0};
        if (every)
            smooth_at(n, rows, k, &future, out->signal + k, out->sigma + k, out->x ? out->x + k * n : NULL);
        else if (k == from)
            smooth_at(n, rows, k, &future, signal, sigma, x);
        else
            smooth_at(n, rows, k, &future, ignored, ignored + 1, NULL);
        if (packed_phase(packed) == DETERMINED)
            step_back(n, rows->model->h, packed_S(packed), packed_K(n, packed), F, out->innovation[k], &future);
        prepare_row_before(n, F, Q, out->verdict[k], rows->starts[k], &future);
    }
}

/* Smooth a row with the rows up to `last`. */
INLINE void smooth_by(const int n, const rows_t *rows, const int64_t row, const int64_t last, real *signal,
                      real *sigma, real *x) {
    const int gathers = packed_phase(rows->states + rows->place[row] * packed_size(n)) != DETERMINED;
    const real filtered[2] = {*signal, *sigma};
    future_t future;
    forget_future(n, &future);
    for (int64_t k = last; k > row && !gathers; k--) {
        const real *packed = rows->states + rows->place[k] * packed_size(n);
        if (packed_phase(packed) == DETERMINED)
            step_back(n, rows->model->h, packed_S(packed), packed_K(n, packed),
                      steps_of(n, rows->block, rows->block->F, k), rows->estimate->innovation[k], &future);
        if (rows->starts[k] == RESTARTS) forget_future(n, &future);
    }
    if (!gathers && smooth_at(n, rows, row, &future, signal, sigma, x)) return;
    *signal = filtered[0], *sigma = filtered[1];
    smooth_all(n, rows, row, last, 0, signal, sigma, x);
}

/* Compute the constants of the stretch of a row. */
static void describe_stretch(const int n, const rows_t *rows, const int64_t row, const int64_t lag, steady_t *steady) {
    const real *packed = rows->states + rows->place[row] * packed_size(n);
    const real *F = steps_of(n, rows->block, rows->block->F, row);
    real A[NN_MAX], g[N_MAX], signal = 0; /* A = (I - K h) F, g = F' h' */
    steady->stretch = row + 1 - rows->alike[row];
    smooth_by(n, rows, row, row + lag, &signal, &steady->sigma, NULL);
    copy(n * n, packed_P(n, packed), steady->P);
    times(n, steady->P, rows->model->c, steady->Pc);
    multiply_HF(n, 1, rows->model->h, F, g);
    close_loop(n, 1, F, packed_K(n, packed), g, A);
    for (int i = 0; i < n; i++) steady->weights[i] = packed_S(packed) > 0 ? g[i] / packed_S(packed) : 0;
    for (int64_t k = 1; k < lag; k++)
        for (int j = 0; j < n; j++) {
            real s = 0;
            for (int i = 0; i < n; i++) s += A[i * n + j] * steady->weights[(k - 1) * n + i];
            steady->weights[k * n + j] = s;
        }
}

INLINE void smooth_rows(const int n, const rows_t *rows, const int64_t lag, const int64_t ready, steady_t *steady) {
    const estimate_t *out = rows->estimate;
    const int64_t whole = rows->block->rows > lag ? rows->block->rows - lag : 0; /* rows with `lag` rows after */
    if (ready > whole) smooth_all(n, rows, whole, rows->block->rows - 1, 1, NULL, NULL, NULL);
    for (int64_t row = 0; row < ready && row < whole; row++) {
        const int64_t last = row + lag;
        real *x = out->x ? out->x + row * n : NULL;
        if (rows->alike[last] <= lag) {
            smooth_by(n, rows, row, last, out->signal + row, out->sigma + row, x);
            continue;
        }
        real r[N_MAX];
        if (steady->stretch != last + 1 - rows->alike[last]) describe_stretch(n, rows, row, lag, steady);
        for (int i = 0; i < n; i++) r[i] = 0;
        for (int64_t k = 0; k < lag; k++)
            for (int i = 0; i < n; i++) r[i] += steady->weights[k * n + i] * out->innovation[row + 1 + k];
        out->signal[row] += dot(n, steady->Pc, r); /* (9) */
        out->sigma[row] = steady->sigma;
        if (x)
            for (int i = 0; i < n; i++) x[i] += dot(n, steady->P + i * n, r);
    }
}

#define OF_SIZE(n)                                                                                             \
    NOINLINE static void smooth_rows_##n(const rows_t *rows, const int64_t lag, const int64_t ready,           \
                                         steady_t *steady) {                                                   \
        smooth_rows(n, rows, lag, ready, steady);                                                              \
    }
OF_SIZE(1)
OF_SIZE(2)
OF_SIZE(3)
OF_SIZE(4)
OF_SIZE(5)
OF_SIZE(6)
OF_SIZE(7)

NOINLINE static void smooth_rows_n(const int n, const rows_t *rows, const int64_t lag, const int64_t ready,
                                   steady_t *steady) {
    smooth_rows(n, rows, lag, ready, steady);
}

static void lag_rows(const int n, rows_t *rows, filter_t *state, const int64_t lag, const int64_t ready,
                     int64_t *settled_row) {
    steady_t steady;
    filter_t newest;
    for (int i = 0; i < n; i++) steady.Pc[i] = 0;
    for (int i = 0; i < n * n; i++) steady.P[i] = 0;
    steady.stretch = -1, steady.sigma = 0, steady.weights = rows->states + rows->block->rows * packed_size(n);
    filter_until(n, rows, state, 0, ready);
    memcpy(&newest, state, sizeof newest);
    filter_until(n, rows, &newest, ready, rows->block->rows);
    *settled_row = newest.settled_row;
    switch (n) { /* each size has its own stack frame; all in one function would need megabytes of stack */
    case 1: smooth_rows_1(rows, lag, ready, &steady); break;
    case 2: smooth_rows_2(rows, lag, ready, &steady); break;
    case 3: smooth_rows_3(rows, lag, ready, &steady); break;
    case 4: smooth_rows_4(rows, lag, ready, &steady); break;
    case 5: smooth_rows_5(rows, lag, ready, &steady); break;
    case 6: smooth_rows_6(rows, lag, ready, &steady); break;
    case 7: smooth_rows_7(rows, lag, ready, &steady); break;
    default: smooth_rows_n(n, rows, lag, ready, &steady);
    }
}

int64_t lag_smooth(const settings_t *settings, const coefficients_t *model, forward_t *forward, const block_t *block,
                   const estimate_t *estimate, const int64_t lag, const int64_t ready, real *room, int64_t *places,
                   int8_t *starts) {
    rows_t rows = {settings, model, block, estimate, starts, room, places, places + block->rows};
    limits_t limits = forward->limits;
    int64_t settled_row = -1;
    memset(starts, 0, (size_t)block->rows);
    find_starts(settings, &limits, block, block->rows, starts);
    lag_rows((int)settings->states, &rows, &forward->filter, lag, ready, &settled_row);
    find_starts(settings, &forward->limits, block, ready, starts);
    return settled_row;
}
