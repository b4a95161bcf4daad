// How it chooses: the predicted satisfaction of every action as bars, the chosen one, what it promised, what came.

import { el, head, named, painter, say, show, signed, withoutCommon } from "../draw.js";
import { own, who } from "./badge.js";

/** Actions of which each bar is drawn thin. */
const MANY = 9;
/** A bar is seen at least so much, however little supports it. */
const FAINTEST = 0.22;

export function start(root, { state, on }) {
  head(root, "How it chooses", "Each bar is how good the robot predicts an action to be. It takes the outlined one.");
  const situation = el("div", { class: "situation", id: "situation" });
  const bars = el("ol", { class: "bars", id: "bars", "aria-label": "Predicted satisfaction of every action" });
  const low = el("span", {}, "\u2212 bad");
  const high = el("span", {}, "good +");
  const axis = el(
    "div",
    { class: "axis", "aria-hidden": "true" },
    el("span"),
    el("div", {}, low, el("span", {}, "0"), high),
    el("span"),
  );
  const promised = el("strong", { id: "promised" }, "–");
  const came = el("strong", { id: "came" }, "–");
  const cameOf = el("span", {}, "What came");
  const outcomeWords = el("p");
  const outcome = el(
    "div",
    { class: "outcome", id: "outcome" },
    outcomeWords,
    el("div", {}, el("span", {}, "It predicted"), promised),
    el("span", { class: "arrow", "aria-hidden": "true" }, "→"),
    el("div", {}, cameOf, came),
  );
  const why = el("p", { class: "why", id: "why" });
  const key = el(
    "p",
    { class: "key" },
    el("span", {}, "Strong colour: many pairs in its memory are like this. Faint: it only guesses."),
  );
  const empty = el("p", { class: "empty" }, "It has not chosen anything yet.");
  const of = el("p", { class: "bars-of", id: "bars-of" });
  const chart = el("div", { class: "bar-chart" }, of, bars, axis);
  root.append(empty, situation, chart, key, outcome, why);

  let made = [];
  let last;
  const paint = () => {
    // While the robot waits, its last choice stays: one thinks about it before one plays the next note.
    const waits = state.thought?.badge === "waits";
    if (!waits) last = state.thought;
    const thought = waits ? last : state.thought;
    const none = !thought;
    show(empty, none);
    say(empty, state.scene?.iteration > 0 ? "Its next choice will be shown here." : "It has not chosen anything yet.");
    for (const part of [situation, chart, key, outcome, why]) show(part, !none);
    if (none) return;
    const actions = thought.actions ?? [];
    const values = actions.length > 0 && actions.every(isPoint) ? Object.keys(actions[0].values) : [];
    say(of, valuesOf(values, state.hello));
    show(of, values.length > 0);
    if (actions.length !== made.length) {
      made = actions.map(row);
      bars.replaceChildren(...made.map((one) => one.item));
      bars.dataset.many = actions.length > MANY ? "yes" : "no";
    }
    show(chart, actions.length > 0);
    show(key, actions.length > 0);
    const most = Math.max(
      1,
      ...actions.map((one) => Math.abs(one.satisfaction ?? 0)),
      Math.abs(thought.came?.feedback ?? 0),
    );
    for (const [i, one] of actions.entries()) fill(made[i], one, most, thought);
    tellSituation(situation, thought, state.you, waits);
    const done = outcomeOf(thought, state.rows);
    tellNumber(promised, done.predicted);
    tellNumber(came, done.feedback, done.waits ? "…" : "no feedback");
    say(
      outcomeWords,
      done.iteration === thought.iteration
        ? `This action, iteration ${done.iteration}`
        : `The action before, iteration ${done.iteration}`,
    );
    const told = done.event && done.event !== "none" && done.event !== "nothing";
    say(cameOf, told ? `What came: ${named(done.event)}` : "What came");
    say(why, own(thought.why, state.you));
  };
  const touch = painter(root, paint);
  for (const part of ["hello", "mode"]) on(part, () => (last = undefined));
  on("thought", touch);
  on("you", touch);
  on("rows", touch);
}

/** What was predicted and what came of it: of this action, or of the one before while this one goes on. */
function outcomeOf(thought, rows) {
  const now = { iteration: thought.iteration, predicted: thought.predicted ?? null };
  const last = rows.iteration.length - 1;
  if (thought.came) {
    // Feedback may come later than the rest of the report.
    const late = rows.iteration[last] === thought.iteration ? rows.feedback[last] : null;
    return { ...now, ...thought.came, feedback: thought.came.feedback ?? late, waits: false };
  }
  if (last < 0 || rows.iteration[last] !== thought.iteration - 1)
    return { ...now, feedback: null, event: null, waits: true };
  return {
    iteration: rows.iteration[last],
    predicted: rows.predicted[last],
    feedback: rows.feedback[last],
    event: rows.event[last],
    waits: false,
  };
}

/** Whether an action is a point of ranges, and no choice with a name of its own. */
function isPoint(action) {
  return (action.choice ?? null) === null && Object.keys(action.values ?? {}).length > 0;
}

/** The name of an action; of a point of ranges its values, in the order that `valuesOf` tells. */
function label(action) {
  return isPoint(action) ? Object.values(action.values).map((value) => signed(value)).join("  ") : action.name;
}

/** What the values of the actions are: "base, shoulder, elbow (rad)". */
function valuesOf(names, hello) {
  const units = [...new Set(names.map((name) => hello?.actuators?.[name]?.unit).filter(Boolean))];
  return `${withoutCommon(names).join(", ")}${units.length > 0 ? ` (${units.join(", ")})` : ""}`;
}

function row() {
  const bar = el("i");
  const mark = el("b", { hidden: true, title: "What came" });
  const number = el("span", { class: "number" });
  const told = el("span", { class: "unseen" });
  const name = el("span", { class: "label" });
  const item = el(
    "li",
    {},
    name,
    el("span", { class: "track", "aria-hidden": "true" }, bar, mark),
    number,
    told,
  );
  return { item, name, bar, mark, number, words: told };
}

function fill(row, action, most, thought) {
  const value = action.satisfaction;
  const known = Number.isFinite(value);
  say(row.name, label(action));
  row.name.title = row.name.textContent;
  row.item.dataset.chosen = action.chosen ? "yes" : "no";
  if (action.chosen) row.item.setAttribute("aria-current", "true");
  else row.item.removeAttribute("aria-current");
  row.bar.dataset.sign = value < 0 ? "-" : "+";
  row.bar.style.transform = `scaleX(${known ? (value / most).toFixed(3) : 0})`;
  const support = Number.isFinite(action.support) ? Math.max(0, Math.min(1, action.support)) : 1;
  row.bar.style.opacity = (FAINTEST + (1 - FAINTEST) * support).toFixed(2);
  say(row.number, known ? signed(value) : "–");
  const feedback = thought.came?.feedback;
  const marked = Boolean(action.chosen) && Number.isFinite(feedback);
  show(row.mark, marked);
  if (marked) row.mark.style.left = `${(50 + (50 * feedback) / most).toFixed(1)}%`;
  say(row.words, `, support ${Math.round(100 * support)} percent${action.chosen ? ", chosen" : ""}`);
}

function tellSituation(box, thought, you, waits) {
  const teacher = who(thought.teacher, you);
  const chips = [`${waits ? "It waits. Its last choice: iteration" : "Iteration"} ${thought.iteration}`];
  if (thought.note !== null && thought.note !== undefined) {
    chips.push(`${waits ? "It heard" : "It hears"} note ${thought.note}${teacher ? ` from ${teacher}` : ""}`);
  } else {
    chips.push(waits ? "It heard no note" : "It hears no note");
  }
  if (thought.mode) chips.push(`Mode: ${thought.mode}`);
  const text = chips.join("\n");
  if (box.dataset.text === text) return;
  box.dataset.text = text;
  box.replaceChildren(...chips.map((words) => el("span", { class: "chip" }, words)));
}

function tellNumber(element, value, otherwise = "–") {
  say(element, Number.isFinite(value) ? signed(value) : otherwise);
  element.toggleAttribute("data-words", !Number.isFinite(value));
  element.className = !Number.isFinite(value) || value === 0 ? "" : value > 0 ? "plus" : "minus";
}
