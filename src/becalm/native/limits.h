/* Detect faults of a measurement: it is impossible, saturated, stuck, or far from earlier measurements. */
#ifndef BECALM_LIMITS_H
#define BECALM_LIMITS_H

#include <string.h>

#include "linear.h"

#define IMPLAUSIBLE_SPREADS ((real)3) /* replaces SPREADS for an implausible value; near a jump, the spread is large */
#define LATE ((real)2.5)        /* a longer wait, over the neighbours' second longest wait, discards them */
#define NEARER ((real)4)        /* a value that replaces missing ones may be this many times nearer than an outlier */
#define FARTHEST ((real)1000)   /* largest distance of a motion from the plausible range, over the width of the range */
#define MOST_IMPOSSIBLE 50      /* after this many impossible values in a row, the next values are accepted */
#define AMID ((real)0.01)       /* a value nearer to an end of a range than this share of the range is not within it */

/* Set the state before the first measurement. */
static inline void start_limits(limits_t *state) {
    memset(state, 0, sizeof *state);
    state->last_value = NOT_A_NUMBER;
    state->least = INFINITE, state->most = -INFINITE;
    for (int k = 0; k < NEIGHBOURS; k++) state->past[k] = NOT_A_NUMBER;
}

/* Copy the last measurements to `neighbours`; return their number. */
static inline int copy_past(const real *past, real *neighbours) {
    int count = 0;
    for (int k = 0; k < NEIGHBOURS; k++)
        if (!isnan(past[k])) neighbours[count++] = past[k];
    return count;
}

/* Sort some neighbours; return their median, and write their spread without the lowest and the highest neighbour. */
static inline real median_of(real *neighbours, const int count, real *spread) {
    for (int k = 1; k < count; k++) {
        const real now = neighbours[k];
        int at = k;
        for (; at > 0 && neighbours[at - 1] > now; at--) neighbours[at] = neighbours[at - 1];
        neighbours[at] = now;
    }
    *spread = neighbours[count - 2] - neighbours[1];
    return (neighbours[(count - 1) / 2] + neighbours[count / 2]) * (real)0.5;
}

/* Return whether a measurement is farther from the median of its neighbours than `distance`, and than `spreads` times
   their spread. */
static inline int is_far(const real z, real *neighbours, const int count, const real distance, const real spreads) {
    real spread;
    const real median = median_of(neighbours, count, &spread);
    return fabs(z - median) > (spreads * spread > distance ? spreads * spread : distance);
}

/* Return whether a measurement is far from the six before it or, with too few of them, from the plausible range. */
static inline int is_far_from_past(const settings_t *settings, const limits_t *state, const real z) {
    const real distance = settings->outlier_distance, *past = state->past;
    real neighbours[NEIGHBOURS], low = past[0], high = past[0];
    UNROLL
    for (int k = 1; k < NEIGHBOURS; k++) {
        low = past[k] < low ? past[k] : low;
        high = past[k] > high ? past[k] : high;
    }
    if (!isnan(past[NEIGHBOURS - 1]) && high - distance <= z && z <= low + distance) return 0; /* near all of them */
    const int count = copy_past(past, neighbours);
    if (count >= FEWEST_NEIGHBOURS) return is_far(z, neighbours, count, distance, SPREADS);
    const int plausible = settings->plausible_low <= z && z <= settings->plausible_high;
    return !(plausible || (count && fabs(z - state->last_value) <= distance));
}

/* Return whether a measurement that equals the previous one replaces a missing measurement. */
static inline int replaces_missing(const settings_t *settings, const real z, const real *past) {
    real neighbours[NEIGHBOURS];
    const int count = copy_past(past, neighbours);
    return count == NEIGHBOURS && is_far(z, neighbours, count, settings->outlier_distance / NEARER, SPREADS);
}

/* Return whether a 0 marks a missing measurement: at least three neighbours are not 0, and all of these three or more
   are far from 0. */
static inline int marks_missing(const settings_t *settings, const real z, const real *neighbours, const int count) {
    if (z != 0 || settings->far_from_0 == 0) return 0;
    int others = 0;
    for (int k = 0; k < count; k++) {
        if (isnan(neighbours[k]) || neighbours[k] == 0) continue;
        if (fabs(neighbours[k]) <= settings->far_from_0) return 0;
        others++;
    }
    return others >= FEWEST_NEIGHBOURS;
}

/* Return whether 0 may be an end of the measured range, because it is not within this range. (The measured range is the
   middle third of the plausible range.) */
static inline int may_end_at_0(const settings_t *settings) {
    const real low = settings->plausible_low, high = settings->plausible_high, third = (high - low) / 3;
    return !(low + (1 + AMID) * third < 0 && 0 < high - (1 + AMID) * third);
}

/* Return whether a 0 at an end of the range lasts so long that it does not mark missing measurements: the sensor rests
   or is off, and 0 is its reading in both cases. */
static inline int is_long_0(const settings_t *settings, const real z, const int64_t rows) {
    const int known = settings->plausible_high - settings->plausible_low < INFINITE;
    return z == 0 && rows >= LONGEST_0 && known && may_end_at_0(settings);
}

/* Return whether a 0 means that the signal rests: 0 is an end of the range so far, and does not mark a missing
   measurement. */
static inline int is_rest(const settings_t *settings, const limits_t *state) {
    return (state->least == 0 || state->most == 0) && !marks_missing(settings, 0, state->past, NEIGHBOURS);
}

/* Return the verdict on a value that cannot be a measurement of the sensor; 0 if it can be one. */
static inline int no_measurement(const settings_t *settings, const real z) {
    if (isnan(z)) return MISSING;
    if (isinf(z)) return NONFINITE;
    if (fabs(z) > settings->largest) return OVERRANGE;
    return z == settings->blank ? OUTLIER : USED;
}

/* Return whether a value is beyond any motion: far from the plausible range and from the last measurement. */
static inline int is_impossible(const settings_t *settings, const limits_t *state, const real z) {
    const real low = settings->plausible_low, high = settings->plausible_high, farthest = FARTHEST * (high - low);
    return farthest > 0 && (z < low - farthest || z > high + farthest) && !(fabs(z - state->last_value) <= farthest);
}

/* Discard the measurements before a long gap, because the signal may have changed during it. A gap is compared with the
   second longest wait, because one of these measurements may itself have come after a gap. */
static inline void forget_past(limits_t *state) {
    real longest = 1, second = 1;
    for (int k = 0; k < NEIGHBOURS; k++) {
        const real wait = state->waits[k];
        second = wait > longest ? longest : wait > second ? wait : second;
        longest = wait > longest ? wait : longest;
    }
    if (state->since <= LATE * second) return;
    for (int k = 0; k < NEIGHBOURS; k++) state->past[k] = NOT_A_NUMBER;
}

/* Return the verdict on one measurement. A measurement with the same time as the previous row does not enter the
   history, unless it is the first measurement. */
static inline int judge(const settings_t *settings, limits_t *state, const real z, const real elapsed) {
    const int moved = elapsed > 0;
    int verdict = no_measurement(settings, z);
    state->since += elapsed;
    if (verdict) return verdict;
    if (!is_impossible(settings, state, z))
        state->impossible = 0;
    else if (state->impossible < MOST_IMPOSSIBLE) {
        state->impossible++;
        return z <= settings->low || z >= settings->high ? CLIPPED : OUTLIER;
    }
    if (state->since > LATE) forget_past(state);
    const int counts = moved || state->run == 0;
    if (settings->outlier_distance < INFINITE) {
        if (marks_missing(settings, z, state->past, NEIGHBOURS))
            state->outlier = z != state->last_value || state->run + 1 < LONGEST_0 ? 1 : may_end_at_0(settings) ? 0 : 2;
        else if (!(settings->repeats_are_one && z == state->last_value)) {
            state->outlier = is_far_from_past(settings, state, z);
            if (counts) {
                state->past[state->at] = z, state->waits[state->at] = state->since;
                state->at = state->at + 1 < NEIGHBOURS ? state->at + 1 : 0;
            }
        } else if (is_long_0(settings, z, state->run + 1))
            state->outlier = 0;
        else if (state->outlier != 1 && moved) {
            const int may_fill = settings->stuck > EVERY_REPEAT && state->run < LONGEST_FILL;
            state->outlier = may_fill && replaces_missing(settings, z, state->past) ? 2 : 0;
        }
    }
    if (counts) {
        state->run = z == state->last_value ? state->run + 1 : 1;
        state->last_value = z;
        state->least = z < state->least ? z : state->least;
        state->most = z > state->most ? z : state->most;
        const int rest = z == 0 && (is_rest(settings, state) || is_long_0(settings, z, state->run));
        if (settings->stuck > 0 && state->run >= settings->stuck && !rest) verdict = STUCK;
    }
    if (state->outlier == 1 || (state->outlier && verdict != STUCK)) verdict = OUTLIER;
    state->since = 0;
    if (z <= settings->low || z >= settings->high) verdict = CLIPPED;
    if (verdict == USED && fabs(z) > settings->largest_accepted) verdict = OVERRANGE;
    return verdict;
}

/* Return whether the state of the limits, which may come from a file, is possible. */
static inline int limits_are_sound(const limits_t *limits) {
    return isfinite(limits->since) && limits->at >= 0 && limits->at < NEIGHBOURS && is_count(limits->run, EVER) &&
           limits->measurements >= 0 && is_count(limits->measurements, EVER) && limits->impossible >= 0 &&
           limits->impossible <= MOST_IMPOSSIBLE && isfinite(limits->now) && isfinite(limits->last);
}

/* Reduce the state of the limits to what later verdicts depend on. */
static inline void reduce_limits(const settings_t *settings, limits_t *limits) {
    limits_t own = *limits;
    for (int k = 0; k < NEIGHBOURS; k++) {
        const int64_t from = (limits->at + k) % NEIGHBOURS;
        own.past[k] = limits->past[from], own.waits[k] = limits->waits[from];
    }
    own.at = 0;
    const int64_t longest = settings->stuck > LONGEST_0 ? settings->stuck : LONGEST_0;
    own.run = limits->run < longest ? limits->run : longest;
    own.least = limits->least < 0 ? -1 : 0, own.most = limits->most > 0; /* whether 0 would be an end of the range */
    own.now = limits->now - limits->last, own.last = 0;
    const int near = limits->measurements < settings->gap_measurements ||
                     settings->gap_spans * limits->last < settings->longest_gap;
    if (near) own.last = limits->last;
    own.measurements = near ? limits->measurements : settings->gap_measurements;
    *limits = own;
}

#endif
