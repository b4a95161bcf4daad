// Curves over the whole run: successes, obedience, the error of every model. Who teaches is shaded behind them.

import { colour, el, faint, head, modelColour, named, painter, say, show, short, signed } from "../draw.js";
import { LOWEST_ERROR, chart } from "./parts/chart.js";
import { phasesOf } from "../past/timeline.js";
import { perRows, places, runningMean, spans } from "./parts/series.js";

const SUCCESS_ROWS = 100;
const OBEYED_ROWS = 20;
const ERROR_PAIRS = 20;
/** A curve ends where nothing came for so many rows. */
const GAP_ROWS = 30;
/** Points that are drawn of each curve, however long the run. */
const MOST_POINTS = 1500;
/** The curves are drawn at most so often: drawing them costs most of all panels. */
const REST_MS = 700;
const TEACHERS = ["blue", "orange", "purple", "yellow"];

export function start(root, { state, on }) {
  head(
    root,
    "How it gets better",
    "Shaded: somebody teaches. White: the robot is on its own. What it learnt from a teacher should stay when the " +
      "teacher has left.",
  );
  const tiles = el("dl", { class: "tiles", id: "numbers" });
  const legend = el("ul", { class: "key" });
  const charts = [
    chart("successes", `Successes in the last ${SUCCESS_ROWS} iterations`),
    chart("obedience", `Commands obeyed of the last ${OBEYED_ROWS}`, { range: [0, 104] }),
    chart("errors", `Error of each model (mean of ${ERROR_PAIRS} pairs)`, { log: true }),
  ];
  const plots = el(
    "div",
    { class: "plots" },
    charts.map((one) => one.figure),
  );
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
    shaded = spans(rows, live ? toCome(state) : [], hello.experiment.iterations);
    const teachers = [...new Set(shaded.map((one) => one.teacher).filter(Boolean))];
    const shade = (name) => faint(TEACHERS[Math.max(0, teachers.indexOf(name)) % TEACHERS.length], 0.13);
    const context = { shaded, shade, moment: state.mode === "past" ? state.moment : null, marks: marks(state) };
    const picked = places(n, MOST_POINTS);
    const x = picked.map((i) => rows.iteration[i]);
    const pick = (values) => picked.map((i) => values[i]);
    const successes = perRows(rows.success, SUCCESS_ROWS);
    const obeyed = runningMean(
      rows.obeyed.map((one) => (one === null ? null : 100 * one)),
      OBEYED_ROWS,
      GAP_ROWS,
    );
    const range = [
      rows.iteration[0],
      Math.max(live ? 0 : rows.iteration[n - 1], soonest(hello, rows.iteration[n - 1])),
    ];
    charts[0].draw([x, pick(successes)], [{ label: "successes", colour: "blue" }], range, context);
    charts[1].draw([x, pick(obeyed)], [{ label: "obeyed", colour: "green" }], range, { ...context, marks: [] });
    const names = hello.models.map((one) => one.name).filter((name) => rows.errors[name] !== undefined);
    const means = names.map((name) => runningMean(rows.errors[name], ERROR_PAIRS, GAP_ROWS).map(positive));
    charts[2].draw(
      [x, ...means.map(pick)],
      names.map((name) => ({ label: name, colour: modelColour(hello, name) })),
      range,
      context,
    );
    show(
      charts[1].figure,
      rows.obeyed.some((one) => one !== null),
    );
    tell(charts, successes, obeyed, names, means);
    renewTiles(tiles, state, successes, obeyed);
    renewLegend(legend, teachers, shade, context.marks);
  };
  const touch = painter(root, paint, REST_MS);
  for (const part of ["rows", "hello", "contexts", "moment", "mode", "timing", "control"]) on(part, touch);
  new ResizeObserver(touch).observe(plots);
}

/** The phases with those who will teach in them, as far as is known now. */
function toCome({ hello, control }) {
  return phasesOf(hello, hello.experiment.iterations - 1, control?.ended ?? []).map((phase) => ({
    start: phase.from,
    teacher: control?.script === false ? null : phase.teacher,
  }));
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

/** Moments of the long-term memory. A model that is stored again is marked large at its first time alone. */
function marks(state) {
  const known = new Set();
  return (state.contexts ?? [])
    .filter((one) => one.kind === "stored" || one.kind === "recalled")
    .map((one) => {
      const name = `${one.model} ${one.stored}`;
      const again = one.kind === "stored" && known.has(name);
      known.add(name);
      return { ...one, again, ink: modelColour(state.hello, one.model) };
    });
}

function tell(charts, successes, obeyed, names, means) {
  const last = (values) => values.findLast((value) => value !== null) ?? null;
  charts[0].say(`${charts[0].title}: now ${short(last(successes))}.`);
  charts[1].say(`${charts[1].title}: now ${short(last(obeyed))} percent.`);
  charts[2].say(`${charts[2].title}: ${names.map((name, i) => `${name} ${short(last(means[i]))}`).join(", ")}.`);
}

function renewTiles(list, state, successes, obeyed) {
  const { rows, hello, timing } = state;
  const now =
    state.mode === "past" && Number.isFinite(state.moment)
      ? rows.iteration.findLastIndex((one) => one <= state.moment)
      : rows.iteration.length - 1;
  const total = rows.success.slice(0, now + 1).reduce((sum, one) => sum + (one ? 1 : 0), 0);
  const kinds = (hello.successes ?? []).map(named).join(", ") || "success";
  const entries = [
    [`successes (${kinds})`, String(total)],
    [
      `in the last ${SUCCESS_ROWS}`,
      successes[now] === null || successes[now] === undefined ? "–" : successes[now].toFixed(0),
    ],
    [
      `obeyed of the last ${OBEYED_ROWS}`,
      obeyed[now] === null || obeyed[now] === undefined ? "–" : `${obeyed[now].toFixed(0)} %`,
    ],
    ["last feedback", signed(rows.feedback.slice(0, now + 1).findLast((one) => one !== null))],
  ];
  if (timing && state.mode === "live" && Number.isFinite(timing.p50_ms))
    entries.push(["to decide, typical", `${short(timing.p50_ms)} ms`]);
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
  list.replaceChildren(
    ...entries.map(([words, background, sign]) => {
      const swatch = el("i", { class: "swatch", "aria-hidden": "true" });
      if (background !== "") {
        swatch.style.background = background;
        swatch.style.boxShadow = "inset 0 0 0 1px var(--strong-line)";
      }
      return el("li", {}, sign === "" ? swatch : el("span", { "aria-hidden": "true" }, sign), words);
    }),
  );
}
