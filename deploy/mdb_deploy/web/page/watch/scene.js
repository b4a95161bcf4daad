// The scene: any machine's drawing, smooth between perceptions, or its image, or its numbers.

import { calm, canvasIn, colour, el, faint, head, named, painter, say, show, short, teller } from "../draw.js";
import { between, follow, jumped, match, windowBetween } from "./parts/shapes.js";

/** A movement is shown within the time between two pictures, but within these milliseconds. */
const SHORTEST_MS = 80;
const LONGEST_MS = 650;
const WINDOW_MS = 500;
const FLASH_MS = 1400;
/** Readings that are told beside the picture. */
const MOST_READINGS = 8;
const CROSS_PX = 5;
/** What the shapes are, for the key. */
const MEANINGS = { robot: "robot", thing: "object", trail: "its way", sensed: "what it senses" };

export function start(root, page) {
  const { state, on } = page;
  head(
    root,
    "The robot and its world",
    "What happens, as a bystander sees it. The robot itself knows only what it senses.",
  );
  const box = el("div", { class: "fill", id: "picture" });
  const flash = el("p", { class: "flash", "aria-hidden": "true" });
  const numbers = el("dl", { class: "facts numbers", hidden: true });
  const waiting = el("p", { class: "empty numbers" }, "Waiting for the first picture.");
  const senses = el("dl", { class: "facts", id: "senses" });
  const tell = teller(box);
  tell("No picture yet.");

  const view = {
    before: null,
    after: null,
    pairs: [],
    from: 0,
    lasts: 0,
    windowFrom: null,
    windowTo: null,
    turned: 0,
    every: 400,
    came: 0,
  };
  let image = null;
  let imageOf = null;
  const key = el("ul", { class: "key", id: "scene-key", hidden: true });
  root.append(box, key, senses);
  const { canvas, context, fresh } = canvasIn(box, () => touch());
  box.append(waiting, numbers, flash);

  const paint = (now) => {
    const { width, height } = fresh();
    if (image !== null) {
      if (!image.complete || image.naturalWidth === 0) return true;
      const scale = Math.min(width / image.naturalWidth, height / image.naturalHeight);
      const [w, h] = [image.naturalWidth * scale, image.naturalHeight * scale];
      context.drawImage(image, (width - w) / 2, (height - h) / 2, w, h);
      return false;
    }
    if (view.after === null) return false;
    const share = view.lasts > 0 ? ease(Math.min(1, (now - view.from) / view.lasts)) : 1;
    const turned = calm.matches ? 1 : ease(Math.min(1, (now - view.turned) / WINDOW_MS));
    const window = windowBetween(view.windowFrom, view.windowTo, turned);
    const shapes = view.after.shapes.map((shape, i) => between(view.pairs[i], shape, share));
    drawAll(context, shapes, window, width, height);
    view.shown = shapes;
    view.windowNow = window;
    return share < 1 || turned < 1;
  };
  const touch = painter(box, paint);

  /** Where in the scene a pointer is, in the scene's own units: {x, y}, or null where no drawing is. */
  page.scenePoint = (event) => {
    const place = canvas.getBoundingClientRect();
    const [right, down] = [event.clientX - place.left, event.clientY - place.top];
    const window = view.windowNow;
    if (view.after === null || !window || image !== null) return null;
    if (right < 0 || down < 0 || right > place.width || down > place.height) return null;
    const scale = Math.min(place.width, place.height) / window.span;
    return { x: window.x + (right - place.width / 2) / scale, y: window.y - (down - place.height / 2) / scale };
  };

  on("picture", (picture) => {
    const drawing = picture?.drawing ?? null;
    show(canvas, Boolean(picture && (drawing || picture.image)));
    if (picture?.image) {
      if (picture.image !== imageOf) {
        imageOf = picture.image;
        const next = new Image();
        next.src = picture.image;
        next.decode().then(
          () => {
            image = next;
            touch();
          },
          () => undefined,
        );
      }
    } else {
      image = imageOf = null;
      if (drawing) take(view, drawing, state.mode, box.clientWidth / Math.max(1, box.clientHeight));
      else view.after = null;
    }
    tellNumbers();
    tellKey(key, drawing);
    touch();
    tell(inWords(state));
  });
  on("mode", () => (view.after = null));
  on("hello", () => delete key.dataset.kinds);

  const tellNumbers = () => {
    const bare = !state.picture?.drawing && !state.picture?.image && Boolean(state.scene);
    show(numbers, bare);
    show(waiting, bare || (!state.picture && !state.scene));
    say(waiting, whyNone(state));
    if (bare) facts(numbers, Object.entries(state.scene.now));
  };
  on("finished", tellNumbers);
  let flashed = null;
  let timer = 0;
  on("scene", (scene) => {
    if (!scene) return;
    tellNumbers();
    tell(inWords(state));
    const said = `${scene.iteration} ${scene.event}`;
    if (said === flashed || !(scene.success || scene.ended)) return;
    flashed = said;
    say(
      flash,
      scene.ended && !scene.success ? `${named(scene.event)}. A new episode begins` : `${named(scene.event)}!`,
    );
    flash.dataset.good = scene.success ? "yes" : "no";
    flash.dataset.on = "yes";
    clearTimeout(timer);
    timer = setTimeout(() => (flash.dataset.on = "no"), FLASH_MS);
  });
  const sensesTouch = painter(senses, () => facts(senses, readings(state.perception?.reading, state.scene, numbers.hidden ? {} : state.scene?.now)));
  on("perception", sensesTouch);
  on("scene", sensesTouch);
}

/** What each colour of a drawing is. What was once there stays in the key: it comes and goes with each action. */
function tellKey(list, drawing) {
  show(list, drawing !== null);
  if (drawing === null) return;
  const kinds = Object.keys(MEANINGS).filter((what) => drawing.shapes.some((shape) => shape.what === what));
  const known = (list.dataset.kinds ?? "").split(" ");
  const all = Object.keys(MEANINGS).filter((what) => kinds.includes(what) || known.includes(what));
  if (list.dataset.kinds === all.join(" ")) return;
  list.dataset.kinds = all.join(" ");
  list.replaceChildren(...all.map((what) => el("li", {}, el("i", { class: `sign ${what}` }), MEANINGS[what])));
}

/** Take a new drawing: from what is shown now, in about the time until the next one comes. */
function take(view, drawing, mode, aspect) {
  const now = performance.now();
  if (view.came > 0) view.every = 0.7 * view.every + 0.3 * Math.min(LONGEST_MS / 0.8, now - view.came);
  view.came = now;
  const before = view.after === null ? null : { ...view.after, shapes: view.shown ?? view.after.shapes };
  view.pairs = before === null ? drawing.shapes.map(() => null) : match(before.shapes, drawing.shapes);
  const still = before === null || calm.matches || jumped(view.after, drawing, view.pairs);
  if (still) view.pairs = drawing.shapes.map(() => null);
  view.after = drawing;
  view.from = now;
  view.lasts = still ? 0 : Math.max(SHORTEST_MS, Math.min(LONGEST_MS, 0.8 * view.every));
  const window = follow(view.windowTo, drawing, aspect || 1);
  if (window !== view.windowTo) {
    view.windowFrom = mode === "past" || still ? null : (view.windowNow ?? view.windowTo);
    view.windowTo = window;
    view.turned = now;
  }
}

function drawAll(context, shapes, window, width, height) {
  const scale = Math.min(width, height) / window.span;
  const at = ([x, y]) => [width / 2 + (x - window.x) * scale, height / 2 - (y - window.y) * scale];
  context.save();
  context.lineJoin = context.lineCap = "round";
  grid(context, window, at, width, height, scale);
  const order = { ground: 0, wall: 1, trail: 2, sensed: 4, thing: 3, robot: 5 };
  for (const shape of shapes.toSorted((a, b) => order[a.what] - order[b.what])) drawShape(context, shape, at, scale);
  context.restore();
}

/** A dot at each unit, or at each ten, hundred, tenth of one, as it fits. */
function grid(context, window, at, width, height, scale) {
  const step = 10 ** Math.floor(Math.log10(window.span / 2));
  const many = (width * height) / (step * scale) ** 2 > 60;
  context.fillStyle = faint("muted", many ? 0.3 : 0.6);
  const [columns, rows] = [width / scale / 2, height / scale / 2];
  for (let i = Math.ceil((window.x - columns) / step); i * step <= window.x + columns; i++) {
    for (let j = Math.ceil((window.y - rows) / step); j * step <= window.y + rows; j++) {
      const [x, y] = at([i * step, j * step]);
      context.fillRect(x - 1, y - 1, 2, 2);
    }
  }
}

const COLOURS = {
  robot: "ink",
  thing: "orange",
  trail: "blue",
  sensed: "green",
  wall: "strong-line",
  ground: "muted",
};
const WIDTHS = { robot: 3, thing: 2.5, trail: 2.5, sensed: 2, wall: 3, ground: 1.2 };

function drawShape(context, shape, at, scale) {
  const ink = COLOURS[shape.what] ?? "ink";
  context.strokeStyle = colour(ink);
  context.fillStyle = colour(ink);
  context.lineWidth = WIDTHS[shape.what] ?? 2;
  context.setLineDash(shape.what === "sensed" ? [2, 6] : []);
  const [x, y] = at(shape.points[0]);
  const radius = (shape.radius ?? 0) * scale;
  if (shape.kind === "line" && shape.what === "trail") {
    trail(context, shape.points.map(at));
  } else if (shape.kind === "line") {
    context.beginPath();
    shape.points.forEach((point, i) => context[i === 0 ? "moveTo" : "lineTo"](...at(point)));
    context.stroke();
  } else if (shape.kind === "circle" || shape.kind === "disc") {
    context.beginPath();
    context.arc(x, y, Math.max(radius, 0.5), 0, 2 * Math.PI);
    if (shape.kind === "disc") {
      context.fill();
    } else {
      context.fillStyle = shape.what === "robot" ? faint("blue", 0.18) : "transparent";
      context.fill();
      context.stroke();
    }
  } else if (shape.kind === "cross") {
    context.setLineDash([]);
    context.beginPath();
    context.moveTo(x - CROSS_PX, y - CROSS_PX);
    context.lineTo(x + CROSS_PX, y + CROSS_PX);
    context.moveTo(x + CROSS_PX, y - CROSS_PX);
    context.lineTo(x - CROSS_PX, y + CROSS_PX);
    context.stroke();
  } else if (shape.kind === "words") {
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.fillText(shape.words, x, y);
  }
}

/** The way that the robot came: the older the fainter. */
function trail(context, points) {
  for (let i = 1; i < points.length; i++) {
    context.globalAlpha = Math.max(0.12, 1 - (points.length - 1 - i) / 14);
    context.beginPath();
    context.moveTo(...points[i - 1]);
    context.lineTo(...points[i]);
    context.stroke();
  }
  context.globalAlpha = 1;
}

/** Why there is no picture. */
function whyNone({ picture, finished, mode }) {
  if (picture?.missing) return "There is no picture of this moment. These are its numbers:";
  if (picture) return "There is no picture of this machine. These are its numbers:";
  if (finished && mode === "live") return "Nobody watched, so no picture was made. These are the last numbers:";
  return "Waiting for the first picture.";
}

/** What is told below the picture; what is told `instead` of it is not told again. */
function readings(reading, scene, instead) {
  const told = Object.entries(reading ?? {})
    .filter(([name]) => !(name in (instead ?? {})))
    .slice(0, MOST_READINGS);
  if (scene) told.push(["episode", scene.episode], ["successes", scene.successes]);
  return told;
}

function facts(list, entries) {
  while (list.children.length > entries.length) list.lastChild.remove();
  while (list.children.length < entries.length) list.append(el("div", {}, el("dt"), el("dd")));
  for (const [i, [name, value]] of entries.entries()) {
    const [term, told] = list.children[i].children;
    say(term, named(name));
    say(told, number(value));
  }
}

function number(value) {
  if (Array.isArray(value)) return value.slice(0, 6).map(short).join(" ") + (value.length > 6 ? " …" : "");
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : short(value);
  return String(value);
}

/** The scene in words. */
function inWords(state) {
  const { scene, picture } = state;
  if (!scene) return "A picture of the robot and its world.";
  const places = Object.entries(scene.now)
    .slice(0, 8)
    .map(([name, value]) => `${named(name)} ${short(value)}`)
    .join(", ");
  const kind = picture?.image ? "Image" : "Drawing";
  const event = named(scene.event);
  return `${kind} of the robot and its world at iteration ${scene.iteration}. Event: ${event}. ${places}.`;
}

function ease(share) {
  return share < 0.5 ? 2 * share * share : 1 - (2 - 2 * share) ** 2 / 2;
}
