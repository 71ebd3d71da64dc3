// Draws figures with uPlot, from the descriptions that `payload` encodes, for reports and for the app.

import { axisOf, roomFor, roomOf, roomy } from "./axes.js";
import { colour, other, translucent } from "./colours.js";
import { short } from "./numbers.js";

/**
 * @typedef {{ label: string, log: boolean, low: number | null, high: number | null }} Axis
 * @typedef {"curve" | "band" | "lane" | "rule"} Kind
 * @typedef {object} Layer
 * @property {Kind} kind
 * @property {string} name
 * @property {string} role
 * @property {number} [x] index of an array in the payload; so are y, low, high, starts and ends
 * @property {number} [y]
 * @property {number} [low]
 * @property {number} [high]
 * @property {number} [starts]
 * @property {number} [ends]
 * @property {number} [at]
 * @property {boolean} [faint]
 * @property {string} [look]
 * @property {string[]} [labels]
 * @typedef {{ name: string, title: string, x: Axis, y: Axis, layers: Layer[] }} Figure
 * @typedef {{ float64?: string, float32?: string, offset?: number }} Held
 * @typedef {(number | null)[][]} Arrays
 * @typedef {{ arrays: Held[], figures: Figure[] }} Payload
 * @typedef {{ u: uPlot, reset: HTMLElement }} Plot
 * @typedef {{ key: string, plots: Plot[] }} Group figures that are zoomed together
 */

const LEFT = 72; // pixels, the smallest width of the y axes of wide figures, so that their time axes align
/** @type {WeakSet<uPlot>} */
const zoomed = new WeakSet();

/** @param {string} base64 */
export function bytesOf(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

/**
 * Decode base64 into numbers; NaN becomes null, where uPlot leaves a gap.
 * @param {Held} held
 */
export function decode(held) {
  const { buffer } = bytesOf(held.float64 ?? held.float32 ?? "");
  const numbers = held.float64 ? new Float64Array(buffer) : new Float32Array(buffer);
  return Array.from(numbers, (value) => (Number.isFinite(value) ? value + (held.offset ?? 0) : null));
}

/** Return the colour name of each layer; layers with the role "other" get successive colours. @param {Layer[]} layers */
function rolesOf(layers) {
  let others = 0;
  return layers.map((layer) => (layer.role === "other" ? other(others++) : layer.role));
}

/**
 * Return the layers as data columns with a common x, and for each column the index of its layer.
 * @param {Figure} figure
 * @param {Arrays} arrays
 * @returns {{ data: uPlot.AlignedData, owners: number[] }}
 */
function columnsOf(figure, arrays) {
  /** @type {Map<number, { layer: number, y: number }[]>} */
  const tables = new Map();
  figure.layers.forEach((layer, i) => {
    if (layer.x === undefined) return;
    const table = tables.get(layer.x) ?? [];
    tables.set(layer.x, table);
    for (const y of layer.kind === "band" ? [layer.low, layer.high] : [layer.y]) table.push({ layer: i, y: Number(y) });
  });
  const grouped = [...tables].map(([x, columns]) => /** @type {uPlot.AlignedData} */ ([arrays[x], ...columns.map(({ y }) => arrays[y])]));
  const owners = [...tables.values()].flat().map(({ layer }) => layer);
  const data = grouped.length > 1 ? uPlot.join(grouped) : grouped[0] ?? [[0, 1], [0, 0]];
  return { data, owners };
}

/**
 * Return the indices of values without neighbours, which a line does not show. Undefined values are skipped, because
 * their x belongs to another layer.
 * @param {uPlot} u
 * @param {number} i
 */
export function alone(u, i) {
  const y = u.data[i];
  const own = [...y.keys()].filter((k) => y[k] !== undefined);
  return own.filter((k, at) => y[k] !== null && (y[own[at - 1]] ?? null) === null && (y[own[at + 1]] ?? null) === null);
}

/**
 * @param {Figure} figure
 * @param {number[]} owners
 * @param {string[]} roles
 * @returns {uPlot.Series[]}
 */
function seriesOf(figure, owners, roles) {
  if (!owners.length) return [{}, { stroke: "transparent", points: { show: false } }];
  const shared = { width: 1, spanGaps: false };
  const dots = (/** @type {string} */ role) => ({ show: true, size: 3, fill: colour(role), filter: alone });
  return [
    {},
    ...owners.map((i) => {
      const { kind, look, faint } = figure.layers[i];
      const stroke = colour(roles[i]);
      if (kind === "band") return { ...shared, stroke: faint ? "transparent" : stroke, points: faint ? { show: false } : dots(roles[i]) };
      if (look === "points") return { ...shared, stroke, paths: () => null, points: { show: true, size: 7, fill: stroke } };
      const dash = look === "dashed" ? [6, 4] : look === "dotted" ? [2, 3] : undefined;
      return { ...shared, stroke, dash, points: dots(roles[i]) };
    }),
  ];
}

/**
 * @param {Figure} figure
 * @param {number[]} owners
 * @param {string[]} roles
 * @returns {uPlot.Band[]}
 */
function bandsOf(figure, owners, roles) {
  return figure.layers.flatMap((layer, i) => {
    if (layer.kind !== "band") return [];
    const low = owners.indexOf(i) + 1;
    return [{ series: [low + 1, low], fill: layer.faint ? translucent(roles[i]) : colour(roles[i]) }];
  });
}

/**
 * Return a scale with the limits of an axis; missing limits come from the data. A zoomed figure ignores the limits.
 * @param {Axis} axis
 * @returns {uPlot.Scale}
 */
function scaleOf({ log, low, high }) {
  /** @type {uPlot.Scale} */
  const scale = { time: false, distr: log ? 3 : 1 };
  if (low !== null || high !== null)
    scale.range = (u, least, most) => (zoomed.has(u) ? [least, most] : [low ?? least, high ?? 1.05 * most]);
  return scale;
}

/** Return the scale of a y axis. @param {Axis} axis */
const heightsOf = (axis) => (axis.log || axis.low !== null || axis.high !== null ? scaleOf(axis) : roomy);

/** Paint within the frame of a plot only. @param {uPlot} u @param {() => void} paint */
export function clipped(u, paint) {
  const { left, top, width, height } = u.bbox;
  u.ctx.save();
  u.ctx.beginPath();
  u.ctx.rect(left, top, width, height);
  u.ctx.clip();
  paint();
  u.ctx.restore();
}

/**
 * Return a function that draws what is no uPlot series: lanes, rules, and the labels of points.
 * @param {Figure} figure
 * @param {Arrays} arrays
 * @param {string[]} roles
 */
function extras(figure, arrays, roles) {
  const lanes = figure.layers.filter((layer) => layer.kind === "lane");
  return (/** @type {uPlot} */ u) =>
    clipped(u, () => {
      lanes.forEach((lane, i) => paintLane(u, i, arrays[Number(lane.starts)], arrays[Number(lane.ends)]));
      figure.layers.forEach((layer, i) => {
        if (layer.kind === "rule") rule(u, Number(layer.at), colour(roles[i])());
        (layer.labels ?? []).forEach((text, k) => {
          const [x, y] = [arrays[Number(layer.x)][k], arrays[Number(layer.y)][k]];
          if (x !== null && y !== null) label(u, text, x, y);
        });
      });
    });
}

/**
 * @param {uPlot} u
 * @param {number} i
 * @param {(number | null)[]} starts
 * @param {(number | null)[]} ends
 */
function paintLane(u, i, starts, ends) {
  u.ctx.fillStyle = colour(other(i))();
  const [above, below] = [u.valToPos(0.4 - i, "y", true), u.valToPos(-0.4 - i, "y", true)];
  starts.forEach((start, k) => {
    const from = u.valToPos(Number(start), "x", true);
    u.ctx.fillRect(from, above, Math.max(devicePixelRatio, u.valToPos(Number(ends[k]), "x", true) - from), below - above);
  });
}

/** @param {uPlot} u @param {number} where @param {string} stroke */
function rule(u, where, stroke) {
  const at = u.valToPos(where, "x", true);
  u.ctx.strokeStyle = stroke;
  u.ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
  u.ctx.beginPath();
  u.ctx.moveTo(at, u.bbox.top);
  u.ctx.lineTo(at, u.bbox.top + u.bbox.height);
  u.ctx.stroke();
}

/** @param {uPlot} u @param {string} text @param {number} x @param {number} y */
function label(u, text, x, y) {
  const right = u.valToPos(x, "x", true) > u.bbox.left + 0.5 * u.bbox.width;
  u.ctx.fillStyle = colour("ink")();
  u.ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
  u.ctx.textAlign = right ? "right" : "left";
  u.ctx.fillText(text, u.valToPos(x, "x", true) + (right ? -8 : 8) * devicePixelRatio, u.valToPos(y, "y", true) - 8 * devicePixelRatio);
}

/**
 * Make a legend: a button for each layer, which shows the value at the cursor; a click hides or shows the layer.
 * @param {uPlot} u
 * @param {{ name: string, role: string, columns: number[] }[]} entries
 * @param {Element} place
 * @returns {() => void} a function to call after each move of the cursor
 */
export function legend(u, entries, place) {
  const buttons = entries.map(({ name, role, columns }) => {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    button.style.setProperty("--mark", `var(--${role})`);
    const value = document.createElement("span");
    button.append(name, " ", value);
    button.addEventListener("click", () => {
      const show = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(show));
      columns.forEach((column) => u.setSeries(column, { show }));
    });
    place.append(button);
    return { columns, value };
  });
  return () => {
    for (const { columns, value } of buttons) {
      const at = u.cursor.idx ?? null;
      const values = columns.map((column) => (at === null ? null : u.data[column]?.[at]));
      const known = values.filter((one) => one !== null && one !== undefined);
      value.textContent = known.length < values.length ? "" : [...new Set(known.map(short))].join(" to ");
    }
  };
}

/**
 * Draw a figure into an element that contains a .canvas, a .legend and a .reset.
 * @param {Figure} figure
 * @param {Arrays} arrays
 * @param {HTMLElement} place
 * @param {Group} [group]
 */
export function draw(figure, arrays, place, group) {
  const [canvas, names, reset] = [".canvas", ".legend", ".reset"].map((one) => /** @type {HTMLElement} */ (place.querySelector(one)));
  const roles = rolesOf(figure.layers);
  const { data, owners } = columnsOf(figure, arrays);
  const lanes = figure.layers.filter((layer) => layer.kind === "lane");
  const wide = place.classList.contains("wide");
  const height = lanes.length ? 58 + 20 * lanes.length : wide ? 320 : 240;
  const size = () => ({ width: canvas.clientWidth, height });
  const inLine = () => (group?.plots[0] ? roomOf(group.plots[0].u, 1) : LEFT);
  const y = lanes.length
    ? axisOf(figure.y, { splits: () => lanes.map((_, i) => -i), values: () => lanes.map((lane) => lane.name), grid: { show: false }, size: inLine })
    : axisOf(figure.y, { size: roomFor(wide ? LEFT : 52) });
  let update = () => {};
  const u = new uPlot(
    {
      ...size(),
      legend: { show: false },
      scales: { x: scaleOf(figure.x), y: lanes.length ? { range: [0.5 - lanes.length, 0.5] } : heightsOf(figure.y) },
      axes: [axisOf(figure.x, { size: 34 }), y],
      series: seriesOf(figure, owners, roles),
      bands: bandsOf(figure, owners, roles),
      cursor: { drag: { x: true, y: false }, sync: group ? { key: group.key } : undefined, points: { show: false } },
      hooks: {
        draw: [extras(figure, arrays, roles)],
        setCursor: [() => update()],
        setSelect: [(self) => { if (self.select.width > 0) zoom(true); }],
      },
    },
    data,
    canvas,
  );
  const entries = figure.layers.map(({ name }, i) => ({ name, role: roles[i], columns: owners.flatMap((owner, column) => (owner === i ? [column + 1] : [])) }));
  update = legend(u, entries.filter(({ name, columns }) => name && columns.length), names);

  /** @param {boolean} on */
  function zoom(on) {
    for (const each of group ? group.plots : [{ u, reset }]) {
      zoomed[on ? "add" : "delete"](each.u);
      each.reset.hidden = !on;
    }
    if (!group || !on) return;
    const { left, width } = u.select;
    const range = { min: u.posToVal(left, "x"), max: u.posToVal(left + width, "x") };
    for (const each of group.plots) if (each.u !== u) each.u.setScale("x", range);
  }

  function whole() {
    zoom(false);
    for (const each of group ? group.plots : [{ u }]) each.u.setData(each.u.data);
  }

  group?.plots.push({ u, reset });
  reset.addEventListener("click", whole);
  u.over.addEventListener("dblclick", whole);
  const watch = new ResizeObserver(() => u.setSize(size()));
  watch.observe(canvas);
  u.hooks.destroy = [() => watch.disconnect()];
  return u;
}
