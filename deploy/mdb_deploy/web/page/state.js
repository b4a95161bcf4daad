// What the page knows: the parts that the server sends, merged, and the socket that brings them.
//
// There are two stores, the live one and that of a past run; `state` shows one of them. Live parts are taken all the
// time, so that going back from a past run shows what is now. Parts: the names in the contract's frame `now`, and
// "hello", "you", "said", "connection" ("connecting" | "open" | "lost"), "mode" ("live" | "past").

const FIRST_WAIT_MS = 400;
const LONGEST_WAIT_MS = 8000;
/** A socket that is not open after so long is given up, and the next one is tried. */
const OPENING_MS = 10000;
/** An order that is not answered after so long has failed. */
const ANSWER_MS = 10000;

/** Parts that are of the connection and the person, not of a run: the same while a past run is looked at. */
const OURS = ["you", "connection", "mode", "said"];
/** Parts that come as changes, by name, to what was sent before. */
const BY_NAME = ["models", "memory"];
const ROW_COLUMNS = [
  "iteration",
  "mode",
  "explored",
  "note",
  "choice",
  "feedback",
  "predicted",
  "event",
  "success",
  "obeyed",
  "teacher",
];

const stores = { live: emptyStore(), past: emptyStore() };
const handlers = new Map();

/** What is shown now. Read only: `state.scene`, `state.rows.feedback`, ... A part that never came is undefined. */
export const state = { connection: "connecting", mode: "live", you: undefined, said: undefined, ...stores.live };

/** Call `handler(value)` when a part is new, and at once if it is there. Returns a function that ends this. */
export function on(part, handler) {
  if (!handlers.has(part)) handlers.set(part, new Set());
  handlers.get(part).add(handler);
  if (state[part] !== undefined) call(handler, state[part], part);
  return () => handlers.get(part).delete(handler);
}

/**
 * Send an order, {do: ...}. The promise gives the server's answer, {ok, words, to}; it never fails: without a
 * connection, or an answer in time, `ok` is false and `words` say why.
 */
export function send(order) {
  if (socket === null || socket.readyState !== WebSocket.OPEN) {
    return Promise.resolve({ is: "said", ok: false, words: "There is no connection to the console.", to: order.do });
  }
  socket.send(JSON.stringify(order));
  return new Promise((resolve) => {
    const asked = { to: order.do, resolve, timer: 0 };
    asked.timer = setTimeout(() => {
      waiting.splice(waiting.indexOf(asked), 1);
      resolve({ is: "said", ok: false, words: "The console did not answer within 10 seconds.", to: order.do });
    }, ANSWER_MS);
    waiting.push(asked);
  });
}

/** Send sound: an ArrayBuffer or a typed array. False: nothing was sent, for there is no connection or it is slow. */
export function sendSound(bytes) {
  if (socket === null || socket.readyState !== WebSocket.OPEN || socket.bufferedAmount > 1 << 17) return false;
  socket.send(bytes);
  return true;
}

/**
 * Show parts of a past run in the place of the live ones. With `parts.hello` it is another run, and all parts of the
 * one before are forgotten; otherwise the parts take the place of those with the same name. `parts.rows` is all rows.
 * `parts.moment`: the iteration that is looked at.
 */
export function showPast(parts) {
  if (parts.hello !== undefined) {
    stores.past = emptyStore();
  }
  for (const name of BY_NAME) {
    if (parts[name] !== undefined) stores.past[name] = {};
  }
  const changed = merge(stores.past, parts.hello === undefined ? parts : { ...parts, hello: whole(parts.hello) });
  if (state.mode === "past" && parts.hello === undefined) {
    show(changed);
  } else {
    state.mode = "past";
    showAll();
  }
}

/** Show what is now again. */
export function showLive() {
  if (state.mode === "live") return;
  state.mode = "live";
  showAll();
}

/** The token in the link, "" without one. It stays in the address, so that loading the page again works. */
export function token() {
  return words(window.location.hash.slice(1)).get("token") ?? words(window.location.search).get("token") ?? "";
}

/** Connect, and again whenever the connection is lost. */
export function connect() {
  open();
  window.addEventListener("online", soon);
  document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && soon());
}

// ---- the socket

let socket = null;
let waitMs = FIRST_WAIT_MS;
let timer = 0;
const waiting = [];

function open() {
  clearTimeout(timer);
  const address = new URL("/live", window.location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  address.search = "";
  address.hash = "";
  if (token() !== "") address.searchParams.set("token", token());
  const mine = new WebSocket(address);
  socket = mine;
  const giveUp = setTimeout(() => mine.close(), OPENING_MS);
  mine.addEventListener("open", () => {
    waitMs = FIRST_WAIT_MS;
    clearTimeout(giveUp);
    show(new Set(["connection"]), { connection: "open" });
  });
  mine.addEventListener("message", (event) => take(event.data));
  mine.addEventListener("close", () => {
    clearTimeout(giveUp);
    if (socket !== mine) return;
    socket = null;
    for (const asked of waiting.splice(0)) {
      clearTimeout(asked.timer);
      asked.resolve({ is: "said", ok: false, words: "The connection to the console was lost.", to: asked.to });
    }
    // Whether a lesson goes on is not known until the server says so again.
    show(new Set(["connection", "you"]), { connection: "lost", you: undefined });
    timer = setTimeout(open, waitMs);
    waitMs = Math.min(2 * waitMs, LONGEST_WAIT_MS);
  });
}

function soon() {
  if (socket !== null) return;
  waitMs = FIRST_WAIT_MS;
  open();
}

function take(text) {
  let frame;
  try {
    frame = JSON.parse(text);
  } catch {
    console.error("The server sent what is no JSON.");
    return;
  }
  if (frame.is === "now") {
    const changed = merge(stores.live, frame);
    if (state.mode === "live") show(changed);
  } else if (frame.is === "hello") {
    const known = stores.live.hello;
    if (known === undefined || known.run !== frame.run || known.brain !== frame.brain) stores.live = emptyStore();
    stores.live.hello = whole(frame);
    if (state.mode === "live") showAll();
  } else if (frame.is === "you") {
    show(new Set(["you"]), { you: frame });
  } else if (frame.is === "said") {
    const place = waiting.findIndex((asked) => asked.to === frame.to);
    if (place >= 0) {
      const [asked] = waiting.splice(place, 1);
      clearTimeout(asked.timer);
      asked.resolve(frame);
    }
    show(new Set(["said"]), { said: frame });
  }
}

// ---- merging

/** A `hello` with all its fields: before there is a brain the server has nothing to say in most of them. */
function whole(hello) {
  return {
    brain: "",
    run: "",
    live: false,
    choices: [],
    actuators: {},
    commands: [],
    order: [],
    notes: 0,
    scale_hz: [],
    ear: false,
    models: [],
    modes: [],
    phases: [],
    languages: {},
    successes: [],
    changes: [],
    patience_s: [null, null],
    action_s: null,
    ...hello,
    experiment: { name: "", iterations: 0, pace: "", seed: 0, words: "", ...hello.experiment },
    rights: { teach: false, operate: false, ...hello.rights },
  };
}

function emptyStore() {
  return { hello: undefined, rows: emptyRows(), models: {}, memory: {} };
}

function emptyRows() {
  const rows = { errors: {} };
  for (const column of ROW_COLUMNS) rows[column] = [];
  return rows;
}

/** Merge a frame into a store. Returns the names of the parts that are new. */
function merge(store, frame) {
  const changed = new Set();
  for (const [part, value] of Object.entries(frame)) {
    if (part === "is" || OURS.includes(part)) continue;
    changed.add(part);
    if (part === "rows") mergeRows(store.rows, value);
    else if (BY_NAME.includes(part)) store[part] = { ...store[part], ...value };
    else store[part] = value;
  }
  return changed;
}

/**
 * Put rows at their place, which their iterations tell: after those that are there, or over them when they are sent
 * again. A server that was started anew knows fewer rows than the page: those from before stay.
 */
function mergeRows(rows, news) {
  const count = news.iteration.length;
  if (count === 0) return;
  const place = firstFrom(rows.iteration, news.iteration[0]);
  for (const column of ROW_COLUMNS) put(rows[column], place, news[column] ?? new Array(count).fill(null));
  for (const name of new Set([...Object.keys(rows.errors), ...Object.keys(news.errors ?? {})])) {
    rows.errors[name] ??= new Array(place).fill(null);
    put(rows.errors[name], place, news.errors?.[name] ?? new Array(count).fill(null));
  }
}

/** The place of the first of rising numbers that is at least `value`. */
function firstFrom(numbers, value) {
  let [low, high] = [0, numbers.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (numbers[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

function put(column, place, values) {
  column.length = Math.max(column.length, place);
  for (let i = 0; i < values.length; i++) column[place + i] = values[i];
}

// ---- telling the panels

function show(changed, ours = {}) {
  Object.assign(state, ours);
  const store = stores[state.mode];
  for (const part of changed) {
    if (!OURS.includes(part)) state[part] = store[part];
  }
  for (const part of changed) {
    for (const handler of handlers.get(part) ?? []) call(handler, state[part], part);
  }
}

function showAll() {
  const store = stores[state.mode];
  const gone = Object.keys(state).filter((part) => !OURS.includes(part) && !(part in store));
  for (const part of gone) state[part] = undefined;
  show(new Set(["mode", "hello", ...Object.keys(store), ...gone]));
}

function call(handler, value, part) {
  try {
    handler(value);
  } catch (error) {
    // One panel's mistake must not keep the others from what is new.
    console.error(`A panel failed on ${part}:`, error);
  }
}

function words(text) {
  return new URLSearchParams(text);
}
