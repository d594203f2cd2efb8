"use strict";
(() => {
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const root = document.documentElement;
const tone = (name) => (name.startsWith("#") ? name : `var(--${name})`);
const figures = [];
let printing = false;

function node(parent, name, attributes = {}, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  parent?.append(made);
  return made;
}

function element(parent, name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  parent?.append(made);
  return made;
}

/** A number as in the tables: six significant digits. */
function number(value) {
  if (value === null || value === undefined) return "–";
  const digits = { maximumFractionDigits: 10 };
  return Number(value.toPrecision(6)).toLocaleString("en-US", digits).replace("-", "\u2212");
}
/** A heading in 0 to 360, rounded before it is wrapped. */
const direction = (degrees) => number((Number(degrees.toFixed(2)) % 360 + 360) % 360);
const percent = (value, digits = 1) => (value === null ? "–" : `${(100 * value).toFixed(digits)} %`);

/** Round numbers that cover a range. */
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= raw * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(+(i * step).toPrecision(12));
  return found;
}

function logTicks(low, high) {
  const found = [], factors = Math.log10(high / low) > 2.5 ? [1] : Math.log10(high / low) > 1 ? [1, 3] : [1, 2, 5];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++)
    for (const factor of factors) if (factor * 10 ** power >= low && factor * 10 ** power <= high) found.push(factor * 10 ** power);
  return found;
}

function scale(low, high, from, to, log) {
  const [a, b] = log ? [Math.log10(low), Math.log10(high)] : [low, high];
  const map = (value) => from + (((log ? Math.log10(value) : value) - a) / (b - a || 1)) * (to - from);
  map.invert = (pixel) => { const value = a + ((pixel - from) / (to - from)) * (b - a); return log ? 10 ** value : value; };
  return map;
}

/** Index of the nearest of ascending values. */
function nearest(values, x) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (values[middle] <= x) low = middle; else high = middle; }
  return Math.abs(values[low] - x) <= Math.abs(values[high] - x) ? low : high;
}

// Tooltip
const tip = $("tip");
function show(event, title, rows) {
  tip.replaceChildren();
  element(tip, "b", "", title);
  for (const [name, value, color] of rows) {
    const row = element(tip, "div");
    if (color) element(row, "i").style.background = tone(color);
    element(row, "span", "", name);
    element(row, "em", "", value);
  }
  tip.hidden = false;
  const box = tip.getBoundingClientRect(), x = event.clientX, y = event.clientY;
  const left = x + 16 + box.width > innerWidth ? Math.max(6, x - 16 - box.width) : x + 16;
  tip.style.left = `${left}px`;
  tip.style.top = `${Math.max(6, Math.min(innerHeight - box.height - 6, y + 16))}px`;
}

/** The time under the pointer, for all figures of a group. */
function point(group, value, source) {
  for (const figure of figures) if (group && figure.spec.group === group && figure !== source && figure.section === source.section) figure.mark?.(value);
}

function legend(figure, entries) {
  if (entries.length < 2 || entries.length > 12) return;
  const list = element(figure.holder, "p", "legend");
  for (const [name, color, shape] of entries) {
    const item = element(list, "span");
    element(item, "i", shape).style.background = tone(color);
    item.append(name);
  }
}

function canvas(figure, width, height) {
  const svg = node(figure.holder, "svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", tabindex: 0 });
  node(svg, "title", {}, figure.spec.title);
  return svg;
}

/** Lines, steps, dots, stacked areas and bars over a common axis. */
function drawXY(figure, width) {
  const { spec } = figure, all = spec.series.filter((s) => s.x.length), height = Math.round(Math.max(190, Math.min(300, 0.56 * width)));
  const shape = (s) => (s.kind === "step" && s.x.length > 240 ? "thin" : s.kind);
  legend(figure, all.map((s) => [s.name, s.tone, shape(s)]));
  element(figure.holder, "p", "axis", spec.y.label);
  const stacked = all.filter((s) => s.kind === "stack"), tops = [];
  stacked.forEach((s, k) => tops.push(s.y.map((value, i) => (value ?? 0) + (k ? tops[k - 1][i] : 0))));
  const flat = (values) => values.flat().filter((value) => value !== null && Number.isFinite(value));
  const xs = flat(all.map((s) => [...s.x, ...(s.until ?? [])])), lines = (spec.lines ?? []);
  const ys = flat(all.map((s) => (s.kind === "stack" ? tops[stacked.indexOf(s)] : s.y)));
  const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity), most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
  let x0 = least([...xs, ...lines.map((line) => line.x)]), x1 = most([...xs, ...lines.map((line) => line.x * 1.3)]);
  let y0 = spec.min ?? least(ys), y1 = spec.max ?? most(ys);
  if (!spec.logx && spec.x.label !== "Episode") x0 = Math.min(0, x0);
  if (x1 <= x0) x1 = x0 + 1;
  if (spec.log) { y0 /= 1.2; y1 *= 1.2; } else if (spec.max === undefined) { const room = 0.06 * (y1 - y0 || Math.abs(y1) || 1); y1 += room; if (spec.min === undefined) y0 -= room; }
  const asText = (value) => (spec.percent ? percent(value, 0) : number(value));
  const yTicks = spec.log ? logTicks(y0, y1) : ticks(y0, y1, Math.max(3, Math.round(height / 55)));
  const xTicks = spec.logx ? logTicks(x0, x1) : ticks(x0, x1, Math.max(2, Math.round(width / 75)));
  const left = 14 + 6.4 * Math.max(...yTicks.map((value) => asText(value).length), 2), bottom = height - 40, top = 8;
  const right = width - Math.max(12, 3.4 * Math.max(...xTicks.map((value) => number(value).length), 0));  // half of a label
  const X = scale(x0, x1, left, right, spec.logx), Y = scale(y0, y1, bottom, top, spec.log), svg = canvas(figure, width, height);
  for (const { x0: a, x1: b, y0: c, y1: d } of spec.bands ?? []) {
    const [p, q] = [Math.max(left, X(a ?? x0)), Math.min(right, X(b ?? x1))], [r, s] = [Y(Math.min(y1, d)), Y(Math.max(y0, c))];
    if (q > p && s > r) node(svg, "rect", { x: p, y: r, width: q - p, height: s - r, class: "band" });
  }
  for (const value of yTicks) {
    node(svg, "line", { x1: left, x2: right, y1: Y(value), y2: Y(value), class: value === 0 ? "zero" : "grid" });
    node(svg, "text", { x: left - 7, y: Y(value) + 4, class: "tick end" }, asText(value));
  }
  for (const value of xTicks) {
    node(svg, "line", { x1: X(value), x2: X(value), y1: bottom, y2: bottom + 4, class: "zero" });
    node(svg, "text", { x: X(value), y: bottom + 17, class: "tick middle" }, number(value));
  }
  node(svg, "text", { x: (left + right) / 2, y: height - 5, class: "label middle" }, spec.x.label);
  const line = (x, y, kind, breaks = []) => {
    let path = "", pen = false;
    for (let i = 0; i < x.length; i++) {
      if (y[i] === null || (spec.log && y[i] <= 0)) { pen = false; continue; }
      const u = X(x[i]).toFixed(1), v = Y(y[i]).toFixed(1);
      path += !pen || breaks.includes(i) ? `M${u} ${v}` : kind === "step" ? `V${v}H${u}` : `L${u} ${v}`;
      pen = true;
    }
    return path;
  };
  stacked.forEach((s, k) => {
    const lower = k ? tops[k - 1] : tops[0].map(() => 0);
    const back = s.x.map((x, i) => `L${X(x).toFixed(1)} ${Y(lower[i]).toFixed(1)}`).reverse().join("");
    node(svg, "path", { d: `${line(s.x, tops[k], "line")}${back}Z`, class: "area", style: `fill:${tone(s.tone)}` });
  });
  for (const s of all) {
    const style = `stroke:${tone(s.tone)}`;
    if (s.kind === "dots") {
      const d = s.x.map((x, i) => (s.y[i] === null ? "" : `M${X(x).toFixed(1)} ${Y(s.y[i]).toFixed(1)}h0`)).join("");
      node(svg, "path", { d, class: "dots", style });
    } else if (s.kind === "bars") {
      const d = s.x.map((x, i) => (s.y[i] ? `M${X(x)} ${Y(0)}V${Y(s.y[i])}H${X(s.until[i])}V${Y(0)}Z` : "")).join("");
      node(svg, "path", { d, class: "area", style: `fill:${tone(s.tone)}` });
    } else if (s.kind !== "stack") {
      node(svg, "path", { d: line(s.x, s.y, s.kind, s.breaks), class: s.tone.startsWith("raw") ? "line raw" : shape(s) === "thin" ? "line thin" : "line", style });
    }
    for (const x of s.marks ?? []) node(svg, "text", { x: X(x), y: Y(s.y[nearest(s.x, x)]) + 4.5, class: "star middle", style: `fill:${tone(s.tone)}` }, "★");
  }
  for (const { x, label } of lines) {
    node(svg, "line", { x1: X(x), x2: X(x), y1: top, y2: bottom, class: "limit" });
    node(svg, "text", { x: X(x) - 4, y: top + 9, class: "tick end" }, `${label} ${number(x)}`);
  }
  const cursor = node(svg, "line", { y1: top, y2: bottom, class: "cursor", visibility: "hidden" }), dots = node(svg, "g");
  figure.mark = (value) => {
    dots.replaceChildren();
    const out = value === null || value < x0 || value > x1;
    cursor.setAttribute("visibility", out ? "hidden" : "visible");
    if (!out) { cursor.setAttribute("x1", X(value)); cursor.setAttribute("x2", X(value)); }
  };
  const at = (value, event) => {
    const found = all.map((s) => [s, nearest(s.x, value)]).filter(([s]) => value <= s.x.at(-1) + 0.03 * (x1 - x0));
    if (!found.length) return null;
    const x = found.map(([s, i]) => s.x[i]).reduce((a, b) => (Math.abs(b - value) < Math.abs(a - value) ? b : a));
    figure.mark(x);
    const rows = found.map(([s, i]) => {
      const text = spec.percent ? percent(s.y[i]) : number(s.y[i]), y = s.kind === "stack" ? tops[stacked.indexOf(s)][i] : s.y[i];
      if (y !== null && s.kind !== "bars") node(dots, "circle", { cx: X(s.x[i]), cy: Y(y), r: 3.5, style: `fill:${tone(s.tone)}` });
      return [s.x[i] === x ? s.name : `${s.name}, at ${number(s.x[i])}`, text, s.tone];
    });
    const bar = found[0][0].until, title = spec.x.label.replace(/\s*[([].*/, ""), unit = (/\[(.+)\]/.exec(spec.x.label)?.[1] ?? "").replace(/^[^°]/, " $&");
    show(event, bar ? `${number(found[0][0].x[found[0][1]])} to ${number(bar[found[0][1]])}${unit}` : `${title} ${number(x)}${unit}`, rows);
    point(spec.group, x, figure);
    return x;
  };
  const leave = () => { figure.mark(null); point(spec.group, null, figure); tip.hidden = true; };
  const pixel = (event) => { const box = svg.getBoundingClientRect(); return ((event.clientX - box.left) * width) / box.width; };
  svg.addEventListener("pointermove", (event) => at(X.invert(Math.max(left, Math.min(right, pixel(event)))), event));
  svg.addEventListener("pointerleave", leave);
  svg.addEventListener("blur", leave);
  let index = -1;
  svg.addEventListener("keydown", (event) => {
    if (!event.key.startsWith("Arrow") || !all.length) return;
    event.preventDefault();
    const { x } = all[0], box = svg.getBoundingClientRect();
    index = Math.max(0, Math.min(x.length - 1, index + (event.key === "ArrowRight" || event.key === "ArrowUp" ? 1 : -1)));
    at(x[index], { clientX: box.left + (X(x[index]) * box.width) / width, clientY: box.top + box.height / 2 });
  });
}

// Plan views
/** Draw each harbor once, in meters; the figures refer to it. */
function defineHarbors() {
  const defs = node(node(document.body, "svg", { width: 0, height: 0, style: "position:absolute" }), "defs");
  data.harbors.forEach((harbor, index) => {
    const group = node(defs, "g", { id: `harbor${index}` });
    for (const [fill, edge, corners] of harbor.shapes) {
      let d = "";
      for (let i = 0; i < corners.length; i += 2) d += `${i ? "L" : "M"}${corners[i] / 100} ${corners[i + 1] / 100}`;
      node(group, "path", { d: fill ? `${d}Z` : d, fill: fill ?? "none", stroke: edge ?? "none", "stroke-width": 0.04 });
    }
  });
}

function outline(hull, x, y, heading) {
  const c = Math.cos(heading), s = Math.sin(heading);
  let d = "";
  for (let i = 0; i < hull.length; i += 2) d += `${i ? "L" : "M"}${(x + c * hull[i] - s * hull[i + 1]).toFixed(3)} ${(y + s * hull[i] + c * hull[i + 1]).toFixed(3)}`;
  return `${d}Z`;
}
const RADIANS = Math.PI / 180;

/** Return an svg with a group in meters, and the conversion of pointer positions. */
function plan(parent, spec, width) {
  const [x0, y0, x1, y1] = spec.view, perMeter = width / (x1 - x0), height = Math.round((y1 - y0) * perMeter);
  const svg = node(parent, "svg", { viewBox: `0 0 ${width} ${height}`, width, height, class: "plan", role: "img", tabindex: 0 });
  node(svg, "title", {}, spec.title);
  node(svg, "rect", { width, height, class: "water" });
  const world = node(svg, "g", { transform: `translate(${-x0 * perMeter} ${y1 * perMeter}) scale(${perMeter} ${-perMeter})` });
  node(world, "use", { href: `#harbor${spec.harbor}`, class: "harbor" });
  for (const [x, y, heading, radius] of spec.goals) {
    node(world, "circle", { cx: x, cy: y, r: radius, class: "goal" });
    node(world, "path", { d: outline(spec.hull, x, y, heading), class: "goal dashed" });
  }
  const bar = [1, 2, 5, 10, 20, 50].filter((m) => m <= 0.25 * (x1 - x0)).at(-1) ?? 1, right = width - 12, low = height - 12;
  node(svg, "path", { d: `M${right} ${low - 5}V${low}H${right - bar * perMeter}V${low - 5}`, class: "bar" });
  node(svg, "text", { x: right - (bar * perMeter) / 2, y: low - 7, class: "bartext middle" }, `${bar} m`);
  const locate = (event) => { const box = svg.getBoundingClientRect(); return [x0 + ((event.clientX - box.left) / box.width) * (x1 - x0), y1 - ((event.clientY - box.top) / box.height) * (y1 - y0)]; };
  return { svg, world, locate, perMeter };
}

function drawPlan(figure, width) {
  const { spec } = figure, { tracks, hull } = spec;
  legend(figure, tracks.map((t) => [`${t.name} · ${t.outcome}`, t.tone]));
  const { svg, world, locate, perMeter } = plan(figure.holder, spec, width);
  const few = tracks.length < 4;
  for (const track of tracks) {
    const d = track.x.map((x, i) => `${i ? "L" : "M"}${x} ${track.y[i]}`).join("");
    node(world, "path", { d, class: "halo" });
    let next = track.time[0] + spec.interval_s, outlines = "";
    track.time.forEach((time, i) => { if (few && time >= next - 1e-9) { next += spec.interval_s; outlines += outline(hull, track.x[i], track.y[i], track.heading[i] * RADIANS); } });
    node(world, "path", { d: outlines, class: "ghost", style: `stroke:${tone(track.tone)};fill:${tone(track.tone)}` });
    node(world, "path", { d, class: "line", style: `stroke:${tone(track.tone)}` });
    for (const i of [0, track.x.length - 1]) node(world, "path", { d: outline(hull, track.x[i], track.y[i], track.heading[i] * RADIANS), class: i ? "boat end" : "boat", style: `stroke:${tone(track.tone)};fill:${tone(track.tone)}` });
  }
  const boats = node(world, "g");
  figure.mark = (time) => {
    boats.replaceChildren();
    if (time === null) return;
    for (const track of tracks) {
      const i = nearest(track.time, time);
      node(boats, "path", { d: outline(hull, track.x[i], track.y[i], track.heading[i] * RADIANS), class: "boat now", style: `fill:${tone(track.tone)}` });
    }
  };
  const leave = () => { figure.mark(null); point(spec.group, null, figure); tip.hidden = true; };
  svg.addEventListener("pointermove", (event) => {
    const [px, py] = locate(event);
    let best = [Infinity];
    for (const track of tracks) track.x.forEach((x, i) => { const away = Math.hypot(x - px, track.y[i] - py); if (away < best[0]) best = [away, track, i]; });
    const [away, track, i] = best;
    if (away * perMeter > 45) return leave();
    const rows = [["position", `${number(track.x[i])}, ${number(track.y[i])} m`], ["heading", `${direction(track.heading[i])}°`], ["surge", `${number(track.u[i])} m/s`], ["propeller", `${number(track.propeller[i])} N`], ["rudder", `${number(track.rudder[i])}°`], ["to the goal", `${number(track.distance[i])} m`]];
    show(event, `${track.name}, ${number(track.time[i])} s`, rows);
    figure.mark(track.time[i]);
    point(spec.group, track.time[i], figure);
  });
  svg.addEventListener("pointerleave", leave);
}

function drawMap(figure, width) {
  const { spec } = figure, most = Math.max(1, Math.floor(width / 230)), columns = Math.ceil(spec.panels.length / Math.ceil(spec.panels.length / most)), kinds = ["docked", "timeout", "collision", "blocked"];
  legend(figure, kinds.map((kind) => [kind, kind]));
  const grid = element(figure.holder, "div", "panels");
  grid.style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
  for (const panel of spec.panels) {
    const holder = element(grid, "div");
    element(holder, "p", "axis", panel.title);
    const { svg, world, locate } = plan(holder, spec, Math.floor((width - 14 * (columns - 1)) / columns)), { cells } = panel, half = 0.45 * spec.side;
    for (const kind of kinds) {
      const d = cells.x.map((x, i) => (cells.outcome[i] === kind ? `M${x - half} ${cells.y[i] - half}h${2 * half}v${2 * half}h${-2 * half}Z` : "")).join("");
      node(world, "path", { d, class: `cell ${kind}`, style: `fill:${tone(kind)}` });
    }
    const box = node(world, "rect", { width: spec.side, height: spec.side, class: "chosen", visibility: "hidden" });
    const leave = () => { box.setAttribute("visibility", "hidden"); tip.hidden = true; };
    svg.addEventListener("pointermove", (event) => {
      const [px, py] = locate(event), i = cells.x.findIndex((x, k) => Math.abs(x - px) <= spec.side / 2 && Math.abs(cells.y[k] - py) <= spec.side / 2);
      if (i < 0) return leave();
      for (const [key, value] of [["x", cells.x[i] - spec.side / 2], ["y", cells.y[i] - spec.side / 2], ["visibility", "visible"]]) box.setAttribute(key, value);
      const rows = [["start", `${number(cells.x[i])}, ${number(cells.y[i])} m`], ["heading", `${direction(cells.heading[i])}°`]];
      if (cells.time?.[i] != null) rows.push(["time", `${number(cells.time[i])} s`]);
      show(event, cells.outcome[i], rows);
    });
    svg.addEventListener("pointerleave", leave);
  }
}

/** One row per value: its name, the value, and its interval. */
function drawIntervals(figure, width) {
  const { spec } = figure, row = 36, height = spec.rows.length * row + 37, left = 18, right = width - 22;
  const ends = spec.rows.flatMap((r) => [r.low, r.high, r.value, ...(r.dots ?? [])]).filter((v) => v !== null && v !== undefined);
  let [low, high] = [Math.min(...ends, spec.min ?? Infinity, spec.zero ? 0 : Infinity), Math.max(...ends, spec.max ?? -Infinity, spec.zero ? 0 : -Infinity)];
  if (spec.max === undefined) { const room = 0.05 * (high - low || 1); high += room; low -= room; }
  const X = scale(low, high, left, right), svg = canvas(figure, width, height), asText = (value) => (spec.percent ? percent(value, 0) : number(value));
  for (const value of ticks(low, high, Math.max(2, Math.round(width / 90)))) {
    node(svg, "line", { x1: X(value), x2: X(value), y1: 4, y2: height - 33, class: spec.zero && value === 0 ? "zero" : "grid" });
    node(svg, "text", { x: X(value), y: height - 19, class: "tick middle" }, asText(value));
  }
  node(svg, "text", { x: (left + right) / 2, y: height - 5, class: "label middle" }, spec.x.label);
  spec.rows.forEach((r, k) => {
    const y = k * row + 25, style = `stroke:${tone(r.tone ?? "mean")}`;
    const group = node(svg, "g", { class: "row" });
    node(group, "rect", { x: 0, y: k * row, width, height: row, class: "hit" });
    node(group, "text", { x: left, y: k * row + 14, class: "name" }, r.label);
    node(group, "text", { x: right, y: k * row + 14, class: "name end" }, r.text);
    if (r.low !== null && r.low !== undefined) node(group, "line", { x1: X(r.low), x2: X(r.high), y1: y, y2: y, class: "whisker", style });
    for (const dot of r.dots ?? []) node(group, "circle", { cx: X(dot), cy: y, r: 3, class: "seed" });
    if (r.value !== null) node(group, "circle", { cx: X(r.value), cy: y, r: 5, style: `fill:${tone(r.tone ?? "mean")}` });
    group.addEventListener("pointermove", (event) => show(event, r.label, r.details ?? [[spec.x.label, r.text]]));
    group.addEventListener("pointerleave", () => { tip.hidden = true; });
  });
}

const DRAW = { xy: drawXY, plan: drawPlan, map: drawMap, intervals: drawIntervals };
const PRINT_PX = { half: 318, wide: 660, tall: 660 };

function draw(figure) {
  const width = printing ? PRINT_PX[figure.frame.className || "half"] : Math.floor(figure.frame.clientWidth - figure.inset);
  if (width < 50 || (!printing && width === figure.width)) return;
  figure.width = printing ? 0 : width;
  figure.holder.replaceChildren();
  DRAW[figure.spec.type](figure, width);
}

defineHarbors();
for (const frame of document.querySelectorAll("figure[data-chart]")) {
  const spec = data.charts[frame.dataset.chart], style = getComputedStyle(frame);
  element(frame, "figcaption", "", spec.title);
  const holder = element(frame, "div"), inset = parseFloat(style.paddingLeft) + parseFloat(style.paddingRight);
  figures.push({ frame, holder, spec, inset, section: frame.closest("section"), width: 0 });
}
const resized = new ResizeObserver(() => { if (!printing) figures.forEach(draw); });
resized.observe(document.querySelector("main"));
figures.forEach(draw);
addEventListener("beforeprint", () => { printing = true; figures.forEach(draw); });
addEventListener("afterprint", () => { printing = false; figures.forEach(draw); });
addEventListener("scroll", () => { tip.hidden = true; }, { passive: true });

// 3-D replay: a page of its own in a frame, unpacked when it comes into view
const place = $("replay");
let replayInView = false;
async function openReplay() {
  const packed = Uint8Array.from(atob($("replay-page").textContent), (c) => c.charCodeAt(0));
  const text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  const frame = element(null, "iframe");
  frame.title = "3-D replay";
  frame.srcdoc = text;
  frame.addEventListener("load", () => paintReplay());
  place.replaceChildren(frame);
}
function paintReplay() {
  const frame = place?.querySelector("iframe"), opened = frame?.contentDocument?.documentElement;
  if (!opened) return;
  const wait = () => (opened.dataset.ready ? frame.contentWindow.replay.theme(root.dataset.theme) : setTimeout(wait, 100));
  wait();
}
if (place) {
  let isOpen = false;
  new IntersectionObserver(([entry]) => {
    replayInView = entry.isIntersecting;
    if (replayInView && !isOpen) { isOpen = true; openReplay(); }
  }, { rootMargin: "120px" }).observe(place);
}

// Theme
function theme(name) {
  root.dataset.theme = name;
  paintReplay();
}
$("theme").addEventListener("click", () => {
  theme(root.dataset.theme === "dark" ? "light" : "dark");
  sessionStorage.setItem("theme", root.dataset.theme); // the device's own changes count until then
});
theme(sessionStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));

// A report that follows a training run reloads itself, unless it is being read closely.
if (data.reload_s) {
  let moved = 0;
  for (const kind of ["pointermove", "keydown", "touchmove"]) addEventListener(kind, () => { moved = performance.now(); }, { passive: true });
  setInterval(() => { if (!document.hidden && !replayInView && performance.now() - moved > 2500) location.reload(); }, 1000 * data.reload_s);
}
root.dataset.ready = "true";
})();
