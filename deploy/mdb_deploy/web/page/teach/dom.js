// Small helpers to make elements. No markup from strings: what comes from the brain is text, never code.

const SVG = "http://www.w3.org/2000/svg";

/** An element with attributes and children. A function becomes a listener, null and false leave an attribute out. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  set(made, attributes);
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false && child !== ""));
  return made;
}

/** The same for shapes. */
export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  set(made, attributes);
  made.append(...children);
  return made;
}

function set(made, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") made.addEventListener(name, value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
}

/** A button that says what it does. `words`: text, an element, or a list of these. `attributes` as in `el`. */
export function button(words, onClick, attributes = {}) {
  return el("button", { type: "button", click: onClick, ...attributes }, words);
}

/** A button that is on or off. Returns the button; `press(button, on)` shows the state. */
export function toggle(words, onClick, attributes = {}) {
  return button(words, onClick, { "aria-pressed": "false", ...attributes });
}

/** Show whether a button is on. */
export function press(made, on) {
  const words = String(Boolean(on));
  if (made.getAttribute("aria-pressed") !== words) made.setAttribute("aria-pressed", words);
}

/** Change a text only if it is another now: a screen reader says each change. */
export function say(made, words) {
  if (made.textContent !== words) made.textContent = words;
}

/** Show or hide. */
export function show(made, on) {
  if (made.hidden === Boolean(on)) made.hidden = !on;
}

/** What this browser keeps between two visits. Where it keeps nothing (a private window), the default is used. */
export const kept = {
  get(name, otherwise = null) {
    try {
      return window.localStorage.getItem(`mdb.${name}`) ?? otherwise;
    } catch {
      return otherwise;
    }
  },
  set(name, value) {
    try {
      window.localStorage.setItem(`mdb.${name}`, String(value));
    } catch {
      // Nothing is kept; the page works without.
    }
  },
};

/** Whether the keys of the keyboard are for somebody else now: a field, or a dialog. */
export function keysTaken(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing || event.defaultPrevented) return true;
  if (document.querySelector("dialog[open]")) return true;
  const at = event.target instanceof Element ? event.target : null;
  return at !== null && at.matches("input:not([type=range], [type=checkbox], [type=radio]), textarea, select, [contenteditable]");
}
