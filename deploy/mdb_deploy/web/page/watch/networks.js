// The networks: each model with its inputs, its hidden units, expressed and silent, its outputs, and its weights.

import {
  canvasIn,
  colour,
  columns,
  el,
  faint,
  head,
  modelColour,
  painter,
  rgb,
  say,
  show,
  short,
  teller,
} from "../draw.js";

const HEIGHT = 230;
const RADIUS = 5;
const LABEL_SHARE = 0.3;
const MOST_LABEL = 104;
/** Weights that are smaller than this share of the largest are not drawn. */
const FAINTEST = 0.06;
/** Units of a layer that are drawn as circles of their own; of more, as many, evenly. */
const MOST_UNITS = 60;
const REST_MS = 400;

export function start(root, { state, on }) {
  head(
    root,
    "The networks that evolve",
    "Circles are units, lines are weights: blue raises, orange lowers, thick is strong. Faint circles are silent " +
      "units that a network may express later.",
  );
  const box = el("div", { class: "nets" });
  const empty = el("p", { class: "empty" }, "No model was learnt yet.");
  root.append(empty, box);
  const nets = new Map();

  on("hello", (hello) => {
    if (!hello) return;
    nets.clear();
    box.replaceChildren();
    for (const model of hello.models) {
      const net = network(model, state);
      nets.set(model.name, net);
      box.append(net.figure);
    }
  });
  on("models", (models) => {
    show(empty, Object.keys(models ?? {}).length === 0);
    for (const [name, net] of nets) {
      const model = models?.[name];
      show(net.figure, model !== undefined);
      if (model !== undefined && model !== net.shown) {
        net.shown = model;
        net.touch();
      }
    }
  });
}

function network(model, state) {
  const words = el("span");
  const swatch = el("i", { class: "swatch" });
  swatch.style.background = `var(--${modelColour(state.hello, model.name)})`;
  const drawn = el("div", { class: "drawn" });
  drawn.style.height = `${HEIGHT}px`;
  const figure = el(
    "figure",
    { hidden: true },
    el("figcaption", {}, el("h3", {}, swatch, `${model.name} · ${model.role} model`), words),
    drawn,
  );
  const tell = teller(drawn);
  tell(`Network of the model ${model.name}`);
  const { context, fresh } = canvasIn(drawn, () => net.touch());
  const net = { figure, shown: null, touch: () => undefined };
  net.touch = painter(
    drawn,
    () => {
      if (net.shown === null) return;
      const { width, height } = fresh();
      const { layers, weights, version, error, generation } = net.shown;
      const hidden = total(net.shown.expressed ?? layers.slice(1, -1));
      const silent = total(net.shown.silent ?? 0);
      if (!weights) {
        say(words, `error ${short(error)} · ${hidden} units expressed: too many weights to draw.`);
        return;
      }
      say(
        words,
        `error ${short(error)} · ${hidden} units expressed, ${silent} silent · generation ${generation ?? version}`,
      );
      const ends = `${layers[0]} inputs, ${layers.at(-1)} outputs`;
      const units = `${hidden} expressed and ${silent} silent hidden units`;
      tell(`Network of the model ${model.name}: ${ends}, ${units}, error ${short(error)}.`);
      draw(
        context,
        width,
        height,
        net.shown,
        namesOf(model.inputs, layers[0]),
        namesOf(model.outputs, layers.at(-1)),
        silent,
      );
    },
    REST_MS,
  );
  return net;
}

function draw(context, width, height, { layers, weights }, inputs, outputs, silent) {
  const label = Math.min(MOST_LABEL, LABEL_SHARE * width);
  const [left, right] = [label + 10, width - label - 10];
  const places = layers.map((count, layer) => {
    const extra = layer > 0 && layer < layers.length - 1 ? share(silent, layers.length - 2) : 0;
    const x = left + ((right - left) * layer) / (layers.length - 1);
    return column(count, extra, x, height, layer > 0 && layer < layers.length - 1);
  });
  const strong = Math.max(1e-9, ...weights.flat(2).map(Math.abs));
  const scale = strongScale(weights, strong);
  context.lineCap = "butt";
  const [blue, orange] = [rgb("blue"), rgb("orange")];
  weights.forEach((matrix, layer) => {
    for (const to of places[layer + 1].filter((one) => one.unit !== null)) {
      const row = matrix[to.unit];
      for (const from of places[layer].filter((one) => one.unit !== null)) {
        const share = Math.min(1, Math.abs(row[from.unit]) / scale);
        if (share < FAINTEST) continue;
        const [r, g, b] = row[from.unit] < 0 ? orange : blue;
        context.strokeStyle = `rgb(${r} ${g} ${b} / ${(0.12 + 0.6 * share).toFixed(2)})`;
        context.lineWidth = 0.4 + 2.2 * share;
        context.beginPath();
        context.moveTo(from.x, from.y);
        context.lineTo(to.x, to.y);
        context.stroke();
      }
    }
  });
  for (const column of places) {
    for (const { x, y, unit, radius } of column) {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.fillStyle = unit === null ? colour("panel") : colour("ink");
      context.strokeStyle = unit === null ? faint("muted", 0.45) : colour("panel");
      context.lineWidth = unit === null ? 1 : 1.5;
      context.fill();
      context.stroke();
    }
  }
  context.fillStyle = colour("muted");
  context.textBaseline = "middle";
  write(context, places[0], inputs, "right", -10, label);
  write(context, places.at(-1), outputs, "left", 10, label);
}

/** Of many weights a few are far larger than all others: those of the upper tenth are drawn as the strongest. */
function strongScale(weights, strong) {
  const all = weights
    .flat(2)
    .map(Math.abs)
    .sort((a, b) => a - b);
  return Math.max(all[Math.floor(0.9 * (all.length - 1))] ?? strong, 1e-9);
}

/** Where the units of a layer are drawn: those expressed, between them those silent (unit null). */
function column(count, silent, x, height, hidden) {
  const shown = Math.min(count, Math.max(1, Math.round((MOST_UNITS * count) / Math.max(MOST_UNITS, count + silent))));
  const faintOnes = Math.min(silent, MOST_UNITS - Math.min(shown, MOST_UNITS));
  const all = shown + faintOnes;
  // Many units are drawn side by side in two or three columns, so that each is still seen.
  const across = hidden ? Math.ceil(all / 20) : 1;
  const rows = Math.ceil(all / across);
  const gap = Math.min(34, (height - 16) / Math.max(rows, 1));
  const radius = Math.max(2, Math.min(RADIUS, gap * 0.4));
  const made = [];
  let expressed = 0;
  for (let i = 0; i < all; i++) {
    const isExpressed = Math.floor(((i + 1) * shown) / all) > Math.floor((i * shown) / all);
    const [row, place] = [Math.floor(i / across), i % across];
    made.push({
      x: x + (place - (across - 1) / 2) * (radius * 2 + 7),
      y: height / 2 + (row - (rows - 1) / 2) * gap,
      unit: isExpressed ? Math.min(count - 1, Math.floor((expressed++ * count) / shown)) : null,
      radius,
    });
  }
  return made;
}

function write(context, units, names, align, shift, room) {
  context.textAlign = align;
  let below = -Infinity;
  for (const one of units) {
    // Names that would lie upon each other are left out.
    if (one.unit === null || names[one.unit] === undefined || one.y - below < 12) continue;
    below = one.y;
    context.fillText(cut(context, names[one.unit], room), one.x + shift, one.y);
  }
}

function cut(context, words, room) {
  let text = words;
  while (text.length > 3 && context.measureText(text).width > room) {
    text = `${text.replace("…", "").slice(0, -1)}…`;
  }
  return text;
}

/** A name for each input or output. */
function namesOf(channels, count) {
  return columns(channels, count).map(({ name, part }) => (part === null ? name : `${name} ${part}`));
}

function total(value) {
  return Array.isArray(value) ? value.reduce((sum, one) => sum + total(one), 0) : (value ?? 0);
}

function share(count, among) {
  return Math.round(total(count) / Math.max(1, among));
}
