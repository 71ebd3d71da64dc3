/* One channel, row by row: limits, gap, predict, gate, update, monitor, estimate.

   A block passes three times: its measurements are judged, filtered, and their innovations watched. No pass knows what
   is in the block but by its rows, so that a stream gives the same bits wherever it is cut.

   Equations are numbered as in core/reference.py. */
#include <string.h>

#include "gate.h"
#include "limits.h"
#include "linear.h"
#include "monitor.h"
#include "opening.h"
#include "settling.h"

enum { BLOCK = 64 };

#define BEYOND_ANY_SENSOR ((real)1e100)
#define LARGEST ((real)1e200) /* a state that no measurement sees saturates here, and cannot spoil the others */

/* What the passes over a block hand on to each other. */
typedef struct {
    real usable[BLOCK]; /* measurements, NaN where none may enter the filter */
    int8_t anew[BLOCK]; /* whether the filter starts anew here */
} pass_t;

static void judge_rows(const settings_t *settings, state_t *state, const block_t *block, const estimate_t *estimate,
                       pass_t *pass) {
    for (int64_t row = 0; row < block->rows; row++) {
        const real z = block->z[row], elapsed = block->elapsed[row];
        const int verdict = judge(settings, state, z, elapsed > 0);
        if (verdict) estimate->verdict[row] = (int8_t)verdict;
        pass->usable[row] = verdict ? NOT_A_NUMBER : z;
        pass->anew[row] = (int8_t)starts_anew(settings, state, elapsed, verdict == USED);
    }
}

/* Take one row with its covariance; return what the gate says of its measurement. */
INLINE int filter_row(const int n, const settings_t *settings, const coefficients_t *model, state_t *state,
                      const real *F, const real *Q, const real elapsed, const real z, real *innovation,
                      real *deviation) {
    const real *h = model->h;
    real x[N_MAX], Ph[N_MAX];
    int verdict = USED;
    if (state->agreeing > 0) state->wandered += wander(n, h, F, Q, state->P);
    times(n, F, state->x, x); /* (1) */
    propagate(n, F, Q, state->P);
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
        state->S = hPh + model->R; /* (4) */
        if (settings->gated) {
            if (state->since_jump < 0 || !(fabs(nu) > settings->gate_threshold * sqrt(state->S)))
                ;
            else if (!believes(settings, model, state, nu))
                verdict = SPIKE, complete = 0;
            else {
                verdict = STEP;
                jump(n, settings, model, state, nu, hPh);
                times(n, state->P, h, Ph);
                state->S = dot(n, h, Ph) + model->R;
            }
            if (verdict != SPIKE) state->rejected = state->agreeing = 0, state->since_jump++;
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
    state->sigma = variance > 0 ? sqrt(variance) : 0;
    notice(n, h, F, state, verdict == STEP ? -2 : elapsed, complete);
    if (verdict == STEP) state->last_step = -1; /* its covariance is that of no other row */
    return verdict;
}

/* Take rows with the gain that has settled, until one is missing, rejected, or comes after another step; return how
   many were taken. What moves is the predicted state: s = F s + L nu (14), the least that a row waits for. */
INLINE int64_t filter_settled(const int n, const settings_t *settings, const coefficients_t *model, state_t *state,
                              const real *F_, const block_t *block, int64_t row, const pass_t *pass,
                              const estimate_t *estimate) {
    const int64_t from = row;
    real F[NN_MAX], s[N_MAX], before[N_MAX], L[N_MAX], h[N_MAX], c[N_MAX], nu = 0, gain = 0;
    const real deviation = sqrt(state->S), threshold = settings->gated ? settings->gate_threshold * deviation : INFINITE;
    const real level = state->level, sigma = state->sigma, step = state->last_step;
    memcpy(F, F_, sizeof(real) * (size_t)(n * n));
    if (!state->predicted) {
        times(n, F, state->x, state->ahead);
        times(n, F, state->K, state->L); /* (13) */
        state->predicted = 1;
    }
    for (int i = 0; i < n; i++) s[i] = before[i] = state->ahead[i], L[i] = state->L[i];
    for (int i = 0; i < n; i++) h[i] = model->h[i], c[i] = model->c[i], gain += c[i] * state->K[i];
    for (; row < block->rows && block->elapsed[row] == step && !pass->anew[row]; row++) {
        const real next = pass->usable[row] - level - dot(n, h, s);
        if (!(fabs(next) <= threshold && fabs(next) < BEYOND_ANY_SENSOR)) break;
        nu = next;
        estimate->signal[row] = dot(n, c, s) + gain * nu + level;
        estimate->sigma[row] = sigma;
        estimate->innovation[row] = nu, estimate->deviation[row] = deviation;
        real ahead[N_MAX];
        for (int i = 0; i < n; i++) ahead[i] = dot(n, F + i * n, s) + L[i] * nu;
        for (int i = 0; i < n; i++) before[i] = s[i], s[i] = ahead[i];
    }
    if (row > from) {
        if (state->settled_row < 0) state->settled_row = state->rows + from;
        for (int i = 0; i < n; i++) state->x[i] = before[i] + state->K[i] * nu, state->ahead[i] = s[i];
        state->since_jump += settings->gated ? row - from : 0;
    }
    return row - from;
}

/* Start a filter anew, with what is known of its sensor. */
static void forget(state_t *state) {
    state->known = UNKNOWN;
    state->level = 0;
    state->rejected = state->agreeing = state->since_jump = state->jumped = 0;
    state->last_rejected = state->wandered = 0;
    unsettle(state);
    state->steady = 0;
}

/* Take one row while measurements do not tell the state: they are gathered as information. */
static void open_row(const int n, const settings_t *settings, const coefficients_t *model, state_t *state,
                     const real *F, const real *Q, const real z, real *signal, real *sigma) {
    *signal = NOT_A_NUMBER, *sigma = INFINITE;
    if (state->known == UNKNOWN) {
        if (isnan(z)) return;
        state->known = GATHERING;
        /* Measurements are told from the first, as long as that does not round their noise away. */
        state->level = model->keeps_level && fabs(z) <= settings->largest_believed / 1000 ? z : 0;
        memcpy(state->P, model->prior, sizeof state->P);
        memset(state->x, 0, sizeof state->x);
    } else
        carry_information(n, F, Q, model->prior, state->P, state->x);
    if (!isnan(z)) add_information(n, model->h, model->R, z - state->level, state->P, state->x);
    if (!model->disturbed) estimate_from_information(n, model->h, state->P, state->x, signal, sigma);
    if (determine(n, state->P, state->x)) {
        state->known = DETERMINED;
        if (model->disturbed) {
            real Pc[N_MAX];
            times(n, state->P, model->c, Pc);
            const real variance = dot(n, model->c, Pc);
            *signal = dot(n, model->c, state->x), *sigma = variance > 0 ? sqrt(variance) : 0;
        }
    }
    *signal += state->level;
}

INLINE void filter_rows(const int n, const settings_t *settings, const coefficients_t *model, state_t *state,
                        const block_t *block, const estimate_t *estimate, pass_t *pass) {
    for (int64_t row = 0; row < block->rows;) {
        const real *F = block->F + block->step[row] * n * n, *Q = block->Q + block->step[row] * n * n;
        if (pass->anew[row]) {
            forget(state);
            pass->anew[row] = 0;
        }
        if (state->settled && state->known == DETERMINED) {
            const int64_t taken = filter_settled(n, settings, model, state, F, block, row, pass, estimate);
            row += taken;
            if (taken) continue;
        }
        if (state->known != DETERMINED) {
            estimate->innovation[row] = estimate->deviation[row] = NOT_A_NUMBER;
            open_row(n, settings, model, state, F, Q, pass->usable[row], estimate->signal + row, estimate->sigma + row);
        } else {
            const real z = pass->usable[row] - state->level;
            const int verdict = filter_row(n, settings, model, state, F, Q, block->elapsed[row], z,
                                           estimate->innovation + row, estimate->deviation + row);
            if (verdict) estimate->verdict[row] = (int8_t)verdict;
            estimate->signal[row] = dot(n, model->c, state->x) + state->level;
            estimate->sigma[row] = state->sigma;
        }
        row++;
    }
}

/* Return sigma with what the uncertainties of times, tuning and calibration add. */
static real widened(const settings_t *settings, const coefficients_t *model, state_t *state, const real signal,
                    real sigma, const real elapsed) {
    if (settings->timed) {
        const real seconds = elapsed * settings->step_s, risen = signal - state->last_signal;
        if (seconds > 0 && isfinite(risen)) state->slope = risen / seconds;
        state->last_signal = signal;
        const real moved = state->slope * settings->time_std_s, more = moved * moved - settings->time_variance;
        if (more > 0) sigma *= sqrt(1 + more / model->R);
    }
    sigma *= settings->factor;
    if (settings->calibrated) {
        const real relative = signal * settings->relative_std;
        const real variance = relative * relative + settings->offset_std * settings->offset_std;
        if (isfinite(variance)) sigma = sqrt(sigma * sigma + variance);
    }
    return sigma;
}

static void watch_rows(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                       const estimate_t *estimate, const pass_t *pass) {
    const real low = settings->plausible_low, high = settings->plausible_high;
    for (int64_t row = 0; row < block->rows; row++) {
        const real deviation = estimate->deviation[row];
        const int alarm = watch(settings, state, deviation > 0 ? estimate->innovation[row] / deviation : NOT_A_NUMBER);
        int verdict = estimate->verdict[row];
        if (alarm && verdict == USED) verdict = alarm;
        real signal = estimate->signal[row], sigma = estimate->sigma[row];
        const int missed = isnan(pass->usable[row]), goes_on = missed && state->missed;
        if (!missed && verdict != SPIKE) state->entered = pass->usable[row];
        state->missed = missed;
        if ((signal < low || signal > high) && fabs(signal - state->entered) > high - low)
            signal = sigma = NOT_A_NUMBER, verdict = RUNAWAY;
        else if (goes_on && sigma >= settings->unknown_from && !isnan(signal))
            signal = sigma = NOT_A_NUMBER, verdict = HOLE;
        state->counts[verdict]++;
        estimate->verdict[row] = (int8_t)verdict;
        estimate->signal[row] = signal;
        estimate->sigma[row] = widened(settings, model, state, signal, sigma, block->elapsed[row]);
    }
}

void channel_start(state_t *state) {
    memset(state, 0, sizeof *state);
    state->held = state->last_signal = state->entered = NOT_A_NUMBER;
    state->least = INFINITE, state->most = -INFINITE;
    for (int k = 0; k < NEIGHBOURS; k++) state->past[k] = NOT_A_NUMBER;
    state->drift_since = state->settled_row = -1;
    forget(state);
}

/* Return whether a state, which may come from a file, is one that a channel can have. */
int channel_is_sound(const state_t *state) {
    return state->known >= UNKNOWN && state->known <= DETERMINED && state->hops >= 0;
}

static void process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                    const estimate_t *estimate) {
    pass_t pass;
    judge_rows(settings, state, block, estimate, &pass);
    switch (settings->states) {
#define WITH_STATES(n) \
    case n: filter_rows(n, settings, model, state, block, estimate, &pass); break
        WITH_STATES(1);
        WITH_STATES(2);
        WITH_STATES(3);
        WITH_STATES(4);
        WITH_STATES(5);
        WITH_STATES(6);
        WITH_STATES(7);
    default: filter_rows((int)settings->states, settings, model, state, block, estimate, &pass);
    }
    watch_rows(settings, model, state, block, estimate, &pass);
}

void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate) {
    for (int64_t row = 0; row < block->rows; row += BLOCK) {
        block_t part = *block;
        const estimate_t out = {estimate->signal + row, estimate->sigma + row, estimate->verdict + row,
                                estimate->innovation + row, estimate->deviation + row};
        part.z += row, part.elapsed += row, part.step += row;
        part.rows = block->rows - row < BLOCK ? block->rows - row : BLOCK;
        process(settings, model, state, &part, &out);
    }
}
