// The part of a stream that is in view; it moves smoothly with the newest rows, or stands still while paused.

const WINDOWS_S = [0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600, 4 * 3600, 12 * 3600, 48 * 3600];
const USUAL_S = 10;
const BEHIND_S = 0.1; // delay of the view behind the newest bin, so that the view moves without stops
const FEWEST_ROWS = 100; // smallest number of rows in the initial window
const MOST_BINS = 2500; // with more bins in view, a coarser level is shown

export class View {
  /** @param {{ rate_hz: number, rows_each: number[], kept: number[], newest: number[] }} stream */
  constructor({ rate_hz, rows_each, kept, newest }) {
    this.rate = rate_hz;
    this.rowsEach = rows_each;
    this.kept = kept;
    const usual = WINDOWS_S.findIndex((window_s) => window_s >= Math.max(USUAL_S, FEWEST_ROWS / rate_hz));
    this.place = usual < 0 ? WINDOWS_S.length - 1 : usual;
    /** Number of the row after the newest one that has arrived; `came` is the time of its arrival in ms. */
    this.newest = newest[0] * rows_each[0];
    this.right = this.newest; // the row at the right edge
    this.speed = rate_hz; // rows per second that arrive
    this.paused = false;
    this.came = 0;
    this.level = this.#fitting();
  }

  get window_s() {
    return WINDOWS_S[this.place];
  }

  /** Return the number of rows in view. */
  get rows() {
    return Math.max(1, this.window_s * this.rate);
  }

  /** Choose the level for the present view. */
  fit() {
    this.level = this.#fitting();
  }

  /** Note that rows up to `row` have arrived. @param {number} row @param {number} now ms */
  noteRows(row, now) {
    const [passed_s, rows] = [(now - this.came) / 1000, row - this.newest];
    if (this.came && passed_s > 0 && passed_s < 1) this.speed += (rows / passed_s - this.speed) * Math.min(1, passed_s);
    this.newest = Math.max(this.newest, row);
    this.came = now;
  }

  /** Move the view by the time that has passed. @param {number} passed_s @param {number} now ms */
  move(passed_s, now) {
    if (this.paused) return;
    const silent = now - this.came > 500;
    const wanted = silent ? this.newest : this.newest + this.speed * Math.min((now - this.came) / 1000 - BEHIND_S, 0);
    const apart = wanted - this.right;
    if (Math.abs(apart) > this.rows / 2 || (apart < 0 && silent)) this.right = wanted;
    else this.right = Math.max(this.right, Math.min(this.newest, this.right + (silent ? 0 : this.speed * passed_s) + apart * Math.min(1, 4 * passed_s)));
  }

  /** Pause the view, or follow the stream again. @param {boolean} paused */
  pause(paused) {
    this.paused = paused;
    if (!paused) this.right = this.newest;
    this.fit();
  }

  /** Move back (negative) or forward by some windows, and pause. @param {number} windows */
  pan(windows) {
    this.paused = true;
    this.right = this.#within(this.right + windows * this.rows);
    this.fit();
  }

  /** Show more time (1) or less (-1). In a paused view, the point at a share of the width stays in place. @param {number} by @param {number} [share] 0 is left, 1 is right */
  zoom(by, share = 1) {
    const before = this.rows;
    this.place = Math.max(0, Math.min(WINDOWS_S.length - 1, this.place + by));
    if (this.paused) this.right = this.#within(this.right - (1 - share) * (before - this.rows));
    this.fit();
  }

  /** Limit the right edge so that the view contains data. @param {number} right */
  #within(right) {
    return Math.max(Math.min(this.rows / 2, this.newest), Math.min(this.newest, right));
  }

  /** Return the finest level with few enough bins in view that is still stored at the left edge. */
  #fitting() {
    const first = Math.max(0, this.right - this.rows);
    const fits = this.rowsEach.findIndex((each, level) => this.rows / each <= MOST_BINS && first >= this.newest - (this.kept[level] - 1) * each);
    return fits < 0 ? this.rowsEach.length - 1 : fits;
  }
}
