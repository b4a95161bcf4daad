// Curves over the whole run: successes, obedience, the error of every model. Who teaches is shaded behind them.

import uPlot from "../vendor/uPlot.esm.js";
import { colour, el, faint, head, modelColour, named, painter, say, show, short, signed, teller } from "../draw.js";
import { perRows, places, runningMean, spans } from "./series.js";

const SUCCESS_ROWS = 100;
const OBEYED_ROWS = 20;
const ERROR_PAIRS = 20;
/** A curve ends where nothing came for so many rows. */
const GAP_ROWS = 30;
/** Points that are drawn of each curve, however long the run. */
const MOST_POINTS = 1500;
/** The curves are drawn at most so often: drawing them costs most of all panels. */
const REST_MS = 700;
const LOWEST_ERROR = 1e-4;
const HEIGHT = 170;
const TEACHERS = ["blue", "orange", "purple", "yellow"];

export function start(root, { state, on }) {
  head(root, "How it gets better",
    "Shaded: somebody teaches. White: the robot is on its own. What it learnt from a teacher should stay when the teacher has left.");
  const tiles = el("dl", { class: "tiles", id: "numbers" });
  const legend = el("ul", { class: "key" });
  const charts = [
    chart("successes", `Successes in the last ${SUCCESS_ROWS} iterations`),
    chart("obedience", `Commands obeyed of the last ${OBEYED_ROWS}`, { range: [0, 104] }),
    chart("errors", `Error of each model (mean of ${ERROR_PAIRS} pairs)`, { log: true }),
  ];
  const plots = el("div", { class: "plots" }, charts.map((one) => one.figure));
  const empty = el("p", { class: "empty" }, "The first iterations are still to come.");
  root.append(tiles, legend, empty, plots);
  let shaded = [];
  let theme = "";

  const paint = () => {
    const { rows, hello } = state;
    const n = rows?.iteration.length ?? 0;
    show(empty, n < 2);
    show(plots, n >= 2);
    show(tiles, n > 0);
    if (!hello || n < 2) return;
    const now = colour("ink");
    if (now !== theme) for (const one of charts) one.forget();
    theme = now;
    const live = state.mode === "live";
    shaded = spans(rows, live ? (hello.phases ?? []) : [], hello.experiment.iterations);
    const teachers = [...new Set(shaded.map((one) => one.teacher).filter(Boolean))];
    const shade = (name) => faint(TEACHERS[Math.max(0, teachers.indexOf(name)) % TEACHERS.length], 0.13);
    const context = { shaded, shade, moment: state.mode === "past" ? state.moment : null, marks: marks(state) };
    const picked = places(n, MOST_POINTS);
    const x = picked.map((i) => rows.iteration[i]);
    const pick = (values) => picked.map((i) => values[i]);
    const successes = perRows(rows.success, SUCCESS_ROWS);
    const obeyed = runningMean(rows.obeyed.map((one) => (one === null ? null : 100 * one)), OBEYED_ROWS, GAP_ROWS);
    const range = [rows.iteration[0], Math.max(live ? 0 : rows.iteration[n - 1], soonest(hello, rows.iteration[n - 1]))];
    charts[0].draw([x, pick(successes)], [{ label: "successes", colour: "blue" }], range, context);
    charts[1].draw([x, pick(obeyed)], [{ label: "obeyed", colour: "green" }], range, { ...context, marks: [] });
    const names = hello.models.map((one) => one.name).filter((name) => rows.errors[name] !== undefined);
    const means = names.map((name) => runningMean(rows.errors[name], ERROR_PAIRS, GAP_ROWS).map(positive));
    charts[2].draw([x, ...means.map(pick)], names.map((name) => ({ label: name, colour: modelColour(hello, name) })), range, context);
    show(charts[1].figure, rows.obeyed.some((one) => one !== null));
    tell(charts, successes, obeyed, names, means);
    renewTiles(tiles, state, successes, obeyed);
    renewLegend(legend, teachers, shade, context.marks);
  };
  const touch = painter(root, paint, REST_MS);
  for (const part of ["rows", "hello", "contexts", "moment", "mode", "timing"]) on(part, touch);
  new ResizeObserver(touch).observe(plots);
}

/** The end of the axis: a whole part of the run further than what was, so that the picture seldom jumps. */
function soonest(hello, last) {
  const total = hello.experiment.iterations;
  for (const share of [0.1, 0.25, 0.5]) if (last < share * total * 0.9) return Math.ceil(share * total);
  return Math.max(total, last);
}

function positive(value) {
  return value === null ? null : Math.max(value, LOWEST_ERROR);
}

/** Moments of the long-term memory. A model that is stored again and again is marked fully at its first time alone. */
function marks(state) {
  const known = new Set();
  return (state.contexts ?? []).filter((one) => one.kind === "stored" || one.kind === "recalled").map((one) => {
    const name = `${one.model} ${one.stored}`;
    const again = one.kind === "stored" && known.has(name);
    known.add(name);
    return { ...one, again, ink: modelColour(state.hello, one.model) };
  });
}

/** One chart: a figure with a heading, drawn by uPlot, made anew when its curves or the theme are other ones. */
function chart(id, title, { log = false, range = null } = {}) {
  const box = el("div", { class: "chart", id: `chart-${id}` });
  const names = el("ul", { class: "key" });
  const figure = el("figure", {}, el("figcaption", {}, el("h3", {}, title), names), box);
  const say = teller(box);
  say(title);
  let plot = null;
  let shape = "";
  let around = { shaded: [], shade: () => "", moment: null, marks: [] };
  let ends = [0, 1];

  const make = (curves) => {
    const lines = { stroke: colour("line"), width: 1 };
    const tens = log ? { filter: (u, splits) => splits.map(decade) } : {};
    const axis = {
      stroke: colour("muted"), font: `11px ${getComputedStyle(document.body).fontFamily}`,
      grid: lines, ticks: { ...lines, size: 4 },
    };
    return new uPlot({
      width: Math.max(120, box.clientWidth), height: HEIGHT, padding: [8, 24, 0, 0],
      legend: { show: false },
      cursor: { sync: { key: "curves" }, points: { size: 7 }, drag: { x: false, y: false }, y: false },
      scales: {
        x: { time: false, range: () => ends },
        y: log ? { distr: 3, log: 10, range: (u, low, high) => errorRange(low, high) } : { range: (u, low, high) => range ?? [0, Math.max(5, (high ?? 0) * 1.12)] },
      },
      axes: [
        { ...axis, size: 26, gap: 3, space: 60 },
        { ...axis, ...tens, size: 52, gap: 4, space: 28, grid: { ...lines, ...tens }, ticks: { ...lines, size: 4, ...tens }, values: (u, values) => values.map((value) => tick(value, log)) },
      ],
      series: [{}, ...curves.map((one) => ({ stroke: colour(one.colour), width: 2, points: { show: false }, spanGaps: false }))],
      hooks: {
        drawClear: [(u) => shadeBehind(u, around)],
        draw: [(u) => markBefore(u, around)],
        setCursor: [(u) => cursor(u, curves)],
      },
    }, [[], ...curves.map(() => [])], box);
  };
  const cursor = (u, curves) => {
    const at = u.cursor.idx;
    for (const [i, one] of curves.entries()) {
      const value = at === null || at === undefined ? undefined : u.data[i + 1][at];
      const words = value === undefined || value === null ? one.label : `${one.label} ${log ? short(value) : value.toFixed(1)}`;
      if (names.children[i] && names.children[i].lastChild.textContent !== words) names.children[i].lastChild.textContent = words;
    }
  };
  return {
    figure,
    title,
    say,
    forget() {
      plot?.destroy();
      plot = null;
    },
    draw(data, curves, newEnds, newAround) {
      around = newAround;
      ends = newEnds;
      const now = JSON.stringify(curves);
      if (plot === null || now !== shape) {
        shape = now;
        plot?.destroy();
        plot = make(curves);
        names.replaceChildren(...curves.map((one) => {
          const swatch = el("i", { class: "swatch" });
          swatch.style.background = `var(--${one.colour})`;
          return el("li", {}, swatch, el("span", {}, one.label));
        }));
        show(names, curves.length > 1 || log);
      }
      const width = box.clientWidth;
      if (width > 0 && Math.abs(width - plot.width) > 1) plot.setSize({ width, height: HEIGHT });
      plot.setData(data);
    },
  };
}

function errorRange(low, high) {
  const from = Math.max(LOWEST_ERROR, low ?? LOWEST_ERROR);
  return [10 ** Math.floor(Math.log10(from)), 10 ** Math.ceil(Math.log10(Math.max(high ?? 1, from * 10)))];
}

/** Lines of a logarithmic axis at powers of ten alone. */
function decade(value) {
  const power = Math.log10(value);
  return Math.abs(power - Math.round(power)) < 1e-6 ? value : null;
}

function tick(value, log) {
  if (value === null || value === undefined) return "";
  if (!log) return String(value);
  return String(Number(value.toPrecision(2)));
}

function shadeBehind(u, { shaded, shade }) {
  const { ctx, bbox } = u;
  const scale = window.devicePixelRatio || 1;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.font = `${11 * scale}px ${getComputedStyle(document.body).fontFamily}`;
  ctx.textBaseline = "top";
  ctx.textAlign = "left";
  for (const { from, to, teacher } of shaded) {
    const left = u.valToPos(from, "x", true);
    const right = u.valToPos(to, "x", true);
    if (teacher !== null) {
      ctx.fillStyle = shade(teacher);
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
    }
    ctx.fillStyle = colour("muted");
    const words = teacher ?? "alone";
    if (ctx.measureText(words).width + 10 * scale < right - Math.max(left, bbox.left)) {
      ctx.fillText(words, Math.max(left, bbox.left) + 5 * scale, bbox.top + 4 * scale);
    }
  }
  ctx.restore();
}

function markBefore(u, { marks: all, moment }) {
  const { ctx, bbox } = u;
  const scale = window.devicePixelRatio || 1;
  ctx.save();
  const base = bbox.top + bbox.height;
  for (const one of all) {
    const at = u.valToPos(one.iteration, "x", true);
    if (at < bbox.left || at > bbox.left + bbox.width) continue;
    ctx.strokeStyle = ctx.fillStyle = colour(one.ink);
    ctx.lineWidth = 2 * scale;
    ctx.globalAlpha = one.again ? 0.45 : 1;
    const size = (one.again ? 3 : 6) * scale;
    // Stored: a full triangle that points down, into the shelf; recalled: an empty one that points up, out of it.
    const tip = one.kind === "stored" ? 1 : -1;
    ctx.beginPath();
    ctx.moveTo(at - size, base - size - tip * size * 0.8);
    ctx.lineTo(at + size, base - size - tip * size * 0.8);
    ctx.lineTo(at, base - size + tip * size * 0.8);
    ctx.closePath();
    if (one.kind === "stored") ctx.fill();
    else ctx.stroke();
  }
  ctx.globalAlpha = 1;
  if (moment !== null && moment !== undefined) {
    const at = u.valToPos(moment, "x", true);
    ctx.strokeStyle = colour("ink");
    ctx.lineWidth = 1.5 * scale;
    ctx.beginPath();
    ctx.moveTo(at, bbox.top);
    ctx.lineTo(at, base);
    ctx.stroke();
  }
  ctx.restore();
}

function tell(charts, successes, obeyed, names, means) {
  const last = (values) => values.findLast((value) => value !== null) ?? null;
  charts[0].say(`${charts[0].title}: now ${short(last(successes))}.`);
  charts[1].say(`${charts[1].title}: now ${short(last(obeyed))} percent.`);
  charts[2].say(`${charts[2].title}: ${names.map((name, i) => `${name} ${short(last(means[i]))}`).join(", ")}.`);
}

function renewTiles(list, state, successes, obeyed) {
  const { rows, hello, timing } = state;
  const now = state.mode === "past" && Number.isFinite(state.moment) ? rows.iteration.findLastIndex((one) => one <= state.moment) : rows.iteration.length - 1;
  const total = rows.success.slice(0, now + 1).reduce((sum, one) => sum + (one ? 1 : 0), 0);
  const kinds = (hello.successes ?? []).map(named).join(", ") || "success";
  const entries = [
    [`successes (${kinds})`, String(total)],
    [`in the last ${SUCCESS_ROWS}`, successes[now] === null || successes[now] === undefined ? "–" : successes[now].toFixed(0)],
    [`obeyed of the last ${OBEYED_ROWS}`, obeyed[now] === null || obeyed[now] === undefined ? "–" : `${obeyed[now].toFixed(0)} %`],
    ["last feedback", signed(rows.feedback.slice(0, now + 1).findLast((one) => one !== null))],
  ];
  if (timing && state.mode === "live" && Number.isFinite(timing.p50_ms)) entries.push(["to decide, typical", `${short(timing.p50_ms)} ms`]);
  while (list.children.length > entries.length) list.lastChild.remove();
  while (list.children.length < entries.length) list.append(el("div", {}, el("dt"), el("dd")));
  for (const [i, [name, value]] of entries.entries()) {
    say(list.children[i].children[0], name);
    say(list.children[i].children[1], value);
  }
}

function renewLegend(list, teachers, shade, all) {
  const entries = [...teachers.map((name) => [`taught by ${name}`, shade(name), ""]), ["alone", "transparent", ""]];
  if (all.some((one) => one.kind === "stored")) entries.push(["model stored in the long-term memory", "", "▼"]);
  if (all.some((one) => one.kind === "recalled")) entries.push(["model recalled from it", "", "△"]);
  const text = JSON.stringify(entries);
  if (list.dataset.text === text) return;
  list.dataset.text = text;
  list.replaceChildren(...entries.map(([words, background, sign]) => {
    const swatch = el("i", { class: "swatch", "aria-hidden": "true" });
    if (background !== "") {
      swatch.style.background = background;
      swatch.style.boxShadow = "inset 0 0 0 1px var(--strong-line)";
    }
    return el("li", {}, sign === "" ? swatch : el("span", { "aria-hidden": "true" }, sign), words);
  }));
}
