/* List the offsets of the structs' fields, for languages that cannot read the header. Each number in a struct has 8
   bytes. */
#include <stddef.h>

#include "filter.h"
#include "imm.h"
#include "multivariate.h"

typedef struct {
    const char *name;     /* NULL: end of the list; `offset` is the struct's size */
    int64_t offset, size; /* in bytes */
    int64_t whole;        /* whether the field holds whole numbers */
} field_t;

#define REALS(type, name) {#name, offsetof(type, name), sizeof(((type *)0)->name), 0}
#define WHOLE(type, name) {#name, offsetof(type, name), sizeof(((type *)0)->name), 1}
#define END(type) {0, sizeof(type), 0, 0}

const field_t *channel_settings_fields(void);
const field_t *channel_coefficients_fields(void);
const field_t *channel_state_fields(void);
const field_t *channel_forward_fields(void);
const field_t *channel_future_fields(void);
const field_t *channel_score_fields(void);
const field_t *channel_limits_fields(void);
const field_t *channel_watched_fields(void);
const field_t *channel_stamps_fields(void);
const field_t *channel_knowledge_fields(void);
const field_t *channel_constants(void);

const field_t *channel_settings_fields(void) {
#define R(name) REALS(settings_t, name)
#define W(name) WHOLE(settings_t, name)
    static const field_t fields[] = {
        W(states), R(low), R(high), R(largest), R(largest_accepted), W(stuck), R(outlier_distance), R(plausible_low),
        R(plausible_high), W(repeats_are_one), R(blank), R(far_from_0), R(longest_gap), R(gap_spans), W(gap_measurements), W(gated),
        R(gate_threshold), W(gate_agree), W(gate_most), W(gate_level), W(drift_threshold), R(dead_variance), W(timed),
        R(step_s), R(time_std_s), R(time_variance), R(factor), W(calibrated), R(relative_std), R(offset_std),
        R(hole_sigma), END(settings_t),
    };
#undef R
#undef W
    return fields;
}

const field_t *channel_coefficients_fields(void) {
#define R_(name) REALS(coefficients_t, name)
    static const field_t fields[] = {
        R_(h), R_(c), R_(R), R_(widest), R_(prior), WHOLE(coefficients_t, keeps_level), WHOLE(coefficients_t, disturbed),
        END(coefficients_t),
    };
#undef R_
    return fields;
}

const field_t *channel_state_fields(void) {
#define IN(part, name, whole) {#name, offsetof(state_t, part.name), sizeof(((state_t *)0)->part.name), whole}
    static const field_t fields[] = {
        WHOLE(state_t, layout), WHOLE(state_t, states), IN(sensor.limits, at, 1), IN(filter, phase, 1),
        IN(filter, has_level, 1), IN(filter, x, 0), IN(filter, P, 0), IN(filter, settled_row, 1),
        IN(sensor.monitor, hops, 1), IN(sensor.monitor, powers, 0), IN(sensor.monitor, drift_since, 1),
        IN(sensor.monitor, silent, 1), IN(sensor, counts, 1), IN(sensor.faults, met, 1),
        IN(sensor.faults, first_row, 1), IN(sensor.faults, first_step, 0), IN(sensor, timing_share, 0), END(state_t),
    };
#undef IN
    return fields;
}

const field_t *channel_forward_fields(void) {
#define IN(part, name, whole) {#name, offsetof(forward_t, part.name), sizeof(((forward_t *)0)->part.name), whole}
    static const field_t fields[] = {
        IN(filter, phase, 1), IN(filter, has_level, 1), IN(filter, x, 0), IN(filter, P, 0), IN(filter, settled_row, 1),
        END(forward_t),
    };
#undef IN
    return fields;
}

const field_t *channel_future_fields(void) {
    static const field_t fields[] = {REALS(future_t, M), END(future_t)};
    return fields;
}

const field_t *channel_limits_fields(void) {
    static const field_t fields[] = {REALS(limits_t, least), REALS(limits_t, most), END(limits_t)};
    return fields;
}

const field_t *channel_watched_fields(void) {
#define IN(name) {#name, offsetof(record_monitor_t, monitor.name), sizeof(((record_monitor_t *)0)->monitor.name), 1}
    static const field_t fields[] = {
        IN(rows), IN(above), IN(below), IN(drift_since), IN(hop_count), IN(hop_total), IN(hop_squares),
        REALS(record_monitor_t, now), END(record_monitor_t),
    };
#undef IN
    return fields;
}

const field_t *channel_stamps_fields(void) {
#define R_(name) REALS(stamps_t, name)
    static const field_t fields[] = {
        R_(grid), R_(last), R_(started), R_(step), R_(slack), R_(farthest), R_(pace), R_(held), R_(held_last),
        R_(opened), R_(coarse), END(stamps_t),
    };
#undef R_
    return fields;
}

const field_t *channel_knowledge_fields(void) {
#define W(name) WHOLE(multivariate_state_t, name)
#define IN(name, whole) {#name, offsetof(multivariate_state_t, score.name), sizeof(((multivariate_state_t *)0)->score.name), whole}
    static const field_t fields[] = {
        W(phase), W(rows), W(opened), W(settled_row), W(closed), IN(squares, 0), IN(product, 0), IN(exponent, 1), IN(used, 1),
        END(multivariate_state_t),
    };
#undef W
#undef IN
    return fields;
}

/* Return the whole numbers that Python also uses, each as the size of a field. */
const field_t *channel_constants(void) {
#define VALUE(name) {#name, 0, name, 1}
    static const field_t values[] = {
        VALUE(NEIGHBOURS), VALUE(SIDE), VALUE(REACH), VALUE(SHORTEST_FILL), VALUE(LONGEST_0), VALUE(SMOOTHED),
        VALUE(EVERY_REPEAT), VALUE(PARTS),
        VALUE(SPREADS), VALUE(MOST_SIGMA),
        VALUE(HOP), VALUE(WINDOW_HOPS), VALUE(KEPT_HOPS), VALUE(TAKEN_STAMP),
        VALUE(LATE_STAMP), VALUE(REPEATED_STAMP), VALUE(FAR_STAMP), VALUE(CLOCK_RESET), VALUE(NO_STAMP), VALUE(AGREEING),
        VALUE(GATHERING), VALUE(GOES_ON), VALUE(WIDE), VALUE(DETERMINED), VALUE(N_MAX), VALUE(M_MAX), VALUE(GAIN),
        VALUE(COVARIANCE), VALUE(MODES_MAX), VALUE(IMM_BLOCK), VALUE(IMM_LAYOUT),
        {"SENSOR_SIZE", 0, sizeof(sensor_t), 1}, {"IMM_HEAD_SIZE", 0, sizeof(imm_state_t), 1}, {0, 0, 0, 0},
    };
#undef VALUE
    return values;
}

const field_t *channel_score_fields(void) {
    static const field_t fields[] = {
        REALS(score_t, squares), REALS(score_t, product), WHOLE(score_t, exponent), WHOLE(score_t, used), END(score_t),
    };
    return fields;
}
