// Try: pause, pace, the next phase, and what can be changed of the body while it learns.

import { button, el, press, say, show, toggle } from "./dom.js";
import { scripted } from "./left.js";
import { Mover } from "./mover.js";

/** How many times the experiment's own pace; and the seconds of an action where the experiment has no pace of its own. */
const TIMES = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const SECONDS = [5, 2, 1, 0.5, 0.2, 0.1, 0];

/** What a Pioneer can be made to be, in words: the setting, its value when on, its value when nothing is changed. */
const SWITCHES = [
  { name: "swapped", words: "Motors swapped", on: true, off: false },
  { name: "left_wheel", words: "Left wheel at half", on: 0.5, off: 1 },
  { name: "right_wheel", words: "Right wheel at half", on: 0.5, off: 1 },
  { name: "turn_share", words: "Turns only half", on: 0.5, off: 1 },
];
/** The sixteen sonars go around the robot, from the left side over the front and the right side to the back. */
const SONARS = [
  { words: "Left", places: [0, 1, 2] },
  { words: "Front", places: [3, 4] },
  { words: "Right", places: [5, 6, 7] },
  { words: "Back", places: [8, 9, 10, 11, 12, 13, 14, 15] },
];
const KNOWN = new Set([...SWITCHES.map((each) => each.name), "blind", "object_x_m", "object_y_m"]);

/** The least time of an action at a place of the slider, in seconds. */
function secondsAt(place, base_s) {
  return base_s > 0 ? base_s / TIMES[place] : SECONDS[place];
}

/** The place of the slider that is nearest to a time of an action. */
function placeOf(action_s, base_s) {
  const miss = TIMES.map((_, place) => Math.abs(Math.log((secondsAt(place, base_s) + 1e-3) / (action_s + 1e-3))));
  return miss.indexOf(Math.min(...miss));
}

/** Ten times the pace, with a script that teaches: for those who only watch. Resolves to words when it cannot be. */
export async function justWatch(page) {
  const { state } = page;
  const hello = state.hello;
  if (!hello?.live) return "No robot runs now. Open a past run to watch one.";
  if (!hello.rights?.operate) return "You may not change the pace with this link. You can watch at its own pace.";
  const order = { do: "control", paused: false, script: true };
  if (hello.experiment?.pace !== "lockstep") order.action_s = secondsAt(TIMES.length - 1, hello.action_s ?? 0);
  const said = await page.send(order);
  if (!said.ok) return said.words;
  if (!scripted(state)) await page.teachByItself?.();
  return null;
}

export function start(root, page) {
  new Try(root, page);
}

class Try {
  constructor(root, page) {
    this._page = page;
    this._root = root;
    this._changed = {};
    this._run = null;
    this._build(root);
    for (const part of ["hello", "control", "phase", "mode", "connection", "finished"]) page.on(part, () => this._show());
    page.on("scene", () => this._mover.show());
    this._show();
  }

  _build(root) {
    this._why = el("p", { class: "plain", role: "status" });
    this._said = el("p", { class: "notice", role: "status" });
    this._pause = toggle("Pause", () => this._order({ do: "control", paused: !this._page.state.control?.paused }), { id: "pause" });
    this._pace = el("input", { type: "range", id: "pace", min: 0, max: TIMES.length - 1, step: 1, value: 3,
      input: () => this._showPace(), change: () => this._setPace() });
    this._paceWords = el("output", { for: "pace", class: "pace-words" });
    this._watch = button("Just watch: ten times the pace", () => this._justWatch(), { id: "just-watch" });
    this._phase = el("p", { class: "plain" });
    this._next = button("Next phase", () => this._order({ do: "control", end_phase: true }), { id: "next-phase" });
    const time = el("div", { class: "try-part" },
      el("h3", {}, "Time"),
      el("div", { class: "buttons" }, this._pause, this._next, this._watch),
      el("div", { class: "pace" }, el("label", { for: "pace" }, "Pace"), this._pace, this._paceWords),
      this._phase);
    this._switches = el("div", { class: "buttons", role: "group", "aria-label": "Changes of the body" });
    this._blind = el("div", { class: "buttons", role: "group", "aria-labelledby": "blind-title" });
    this._others = el("div", { class: "others" });
    this._reset = button("Body as it was", () => this._asItWas(), { id: "reset-body" });
    this._body = el("div", { class: "try-part" },
      el("h3", {}, "Change its body"),
      el("p", { class: "plain" }, "The brain is not told. See its errors rise in the curves, and fall again while it learns."),
      this._switches, this._blind, this._others, el("div", { class: "buttons" }, this._reset));
    this._mover = new Mover(this._page, (settings) => this._change(settings));
    this._parts = el("div", { class: "try-parts" }, time, this._body, this._mover.root);
    root.append(el("h2", {}, "Try"), this._why, this._said, this._parts);
  }

  _show() {
    const { state } = this._page;
    const hello = state.hello;
    const why = state.mode === "past" ? "You look at a past run: nothing of it can be changed."
      : !hello?.live ? "No robot runs now."
        : state.finished ? "The run is over."
          : !hello.rights?.operate ? "You watch. To change something, open the link for the operator." : null;
    this._root.classList.toggle("is-idle", state.mode === "past");
    say(this._why, why ?? "");
    show(this._why, why !== null);
    show(this._parts, why === null);
    this._mover.allow(why === null && (hello.changes ?? []).includes("object_x_m"));
    if (why !== null) return;
    if (this._run !== hello.run) {
      this._run = hello.run;
      this._changed = {};
      this._showChanges(hello);
    }
    const paused = Boolean(state.control?.paused);
    press(this._pause, paused);
    say(this._pause, paused ? "Go on" : "Pause");
    const fixed = hello.experiment?.pace === "lockstep";
    this._pace.disabled = fixed;
    const action_s = state.control?.action_s ?? hello.action_s ?? 0;
    if (document.activeElement !== this._pace) this._pace.value = String(placeOf(action_s, hello.action_s ?? 0));
    this._showPace();
    this._showPhase(hello, state.phase);
  }

  _showPace() {
    const hello = this._page.state.hello;
    const place = Number(this._pace.value);
    const base_s = hello?.action_s ?? 0;
    const least = secondsAt(place, base_s);
    const seconds = least === 0 ? "as fast as it can" : `${Number(least.toPrecision(2))} s an action`;
    const words = hello?.experiment?.pace === "lockstep" ? "in lockstep it has no pace"
      : base_s > 0 ? `${TIMES[place] === 1 ? "as usual" : `${TIMES[place]} times`}, ${seconds}` : seconds;
    say(this._paceWords, words);
    this._pace.setAttribute("aria-valuetext", words);
  }

  _setPace() {
    this._order({ do: "control", action_s: secondsAt(Number(this._pace.value), this._page.state.hello?.action_s ?? 0) });
  }

  _showPhase(hello, phase) {
    const phases = hello.phases ?? [];
    const place = phases.findIndex((each) => each.name === phase?.name);
    const next = place >= 0 ? phases[place + 1] : undefined;
    const silent = this._page.state.control?.script === false;
    const who = (each) => (each.teacher === null || each.teacher === undefined ? `${each.name} (nobody teaches)`
      : silent ? `${each.name} (the scripted teacher is kept silent)` : `${each.name} (${each.teacher} teaches)`);
    show(this._next, next !== undefined);
    const here = place >= 0 ? `Phase: ${who(phases[place])}.` : "";
    say(this._phase, next ? `${here} Next: ${who(next)}.` : here);
  }

  // ---- the body

  _showChanges(hello) {
    const can = new Set(hello.changes ?? []);
    const made = SWITCHES.filter((each) => can.has(each.name)).map((each) =>
      toggle(each.words, () => this._change({ [each.name]: this._is(each.name, each.on) ? each.off : each.on }),
        { "data-change": each.name }));
    this._switches.replaceChildren(...made);
    show(this._blind, can.has("blind"));
    this._blind.replaceChildren(el("span", { id: "blind-title", class: "plain" }, "Blind sonars:"),
      ...SONARS.map((each) => toggle(each.words, () => this._change({ blind: this._blinded(each.places) }),
        { "data-change": "blind", "data-places": each.places.join(",") })));
    this._others.replaceChildren(...[...can].filter((name) => !KNOWN.has(name)).map((name) => this._other(name)));
    show(this._body, can.size > 0);
    this._showChanged();
  }

  /** A setting that this page has no words for: its value is typed, as JSON. */
  _other(name) {
    const field = el("input", { type: "text", id: `change-${name}`, autocomplete: "off", spellcheck: "false" });
    const set = () => {
      let value;
      try {
        value = JSON.parse(field.value);
      } catch {
        say(this._said, `${name}: expected a value such as 0.5, true, [1, 2] or "words" in quotation marks.`);
        return;
      }
      this._change({ [name]: value });
    };
    return el("form", { class: "other", submit: (event) => { event.preventDefault(); set(); } },
      el("label", { for: `change-${name}` }, name.replaceAll("_", " ")), field, el("button", { type: "submit" }, "Change"));
  }

  _is(name, value) {
    return JSON.stringify(this._changed[name]) === JSON.stringify(value);
  }

  _blinded(places) {
    const blind = new Set(this._changed.blind ?? []);
    const all = places.every((place) => blind.has(place));
    for (const place of places) {
      if (all) blind.delete(place);
      else blind.add(place);
    }
    return [...blind].sort((one, other) => one - other);
  }

  async _change(settings) {
    if (!(await this._order({ do: "change", settings }))) return;
    for (const [name, value] of Object.entries(settings)) {
      if (!name.startsWith("object_")) this._changed[name] = value;
    }
    this._showChanged();
  }

  _asItWas() {
    const can = new Set(this._page.state.hello?.changes ?? []);
    const settings = Object.fromEntries(SWITCHES.filter((each) => can.has(each.name)).map((each) => [each.name, each.off]));
    if (can.has("blind")) settings.blind = [];
    this._change(settings);
  }

  _showChanged() {
    for (const made of this._body.querySelectorAll("[data-change]")) {
      const { change, places } = made.dataset;
      const known = SWITCHES.find((each) => each.name === change);
      press(made, known ? this._is(change, known.on)
        : places.split(",").every((place) => (this._changed.blind ?? []).includes(Number(place))));
    }
  }

  // ---- orders

  async _justWatch() {
    say(this._said, (await justWatch(this._page)) ?? "");
  }

  async _order(order) {
    const said = await this._page.send(order);
    say(this._said, said.ok ? "" : said.words);
    return said.ok;
  }
}
