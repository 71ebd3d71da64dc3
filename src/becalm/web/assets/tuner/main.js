// The tuner: shows the messages of becalm, and sends the actions of a person.

import { onTheme, readColours } from "../colours.js";
import { amount, find, make, say } from "../dom.js";
import { connect } from "../wire.js";
import { RequestQueue } from "./asking.js";
import { Choices } from "./choices.js";
import { Dial } from "./dial.js";
import { Files, save, upload, whyNot } from "./files.js";
import { Verdict } from "./judged.js";
import { handleKeys } from "./keys.js";
import { drawLanes } from "./lanes.js";
import { CostMap } from "./map.js";
import { SignalPlot } from "./plot.js";
import { Tabs } from "./tabs.js";

/**
 * @typedef {import("./choices.js").Channel} Channel
 * @typedef {import("./choices.js").Settings} Settings
 * @typedef {{ file: string, group: string, groups: string[], name: string, rows: number, rate_hz: number, rate_said_hz: number | null, lasts_s: number, mode: string, lag_s: number | null,
 *   channels: Channel[], classics: string[], remarks: string[], command: string }} Recording
 * @typedef {{ mode: string, lag_s: number | null, can_undo: boolean, can_redo: boolean, recipe: string, turned: number, channels: Settings[],
 *   classics?: string[] }} State
 */

/** The open recording and its settings; the page restores both after a restart of becalm. */
const desk = {
  /** @type {Recording | null} */ recording: null,
  /** @type {State | null} */ state: null,
  /** @type {File | null} */ brought: null,
  /** @type {string | null} */ restoring: null,
  /** @type {Map<number, import("./dial.js").Positions>} */ dials: new Map(),
  /** @type {Map<number, import("./judged.js").Judged & { of: string | null }>} */ judged: new Map(),
  channel: 0,
  opening: false, // whether a file that the person chose is being opened
  saving: false,
  /** @type {number | null} */ turned: null, // number of the last change while it has no answer; states before the answer are older
  mapped: "", // the setting for which the map was requested last
  /** @type {number | null} */ mapAsked: null, // number of the last request for a map
  run: "", // identifier of the run of becalm that the page is connected to
  /** @type {import("./dial.js").Filter} */ filter: {}, // the filter of the last picture
  pictures: 0, // number of pictures received
};
const lanes = find("lanes", HTMLCanvasElement);
const words = { link: find("link", HTMLElement), trouble: find("trouble", HTMLElement), working: find("working", HTMLElement), remarks: find("remarks", HTMLElement) };

/** @param {import("./choices.js").Settings | Partial<Settings>} settings @param {boolean} [final] */
function turn(settings, final = true) {
  const message = { do: "turn", channel: desk.channel, settings, final };
  if (final) {
    say(words.trouble, "");
    desk.turned = asking.sendNow(message);
  } else asking.ask(message);
}

const send = connect({ text: receive, frame: draw, link: showLink });
const asking = new RequestQueue(send);
const plot = new SignalPlot(find("plot", HTMLElement), ({ from, to }) => look(from, to));
const dial = new Dial((process_noise_density, final) => turn({ process_noise_density }, final));
const map = new CostMap(turn);
const choices = new Choices((settings) => turn(settings), (mode, lag_s) => request({ do: "mode", mode, lag_s }));
const verdict = new Verdict();
const tabs = new Tabs((channel, focus) => choose(channel, focus));
const files = new Files(open, (file) => uploadAndOpen(file), () => send({ do: "files" }));
const [classic, group, format] = ["classic", "group", "format"].map((id) => find(id, HTMLSelectElement));

/** Send a request for a person, and clear an older error. @param {object} message */
function request(message) {
  say(words.trouble, "");
  send(message);
}

/** @param {number} from @param {number} to */
function look(from, to) {
  const whole = plot.isWhole;
  asking.ask({ do: "look", channel: desk.channel, from_s: whole ? null : from, to_s: whole ? null : to, width: plot.width });
}

/** @param {string} file */
function open(file) {
  desk.brought = null;
  desk.opening = true;
  request({ do: "open", file, rate_hz: files.rate_hz });
}

/** Send a file that was dropped or chosen, and open it. @param {File} file @param {string} [group] @param {number | null} [rate_hz] */
async function uploadAndOpen(file, group, rate_hz = files.rate_hz) {
  await showProgress(`Sending ${file.name} …`, async () => {
    const id = await upload(file);
    desk.brought = file;
    desk.opening = true;
    send({ do: "open", file: id, group, rate_hz });
  });
}

/** Show a sentence during some work, and afterwards the error if the work failed. @param {string} says @param {() => Promise<unknown>} does */
async function showProgress(says, does) {
  say(words.trouble, "");
  say(words.working, says);
  try {
    await does();
    say(words.working, "");
  } catch (error) {
    say(words.working, "");
    say(words.trouble, whyNot(error));
  }
}

/** @param {import("../wire.js").Link} link */
function showLink({ up, again_s, reason, hint }) {
  document.body.dataset.state = up ? "open" : "disconnected";
  for (const one of document.querySelectorAll("fieldset")) one.disabled = !up;
  asking.forget();
  desk.turned = null;
  const kept = desk.recording ? " This page keeps your settings." : "";
  say(words.link, up ? "" : `${reason ? `${reason} Trying` : "becalm does not answer; trying"} again in ${Math.ceil(again_s)} s.${kept}${hint}`);
  if (!up) say(words.working, "");
}

/** @param {any} message */
function receive(message) {
  if (message.kind === "welcome") receiveWelcome(message);
  else if (message.kind === "files") files.list(message);
  else if (message.kind === "working") say(words.working, message.says);
  else if (message.kind === "trouble") {
    say(words.working, "");
    if (message.answers !== null && message.answers === desk.mapAsked) map.refuse(message.says); // the person did not request the map
    else say(words.trouble, message.says);
    if (!desk.recording) files.suggest(true); // so that the person can choose another file, or give a rate
    desk.opening = false;
    choices.forgetLag();
    asking.handleAnswer(message.answers);
    finishChange(message.answers ?? 0);
    showSettings();
  } else if (message.kind === "recording") receiveRecording(message);
  else if (message.kind === "state") receiveState(message);
  else if (message.kind === "figures") {
    desk.judged.set(message.channel, { ...message, of: JSON.stringify(message.of) });
    if (message.channel === desk.channel) verdict.show(message);
  }
}

/** @param {any} welcome */
function receiveWelcome(welcome) {
  say(words.working, "");
  files.list(welcome);
  fill(format, welcome.saves.map((/** @type {string} */ ending) => ending.slice(1)), format.value);
  const open = desk.recording?.file;
  const [here, again] = [welcome.run === desk.run, Boolean(desk.run)];
  desk.run = welcome.run;
  desk.restoring = again && !here ? desk.state?.recipe ?? null : null;
  if (!open) files.suggest(!welcome.file);
  else if (here) return; // only the connection failed: becalm sends the open recording by itself
  else if (welcome.file === open && desk.recording?.groups.length === 1 && !desk.recording.rate_said_hz) return;
  else if (desk.brought && !welcome.files.some((/** @type {{ id: string }} */ one) => one.id === open)) uploadAndOpen(desk.brought, desk.recording?.group, desk.recording?.rate_said_hz);
  else send({ do: "open", file: open, group: desk.recording?.group, rate_hz: desk.recording?.rate_said_hz });
}

/** @param {Recording} recording */
function receiveRecording(recording) {
  const again = desk.recording?.file === recording.file && desk.recording.group === recording.group;
  desk.recording = recording;
  if (!again) desk.state = null;
  desk.dials.clear();
  desk.judged.clear();
  say(words.working, "");
  say(words.trouble, "");
  say(words.remarks, recording.remarks.join(" "));
  files.rate.value = "";
  document.title = `${recording.name} - becalm`;
  find("facts", HTMLElement).textContent = `${recording.name}: ${recording.rows.toLocaleString("en")} rows at ${amount(recording.rate_hz, "Hz")}, ${amount(recording.lasts_s, "s")}`;
  find("command", HTMLElement).textContent = recording.command;
  find("typed", HTMLElement).hidden = !recording.command; // empty if a name cannot be typed
  find("desk", HTMLElement).hidden = false;
  find("actions", HTMLElement).hidden = false;
  if (desk.opening) files.show(false);
  else if (!again) files.suggest(false);
  desk.opening = false;
  fill(group, recording.groups, recording.group);
  group.hidden = recording.groups.length < 2;
  choices.proposed_s = 10 / recording.rate_hz;
  choices.pointMode(recording.mode, recording.lag_s);
  if (!again) choices.forgetLag();
  offerClassics(recording.classics);
  tabs.open(recording.channels.map(({ name }) => name));
  choose(again ? desk.channel : 0, false, again);
}

/** Fill a list of choices. @param {HTMLSelectElement} place @param {string[]} names @param {string} chosen */
function fill(place, names, chosen) {
  place.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
  place.value = names.includes(chosen) ? chosen : names[0];
}

/** Offer classic filters to compare with. @param {string[]} names */
function offerClassics(names) {
  fill(classic, ["", ...names], classic.value);
  classic.options[0].text = names.length ? "no classic filter" : "no classic filter has a delay";
}

/** Show a channel. @param {number} channel @param {boolean} [focus] @param {boolean} [stay] whether to keep the view */
function choose(channel, focus = false, stay = true) {
  const { recording } = desk;
  const chosen = recording?.channels[channel];
  if (!recording || !chosen) return;
  desk.channel = channel;
  tabs.point(channel, focus);
  find("plot-title", HTMLElement).textContent = chosen.name;
  const { from, to } = plot.view;
  const seen = stay && !plot.isWhole;
  plot.open(chosen, recording);
  delete lanes.dataset.rows;
  choices.open(chosen);
  dial.lay(desk.dials.get(channel) ?? null, chosen.unit);
  map.clear();
  desk.mapped = "";
  verdict.clear();
  const judged = desk.judged.get(channel);
  if (judged) verdict.show(judged);
  showSettings();
  if (seen) plot.look(from, to);
  else plot.whole();
  if (classic.value) send({ do: "compare", channel, classic: classic.value });
}

/** Handle new settings; after a restart of becalm, send the settings from before the restart. @param {State} state */
function receiveState(state) {
  const { restoring } = desk;
  desk.restoring = null;
  desk.state = state;
  finishChange(state.turned);
  if (!desk.saving) say(words.working, "");
  if (restoring && restoring !== state.recipe) send({ do: "restore", recipe: restoring });
  else showSettings();
}

/** Handle the answer to a change. @param {number} number */
function finishChange(number) {
  if (desk.turned !== null && number >= desk.turned) desk.turned = null;
}

/** Show the settings. */
function showSettings() {
  const { state } = desk;
  const settings = state?.channels[desk.channel];
  if (!state || !settings) return;
  find("undo", HTMLButtonElement).disabled = !state.can_undo;
  find("redo", HTMLButtonElement).disabled = !state.can_redo;
  choices.pointMode(state.mode, state.lag_s);
  if (state.classics) offerClassics(state.classics);
  choices.point(settings);
  if (desk.turned === null) dial.point(settings.process_noise_density);
  verdict.wait(desk.judged.get(desk.channel)?.of !== settingOf(desk.channel));
  askMap(settings);
}

/** Return the setting that figures must belong to, as JSON. @param {number} channel */
function settingOf(channel) {
  const { state } = desk;
  return state && JSON.stringify([state.mode, state.lag_s, state.channels[channel]]);
}

/** Request a new map after a change of the model. @param {Settings} settings */
function askMap({ choice, on, noise_std, process_noise_density }) {
  const wanted = JSON.stringify([desk.state?.mode, desk.state?.lag_s, desk.channel, choice, on]);
  if (noise_std && process_noise_density) map.point({ noise_std, process_noise_density });
  find("map", HTMLElement).hidden = !noise_std;
  if (wanted === desk.mapped || !noise_std) return;
  desk.mapped = wanted;
  desk.mapAsked = send({ do: "map", channel: desk.channel });
}

/** @param {import("../frames.js").Frame} frame */
function draw(frame) {
  const { header, arrays } = frame;
  if (header.kind === "dial" && arrays.process_noise_density?.length) desk.dials.set(header.channel, /** @type {any} */ (arrays));
  else if (header.kind === "dial") desk.dials.delete(header.channel); // the channel passes unchanged
  if (header.kind === "picture") asking.handleAnswer(header.answers);
  if (header.channel !== desk.channel || !desk.recording) return;
  const { unit } = desk.recording.channels[desk.channel];
  if (header.kind === "dial") {
    dial.lay(desk.dials.get(header.channel) ?? null, unit);
    dial.point(desk.state?.channels[desk.channel].process_noise_density ?? null);
    dial.show(desk.filter);
  } else if (header.kind === "map") {
    if (header.answers === desk.mapAsked) map.show(header, arrays.cost, unit);
  }
  else if (header.kind === "picture") {
    plot.drawn = () => { if (plot.u) drawLanes(lanes, plot.u, arrays.verdicts); };
    desk.pictures += 1;
    plot.show(frame);
    desk.filter = header.filter;
    dial.show(header.filter);
    const each = header.rows_each > 1 ? `Each stretch is ${header.rows_each.toLocaleString("en")} rows, drawn from minimum to maximum.` : "";
    const hurried = header.hurried ? "The earlier spikes are left out until the gate has judged again." : "";
    find("plot-says", HTMLElement).textContent = [`Drawn: ${header.filter.says}.`, each, hurried].join(" ");
  }
}

/** @param {string} what */
function saveResult(what) {
  if (!desk.state || desk.saving) return;
  desk.saving = true;
  showProgress("Saving …", () => save(`/save/${what}`)).finally(() => { desk.saving = false; });
}

/** @type {Record<string, () => void>} */
const ACTIONS = {
  undo: () => request({ do: "undo" }),
  redo: () => request({ do: "redo" }),
  "save-recipe": () => saveResult("recipe"),
  "save-clean": () => saveResult(`clean?format=${format.value}`),
  "save-report": () => saveResult("report"),
  nearer: () => plot.zoom(0.5),
  farther: () => plot.zoom(2),
  whole: () => plot.whole(),
  tuned: () => turn({ choice: desk.state?.channels[desk.channel].choice }),
  copy: () => navigator.clipboard.writeText(desk.recording?.command ?? ""),
};
for (const [id, action] of Object.entries(ACTIONS)) find(id, HTMLButtonElement).addEventListener("click", action);
find("copy", HTMLElement).hidden = !navigator.clipboard;
group.addEventListener("change", () => request({ do: "open", file: desk.recording?.file, group: group.value, rate_hz: desk.recording?.rate_said_hz }));
classic.addEventListener("change", () => request({ do: "compare", channel: desk.channel, classic: classic.value || null }));
handleKeys({
  ArrowLeft: () => plot.pan(-0.2), ArrowRight: () => plot.pan(0.2),
  "+": ACTIONS.nearer, "=": ACTIONS.nearer, "-": ACTIONS.farther, 0: ACTIONS.whole,
  "[": () => dial.step(-1), "]": () => dial.step(1),
  z: ACTIONS.undo, "Shift+z": ACTIONS.redo, o: () => files.show(true, true), Escape: () => files.show(!desk.recording), s: ACTIONS["save-recipe"],
}, (channel) => choose(channel));
readColours();
onTheme(() => {
  plot.u?.redraw(false, true);
  map.redraw();
  verdict.plots.forEach((u) => u.redraw(false, true));
});
Object.assign(window, { becalm: { plot, dial, map, desk, asking } }); // for scripts that inspect the page, such as its tests
