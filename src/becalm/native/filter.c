/* The filter of one channel, for rows whose measurements and gaps are already checked.

   Equations are numbered as in core/reference/kalman.py. */
#include "filter.h"

#include <string.h>

#include "gate.h"
#include "linear.h"
#include "opening.h"
#include "settling.h"


enum { NO_DIGITS = -1 }; /* the covariance has lost all digits: the filter restarts at this row */

/* Predict and update state and covariance; return the gate's verdict on the measurement, or NO_DIGITS. */
INLINE int filter_row(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                      const real *F, const real *Q, const real elapsed, const real z, const int jumps, real *innovation,
                      real *deviation) {
    const real *h = model->h;
    real x[N_MAX], Ph[N_MAX];
    int verdict = USED;
    if (state->agreeing > 0 && elapsed > 0) state->wandered += error_change_std(n, h, F, Q, state->P);
    if (elapsed > 0) {
        times(n, F, state->x, x); /* (1) */
        propagate(n, F, Q, state->P);
    } else
        for (int i = 0; i < n; i++) x[i] = state->x[i];
    for (int i = 0; i < n; i++) {
        state->x[i] = x[i] < -LARGEST ? -LARGEST : x[i] > LARGEST ? LARGEST : x[i];
        if (state->P[i * n + i] > LARGEST) {
            const real shrink = sqrt(LARGEST / state->P[i * n + i]);
            for (int j = 0; j < n; j++) state->P[i * n + j] *= shrink, state->P[j * n + i] *= shrink;
        }
    }
    const int arrived = fabs(z) <= BEYOND_ANY_SENSOR;
    int complete = arrived;
    *innovation = *deviation = NOT_A_NUMBER;
    if (arrived) {
        const real nu = z - dot(n, h, state->x); /* (3) */
        times(n, state->P, h, Ph);
        real hPh = dot(n, h, Ph);
        if (loses_digits(n, model->R, Q, hPh)) return NO_DIGITS;
        state->S = hPh + model->R; /* (4) */
        if (settings->gated) {
            if (state->since_jump < 0 || !(fabs(nu) > settings->gate_threshold * sqrt(state->S)))
                ;
            else if (!(reject(settings, model, state, nu) || jumps))
                verdict = SPIKE, complete = 0;
            else {
                verdict = STEP;
                jump(n, settings, model, state, F, nu, hPh);
                times(n, state->P, h, Ph);
                state->S = dot(n, h, Ph) + model->R;
            }
            if (verdict != SPIKE) {
                if (state->jumped && fabs(nu) > state->burst) state->burst = fabs(nu);
                state->rejected = state->agreeing = 0, state->since_jump++;
            }
        }
        if (verdict != SPIKE) {
            for (int i = 0; i < n; i++) state->K[i] = state->S > 0 ? Ph[i] / state->S : 0; /* (5) */
            for (int i = 0; i < n; i++) state->x[i] += state->K[i] * nu;                   /* (6) */
            joseph(n, h, model->R, state->K, Ph, state->P);
            *innovation = nu, *deviation = sqrt(state->S);
        }
    }
    real Pc[N_MAX];
    times(n, state->P, model->c, Pc);
    const real variance = dot(n, model->c, Pc);
    if (arrived && loses_digits(n, model->R, Q, variance)) return NO_DIGITS;
    state->sigma = variance > 0 ? sqrt(variance) : 0;
    check_settling(n, h, F, state, verdict == STEP ? -2 : elapsed, complete);
    if (verdict == STEP) state->last_step = -1; /* the covariance after a jump is not that of other rows */
    return verdict;
}

/* Filter rows with the steady-state gain, up to a row that is missing, rejected, or has another step; return the number
   of filtered rows. The recursion is that of the predicted state, F s + L nu (14), in closed-loop form:
   s = A s + L z, A = F - L h. In this form a row depends on the previous row by the fewest operations. */
INLINE int64_t filter_settled(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                              const real *F, const block_t *block, int64_t row, const pass_t *pass,
                              const estimate_t *estimate) {
    const int64_t from = row;
    real A[NN_MAX], s[N_MAX], before[N_MAX], L[N_MAX], h[N_MAX], c[N_MAX], nu = 0, gain = 0;
    const real deviation = sqrt(state->S);
    const real limit = settings->gated ? settings->gate_threshold * deviation : INFINITE;
    const real threshold = limit > BEYOND_ANY_SENSOR ? BEYOND_ANY_SENSOR : limit;
    const real level = state->level, sigma = state->sigma, step = state->last_step;
    const int disturbed = model->disturbed != 0;
    if (!state->predicted) {
        times(n, F, state->x, state->ahead);
        times(n, F, state->K, state->L); /* (13) */
        state->predicted = 1;
    }
    for (int i = 0; i < n; i++) s[i] = before[i] = state->ahead[i], L[i] = state->L[i];
    for (int i = 0; i < n; i++) h[i] = model->h[i], c[i] = model->c[i], gain += c[i] * state->K[i];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] = F[i * n + j] - L[i] * h[j];
    for (; row < block->rows && block->elapsed[row] == step && pass->starts[row] != RESTARTS; row++) {
        const real z = pass->usable[row] - level, measured = dot(n, h, s), next = z - measured;
        if (!(fabs(next) <= threshold)) break;
        nu = next;
        estimate->signal[row] = (disturbed ? dot(n, c, s) : measured) + gain * nu + level;
        estimate->innovation[row] = nu;
        if (estimate->x)
            for (int i = 0; i < n; i++) estimate->x[row * n + i] = s[i] + state->K[i] * nu;
        real ahead[N_MAX];
        UNROLL
        for (int i = 0; i < n; i++) ahead[i] = onward(n, A + i * n, s, L[i] * z);
        UNROLL
        for (int i = 0; i < n; i++) before[i] = s[i], s[i] = ahead[i];
    }
    for (int64_t k = from; k < row; k++) estimate->sigma[k] = sigma, estimate->deviation[k] = deviation;
    if (row > from) {
        if (state->settled_row < 0) state->settled_row = state->rows;
        for (int i = 0; i < n; i++) state->x[i] = before[i] + state->K[i] * nu, state->ahead[i] = s[i];
        state->since_jump += settings->gated ? row - from : 0;
        state->rows += row - from;
    }
    return row - from;
}

void filter_forget(filter_t *state) {
    state->phase = UNKNOWN;
    state->level = 0, state->has_level = 0;
    state->rejected = state->agreeing = state->since_jump = state->jumped = 0;
    state->last_rejected = state->wandered = state->burst = 0;
    unsettle(state);
    state->steady = 0;
}

real filter_level(const settings_t *settings, const coefficients_t *model, const real first) {
    return model->keeps_level && fabs(first) <= settings->largest_accepted / 1000 ? first : 0;
}

void filter_begin_after(const settings_t *settings, const coefficients_t *model, limits_t *limits, filter_t *state,
                        const real first, const int64_t rows, const real steps) {
    if (isfinite(first)) state->level = filter_level(settings, model, first), state->has_level = 1;
    limits->now = limits->last = steps, limits->measurements = rows;
}

/* Filter one row while measurements do not determine the state: add the information of the row. */
static void open_row(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                     const real *F, const real *Q, const real elapsed, const real z, real *signal, real *sigma) {
    *signal = NOT_A_NUMBER, *sigma = INFINITE;
    const int arrived = fabs(z) <= BEYOND_ANY_SENSOR;
    if (state->phase == UNKNOWN) {
        if (!arrived) return;
        state->phase = GATHERING;
        if (!state->has_level) state->level = filter_level(settings, model, z), state->has_level = 1;
        begin_information(n, model->prior, state->P, state->x);
    } else if (elapsed > 0)
        predict_information(n, F, Q, model->prior, state->P, state->x);
    if (arrived) add_information(n, model->h, model->R, z - state->level, state->P, state->x);
    if (!model->disturbed) estimate_from_information(n, model->h, state->P, state->x, signal, sigma);
    if (try_to_determine(n, model, F, Q, state->P, state->x)) {
        state->phase = DETERMINED;
        if (model->disturbed) {
            real Pc[N_MAX];
            times(n, state->P, model->c, Pc);
            const real variance = dot(n, model->c, Pc);
            *signal = dot(n, model->c, state->x), *sigma = variance > 0 ? sqrt(variance) : 0;
        }
    }
    *signal += state->level;
}

INLINE void filter_rows(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                        const block_t *block, const estimate_t *estimate, pass_t *pass) {
    for (int64_t row = 0; row < block->rows;) {
        const int64_t at = (int64_t)block->step[row] * n * n;
        const real *F = block->F + at, *Q = block->Q + at;
        if (pass->starts[row] == RESTARTS) filter_forget(state);
        if (state->settled && state->phase == DETERMINED) {
            const int64_t filtered_rows = filter_settled(n, settings, model, state, F, block, row, pass, estimate);
            row += filtered_rows;
            if (filtered_rows) continue;
            unsettle(state); /* later rows must not depend on the row at which the gain settled */
        }
        if (state->phase == DETERMINED) {
            const real z = pass->usable[row] - state->level;
            const int verdict = filter_row(n, settings, model, state, F, Q, block->elapsed[row], z,
                                           pass->starts[row] == JUMPS, estimate->innovation + row,
                                           estimate->deviation + row);
            if (verdict == NO_DIGITS) {
                filter_forget(state);
                pass->starts[row] = RESTARTS;
            } else if (verdict)
                estimate->verdict[row] = (int8_t)verdict;
            estimate->signal[row] = dot(n, model->c, state->x) + state->level;
            estimate->sigma[row] = state->sigma;
        }
        if (state->phase != DETERMINED) {
            estimate->innovation[row] = estimate->deviation[row] = NOT_A_NUMBER;
            open_row(n, settings, model, state, F, Q, block->elapsed[row], pass->usable[row], estimate->signal + row,
                     estimate->sigma + row);
        }
        if (estimate->x)
            for (int i = 0; i < n; i++)
                estimate->x[row * n + i] = state->phase == DETERMINED ? state->x[i] : NOT_A_NUMBER;
        state->rows++, row++;
    }
}

void filter_block(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *block,
                  const estimate_t *estimate, pass_t *pass) {
    FOR_STATES(settings->states, filter_rows, settings, model, state, block, estimate, pass)
}

void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *part,
                 const estimate_t *estimate, int8_t *starts) {
    pass_t pass;
    memcpy(pass.usable, part->z, sizeof(real) * (size_t)part->rows);
    memcpy(pass.starts, starts, (size_t)part->rows);
    filter_block(settings, model, state, part, estimate, &pass);
    memcpy(starts, pass.starts, (size_t)part->rows);
}
