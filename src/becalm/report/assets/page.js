// Draws the figures of a report with uPlot and numbers.js; all that it needs stands in the page.
"use strict";

(() => {
  const OTHERS = 6;
  const LEFT = 72; // pixels beside what has time in common, so that it lies in line
  const palette = new Map();

  /** Read the colours again, as the reader's light or dark theme has them. */
  function readColours() {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["ink", "faint", "grid", "readings", "clean", "truth", "limit", ...numbered()])
      palette.set(name, style.getPropertyValue(`--${name}`).trim());
  }

  function numbered() {
    return Array.from({ length: OTHERS }, (_, i) => `other-${i}`);
  }

  const colour = (role) => () => palette.get(role);
  const translucent = (role) => () => `${palette.get(role)}40`;

  function bytesOf(base64) {
    return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  }

  /** Turn base64 into numbers; what is no number becomes null, where uPlot leaves a gap. */
  function decode(held) {
    const bytes = bytesOf(held.float64 ?? held.float32);
    const numbers = held.float64 ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
    return Array.from(numbers, (value) => (Number.isFinite(value) ? value + (held.offset ?? 0) : null));
  }

  /** Give each layer its role's colour; "other" ones take turns. */
  function rolesOf(layers) {
    let others = 0;
    return layers.map((layer) => (layer.role === "other" ? `other-${others++ % OTHERS}` : layer.role));
  }

  /** Lay out the layers as columns beside one x, and say which columns each layer has. */
  function columnsOf(figure, arrays) {
    const tables = new Map();
    figure.layers.forEach((layer, i) => {
      if (layer.x === undefined) return;
      if (!tables.has(layer.x)) tables.set(layer.x, []);
      for (const y of layer.kind === "band" ? [layer.low, layer.high] : [layer.y])
        tables.get(layer.x).push({ layer: i, y });
    });
    const grouped = [...tables].map(([x, found]) => [arrays[x], ...found.map(({ y }) => arrays[y])]);
    const owners = [...tables.values()].flat().map(({ layer }) => layer);
    const data = grouped.length > 1 ? uPlot.join(grouped) : grouped[0] ?? [[0, 1], [0, 0]];
    return { data, owners };
  }

  /** Where a value has no neighbours, so that no line leads to it; what is undefined has its x from another layer. */
  function alone(u, i) {
    const y = u.data[i];
    const own = [...y.keys()].filter((k) => y[k] !== undefined);
    return own.filter((k, at) => y[k] !== null && (y[own[at - 1]] ?? null) === null && (y[own[at + 1]] ?? null) === null);
  }

  function seriesOf(figure, owners, roles) {
    if (!owners.length) return [{}, { stroke: "transparent", points: { show: false } }];
    const [shared, dots] = [{ width: 1, spanGaps: false }, (role) => ({ show: true, size: 3, fill: colour(role), filter: alone })];
    return [
      {},
      ...owners.map((i) => {
        const { kind, look, faint } = figure.layers[i];
        if (kind === "band") return { ...shared, stroke: faint ? "transparent" : colour(roles[i]), points: faint ? { show: false } : dots(roles[i]) };
        if (look === "points")
          return { ...shared, stroke: colour(roles[i]), paths: () => null, points: { show: true, size: 7, fill: colour(roles[i]) } };
        const dash = { dashed: [6, 4], dotted: [2, 3] }[look];
        return { ...shared, stroke: colour(roles[i]), dash, points: dots(roles[i]) };
      }),
    ];
  }

  function bandsOf(figure, owners, roles) {
    return figure.layers.flatMap((layer, i) => {
      if (layer.kind !== "band") return [];
      const low = owners.indexOf(i) + 1;
      return [{ series: [low + 1, low], fill: layer.faint ? translucent(roles[i]) : colour(roles[i]) }];
    });
  }

  function axisOf(axis, more) {
    const font = "12px system-ui, sans-serif";
    const lines = { stroke: colour("grid"), width: 1 };
    const values = axis.log ? (u, splits) => splits.map(short) : (u, splits, i, space, step) => splits.map((value) => even(value, step));
    const powers = axis.log ? { splits: logarithmic, filter: (u, splits) => splits } : {};
    return { label: axis.label, labelFont: font, labelSize: 18, font, stroke: colour("ink"), grid: lines, ticks: lines, values, ...powers, ...more };
  }

  /** The room that numbers beside an axis take, and its label; never less than others have with which it lies in line. */
  function roomFor(least) {
    return (u, values) => Math.max(least, 26 + 7.2 * Math.max(0, ...(values ?? []).map((value) => value.length)));
  }

  /** Keep a scale to what is asked; what is not comes from the data, or from where the reader looks. */
  function scaleOf({ log, low, high }) {
    const scale = { time: false, distr: log ? 3 : 1 };
    if (low !== null || high !== null)
      scale.range = (u, least, most) => (u.zoomed ? [least, most] : [low ?? least, high ?? 1.05 * most]);
    return scale;
  }

  /** Keep the heights in sight however little they differ: what uPlot takes for rounding may be all there is. */
  function heightsOf(axis) {
    if (axis.log || axis.low !== null || axis.high !== null) return scaleOf(axis);
    const room = (least, most) => 0.05 * (most - least) || 0.05 * Math.abs(most) || 1;
    return { range: (u, least, most) => (least === null ? [0, 1] : [least - room(least, most), most + room(least, most)]) };
  }

  /** Draw what uPlot has no series for: lanes, rules, and the names of points. */
  function extras(figure, arrays, roles) {
    const lanes = figure.layers.filter((layer) => layer.kind === "lane");
    return (u) => {
      const { ctx } = u;
      const { left, top, width, height } = u.bbox;
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      lanes.forEach((lane, i) => {
        ctx.fillStyle = palette.get(`other-${i % OTHERS}`);
        const [above, below] = [u.valToPos(0.4 - i, "y", true), u.valToPos(-0.4 - i, "y", true)];
        arrays[lane.starts].forEach((start, k) => {
          const from = u.valToPos(start, "x", true);
          ctx.fillRect(from, above, Math.max(devicePixelRatio, u.valToPos(arrays[lane.ends][k], "x", true) - from), below - above);
        });
      });
      figure.layers.forEach((layer, i) => {
        if (layer.kind === "rule") rule(u, layer, palette.get(roles[i]));
        (layer.labels ?? []).forEach((text, k) => {
          const [x, y] = [arrays[layer.x][k], arrays[layer.y][k]];
          if (x !== null && y !== null) label(u, text, x, y);
        });
      });
      ctx.restore();
    };
  }

  function rule(u, layer, stroke) {
    const at = u.valToPos(layer.at, "x", true);
    u.ctx.strokeStyle = stroke;
    u.ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    u.ctx.beginPath();
    u.ctx.moveTo(at, u.bbox.top);
    u.ctx.lineTo(at, u.bbox.top + u.bbox.height);
    u.ctx.stroke();
  }

  function label(u, text, x, y) {
    const right = u.valToPos(x, "x", true) > u.bbox.left + 0.5 * u.bbox.width;
    u.ctx.fillStyle = palette.get("ink");
    u.ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    u.ctx.textAlign = right ? "right" : "left";
    u.ctx.fillText(text, u.valToPos(x, "x", true) + (right ? -8 : 8) * devicePixelRatio, u.valToPos(y, "y", true) - 8 * devicePixelRatio);
  }

  /** One button a layer, which hides it; beside it what stands under the cursor. */
  function legend(u, figure, owners, roles, place) {
    const told = [];
    figure.layers.forEach((layer, i) => {
      const columns = owners.flatMap((owner, column) => (owner === i ? [column + 1] : []));
      if (!layer.name || !columns.length) return;
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.style.setProperty("--mark", `var(--${roles[i]})`);
      const value = document.createElement("span");
      button.append(layer.name, " ", value);
      button.addEventListener("click", () => {
        const show = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(show));
        columns.forEach((column) => u.setSeries(column, { show }));
      });
      place.append(button);
      told.push({ columns, value });
    });
    return () => {
      for (const { columns, value } of told) {
        const values = columns.map((column) => u.cursor.idx === null ? null : u.data[column][u.cursor.idx]);
        value.textContent = values.some((one) => one === null || one === undefined) ? "" : [...new Set(values.map(short))].join(" to ");
      }
    };
  }

  /** Unpack what is shown in print. */
  async function unpack(place) {
    const stream = new Blob([bytesOf(place.dataset.svg)]).stream().pipeThrough(new DecompressionStream("gzip"));
    place.innerHTML = await new Response(stream).text();
  }

  function draw(figure, arrays, place, group) {
    const roles = rolesOf(figure.layers);
    const { data, owners } = columnsOf(figure, arrays);
    const lanes = figure.layers.filter((layer) => layer.kind === "lane");
    const canvas = place.querySelector(".canvas");
    const height = lanes.length ? 58 + 20 * lanes.length : place.classList.contains("wide") ? 320 : 240;
    const size = () => ({ width: canvas.clientWidth, height });
    const y = lanes.length
      ? axisOf(figure.y, { splits: () => lanes.map((_, i) => -i), values: () => lanes.map((lane) => lane.name), grid: { show: false }, size: () => group?.plots[0]?.u.axes[1]._size ?? LEFT })
      : axisOf(figure.y, { size: roomFor(place.classList.contains("wide") ? LEFT : 52) });
    const yScale = lanes.length ? { range: [0.5 - lanes.length, 0.5] } : heightsOf(figure.y);
    const reset = place.querySelector(".reset");
    let update = () => {};
    const u = new uPlot(
      {
        ...size(),
        legend: { show: false },
        scales: { x: scaleOf(figure.x), y: yScale },
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
    update = legend(u, figure, owners, roles, place.querySelector(".legend"));

    function zoom(on) {
      for (const each of group ? group.plots : [{ u, reset }]) {
        each.u.zoomed = on;
        each.reset.hidden = !on;
      }
      if (!group) return;
      const { left, width } = u.select;
      const range = on && { min: u.posToVal(left, "x"), max: u.posToVal(left + width, "x") };
      for (const each of group.plots) if (each.u !== u && range) each.u.setScale("x", range);
    }

    function whole() {
      zoom(false);
      for (const each of group ? group.plots : [{ u }]) each.u.setData(each.u.data);
    }

    group?.plots.push({ u, reset });
    reset.addEventListener("click", whole);
    u.over.addEventListener("dblclick", whole);
    new ResizeObserver(() => u.setSize(size())).observe(canvas);
    return u;
  }

  readColours();
  const { arrays: held, figures } = JSON.parse(document.getElementById("figures").textContent);
  const arrays = held.map(decode);
  const groups = new Map();
  const plots = figures.map((figure) => {
    const place = document.getElementById(figure.name);
    const key = place.dataset.together;
    if (key && !groups.has(key)) groups.set(key, { key, plots: [] });
    return draw(figure, arrays, place, groups.get(key));
  });
  for (const asked of ["(prefers-color-scheme: dark)", "print"])
    matchMedia(asked).addEventListener("change", () => {
      readColours();
      plots.forEach((u) => u.redraw(false, true));
    });
  document.querySelectorAll("[data-svg]").forEach(unpack);
  window.becalmPlots = plots; // for whoever looks at the page by a script, as its tests do
})();
