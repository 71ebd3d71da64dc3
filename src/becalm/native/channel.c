/* Process one channel row by row: limits, gap, predict, gate, update, monitor, estimate.

   Three passes run over a block: they check the measurements, filter them, and monitor their innovations. Each pass
   works row by row, so that the boundaries between blocks change no bit.

   Equations are numbered as in core/reference/kalman.py. */
#include <string.h>

#include "sensor.h"

void channel_start(const settings_t *settings, state_t *state) {
    memset(state, 0, sizeof *state);
    state->layout = LAYOUT, state->states = settings->states;
    start_sensor(&state->sensor);
    state->filter.settled_row = -1;
    filter_forget(&state->filter);
}

void channel_begin_after(const settings_t *settings, const coefficients_t *model, state_t *state, const real first,
                         const int64_t rows, const real steps, const real least, const real most) {
    sensor_t *sensor = &state->sensor;
    filter_begin_after(settings, model, &sensor->limits, &state->filter, first, rows, steps);
    sensor->limits.least = least, sensor->limits.most = most;
    sensor->monitor.rows = sensor->faults.rows = rows, sensor->faults.steps = steps;
    sensor->monitor.hop_count = rows % HOP;
}

static void process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                    const estimate_t *estimate) {
    pass_t pass;
    judge_rows(settings, &state->sensor, block, estimate->verdict, &pass);
    filter_block(settings, model, &state->filter, block, estimate, &pass);
    watch_rows(settings, model->R, &state->sensor, block, estimate, &pass);
}

void channel_process(const settings_t *settings, const coefficients_t *model, state_t *state, const block_t *block,
                     const estimate_t *estimate) {
    for (int64_t row = 0; row < block->rows; row += BLOCK) {
        const block_t part = rows_from(block, row, BLOCK);
        const estimate_t out = estimate_from(estimate, row, settings->states);
        process(settings, model, state, &part, &out);
    }
}

void channel_call(const call_t *call) {
    memset(call->estimate->verdict, USED, (size_t)call->block->rows);
    channel_process(call->settings, call->model, call->state, call->block, call->estimate);
}
