// What each key says, as in the terminal (deploy/mdb_deploy/teach/keyboard.py), and the large keys on the page.

import { el, button, svg } from "./dom.js";

export const NOTE_KEYS = "zxcvbnmasdfg";
const FULL = { "+": 1, "=": 1, "-": -1 };

/** The five faces: value, name, and how the mouth goes (control point of a curve). */
export const FACES = [
  { value: -1, name: "very bad", mouth: -7 },
  { value: -0.5, name: "bad", mouth: -3.5 },
  { value: 0, name: "so-so", mouth: 0 },
  { value: 0.5, name: "good", mouth: 3.5 },
  { value: 1, name: "very good", mouth: 7 },
];

/** The feedback that a digit stands for: 0 is -1, 9 is +1. */
export function graded(digit) {
  return (2 * digit) / 9 - 1;
}

/** What a key of the keyboard asks for, or null. `notes`: how many notes there are. */
export function understood(event, notes) {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const note = key.length === 1 ? NOTE_KEYS.indexOf(key) : -1;
  if (note >= 0 && note < notes) return { note };
  if (key === " ") return { note: null };
  if (key in FULL) return { judge: FULL[key] };
  if (/^[0-9]$/.test(key)) return { judge: graded(Number(key)) };
  const tool = { p: "silent", l: "language", h: "hint", q: "leave" }[key];
  return tool ? { tool } : null;
}

/** A value with its sign: "+0.50", "0". */
export function signed(value) {
  if (value === null || value === undefined) return "";
  const digits = Math.abs(value * 2) % 1 === 0 ? String(Math.abs(value)) : Math.abs(value).toFixed(2);
  return value === 0 ? "0" : `${value < 0 ? "−" : "+"}${digits}`;
}

/** The meaning of each note: for note n the place of its command. `language`: the note of each command. */
export function meanings(language) {
  const found = [];
  language.forEach((note, command) => {
    found[note] = command;
  });
  return found;
}

/** An arrow that shows a turn in degrees (left is positive), or null if the command is no such turn. */
export function arrow(hello, name) {
  const choice = (hello.choices ?? []).find((each) => each.name === name);
  const actuators = Object.entries(hello.actuators ?? {});
  if (!choice || actuators.length !== 1 || !/^deg/.test(actuators[0][1].unit ?? "")) return null;
  const degrees = Number(choice.values[actuators[0][0]]);
  if (!Number.isFinite(degrees)) return null;
  const drawn = svg("svg", { viewBox: "-12 -12 24 24", "aria-hidden": "true", class: "arrow" });
  drawn.append(svg("path", { d: "M0 9V-8M-5.5 -2.5L0 -8.5L5.5 -2.5", transform: `rotate(${-degrees})` }));
  return drawn;
}

/** A face whose mouth goes up or down. */
export function face(mouth) {
  const drawn = svg("svg", { viewBox: "0 0 40 40", "aria-hidden": "true", class: "face" });
  const y = 26 - mouth / 3;
  drawn.append(
    svg("circle", { cx: 20, cy: 20, r: 17 }),
    svg("circle", { cx: 13.5, cy: 16, r: 2.2, class: "eye" }),
    svg("circle", { cx: 26.5, cy: 16, r: 2.2, class: "eye" }),
    svg("path", { d: `M11.5 ${y}Q20 ${y + mouth * 1.6} 28.5 ${y}` }),
  );
  return drawn;
}

/** The row of faces; `onJudge` gets the value. */
export function faces(onJudge) {
  return FACES.map(({ value, name, mouth }) =>
    button([face(mouth), el("span", { "aria-hidden": "true" }, signed(value))], () => onJudge(value), {
      class: "face-key",
      "data-value": value,
      "aria-pressed": "false",
      "aria-label": `${signed(value)} ${name}`,
      title: name,
    }),
  );
}

/** The keys of all notes. Renewed by `show`. */
export class NoteKeys {
  /** `silence`: the key that says nothing; it is the last one. */
  constructor(onNote, silence) {
    this.root = el("div", { class: "note-keys", role: "group", "aria-label": "Your notes" });
    this._onNote = onNote;
    this._silence = silence;
    this._made = "";
    this._keys = [];
  }

  /** `language`: the note of each command; `wanted`: the note that is right now, or null; `last`: the note just said. */
  show(hello, language, wanted, last) {
    const made = JSON.stringify([hello.run, hello.commands, language]);
    if (made !== this._made) {
      this._made = made;
      const command = meanings(language);
      this._keys = command.map((meant, note) => this._key(hello, note, hello.commands[meant] ?? `command ${meant}`));
      const focused = this._keys.length && this.root.contains(document.activeElement)
        ? document.activeElement.dataset.note : null;
      this.root.replaceChildren(...this._keys, this._silence);
      if (focused !== null) this.root.querySelector(`[data-note="${focused}"]`)?.focus();
    }
    this._keys.forEach((key, note) => {
      key.classList.toggle("is-wanted", note === wanted);
      key.classList.toggle("is-last", note === last);
    });
  }

  /** Show that a key was hit. */
  flash(note) {
    const key = this._keys[note];
    if (!key) return;
    key.classList.remove("is-hit");
    void key.offsetWidth; // so that the animation begins anew
    key.classList.add("is-hit");
  }

  _key(hello, note, name) {
    const letter = NOTE_KEYS[note] ?? "";
    const shown = [
      arrow(hello, name),
      el("span", { class: "meant" }, name),
      el("span", { class: "unseen" }, `, note ${note}, key `),
      letter && el("kbd", {}, letter),
    ];
    return button(shown, () => this._onNote(note), {
      class: "note-key",
      "data-note": note,
      "data-command": name,
      "aria-keyshortcuts": letter || null,
    });
  }
}
