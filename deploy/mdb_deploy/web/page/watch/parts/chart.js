// One chart of curves by uPlot, with who teaches shaded behind it, and moments marked in it.

import uPlot from "../../vendor/uPlot.esm.js";
import { colour, el, short, show, teller } from "../../draw.js";

/** Errors below this are drawn as this. */
export const LOWEST_ERROR = 1e-4;
const HEIGHT = 170;

/** One chart: a figure with a heading, drawn by uPlot, made anew when its curves or the theme are other ones. */
export function chart(id, title, { log = false, range = null } = {}) {
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
      stroke: colour("muted"),
      font: `11px ${getComputedStyle(document.body).fontFamily}`,
      grid: lines,
      ticks: { ...lines, size: 4 },
    };
    return new uPlot(
      {
        width: Math.max(120, box.clientWidth),
        height: HEIGHT,
        padding: [8, 24, 0, 0],
        legend: { show: false },
        cursor: { sync: { key: "curves" }, points: { size: 7 }, drag: { x: false, y: false }, y: false },
        scales: {
          x: { time: false, range: () => ends },
          y: log
            ? { distr: 3, log: 10, range: (u, low, high) => errorRange(low, high) }
            : { range: (u, low, high) => range ?? [0, Math.max(5, (high ?? 0) * 1.12)] },
        },
        axes: [
          { ...axis, size: 26, gap: 3, space: 60 },
          {
            ...axis,
            ...tens,
            size: 52,
            gap: 4,
            space: 28,
            grid: { ...lines, ...tens },
            ticks: { ...lines, size: 4, ...tens },
            values: (u, values) => values.map((value) => tick(value, log)),
          },
        ],
        series: [
          {},
          ...curves.map((one) => ({
            stroke: colour(one.colour),
            width: 2,
            points: { show: false },
            spanGaps: false,
          })),
        ],
        hooks: {
          drawClear: [(u) => shadeBehind(u, around)],
          draw: [(u) => markBefore(u, around)],
          setCursor: [(u) => cursor(u, curves)],
        },
      },
      [[], ...curves.map(() => [])],
      box,
    );
  };
  const cursor = (u, curves) => {
    const at = u.cursor.idx;
    for (const [i, one] of curves.entries()) {
      const value = at === null || at === undefined ? undefined : u.data[i + 1][at];
      const words =
        value === undefined || value === null ? one.label : `${one.label} ${log ? short(value) : value.toFixed(1)}`;
      if (names.children[i] && names.children[i].lastChild.textContent !== words)
        names.children[i].lastChild.textContent = words;
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
        names.replaceChildren(
          ...curves.map((one) => {
            const swatch = el("i", { class: "swatch" });
            swatch.style.background = `var(--${one.colour})`;
            return el("li", {}, swatch, el("span", {}, one.label));
          }),
        );
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
