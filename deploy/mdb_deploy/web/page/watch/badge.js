// The top of the page: what the robot does now in plain words, how far the run is, the connection, the theme.

import { el, svg, kept, say, show, themeChanged } from "../draw.js";
import { phasesOf } from "../past/timeline.js";

const HEADLINES = {
  obeys: (who) => `Obeying ${who}`,
  explores: () => "Exploring",
  alone: () => "On its own",
  waits: () => "Waiting",
};
const WORDS = {
  obeys: (who) =>
    `It does what ${who === "you" ? "your notes" : `the notes of ${who}`} mean, as far as it knows them.`,
  explores: () => "It tries actions, to learn what comes of them.",
  alone: (who) => (who === null ? "Nobody tells it what to do." : `By what it learnt from ${who}.`),
  waits: () => "Nothing was decided yet.",
};
/** What is waited for, when it is the visitor's turn. */
const TURNS = {
  play: "Play a note.",
  judge: "Say how good the last action was.",
  both: "Play a note, and say how good the last action was.",
};
/** Paths of 24 by 24: an ear, a compass, a head start, a pause. */
const SIGNS = {
  obeys: "M4 9v6h4l5 4V5L8 9zM16.5 8.5a5 5 0 0 1 0 7M19 6a9 9 0 0 1 0 12",
  explores: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM15.5 8.5l-2 5-5 2 2-5z",
  alone: "M12 3v3M6 9h12a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2H6a2 2 0 0 1-2-2v-6a2 2 0 0 1 2-2zM9 13v1.5M15 13v1.5",
  waits: "M9 6v12M15 6v12",
};
const THEMES = ["auto", "light", "dark"];
const THEME_WORDS = { auto: "Colours: as your device", light: "Colours: light", dark: "Colours: dark" };
const THEME_SIGNS = {
  auto: "M12 4a8 8 0 1 0 0 16zM12 4a8 8 0 0 1 0 16",
  light: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v3M12 19v3M2 12h3M19 12h3M5 5l2 2M17 17l2 2M5 19l2-2M17 7l2-2",
  dark: "M19 14.5A8 8 0 1 1 9.5 5a6.5 6.5 0 0 0 9.5 9.5z",
};
const LINKS = { open: "Connected", connecting: "Connecting", lost: "Connection lost. Trying again" };

export function start(root, { state, on, showLive }) {
  const sign = path(SIGNS.waits);
  const headline = el("strong", {}, "Waiting");
  const words = el("span", {}, "Nothing was decided yet.");
  const badge = el(
    "div",
    { class: "badge", id: "badge", "data-kind": "waits", role: "status" },
    picture(sign),
    el("div", {}, headline, words),
  );
  const run = el("p", {}, "");
  const count = el("strong", {}, "–");
  const of = el("span", {}, "");
  const link = el("span", { class: "link", role: "status", id: "link" }, "Connecting");
  const past = el("button", { type: "button", id: "to-live", click: showLive, hidden: true }, "Back to now");
  const theme = themeButton();
  const phases = el("ol", { class: "phases", "aria-label": "Phases of the run" });
  const trouble = el("p", { class: "trouble", role: "alert", hidden: true });
  root.append(
    el(
      "div",
      { class: "name" },
      el("img", { src: "/page/icon.svg", alt: "", width: 32, height: 32 }),
      el("div", {}, el("h1", {}, "Multilevel Darwinist Brain"), run),
    ),
    badge,
    el("div", { class: "state" }, past, el("p", { class: "count", id: "iteration" }, count, of), link, theme),
    phases,
    trouble,
  );

  const renew = () => {
    const { kind, title, text } = told(state);
    if (badge.dataset.kind !== kind) {
      badge.dataset.kind = kind;
      sign.setAttribute("d", SIGNS[kind]);
    }
    say(headline, title);
    say(words, text);
    show(past, state.mode === "past");
  };
  for (const part of ["thought", "control", "finished", "mode", "you", "alive"]) on(part, renew);

  on("hello", (hello) => {
    if (hello === undefined) return;
    const { name, iterations, words: about } = hello.experiment;
    // Without a brain only past runs can be seen: the other panels would be empty.
    document.body.dataset.brain = name === "" ? "none" : "there";
    say(run, name === "" ? "" : `${name} · ${hello.run || hello.brain}`);
    run.title = about;
    document.title = name === "" ? "Multilevel Darwinist Brain" : `${name} · Multilevel Darwinist Brain`;
    say(of, iterations > 0 ? ` of ${iterations}` : "");
    show(phases, name !== "");
    show(count.parentElement, name !== "");
    renew();
    progress();
  });
  const progress = () => {
    const at = iteration(state);
    say(count, at === null ? "–" : String(at));
    fill(phases, at, state);
  };
  for (const part of ["scene", "moment", "phase", "rows", "mode", "control", "thought", "you"]) on(part, progress);
  on("connection", (now) => {
    link.dataset.link = now;
    say(link, LINKS[now]);
  });
  const warn = () => {
    const text = state.mode === "live" ? state.trouble : null;
    say(trouble, capital(text ?? ""));
    show(trouble, Boolean(text));
  };
  on("trouble", warn);
  on("mode", warn);
}

/** The iteration that is shown, null while none is known. */
export function iteration(state) {
  if (state.mode === "past" && state.moment !== undefined && state.moment !== null) return state.moment;
  return state.scene?.iteration ?? state.rows?.iteration.at(-1) ?? null;
}

/** Who is meant by a teacher's name: "you" for the visitor's own, after the lesson too. */
export function who(name, you) {
  return name !== null && name !== undefined && name === mine(you) ? "you" : (name ?? null);
}

/** The visitor's name as a teacher: now, or in the last lesson. */
function mine(you) {
  return you?.name ?? kept.get("name");
}

/** What the badge says of a state. */
export function told(state) {
  const { thought, control, finished, you, hello, mode } = state;
  const kind = Object.hasOwn(HEADLINES, thought?.badge ?? "") ? thought.badge : "waits";
  const teacher = who(thought?.teacher, you);
  let title = HEADLINES[kind](teacher ?? "a teacher");
  let text = own(thought?.badge_words, you) || WORDS[kind](teacher);
  // The headline need not be said twice.
  if (text.toLowerCase().startsWith(title.toLowerCase())) {
    text = capital(text.slice(title.length).replace(/^[\s,.:]+/, ""));
  }
  if (text === "" || /^(explores|waits|obeys \S+)$/i.test(text)) text = WORDS[kind](teacher ?? "a teacher");
  if (
    kind === "waits" &&
    mode === "live" &&
    !control?.paused &&
    you?.name &&
    Object.hasOwn(TURNS, you.turn?.kind ?? "")
  ) {
    return { kind, title: "Waiting for you", text: TURNS[you.turn.kind] };
  }
  if (mode === "past") title = `Past run · ${title}`;
  else if (finished) title = `The run is over · ${title}`;
  else if (control?.paused && kind === "waits") return { kind, title: "Paused", text: "The robot stands still." };
  else if (control?.paused) title = `Paused · ${title}`;
  else if (!thought && hello !== undefined && hello.experiment.name === "") {
    return { kind, title: "No brain runs now", text: "You can look at past runs." };
  }
  return { kind, title, text };
}

/** The server's words, with "you" in the place of the visitor's own name, and a capital letter. */
export function own(words, you) {
  if (!words) return "";
  let text = words;
  const name = mine(you);
  if (name) {
    const escaped = name.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
    text = text.replace(new RegExp(`(^|[^\\p{L}\\p{N}_])"?${escaped}"?(?![\\p{L}\\p{N}_])`, "gu"), "$1you");
  }
  return capital(text);
}

function capital(text) {
  return text.slice(0, 1).toUpperCase() + text.slice(1);
}

/**
 * The phases as they are now, [{from, to, words, title, taught}], and the place of the one that goes on. A phase that
 * was ended by hand is shorter. While the scripted teacher is kept silent nobody teaches in its phases but who came.
 */
export function phasesNow(at, { hello, control, thought, you }) {
  const total = Math.max(1, hello.experiment.iterations);
  const found = phasesOf(hello, total - 1, control?.ended ?? []);
  const all = found.length > 0 ? found : [{ from: 0, to: total - 1, name: hello.experiment.name, teacher: null }];
  const now = all.findLastIndex((phase) => at !== null && phase.from <= at);
  const told = all.map((phase, i) => {
    const silent = control?.script === false && i >= now;
    const planned = silent ? null : phase.teacher;
    const heard = silent && thought?.teacher === phase.teacher ? null : who(thought?.teacher, you);
    const teacher = i === now ? (heard ?? planned) : planned;
    const nobody = phase.teacher !== null && teacher === null;
    const unnamed = teacher !== null && !phase.name.includes(teacher);
    const words = nobody ? `${phase.name} · nobody` : unnamed ? `${phase.name} · ${teacher}` : phase.name;
    const title = `${words}, from iteration ${phase.from}${nobody ? ". The scripted teacher is kept silent." : ""}`;
    return { from: phase.from, to: phase.to, words, title, taught: teacher !== null };
  });
  return { told, now };
}

function fill(list, at, state) {
  if (state.hello === undefined || state.hello.experiment.name === "") return;
  const { told, now } = phasesNow(at, state);
  const shape = JSON.stringify(told);
  if (list.dataset.shape !== shape) {
    list.dataset.shape = shape;
    while (list.children.length > told.length) list.lastChild.remove();
    while (list.children.length < told.length) list.append(el("li", {}, el("i"), el("span")));
    for (const [i, phase] of told.entries()) {
      const made = list.children[i];
      made.title = phase.title;
      made.dataset.taught = phase.taught ? "yes" : "no";
      made.style.flex = `${Math.max(phase.to - phase.from + 1, 1)} 1 0`;
      say(made.lastChild, phase.words);
    }
  }
  for (const [i, phase] of told.entries()) {
    const whole = Math.max(1, phase.to - phase.from + 1);
    const share = i < now ? 1 : i > now || at === null ? 0 : Math.min(1, (at + (state.mode === "past" ? 1 : 0) - phase.from) / whole);
    list.children[i].firstChild.style.width = `${(100 * share).toFixed(1)}%`;
    if (i === now) list.children[i].setAttribute("aria-current", "step");
    else list.children[i].removeAttribute("aria-current");
  }
}

function themeButton() {
  const sign = path(THEME_SIGNS.auto);
  const button = el("button", { type: "button", class: "square", id: "theme" }, picture(sign));
  const set = (theme) => {
    if (theme === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
    sign.setAttribute("d", THEME_SIGNS[theme]);
    button.setAttribute("aria-label", THEME_WORDS[theme]);
    button.title = THEME_WORDS[theme];
    themeChanged();
  };
  let theme = THEMES.includes(kept.get("theme")) ? kept.get("theme") : "auto";
  button.addEventListener("click", () => {
    theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
    kept.set("theme", theme);
    set(theme);
  });
  set(theme);
  return button;
}

function path(d) {
  return svg("path", {
    d,
    fill: "none",
    stroke: "currentColor",
    "stroke-width": 1.8,
    "stroke-linecap": "round",
    "stroke-linejoin": "round",
  });
}

function picture(drawn) {
  return svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, drawn);
}
