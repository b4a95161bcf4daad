// What panels that draw share: colours by theme, canvases as sharp as the screen, drawing only what is new and seen.

export { el, svg, button, press, say, show, kept } from "./teach/dom.js";
import { el } from "./teach/dom.js";

/** Colours of the models, in the order of the experiment. */
const MODEL_COLOURS = ["blue", "orange", "green", "purple", "yellow", "muted"];
const MOST_PIXELS = 2;
const SAY_MS = 1000;

let cache = new Map();
let probe = null;
const repaints = new Set();

/** The colour of a CSS variable as the theme has it now, as "rgb(r, g, b)". */
export function colour(name) {
  if (!cache.has(name)) {
    if (probe === null) {
      probe = document.createElement("i");
      probe.hidden = true;
      document.body.append(probe);
    }
    probe.style.color = `var(--${name})`;
    cache.set(name, getComputedStyle(probe).color);
  }
  return cache.get(name);
}

/** The name of the colour of a model. */
export function modelColour(hello, model) {
  const place = (hello?.models ?? []).findIndex((one) => one.name === model);
  return MODEL_COLOURS[Math.max(place, 0) % MODEL_COLOURS.length];
}

/** Red, green and blue of a colour, 0 to 255. */
export function rgb(name) {
  return colour(name)
    .match(/[\d.]+/g)
    .slice(0, 3)
    .map(Number);
}

/** The same colour, seen through. */
export function faint(name, share) {
  const [r, g, b] = rgb(name);
  return `rgb(${r} ${g} ${b} / ${share})`;
}

/** Numbers of a colour from orange (-1) through `middle` to blue (1). */
export function diverging(value, middle = "sunk") {
  const share = Math.max(-1, Math.min(1, value));
  const end = rgb(share < 0 ? "orange" : "blue");
  const from = rgb(middle);
  const mixed = Math.abs(share) ** 0.85;
  return end.map((part, i) => Math.round(from[i] + (part - from[i]) * mixed));
}

/** The same for CSS. */
export function divergingText(value, middle = "sunk") {
  return `rgb(${diverging(value, middle).join(" ")})`;
}

/** The theme is another one: every panel draws again. */
export function themeChanged() {
  cache = new Map();
  for (const touch of repaints) touch();
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", themeChanged);

/** Whether the visitor wants little motion. */
export const calm = matchMedia("(prefers-reduced-motion: reduce)");

/**
 * Draw `element` by `paint(now_ms)` when there is something new, on the screen's own beat, while it can be seen.
 * Returns `touch`: call it when something is new. A `paint` that returns true is called again on the next beat.
 * rest_ms: the least time between two drawings.
 */
export function painter(element, paint, restMs = 0) {
  let seen = false;
  let dirty = true;
  let asked = 0;
  let last = -Infinity;
  const beat = (now) => {
    asked = 0;
    if (!seen || !dirty) return;
    if (now - last < restMs) {
      ask();
      return;
    }
    last = now;
    dirty = false;
    if (paint(now) === true) dirty = true;
    if (dirty) ask();
  };
  const ask = () => {
    if (asked !== 0 || !seen || !dirty) return;
    const left = last + restMs - performance.now();
    // With a rest before it a timer costs less than to ask on every beat.
    if (left > 20) asked = setTimeout(() => (asked = requestAnimationFrame(beat)), left);
    else asked = requestAnimationFrame(beat);
  };
  const touch = () => {
    dirty = true;
    ask();
  };
  new IntersectionObserver(
    (entries) => {
      seen = entries[entries.length - 1].isIntersecting;
      ask();
    },
    { rootMargin: "80px" },
  ).observe(element);
  repaints.add(touch);
  return touch;
}

/** A canvas that fills `box`. `size()` gives width and height in CSS pixels, and sets it up for drawing afresh. */
export function canvasIn(box, resized) {
  const canvas = el("canvas", { "aria-hidden": "true" });
  box.append(canvas);
  const context = canvas.getContext("2d");
  let width = 0;
  let height = 0;
  new ResizeObserver(() => {
    width = box.clientWidth;
    height = box.clientHeight;
    resized();
  }).observe(box);
  const fresh = () => {
    const scale = Math.min(MOST_PIXELS, window.devicePixelRatio || 1);
    const [w, h] = [Math.round(width * scale), Math.round(height * scale)];
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = w;
      canvas.height = h;
    }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    return { width, height };
  };
  return { canvas, context, fresh };
}

/** Say what a picture shows, to those who do not see it: at most once a second. Returns `tell(words)`. */
export function teller(element) {
  element.setAttribute("role", "img");
  let last = -Infinity;
  let timer = 0;
  let words = "";
  const say = () => {
    timer = 0;
    last = performance.now();
    if (element.getAttribute("aria-label") !== words) element.setAttribute("aria-label", words);
  };
  return (news) => {
    words = news;
    if (timer !== 0) return;
    const left = last + SAY_MS - performance.now();
    if (left <= 0) say();
    else timer = setTimeout(say, left);
  };
}

/** A panel's heading and the one sentence that says what it shows. `aside`: what stands at the right. */
export function head(root, title, sentence, ...aside) {
  const made = el(
    "div",
    { class: "head" },
    el("h2", { id: `${root.id}-title` }, title),
    aside.length > 0 ? el("div", { class: "aside" }, ...aside) : null,
    el("p", { class: "plain" }, sentence),
  );
  root.append(made);
  return made;
}

/** Buttons of which one is pressed. `pick(name)` is called; returns {set(names, name)}. */
export function choices(label, pick) {
  const box = el("div", { class: "choices", role: "group", "aria-label": label });
  let shown = "";
  return {
    box,
    set(names, chosen) {
      const all = JSON.stringify(names);
      if (all !== shown) {
        shown = all;
        box.replaceChildren(...names.map((name) => el("button", { type: "button", click: () => pick(name) }, name)));
      }
      for (const made of box.children) made.setAttribute("aria-pressed", String(made.textContent === chosen));
      box.hidden = names.length < 2;
    },
  };
}

/** A number with its sign, as satisfaction and feedback are told. */
export function signed(value, places = 2) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(places);
  return Number(text) === 0 ? text : `${value < 0 ? "\u2212" : "+"}${text}`;
}

/** A number with about three digits. */
export function short(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 0.001 || size >= 1e5)) return value.toExponential(1).replace("-", "\u2212");
  const places = size >= 100 ? 0 : size >= 10 ? 1 : size >= 0.1 || size === 0 ? 2 : size >= 0.01 ? 3 : 4;
  const text = value.toFixed(places);
  return text.replace("-", "\u2212");
}

/** About `count` round numbers from `low` to `high`. */
export function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  if (!(raw > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw - 1e-12);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

/** A channel's name in words: "next.angle" is "next angle". */
export function named(name) {
  return String(name).replaceAll(".", " ").replaceAll("_", " ");
}

/** Names without the words that all of them begin with: "turn_base" is "base". A mere number keeps its words. */
export function withoutCommon(names) {
  const first = names[0] ?? "";
  let end = 0;
  for (let i = 0; names.length > 1 && i < first.length && names.every((name) => name[i] === first[i]); i++)
    if (/[_. ]/.test(first[i])) end = i + 1;
  return names.map((name, _, all) => named(all.some((one) => /^\d*$/.test(one.slice(end))) ? name : name.slice(end)));
}

/**
 * What each column of a network's inputs or outputs is, in words. A channel in one-hot code has one for each of its
 * values; which of the channels it is, is told by how many columns there are, and notes are the usual ones.
 * Returns [{name, part: number or null}].
 */
export function columns(names, count) {
  const wide = Math.max(
    0,
    names.findIndex((name) => name === "note" || name.endsWith(".note")),
  );
  const parts = count - names.length + 1;
  return names.flatMap((name, i) =>
    i === wide && parts > 1
      ? Array.from({ length: parts }, (_, part) => ({ name: named(name), part }))
      : [{ name: named(name), part: null }],
  );
}
