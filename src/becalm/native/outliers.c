/* Detect gross outliers of a record by neighbours on both sides; for streams, `limits.h` uses only earlier neighbours.
 */
#include "limits.h"

#define FEWEST_AFTER 2 /* least number of later runs; with fewer, the limit for earlier neighbours applies */

/* Collect up to six nearest neighbours of a run, in the rows from `from` to `until`; return their number. If one side
   has fewer than three, the other side gives more. Write to `after` the number of runs after this run, up to six, and to
   `missing` whether more are needed and may follow after the last run. */
static int collect_neighbours(const real *values, const int64_t *ends, const int64_t run, const int64_t runs, const int64_t from,
                  const int64_t until, real *neighbours, int *after, int *missing) {
    int before = 0;
    *after = 0;
    while (before < NEIGHBOURS && run - before > 0 && ends[2 * (run - before - 1) + 1] >= from) before++;
    while (*after < NEIGHBOURS && run + *after + 1 < runs && ends[2 * (run + *after + 1)] <= until) ++*after;
    const int wanted = NEIGHBOURS - (before < SIDE ? before : SIDE);
    const int room = NEIGHBOURS - (*after < SIDE ? *after : SIDE);
    const int left = before < room ? before : room;
    const int right = *after < NEIGHBOURS - left ? *after : NEIGHBOURS - left;
    *missing = *after < wanted && run + *after + 1 == runs;
    for (int k = 0; k < left; k++) neighbours[k] = values[run - 1 - k];
    for (int k = 0; k < right; k++) neighbours[left + k] = values[run + 1 + k];
    return left + right;
}

/* Write the value, the first row and the last row of each run of measurements that are not NaN; return the number of
   runs. Equal measurements in a row are one run if `repeats_are_one`, or if they are zeros that may mark missing
   measurements; otherwise each measurement is a run. */
static int64_t find_runs(const settings_t *settings, const real *z, const int64_t rows, real *values, int64_t *ends) {
    int64_t runs = 0;
    for (int64_t row = 0; row < rows; row++) {
        if (isnan(z[row])) continue;
        const int are_one = settings->repeats_are_one || (z[row] == 0 && settings->far_from_0 > 0);
        const int same_run = are_one && runs && z[row] == values[runs - 1] && row - ends[2 * (runs - 1) + 1] <= REACH;
        if (same_run)
            ends[2 * (runs - 1) + 1] = row;
        else
            values[runs] = z[row], ends[2 * runs] = ends[2 * runs + 1] = row, runs++;
    }
    return runs;
}

static int64_t count_measured(const real *z, const int64_t first, const int64_t last) {
    int64_t count = 0;
    for (int64_t row = first; row <= last; row++) count += !isnan(z[row]);
    return count;
}

/* Return whether a single measurement is so near to each of three neighbours on either side, in the rows from `from` to
   `until`, that it is not an outlier. This is true for most measurements, so that they need no median. */
static int is_near_neighbours(const settings_t *settings, const real distance, const real *values, const int64_t *ends,
                   const int64_t run, const int64_t runs, const int64_t from, const int64_t until) {
    if (run < SIDE || run + SIDE >= runs || ends[2 * run] != ends[2 * run + 1]) return 0;
    const real z = values[run];
    if (z == 0 && settings->far_from_0 > 0) return 0;
    if (ends[2 * (run - SIDE) + 1] < from || ends[2 * (run + SIDE)] > until) return 0;
    int near = z >= settings->plausible_low && z <= settings->plausible_high;
    UNROLL
    for (int k = 1; k <= SIDE; k++)
        near &= (fabs(z - values[run - k]) <= distance) & (fabs(z - values[run + k]) <= distance);
    return near;
}

/* Return whether the row before a run and the row after it have no measurement. */
static int has_missing_beside(const int64_t *ends, const int64_t run, const int64_t runs) {
    const int64_t row = ends[2 * run];
    return (run == 0 || row - ends[2 * run - 1] > 1) && (run + 1 == runs || ends[2 * run + 2] - row > 1);
}

/* Remove each implausible neighbour whose distance from a value is more than four times the distance of the value from
   the plausible range; return the number of remaining neighbours. */
static int keep_supporting(const settings_t *settings, const real value, real *neighbours, const int count) {
    const real low = settings->plausible_low, high = settings->plausible_high;
    const real beyond = value < low ? low - value : value - high;
    int kept = 0;
    for (int k = 0; k < count; k++) {
        const real other = neighbours[k];
        if ((low <= other && other <= high) || fabs(other - value) <= NEARER * beyond) neighbours[kept++] = other;
    }
    return kept;
}

/* Remove neighbours that are 0 and mark missing measurements; return the number of remaining neighbours. */
static int keep_measured(const settings_t *settings, real *neighbours, const int count) {
    if (!marks_missing(settings, 0, neighbours, count)) return count;
    int kept = 0;
    for (int k = 0; k < count; k++)
        if (neighbours[k] != 0) neighbours[kept++] = neighbours[k];
    return kept;
}

/* Return the verdict on the measurements of a run from its neighbours. */
static int judge_run(const settings_t *settings, const real distance, const int64_t stuck, const real *values,
                     const int64_t *ends, const int64_t run, const int64_t runs, const int64_t rows,
                     real *neighbours, int count) {
    const real value = values[run];
    const int holds = stuck > 0 && rows >= stuck; /* long enough to be stuck */
    if (marks_missing(settings, value, neighbours, count)) return holds && rows >= LONGEST_0 ? STUCK : OUTLIER;
    count = keep_measured(settings, neighbours, count);
    int away = value < settings->plausible_low || value > settings->plausible_high;
    if (away && rows == 1 && has_missing_beside(ends, run, runs)) /* among sparse measurements outliers would hide each other */
        count = keep_supporting(settings, value, neighbours, count);
    if (count >= FEWEST_NEIGHBOURS) {
        const int fills = stuck > 0 && rows >= SHORTEST_FILL && rows <= LONGEST_FILL;
        away = is_far(value, neighbours, count, fills ? distance / NEARER : distance,
                      away ? IMPLAUSIBLE_SPREADS : SPREADS);
    }
    if (away) return OUTLIER;
    return holds && !(value == 0 && may_end_at_0(settings)) ? STUCK : USED;
}

int64_t scan_outliers(const settings_t *settings, const real distance, const int64_t stuck, const real *z,
                      const int64_t rows, const int64_t judged_rows, const int whole, real *values, int64_t *ends,
                      int8_t *verdict) {
    const int64_t runs = find_runs(settings, z, rows, values, ends);
    const int64_t longest = stuck > 0 ? LONGEST_FILL + 1 : 0; /* a run too long to replace missing measurements */
    const int64_t decided = stuck > longest ? stuck : longest;
    for (int64_t run = 0; run < runs; run++) {
        const int64_t first = ends[2 * run], last = ends[2 * run + 1];
        int found = verdict[first];
        const int64_t from = first - REACH, until = first + REACH;
        if (first >= judged_rows &&
            (stuck == 1 || !is_near_neighbours(settings, distance, values, ends, run, runs, from, until))) {
            real neighbours[NEIGHBOURS];
            int after, missing;
            const int count = collect_neighbours(values, ends, run, runs, from, until, neighbours, &after, &missing);
            const int64_t measured = count_measured(z, first, last);
            if (missing && !whole && rows - 1 - first < REACH) return first;
            const int undecided = measured < decided || (values[run] == 0 && last - first + 1 < LONGEST_0);
            if (run == runs - 1 && undecided && !whole && rows - 1 - last < REACH) return first;
            if (!is_long_0(settings, values[run], last - first + 1))
                found = judge_run(settings, distance, stuck, values, ends, run, runs, measured, neighbours, count);
        }
        for (int64_t row = first > judged_rows ? first : judged_rows; found && row <= last; row++)
            verdict[row] = (int8_t)(isnan(z[row]) ? USED : found);
    }
    return rows;
}

int64_t scan_outliers_soon(const settings_t *settings, const real distance, const int64_t stuck, const real *z,
                           const int64_t rows, const int64_t judged_rows, const int64_t ahead, const int whole, real *values,
                           int64_t *ends, int8_t *verdict) {
    const int64_t runs = find_runs(settings, z, rows, values, ends);
    const int64_t end = whole ? rows : rows - ahead;
    int64_t run = 0;
    for (int64_t row = judged_rows; row < end; row++) {
        if (isnan(z[row])) continue;
        while (ends[2 * run + 1] < row) run++;
        const int64_t from = row - REACH, until = row + ahead; /* these rows decide, whatever the block */
        int64_t first = ends[2 * run] > from ? ends[2 * run] : from;
        int64_t last = ends[2 * run + 1] < until ? ends[2 * run + 1] : until;
        while (isnan(z[first])) first++;
        while (isnan(z[last])) last--;
        if (is_near_neighbours(settings, distance, values, ends, run, runs, from, until)) continue;
        real neighbours[NEIGHBOURS];
        int after, missing;
        const int count = collect_neighbours(values, ends, run, runs, from, until, neighbours, &after, &missing);
        if (is_long_0(settings, values[run], last - first + 1)) continue;
        const int64_t measured = count_measured(z, first, last);
        const real far = after < FEWEST_AFTER ? settings->outlier_distance : distance;
        verdict[row] = (int8_t)judge_run(settings, far, stuck, values, ends, run, runs, measured, neighbours, count);
    }
    return end > judged_rows ? end : judged_rows;
}

void measure_distances(const real *z, const int64_t rows, int64_t *ends, real *distances, real *spreads) {
    for (int64_t row = 0; row < rows; row++) ends[2 * row] = ends[2 * row + 1] = row;
    for (int64_t row = 0; row < rows; row++) {
        real neighbours[NEIGHBOURS];
        int after, missing;
        const int count = collect_neighbours(z, ends, row, rows, row - REACH, row + REACH, neighbours, &after, &missing);
        distances[row] = fabs(z[row] - median_of(neighbours, count, spreads + row));
    }
}

void measure_jumps(const real *z, const int64_t rows, real *jumps) {
    for (int64_t row = NEIGHBOURS; row < rows; row++) {
        real neighbours[NEIGHBOURS], spread;
        for (int k = 0; k < NEIGHBOURS; k++) neighbours[k] = z[row - NEIGHBOURS + k];
        jumps[row - NEIGHBOURS] = fabs(z[row] - median_of(neighbours, NEIGHBOURS, &spread));
    }
}
