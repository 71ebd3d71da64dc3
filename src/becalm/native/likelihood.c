/* Compute the likelihood of a record, and no estimates; tuning needs it dozens of times per channel. Source: Schweppe,
   IEEE TIT-11 (1965) 61; equation (8) of core/reference/kalman.py. The innovation variances are multiplied, so that one
   logarithm of the product replaces one logarithm per row. */
#include <string.h>

#include "filter.h"
#include "score.h"

void likelihood_add(const settings_t *settings, const coefficients_t *model, const block_t *block, const int64_t from,
                    score_t *score) {
    real signal[BLOCK], sigma[BLOCK], innovation[BLOCK], deviation[BLOCK];
    int8_t verdict[BLOCK];
    const estimate_t estimate = {signal, sigma, verdict, innovation, deviation, NULL};
    filter_t state;
    memset(&state, 0, sizeof state);
    filter_forget(&state);
    for (int64_t at = 0; at < block->rows; at += BLOCK) {
        const block_t part = rows_from(block, at, BLOCK);
        pass_t pass = {{0}, {0}};
        memcpy(pass.usable, part.z, sizeof(real) * (size_t)part.rows);
        filter_block(settings, model, &state, &part, &estimate, &pass);
        for (int64_t row = from > at ? from - at : 0; row < part.rows; row++) {
            const real S = deviation[row] * deviation[row];
            if (!(S > 0 && S < INFINITE)) continue; /* no measurement, no prediction, or an exact prediction */
            add_score(score, innovation[row], S);
        }
    }
}
