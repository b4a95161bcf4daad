// The time line of a run: its phases, who was being obeyed, its successes, and the moment that is looked at.

import { canvasIn, colour, faint, painter } from "../draw.js";

const COLOURS = ["blue", "orange", "purple", "green", "yellow"];
const NOBODY = "strong-line";
const FAR = 25;
const PHASE_PX = 26;
const TEACHER_PX = 14;
const SUCCESS_PX = 26;
const GAP_PX = 4;
export const HEIGHT_PX = PHASE_PX + TEACHER_PX + SUCCESS_PX + 2 * GAP_PX;

/** Stretches of iterations with the same value: [{from, to, value}], `to` is the last one. */
export function stretches(iterations, values) {
  const found = [];
  values.forEach((value, place) => {
    const last = found.at(-1);
    if (last && last.value === (value ?? null)) last.to = iterations[place];
    else found.push({ from: iterations[place], to: iterations[place], value: value ?? null });
  });
  return found;
}

/**
 * Phases as they were: [{from, to, name, teacher}]. `ended`: iterations at which a phase was ended early; the next
 * one begins after it, and all later ones as much earlier.
 */
export function phasesOf(hello, last, ended = []) {
  const phases = (hello.phases ?? []).map((each) => ({ from: each.start, name: each.name, teacher: each.teacher ?? null }));
  for (const at of [...ended].sort((one, other) => one - other)) {
    const next = phases.findIndex((each) => each.from > at);
    if (next < 1) continue;
    const earlier = phases[next].from - (at + 1);
    for (const each of phases.slice(next)) each.from -= earlier;
  }
  const seen = phases.filter((each) => each.from <= last);
  return seen.map((each, place) => ({ ...each, to: place + 1 < seen.length ? seen[place + 1].from - 1 : last }));
}

export class TimeLine {
  /** `onMove(iteration)` is called while the moment is moved. */
  constructor(root, onMove) {
    this.root = root;
    this._onMove = onMove;
    this.first = this.last = this.at = 0;
    this._run = null;
    root.classList.add("time-line");
    root.style.height = `${HEIGHT_PX}px`;
    root.setAttribute("role", "slider");
    root.setAttribute("tabindex", "0");
    root.setAttribute("aria-label", "Moment of the run");
    const { context, fresh } = canvasIn(root, () => this._touch());
    this._touch = painter(root, () => this._paint(context, fresh()));
    root.addEventListener("pointerdown", (event) => this._down(event));
    root.addEventListener("pointermove", (event) => this._held && this._to(event));
    for (const kind of ["pointerup", "pointercancel"]) root.addEventListener(kind, () => (this._held = false));
    root.addEventListener("keydown", (event) => this._key(event));
  }

  /** Show a run: its `hello`, all its rows, and the iterations at which phases were ended early. */
  run(hello, rows, ended) {
    const iterations = rows.iteration ?? [];
    this.first = iterations[0] ?? 0;
    this.last = iterations.at(-1) ?? 0;
    const teachers = stretches(iterations, rows.teacher ?? []);
    const names = [...new Set(teachers.map((each) => each.value).filter((name) => name !== null))];
    this._run = {
      phases: phasesOf(hello, this.last, ended), teachers, names,
      successes: iterations.filter((_, place) => rows.success?.[place]),
    };
    this.root.setAttribute("aria-valuemin", this.first);
    this.root.setAttribute("aria-valuemax", this.last);
    this._touch();
  }

  /** The teachers of the run with their colours, for the key: [{name, colour}]. */
  teachers() {
    return (this._run?.names ?? []).map((name) => ({ name, colour: this._colour(name) }));
  }

  /** Show the moment. */
  show(iteration) {
    this.at = iteration;
    const phase = this._run?.phases.findLast((each) => each.from <= iteration);
    const who = this._run?.teachers.find((each) => each.from <= iteration && iteration <= each.to)?.value;
    this.root.setAttribute("aria-valuenow", iteration);
    this.root.setAttribute("aria-valuetext",
      `iteration ${iteration}${phase ? `, phase ${phase.name}` : ""}${who ? `, ${who} is obeyed` : ""}`);
    this._touch();
  }

  /** Iterations at which a phase begins. */
  marks() {
    return (this._run?.phases ?? []).map((each) => each.from);
  }

  _colour(name) {
    const place = this._run.names.indexOf(name);
    return place < 0 ? NOBODY : COLOURS[place % COLOURS.length];
  }

  _down(event) {
    if (event.button !== 0) return;
    this._held = true;
    this.root.setPointerCapture(event.pointerId);
    this._to(event);
  }

  _to(event) {
    const box = this.root.getBoundingClientRect();
    const share = Math.max(0, Math.min(1, (event.clientX - box.left) / box.width));
    this._onMove(Math.min(this.last, this.first + Math.floor(share * (this.last - this.first + 1))));
  }

  _key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? 10 : 1;
    const to = {
      ArrowRight: this.at + step, ArrowUp: this.at + step, ArrowLeft: this.at - step, ArrowDown: this.at - step,
      PageUp: this.at + FAR, PageDown: this.at - FAR, Home: this.first, End: this.last,
    }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this._onMove(Math.max(this.first, Math.min(this.last, to)));
  }

  _paint(context, { width, height }) {
    if (!this._run || width === 0) return false;
    const whole = this.last - this.first + 1;
    const x = (iteration) => ((iteration - this.first) / whole) * width;
    context.textBaseline = "middle";
    for (const each of this._run.phases) {
      const [left, right] = [x(each.from), x(each.to + 1)];
      context.fillStyle = each.teacher ? colour("blue-soft") : colour("sunk");
      context.fillRect(left, 0, right - left - 1, PHASE_PX);
      this._label(context, each.name, left + 7, PHASE_PX / 2, right - left - 12);
    }
    const below = PHASE_PX + GAP_PX;
    for (const { from, to, value } of this._run.teachers) {
      if (value === null) continue;
      context.fillStyle = colour(this._colour(value));
      context.fillRect(x(from), below, Math.max(1, x(to + 1) - x(from)), TEACHER_PX);
    }
    context.fillStyle = faint("muted", 0.25);
    context.fillRect(0, below + TEACHER_PX, width, 1);
    context.fillStyle = colour("green");
    const low = below + TEACHER_PX + GAP_PX;
    for (const iteration of this._run.successes) context.fillRect(x(iteration), low + 3, Math.max(1.2, width / whole), SUCCESS_PX - 6);
    const here = x(this.at + 0.5);
    context.fillStyle = colour("ink");
    context.fillRect(here - 1, 0, 2, height);
    context.beginPath();
    context.moveTo(here - 7, 0);
    context.lineTo(here + 7, 0);
    context.lineTo(here, 9);
    context.fill();
    return false;
  }

  /** A name, if there is room for at least a part of it. */
  _label(context, words, left, middle, room) {
    if (room < 24) return;
    let shown = words;
    while (shown.length > 1 && context.measureText(shown).width > room) shown = `${shown.slice(0, -2)}…`;
    context.fillStyle = colour("ink");
    context.fillText(shown, left, middle);
  }
}
