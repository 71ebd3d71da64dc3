/* Passes over a record that need no filter: they detect faults of measurements and of innovations. */
#include "limits.h"
#include "monitor.h"

void scan_start(limits_t *limits, record_monitor_t *watched) {
    start_limits(limits);
    memset(watched, 0, sizeof *watched);
    watched->monitor.drift_since = -1;
}

int scan_is_sound(const limits_t *limits, const record_monitor_t *watched) {
    return limits_are_sound(limits) && monitor_is_sound(&watched->monitor) && isfinite(watched->now) &&
           isfinite(watched->opened);
}

int64_t scan_faults(const settings_t *settings, limits_t *state, const real *z, const real *elapsed, const int64_t rows,
                    int8_t *verdict) {
    int64_t found = 0;
    for (int64_t row = 0; row < rows; row++) {
        const int fault = judge(settings, state, z[row], elapsed[row]);
        if (fault) verdict[row] = (int8_t)fault;
        found += verdict[row] != 0;
    }
    return found;
}

void scan_reduce(const settings_t *settings, limits_t *state) { reduce_limits(settings, state); }

int64_t scan_innovations(const settings_t *settings, record_monitor_t *state, const real *normalised,
                         const real *elapsed, const int64_t rows, int8_t *verdict, const hops_t *hops) {
    enum { LAST = WINDOW_HOPS - 2 };
    monitor_t *monitor = &state->monitor;
    int64_t ended = 0;
    for (int64_t row = 0; row < rows; row++) {
        const int64_t before = monitor->hops;
        state->now = monitor->rows ? state->now + elapsed[row] : 0;
        if (!monitor->hop_count) state->opened = state->now;
        const int alarm = watch(settings, monitor, normalised[row]);
        if (alarm) verdict[row] = (int8_t)alarm;
        if (monitor->hops == before) continue;
        hops->totals[ended] = monitor->totals[LAST], hops->squares[ended] = monitor->squares[LAST];
        hops->powers[ended] = monitor->powers[before % KEPT_HOPS], hops->steps[ended] = state->opened;
        ended++;
    }
    return ended;
}
