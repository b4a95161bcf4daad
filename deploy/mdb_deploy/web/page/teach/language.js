// The editor of a teacher's language: which note says what. The brain is never told.

import { el, button, press, say } from "./dom.js";
import { NOTE_KEYS } from "./keys.js";

/** The language in which `note` says `command`; the command that it said takes the other note. */
export function swapped(language, command, note) {
  const notes = [...language];
  const other = notes.indexOf(note);
  [notes[command], notes[other]] = [notes[other], notes[command]];
  return notes;
}

/** Notes rise with the commands' order, or fall. `order`: each command's rank. */
export function ordered(order, falling = false) {
  return order.map((rank) => (falling ? order.length - 1 - rank : rank));
}

/** Any correspondence, by chance. */
export function drawn(count) {
  const notes = Array.from({ length: count }, (_, note) => note);
  for (let last = count - 1; last > 0; last--) {
    const other = Math.floor(Math.random() * (last + 1));
    [notes[last], notes[other]] = [notes[other], notes[last]];
  }
  return notes;
}

/** The ranks of the commands; as they are listed, if the brain does not say. */
export function orderOf(hello) {
  const order = hello.order ?? [];
  return order.length === hello.commands.length ? order : hello.commands.map((_, place) => place);
}

export class LanguageEditor {
  /** `onChange(language)` is called at each change; `onSound(note)` to let a note sound. */
  constructor(onChange, onSound) {
    this._onChange = onChange;
    this._onSound = onSound;
    this._chosen = null;
    this._rows = el("div", { class: "language-rows", role: "group", "aria-label": "Meanings" });
    this._help = el("p", { class: "plain", "aria-live": "polite" });
    this.root = el("dialog", { id: "language", class: "sheet", "aria-labelledby": "language-title", keydown: (event) => this._key(event) },
      el("h2", { id: "language-title" }, "Your language"),
      el("p", {}, "Which note says what? You decide, and only you know it. The robot must find it out from what you praise."),
      this._rows,
      this._help,
      el("div", { class: "buttons" },
        button("Ordered", () => this._whole(ordered(orderOf(this._hello))), { id: "language-ordered" }),
        button("Reversed", () => this._whole(ordered(orderOf(this._hello), true)), { id: "language-reversed" }),
        button("Random", () => this._whole(drawn(this._language.length)), { id: "language-random" }),
        button("Done", () => this.root.close(), { id: "language-done", class: "primary", autofocus: true })));
    document.body.append(this.root);
  }

  get open() {
    return this.root.open;
  }

  /** Show the editor with a language: the note of each command. */
  show(hello, language) {
    this._hello = hello;
    this._language = [...language];
    this._chosen = null;
    this._draw();
    if (!this.root.open) this.root.showModal();
  }

  _draw() {
    const order = orderOf(this._hello);
    const commands = this._language.map((_, command) => command).sort((one, other) => order[other] - order[one]);
    this._buttons = commands.map((command) => {
      const note = this._language[command];
      const letter = NOTE_KEYS[note];
      const row = button(
        [el("span", { class: "meant" }, this._hello.commands[command]), el("span", {}, `note ${note}`),
          letter && el("kbd", {}, letter)],
        () => this._choose(command),
        { class: "language-row", "data-command": command, "data-note": note },
      );
      press(row, command === this._chosen);
      return row;
    });
    this._rows.replaceChildren(...this._buttons);
    say(this._help, this._chosen === null
      ? "To exchange two notes, choose a meaning."
      : `Now choose another meaning, or press the key of a note: “${this._hello.commands[this._chosen]}” gets that note, and the two are exchanged.`);
  }

  _choose(command) {
    if (this._chosen === null) {
      this._chosen = command;
      this._onSound(this._language[command]);
      this._draw();
    } else if (this._chosen === command) {
      this._chosen = null;
      this._draw();
    } else {
      this._swap(this._language[command]);
    }
    this._rows.querySelector(`[data-command="${command}"]`)?.focus();
  }

  _swap(note) {
    this._onSound(note);
    this._whole(swapped(this._language, this._chosen, note));
  }

  _whole(language) {
    this._language = language;
    this._chosen = null;
    this._draw();
    this._onChange(language);
  }

  _key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const at = this._buttons.indexOf(document.activeElement);
    const move = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (move) {
      const to = at < 0 ? 0 : (at + move + this._buttons.length) % this._buttons.length;
      this._buttons[to].focus();
      event.preventDefault();
      return;
    }
    const note = event.key.length === 1 ? NOTE_KEYS.indexOf(event.key.toLowerCase()) : -1;
    if (note < 0 || note >= this._language.length) return;
    event.preventDefault();
    const command = this._chosen ?? (at < 0 ? null : Number(this._buttons[at].dataset.command));
    if (command === null) return;
    this._chosen = command;
    this._swap(note);
    this._rows.querySelector(`[data-command="${command}"]`)?.focus();
  }
}
