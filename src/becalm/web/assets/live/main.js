// The live page: shows a stream while it runs.

import { onTheme, readColours } from "../colours.js";
import { amount, find, say, fillTerms } from "../dom.js";
import { save, whyNot } from "../tuner/files.js";
import { handleKeys } from "../tuner/keys.js";
import { connect } from "../wire.js";
import { clock, drawAxis, ticksOf, timeOf } from "./axis.js";
import { HELD, Store } from "./store.js";
import { GUTTER, Strip } from "./strip.js";
import { View } from "./view.js";

const MOST_REQUESTED = 4000; // largest number of bins in one request
const NUMBERS_MS = 250; // time between two updates of the numbers, long enough to read them
const QUIET_S = 5; // becalm sends a status every second; after this time without one it counts as silent
/** @type {Record<string, string>} */
const OVER = { ended: "The stream has ended, and becalm with it;", stopping: "becalm was stopped;", failed: "becalm has ended;" };

const links = { link: find("link", HTMLElement), trouble: find("trouble", HTMLElement), working: find("working", HTMLElement) };
const buttons = { pause: find("pause", HTMLButtonElement), now: find("now", HTMLButtonElement), undo: find("undo", HTMLButtonElement) };
const axis = find("axis", HTMLCanvasElement);

/** @type {any} */
let welcome = null;
/** @type {View} */
let view;
/** @type {Strip[]} */
let strips = [];
/** @type {Store} the newest bins */
let live;
/** @type {Store | null} the bins in view while the view is paused */
let pausedStore = null;
let level = -1; // level of the newest bins
let next = 0; // number of the next new bin
let state = "";
let chosen = 0; // channel whose dial the keys turn
let requested = ""; // last request for past bins
let numbersMs = 0;
const counts = { bytes: 0, frames: 0, updates: 0, drawn: 0, bins: 0, gaps: 0 };
let hasNewBins = false; // whether bins arrived since the last frame
let connected = false; // whether the connection is open
let described = false; // whether becalm has described the stream since it connected; only then it answers requests
let quiet_s = 0; // time since the last message

const send = connect({
  text: (message) => {
    noteMessage();
    handlers[message.kind]?.(message);
  },
  frame: (frame) => {
    noteMessage();
    receiveFrame(frame);
  },
  link: ({ up, again_s, reason, hint }) => {
    connected = up;
    described = false;
    quiet_s = 0;
    for (const strip of strips) strip.dropChange(); // requests without an answer will not get one
    if (up) say(links.trouble, "");
    else if (state in OVER && state !== "failed") say(links.working, "");
    showLink(up ? "" : `${OVER[state] ?? (reason || "becalm does not answer;")} earlier data stay visible. Trying again in ${Math.ceil(again_s)} s.${hint}`);
  },
});

/** Show whether becalm answers. @param {string} says why becalm does not answer; "" if it does */
function showLink(says) {
  document.body.dataset.state = says ? "disconnected" : "live";
  say(links.link, says);
}

/** Note that a message has arrived from becalm. */
function noteMessage() {
  if (quiet_s >= QUIET_S) showLink("");
  quiet_s = 0;
}

// The connection may stay open without messages, if becalm hangs or a cable is unplugged.
setInterval(() => {
  quiet_s += 1;
  if (connected && quiet_s >= QUIET_S) showLink(`becalm has sent nothing for more than ${QUIET_S - 1} s; earlier data stay visible.`);
}, 1000);

/** @type {Record<string, (message: any) => void>} */
const handlers = {
  welcome: begin,
  health: showHealth,
  tuned: tune,
  taken: ({ answers }) => answered(answers, ""),
  "passed over": ({ answers }) => answered(answers, ""),
  trouble: ({ says, answers }) => answered(answers, says),
};

/** Handle the answer to a request. @param {number | null} number of the request @param {string} says an error, or "" */
function answered(number, says) {
  say(links.trouble, says);
  for (const strip of strips) strip.answered(number, !says);
}

/** Start with the description of a stream. @param {any} message */
function begin(message) {
  const again = welcome?.run === message.run;
  const before = welcome;
  welcome = message;
  described = true;
  say(links.working, "");
  if (!again) {
    if (before) say(links.link, "becalm was restarted; earlier data are gone.");
    view = new View(message);
    let place = 0;
    strips = message.names.map((/** @type {string} */ name, /** @type {number} */ c) => {
      const modes = (message.modes[c] ?? []).map((/** @type {string} */ mode) => /** @type {[string, number]} */ ([mode, place++]));
      return new Strip(c, name, message.units[c], modes, (density) => send({ do: "turn", channel: c, process_noise_density: density }));
    });
    const list = find("strips", HTMLElement);
    list.style.setProperty("--strips", String(strips.length));
    list.replaceChildren(...strips.map((strip) => strip.element));
    strips.forEach(handlePointer);
    Object.assign(globalThis, { becalmLive: { view, strips, counts, store: shown } });
    pausedStore = null;
    level = -1;
    showButtons();
  }
  requested = ""; // a request for past bins from before gets no answer
  const was = view.level;
  view.fit();
  if (pausedStore && view.level !== was) pausedStore = new Store(strips.length, modesOf());
  find("stream", HTMLElement).hidden = find("actions", HTMLElement).hidden = false;
  requestNewBins(again);
  requestMissingBins();
}

/** Request the new bins of the level in view. @param {boolean} [continues] whether to continue after the last bin, if the level is the same */
function requestNewBins(continues = false) {
  if (!continues || level !== view.level) {
    level = view.level;
    live = new Store(strips.length, modesOf());
    const each = welcome.rows_each[level];
    next = Math.max(0, Math.floor(view.newest / each) - Math.ceil(view.rows / each) - 2);
  }
  send({ do: "from", level, bin: next });
}

const modesOf = () => strips.reduce((count, { modes }) => count + modes.length, 0);
/** Return the store in view. */
const shown = () => pausedStore ?? live;

/** @param {import("../frames.js").Frame} frame */
function receiveFrame(frame) {
  const { header } = frame;
  const each = welcome.rows_each[header.level];
  if (header.answers !== undefined && header.answers !== null) {
    if (pausedStore && header.level === view.level) {
      pausedStore.put(frame);
      for (const { tape } of strips) tape.forget();
      requestMissingBins();
    }
    return;
  }
  if (header.level !== level || header.first - header.gap !== next) return; // an answer to an earlier request
  if (live.has(next - 1)) counts.gaps += header.gap;
  next = header.first + header.count;
  counts.bytes += frame.arrays.t.buffer.byteLength;
  live.put(frame);
  counts.updates += 1;
  counts.bins += header.count;
  hasNewBins = true;
  view.noteRows((header.first + header.count) * each, performance.now());
  requestMissingBins(); // the last bins of a paused view may have closed only now
}

/** Request the bins in view that are missing. */
function requestMissingBins() {
  if (!pausedStore) return;
  const each = welcome.rows_each[view.level];
  const [begin, stop] = [Math.max(0, Math.floor((view.right - view.rows) / each) - 1), Math.min(Math.floor(view.newest / each), Math.ceil(view.right / each) + 1)];
  const first = pausedStore.missing(begin, stop);
  if (first === null) return;
  const wanted = `${view.level} ${first} ${stop}`;
  if (wanted === requested) return; // becalm has no such bins, or has not answered yet
  if (send({ do: "past", level: view.level, first, count: Math.min(MOST_REQUESTED, HELD, stop - first) }) !== null) requested = wanted;
}

/** Change the view for a person. @param {() => void} change */
function change(change) {
  if (!welcome) return;
  const [before, paused] = [view.level, view.paused];
  change();
  if (!described) view.level = view.paused ? before : level; // without a connection no other level can be loaded
  if (view.paused) {
    if (!paused && view.level === level) pausedStore = new Store(strips.length, modesOf(), live);
    else if (!pausedStore || before !== view.level) pausedStore = new Store(strips.length, modesOf());
    requestMissingBins();
  } else {
    pausedStore = null;
    if (view.level !== level) requestNewBins();
  }
  numbersMs = 0;
  for (const strip of strips) strip.scale = null;
  showButtons();
}

function showButtons() {
  buttons.pause.textContent = view.paused ? "Continue" : "Pause";
  buttons.now.disabled = !view.paused;
}

const toggle = () => change(() => view.pause(!view.paused));
/** @param {number} by @param {number} [share] */
const zoom = (by, share) => change(() => view.zoom(by, share));
/** @param {number} windows */
const pan = (windows) => change(() => view.pan(windows));

/** Handle pointer and wheel on a strip. @param {Strip} strip */
function handlePointer(strip) {
  const { canvas } = strip;
  /** @type {number | null} */
  let from = null;
  let scrolled = 0;
  const width = () => canvas.clientWidth - GUTTER;
  canvas.addEventListener("focus", () => (chosen = strip.number));
  canvas.addEventListener("pointerdown", (event) => {
    from = event.clientX;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointerup", () => (from = null));
  canvas.addEventListener("pointercancel", () => (from = null));
  canvas.addEventListener("pointermove", (event) => {
    for (const each of strips) each.pointed = event.offsetX > GUTTER ? event.offsetX : null;
    numbersMs = 0;
    if (from === null || Math.abs(event.clientX - from) < 3) return;
    pan((from - event.clientX) / width());
    from = event.clientX;
  });
  canvas.addEventListener("pointerleave", () => {
    for (const each of strips) each.pointed = null;
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) return pan(event.deltaX / width());
    scrolled += event.deltaY;
    if (Math.abs(scrolled) < 60) return undefined;
    zoom(Math.sign(scrolled), Math.max(0, Math.min(1, (event.offsetX - GUTTER) / width())));
    scrolled = 0;
    return undefined;
  }, { passive: false });
}

/** Show the status of the stream. @param {any} health */
function showHealth(health) {
  state = health.state;
  const source = health.source.replace(/^(\w+:)\S*\//, "$1"); // only the last part of a path
  const says = state === "silent" ? ` since ${clock(Date.parse(health.since) / 1000, 1)}` : health.says ? `: ${health.says}` : "";
  const learns = state === "learning"; // the row count goes where screen readers do not repeat it every second
  const known = learns ? [`${health.rows_taken.toLocaleString("en")} rows so far`] : welcome ? [amount(welcome.rate_hz, "Hz")] : [];
  find("facts", HTMLElement).textContent = [source, ...known, state + says].join(" · ");
  if (learns || (!welcome && !(state in OVER)))
    say(links.working, learns ? "becalm learns filters for this stream." : `Waiting for the first rows (${state}${says}).`);
  else say(links.working, { away: `The source is away${says}. becalm tries again.`, silent: `The source is silent${says}.`, full: `Storage is full${says}`, ended: "The stream has ended.", stopping: "The stream was stopped.", failed: `The stream failed${says}` }[state] ?? "");
  for (const strip of strips) {
    const channel = health.channels[welcome.names[strip.number]];
    if (channel) strip.showHealth(channel);
  }
  numbersMs = 0;
  const losses = Object.entries(health.losses).filter(([, { events }]) => events);
  const latency = (/** @type {number | null} */ ms) => amount(ms === null ? null : ms / 1e3, "s");
  const { p50, p99 } = health.latency_ms;
  fillTerms(find("health", HTMLElement), [
    ["rows", health.rows.toLocaleString("en")],
    ["rows a second", amount(health.rows_per_s, "")],
    ["latency, p50 / p99", `${latency(p50)} / ${latency(p99)}`],
    ["blocks in the queue", String(health.queue.blocks)],
    ["kept", health.commits.last_age_s === null ? "not yet" : `${amount(health.commits.last_age_s, "s")} ago`],
    ["losses", losses.length ? losses.map(([kind, { events, rows }]) => `${kind} ${events}${rows ? ` (${rows} rows)` : ""}`).join(", ") : "none"],
  ]);
}

/** Show the filters. @param {any} message */
function tune({ filters, dials, can_undo }) {
  buttons.undo.disabled = !can_undo;
  for (const strip of strips) strip.tune(filters?.[strip.number], dials?.[strip.number]);
}

/** Draw the view. @param {number} now ms */
function frame(now) {
  requestAnimationFrame(frame);
  if (!welcome || !live) return;
  const passed_s = Math.min(1, (now - drawnMs) / 1000);
  drawnMs = now;
  view.move(passed_s, performance.now());
  const store = shown();
  const each = welcome.rows_each[view.paused ? view.level : level];
  for (const strip of strips) strip.fit();
  const [wide, tall] = [axis.clientWidth, axis.clientHeight].map((one) => Math.round(one * devicePixelRatio));
  if (axis.width !== wide || axis.height !== tall) Object.assign(axis, { width: wide, height: tall });
  const width = axis.width - Math.round(GUTTER * devicePixelRatio);
  const perRow = width / view.rows;
  const ticks = ticksOf(store, each, view.rate, view.right - view.rows, view.right, width);
  const scene = { store, each, perRow, right: view.right, newest: view.paused ? Infinity : next, ticks };
  const showsNumbers = now - numbersMs > NUMBERS_MS;
  for (const strip of strips) {
    if (showsNumbers || !strip.scale) strip.rescale(scene);
    strip.draw(scene);
  }
  drawAxis(axis, ticks, axis.width - width);
  counts.frames += 1;
  if (hasNewBins) counts.drawn += 1;
  hasNewBins = false;
  if (showsNumbers) showNumbers(now, each, perRow);
}

/** Show the numbers at the right edge, or at the pointer. @param {number} nowMs @param {number} each @param {number} perRow */
function showNumbers(nowMs, each, perRow) {
  numbersMs = nowMs;
  const pointed = strips[0]?.pointed;
  const left = view.right - view.rows;
  const row = pointed === null || pointed === undefined ? view.right - each : left + ((pointed - GUTTER) * devicePixelRatio) / perRow;
  for (const strip of strips) strip.showNumbers(shown(), Math.floor(row / each));
  const window_s = view.window_s;
  find("window", HTMLOutputElement).value = window_s < 120 ? `${window_s} s` : window_s < 7200 ? `${window_s / 60} min` : `${window_s / 3600} h`;
  const t = timeOf(shown(), each, row, view.rate);
  const at = t === null ? "" : clock(t, Math.min(1, each / view.rate));
  const now = document.body.dataset.state === "live" && state === "running" ? "now" : "until";
  find("when", HTMLElement).textContent = `${view.paused ? "paused at" : now} ${at}`;
}

let drawnMs = performance.now();
buttons.pause.addEventListener("click", toggle);
buttons.now.addEventListener("click", () => change(() => view.pause(false)));
buttons.undo.addEventListener("click", () => send({ do: "undo" }));
find("nearer", HTMLButtonElement).addEventListener("click", () => zoom(-1));
find("farther", HTMLButtonElement).addEventListener("click", () => zoom(1));
find("save", HTMLButtonElement).addEventListener("click", async () => {
  try {
    await save("/save/recipe");
    say(links.trouble, "");
  } catch (error) {
    say(links.trouble, whyNot(error));
  }
});
handleKeys(
  {
    n: () => change(() => view.pause(false)),
    ArrowLeft: () => pan(-0.25),
    ArrowRight: () => pan(0.25),
    "+": () => zoom(-1),
    "-": () => zoom(1),
    z: () => send({ do: "undo" }),
    "[": () => strips[chosen]?.dial.step(-1),
    "]": () => strips[chosen]?.dial.step(1),
  },
  (number) => strips[number]?.canvas.focus(),
);
addEventListener("keydown", (event) => {
  if (event.key !== " " || /** @type {Element} */ (event.target).closest?.("button, a, input, summary")) return; // these elements handle the key
  toggle();
  event.preventDefault();
});
readColours();
onTheme(() => strips.forEach(({ tape }) => tape.forget()));
requestAnimationFrame(frame);
