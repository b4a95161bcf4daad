// The memories: each model's short-term memory as a field of pairs, and the shelf of the long-term memory.

import {
  canvasIn,
  choices,
  colour,
  columns,
  diverging,
  el,
  faint,
  head,
  modelColour,
  named,
  painter,
  say,
  show,
  short,
  signed,
  teller,
} from "../draw.js";

const MOST_SLOTS = 400;
const MOST_MOMENTS = 40;
const REST_MS = 150;
const HEIGHT = 132;
const KINDS = {
  changed: (model) => `${model}: the world is another one now. What was learnt before may be wrong.`,
  known: (model) => `${model}: the new situation is learnt.`,
  stored: (model, stored, again) =>
    `${model}: stored as number ${stored}${again ? ", in the place of the older one" : ""}.`,
  recalled: (model, stored) => `${model}: number ${stored} fits again, and acts at once.`,
};

export function start(root, { state, on }) {
  let model = null;
  const pick = choices("Model", (name) => {
    model = name;
    pointed = null;
    touch();
  });
  head(
    root,
    "What it remembers",
    "Each square is an action-perception pair in the short-term memory. Blue was good, orange was bad; the older " +
      "the fainter.",
  );
  const used = el("p", { class: "tell", id: "memory-used" });
  const box = el("div", { class: "drawn slots", tabindex: "0", id: "slots" });
  box.style.height = `${HEIGHT}px`;
  const pair = el("dl", { class: "pair" });
  const which = el("p", { class: "tell" });
  const empty = el("p", { class: "empty" }, "No pair is in a memory yet.");
  const shelf = el("ul", { class: "shelf", id: "shelf", "aria-label": "Models in the long-term memory" });
  const bare = el(
    "p",
    { class: "empty" },
    "Nothing is stored yet. A model is stored when its world changes, and comes back when it fits again.",
  );
  const moments = el("ol", {
    class: "moments",
    id: "moments",
    tabindex: "0",
    "aria-label": "Moments of change, storing and recall",
  });
  root.append(
    el(
      "div",
      { class: "memories" },
      el("div", {}, el("h3", {}, "Short-term memory"), pick.box, empty, used, box, which, pair),
      el("div", {}, el("h3", {}, "Long-term memory"), bare, shelf, moments),
    ),
  );
  const tell = teller(box);
  tell("No pairs yet.");

  let pointed = null;
  let cells = [];
  const { context, fresh } = canvasIn(box, () => touch());
  const paint = () => {
    const names = (state.hello?.models ?? [])
      .map((one) => one.name)
      .filter((name) => state.memory?.[name] !== undefined);
    if (!names.includes(model)) model = names[0] ?? null;
    pick.set(names, model);
    const memory = state.memory?.[model];
    show(empty, memory === undefined);
    for (const part of [used, box, pair, which]) show(part, memory !== undefined);
    if (memory === undefined) return;
    const { width, height } = fresh();
    const pairs = memory.pairs ?? [];
    say(used, `${memory.used} of ${memory.capacity} places are used.`);
    cells = lay(width, height, Math.min(MOST_SLOTS, memory.capacity), pairs);
    drawSlots(context, cells, pairs, pointed, state.hello, model);
    const newest = youngest(pairs);
    const shown = pairs[pointed ?? -1] ?? newest;
    const oldest = pairs.reduce((old, one) => (old === null || (one.age ?? -1) > (old.age ?? -1) ? one : old), null);
    const kind = shown === newest ? "The newest pair" : shown === oldest ? "The oldest pair" : "A pair";
    const age = `${shown?.age} ${shown?.age === 1 ? "iteration" : "iterations"} old`;
    const since = Number.isFinite(shown?.age) ? age : "recalled with its model";
    say(which, shown ? `${kind}, ${since}, as the network reads it (numbers from \u22121 to 1):` : "");
    tellPair(
      pair,
      shown,
      state.hello?.models.find((one) => one.name === model),
    );
    tell(`Short-term memory of ${model}: ${memory.used} of ${memory.capacity} pairs. ${shown ? inWords(pair) : ""}`);
  };
  const touch = painter(root, paint, REST_MS);
  for (const part of ["memory", "hello", "mode"]) on(part, touch);
  box.addEventListener("pointermove", (event) => {
    const edge = box.getBoundingClientRect();
    const [x, y] = [event.clientX - edge.left, event.clientY - edge.top];
    const found = cells.find((one) => x >= one.x && x < one.x + one.size && y >= one.y && y < one.y + one.size);
    pointed = found?.pair ?? null;
    touch();
  });
  box.addEventListener("pointerleave", () => {
    pointed = null;
    touch();
  });
  box.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const filled = cells.filter((one) => one.pair !== null);
    const at = filled.findIndex((one) => one.pair === pointed);
    pointed = filled[(at + step + filled.length) % Math.max(1, filled.length)]?.pair ?? null;
    touch();
  });

  const renew = painter(
    root,
    () => {
      const books = state.shelf ?? [];
      show(bare, books.length === 0);
      show(shelf, books.length > 0);
      list(
        shelf,
        books.map((one) => JSON.stringify(one)),
        (text) => book(JSON.parse(text), state.hello),
      );
      const known = new Set();
      const all = (state.contexts ?? [])
        .map((one) => {
          const name = `${one.model} ${one.stored}`;
          const again = known.has(name);
          known.add(name);
          return { ...one, again };
        })
        .slice(-MOST_MOMENTS)
        .toReversed();
      show(moments, all.length > 0);
      list(
        moments,
        all.map((one) => JSON.stringify(one)),
        (text) => moment(JSON.parse(text)),
      );
    },
    REST_MS,
  );
  for (const part of ["shelf", "contexts", "hello"]) on(part, renew);
}

function book(one, hello) {
  const uses = one.uses ?? 0;
  const words = `${one.model} ${one.stored}, stored at iteration ${one.iteration}, recalled ${uses} times`;
  const made = el(
    "li",
    { title: words, "data-used": uses > 0 ? "yes" : "no" },
    el("b", {}, `${one.model} ${one.stored}`),
    el("span", {}, uses > 0 ? `from ${one.iteration}, back ${uses}×` : `from ${one.iteration}`),
  );
  made.style.setProperty("--spine", `var(--${modelColour(hello, one.model)})`);
  return made;
}

function moment(one) {
  const words = KINDS[one.kind] ?? ((model) => `${model}: ${one.kind}`);
  return el(
    "li",
    { "data-kind": one.kind },
    el("span", { class: "at" }, one.iteration),
    el("span", {}, words(one.model, one.stored, one.again)),
  );
}

/** Make a list again only when it is another one. */
function list(root, texts, make) {
  const all = texts.join("\n");
  if (root.dataset.text === all) return;
  root.dataset.text = all;
  root.replaceChildren(...texts.map(make));
}

/** A square for each place of the memory, as large as fits, with the number of its pair (null: free). */
function lay(width, height, capacity, pairs) {
  const slots = Math.max(capacity, pairs.length, 1);
  let size = Math.floor(Math.sqrt((width * height) / slots));
  while (size > 4 && Math.floor(width / size) * Math.floor(height / size) < slots) size -= 1;
  size = Math.min(size, 26);
  const columns = Math.max(1, Math.floor(width / size));
  const bySlot = pairs.every((one) => Number.isInteger(one.slot) && one.slot < slots);
  const made = Array.from({ length: slots }, (_, i) => ({
    x: (i % columns) * size,
    y: Math.floor(i / columns) * size,
    size,
    pair: null,
  }));
  pairs.forEach((one, i) => (made[bySlot ? one.slot : i].pair = i));
  return made;
}

function drawSlots(context, cells, pairs, pointed, hello, model) {
  const value = valuer(hello, model, pairs);
  // A pair that was recalled with its model has no age in this run: it is drawn as an old one.
  const ages = pairs.map((one) => one.age).filter(Number.isFinite);
  const oldest = Math.max(1, ...ages);
  const youngestAge = ages.length > 0 ? Math.min(...ages) : 0;
  for (const { x, y, size, pair } of cells) {
    const inner = size - 2;
    if (pair === null) {
      context.fillStyle = colour("sunk");
      context.fillRect(x, y, inner, inner);
      continue;
    }
    const one = pairs[pair];
    const shown = value(one);
    context.globalAlpha = 1 - 0.72 * ((one.age ?? oldest) / oldest);
    context.fillStyle = `rgb(${diverging(shown, "line").join(" ")})`;
    context.fillRect(x, y, inner, inner);
    context.globalAlpha = 1;
    if (pair === pointed || (pointed === null && one.age === youngestAge)) {
      context.strokeStyle = colour("ink");
      context.lineWidth = 2;
      context.strokeRect(x + 1, y + 1, inner - 2, inner - 2);
    } else if (one.age === oldest) {
      context.strokeStyle = faint("ink", 0.6);
      context.lineWidth = 1;
      context.strokeRect(x + 0.5, y + 0.5, inner - 1, inner - 1);
    }
  }
}

/** What colours a pair: the feedback among its targets, or else its first target, in the range of the memory. */
function valuer(hello, model, pairs) {
  const outputs = hello?.models.find((one) => one.name === model)?.outputs ?? [];
  const place = Math.max(
    0,
    outputs.findIndex((name) => name.includes("feedback")),
  );
  const all = pairs.map((one) => values(one.targets)[place] ?? 0);
  if (outputs[place]?.includes("feedback")) {
    const most = Math.max(1, ...all.map(Math.abs));
    return (one) => (values(one.targets)[place] ?? 0) / most;
  }
  const [low, high] = [Math.min(...all), Math.max(...all)];
  return (one) => (high > low ? (2 * ((values(one.targets)[place] ?? 0) - low)) / (high - low) - 1 : 0);
}

function values(told) {
  return Array.isArray(told) ? told : Object.values(told ?? {});
}

function youngest(pairs) {
  const age = (one) => one.age ?? Infinity;
  return pairs.reduce((young, one) => (young === null || age(one) < age(young) ? one : young), null);
}

function tellPair(box, pair, model) {
  const entries = [...told(pair?.inputs, model?.inputs, ""), ...told(pair?.targets, model?.outputs, "→ ")];
  while (box.children.length > entries.length) box.lastChild.remove();
  while (box.children.length < entries.length) box.append(el("div", {}, el("dt", { class: "muted" }), el("dd")));
  for (const [i, [name, value]] of entries.entries()) {
    say(box.children[i].children[0], name);
    say(box.children[i].children[1], value);
  }
}

function told(values, names, sign) {
  if (values === null || values === undefined) return [];
  if (!Array.isArray(values))
    return Object.entries(values).map(([name, value]) => [sign + named(name), number(value)]);
  const made = new Map();
  for (const [i, { name, part }] of columns(names ?? ["value"], values.length).entries()) {
    if (part === null) made.set(name, name.includes("feedback") ? signed(values[i]) : number(values[i]));
    else if (!made.has(name) || values[i] > values[i - part + made.get(name)]) made.set(name, part);
  }
  return [...made].map(([name, value]) => [sign + name, String(value)]);
}

function number(value) {
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : short(value);
  return Array.isArray(value) ? value.map(short).join(" ") : String(value);
}

function inWords(box) {
  return [...box.children].map((one) => one.textContent).join(", ");
}
