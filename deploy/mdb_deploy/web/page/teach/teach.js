// Teach: come with a name and a language, teach, leave; then watch the robot go on alone.

import { named } from "../draw.js";
import { button, el, kept, keysTaken, say, show } from "./dom.js";
import { understood } from "./keys.js";
import { LanguageEditor, drawn, orderOf, ordered } from "./language.js";
import { Left, scripted } from "./left.js";
import { Lesson } from "./lesson.js";
import { Microphone } from "./audio/microphone.js";
import { Sound } from "./audio/sound.js";

/** What a name may be on the wire: letters, digits, dot, line, underline; at most 64. */
const NAME = /[^A-Za-z0-9_.-]+/g;
const RETURN_MS = 60000;
const AGAIN_MS = 1000;
const LANGUAGES = { random: "at random", ordered: "notes in order", reversed: "notes in reverse order" };

export function start(root, page) {
  new Teach(root, page);
}

class Teach {
  constructor(root, page) {
    this._page = page;
    this._root = root;
    this._me = null; // {name, language} while somebody teaches here
    this._waits = true; // whether the robot waits for this teacher
    this._coming = null; // the name that was asked for, until the server says that it is there
    this._tools = { sound: kept.get("sound", "on") === "on", microphone: false };
    this._sound = new Sound();
    this._sound.on = this._tools.sound;
    this._microphone = new Microphone((frame) => page.sendSound(frame), (share) => this._lesson.loud(share));
    this._editor = new LanguageEditor((language) => this._speak(language), (note) => this._play(note));
    this._lesson = new Lesson({
      note: (note) => this._note(note),
      judge: (value) => this._judge(value),
      wait: () => this._flipWait(),
      silent: () => this._do({ do: "silent", on: !page.state.you?.paused }),
      script: (on) => this._script(on),
      sound: () => this._flipSound(),
      auto: () => this._do({ do: "auto", on: !page.state.you?.auto }),
      microphone: () => this._flipMicrophone(),
      language: () => this._editLanguage(),
      changed: () => this._show(),
    });
    this._build(root);
    page.teachByItself = () => this._byItself();
    for (const part of ["hello", "you", "control", "alive", "mode", "finished", "thought"]) page.on(part, () => this._soon());
    page.on("connection", (connection) => connection === "lost" && this._return());
    document.addEventListener("keydown", (event) => this._key(event));
    const tick = (now_ms) => {
      if (this._teaches()) this._lesson.tick(now_ms);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this._show();
  }

  // ---- the three faces of the panel: come, teach, left

  _build(root) {
    this._title = el("h2", { id: "teach-title" }, "Teach");
    this._why = el("p", { class: "plain", role: "status" });
    this._back = button("Back to the robot that runs now", () => this._page.showLive(), { id: "teach-back" });
    this._name = el("input", { id: "teach-name", name: "name", type: "text", maxlength: 64, required: true, autocomplete: "off",
      spellcheck: "false", value: kept.get("name", `guest-${1 + Math.floor(99 * Math.random())}`) });
    this._language = el("select", { id: "teach-language" },
      ...Object.entries(LANGUAGES).map(([value, words]) => el("option", { value }, words)));
    this._takes = el("input", { id: "teach-takes", type: "checkbox", checked: true });
    this._takesRow = el("label", { class: "check", for: "teach-takes" }, this._takes, "Take over from the scripted teacher");
    this._come = el("button", { type: "submit", id: "teach-join", class: "primary" }, "Teach it");
    this._failed = el("p", { class: "trouble", role: "alert" });
    this._goal = el("p", { id: "teach-goal" });
    this._form = el("form", { class: "come", submit: (event) => this._join(event) },
      el("p", {}, "The robot hears notes and does not know what they mean. Play a note, see what it does, and say how good that was. It learns your language, whatever it is."),
      this._goal,
      el("label", { for: "teach-name" }, "Your name"), this._name,
      el("label", { for: "teach-language" }, "Your language"), this._language,
      this._takesRow, this._failed, this._come);
    this._run = button("Look at any moment of this run", () => this._page.openPast?.(this._hello.run), { id: "teach-run", class: "primary" });
    this._left = new Left(this._page, () => this._again(), (on) => this._do({ do: "control", script: on }));
    this._leaves = button("Leave", () => this._leave(), { id: "leave", "aria-keyshortcuts": "q", title: "Leave (key q)" });
    root.append(el("div", { class: "teach-head" }, this._title, this._leaves), this._why, this._back, this._run, this._left.root, this._form, this._lesson.root);
  }

  _teaches() {
    return Boolean(this._page.state.you?.name) && this._page.state.mode === "live";
  }

  _soon() {
    if (this._asked) return;
    this._asked = true;
    queueMicrotask(() => {
      this._asked = false;
      this._show();
    });
  }

  _show() {
    const { state } = this._page;
    const { hello, you, mode } = state;
    if (mode === "live" && hello) this._hello = hello;
    const there = Boolean(you?.name);
    if (there && !this._wasThere) this._arrived(you);
    if (!there && this._wasThere) this._gone(you);
    // Nothing more can be said: the lesson ends, and what came of it is told.
    if (there && state.finished && mode === "live" && this._me) this._leave();
    this._wasThere = there;
    const whyNot = this._whyNot();
    this._root.classList.toggle("is-idle", mode === "past" && !there);
    say(this._why, whyNot ?? "");
    show(this._why, whyNot !== null);
    show(this._back, mode === "past" && state.connection === "open" && this._hello?.live);
    show(this._run, mode === "live" && Boolean(state.finished) && Boolean(this._hello?.run));
    const left = mode === "live" && !there && this._left.told;
    show(this._left.root, left);
    show(this._form, whyNot === null && !there && !left);
    show(this._lesson.root, whyNot === null && there);
    show(this._leaves, there);
    say(this._title, there && this._hello ? `You teach ${this._hello.brain}, as ${you.name}` : "Teach");
    if (whyNot !== null || !this._hello) return;
    const operates = Boolean(this._hello.rights?.operate);
    const goals = (this._hello.successes ?? []).map((name) => `“${named(name)}”`).join(" or ");
    say(this._goal, goals ? `Help it to a success: ${goals}. A hint tells which note is right.` : "A hint tells which note is right.");
    show(this._takesRow, operates && scripted(state) && state.control?.script !== false);
    if (there) {
      this._lesson.show(this._hello, you, {
        control: state.control, tools: this._tools, rights: this._hello.rights ?? {}, scripted: scripted(state),
        phase: state.phase, explores: state.thought?.badge === "explores",
      });
    }
  }

  /** Why nobody can teach here now, or null. */
  _whyNot() {
    const { state } = this._page;
    const hello = this._hello;
    const still = state.you?.name ? ` You still teach as ${state.you.name}: the robot may wait for you.` : "";
    if (this._returning && !state.you?.name) return "The connection was lost. Your lesson goes on when it is back.";
    if (state.mode === "past") return `You look at a past run. Only a robot that runs now can be taught.${still}`;
    if (!hello) return state.connection === "lost" ? "There is no connection to the console." : "No robot runs yet.";
    if (!hello.live) return "No robot runs now. Past runs can be looked at below.";
    if (state.finished && !state.you?.name) return "The run is over.";
    if (!hello.rights?.teach) return "You watch. To teach, open the link for teachers.";
    if (!hello.notes || !hello.commands?.length) return "This experiment has no notes: nobody teaches this robot.";
    return null;
  }

  // ---- come and leave

  async _join(event) {
    event.preventDefault();
    if (this._come.hasAttribute("aria-disabled")) return; // asked already
    const name = this._name.value.trim().replace(NAME, "-").replace(/^-+|-+$/g, "");
    if (!name || name === "script") {
      say(this._failed, name ? "This name is the scripted teacher's. Choose another." : "Type a name of letters and digits.");
      this._name.focus();
      return;
    }
    kept.set("name", name);
    const order = orderOf(this._hello);
    const language = { random: () => drawn(order.length), ordered: () => ordered(order), reversed: () => ordered(order, true) }[this._language.value]();
    await this._ask(name, language, !this._takesRow.hidden && this._takes.checked);
  }

  /** Ask the server to be let in. Returns whether it went well. */
  async _ask(name, language, takes) {
    say(this._failed, "");
    this._coming = name;
    this._come.setAttribute("aria-disabled", "true"); // not `disabled`: who works with the keys would lose his place
    const said = await this._page.send({ do: "join", name, language });
    this._come.removeAttribute("aria-disabled");
    if (!said.ok) {
      this._coming = null;
      say(this._failed, said.words);
      return false;
    }
    // At first the robot waits: nobody plays and judges quickly on the first day.
    await this._page.send({ do: "wait", on: this._waits });
    if (takes) await this._do({ do: "control", script: false });
    return true;
  }

  /** A script teaches under a name of its own: for those who only watch, where the experiment has no scripted teacher. */
  async _byItself() {
    if (this._whyNot() !== null) return false;
    const there = Boolean(this._page.state.you?.name) || (await this._ask("script-2", drawn(this._hello.commands.length), false));
    return there && this._do({ do: "auto", on: true });
  }

  _arrived(you) {
    this._me = { name: you.name, language: [...(you.language ?? [])] };
    this._coming = null;
    this._left.clear();
    queueMicrotask(() => {
      this._lesson.root.focus({ preventScroll: true });
      this._scroll();
    });
  }

  /** On a phone the panel is brought to where it can be seen. */
  _scroll() {
    if (window.matchMedia("(max-width: 719px)").matches) this._root.scrollIntoView();
  }

  async _leave() {
    this._me = null;
    await this._do({ do: "leave" });
  }

  _gone(you) {
    this._microphoneOff();
    if (this._returning || this._coming) return; // the connection was lost, not the will: see `_return`
    this._me = null;
    this._left.tell(this._hello, you?.summary, you?.trouble);
    queueMicrotask(() => {
      this._left.root.focus({ preventScroll: true });
      this._scroll();
    });
  }

  /** The connection is lost. When it is back within a minute the lesson goes on, under the same name. */
  async _return() {
    const me = this._me;
    if (!me || this._returning) return;
    this._returning = true;
    const until_ms = performance.now() + RETURN_MS;
    while (this._me === me && performance.now() < until_ms) {
      await new Promise((resume) => setTimeout(resume, AGAIN_MS));
      const { connection, you } = this._page.state;
      if (connection !== "open" || !this._hello?.live || you === undefined) continue;
      if (you.name || (await this._ask(me.name, me.language, false))) break;
    }
    this._returning = false;
    say(this._failed, "");
    this._show();
  }

  _again() {
    const [, stem, number] = /^(.*?)-?(\d*)$/.exec(this._name.value);
    this._name.value = `${stem || "guest"}-${Number(number || 1) + 1}`;
    this._left.clear();
    this._show();
    this._name.focus();
    this._name.select();
  }

  // ---- what the teacher says

  /** Send an order; what went wrong is shown. Returns whether it went well. */
  async _do(order) {
    const said = await this._page.send(order);
    if (!said.ok) {
      if (this._teaches()) this._lesson.notice(said.words);
      else say(this._failed, said.words);
    }
    return said.ok;
  }

  /** Let the scripted teacher teach, and stay silent meanwhile; or take the robot over from it. */
  async _script(on) {
    const silent = Boolean(this._page.state.you?.paused);
    if ((await this._do({ do: "control", script: on })) && silent !== on) await this._do({ do: "silent", on });
  }

  _play(note) {
    this._sound.play(note, this._hello?.scale_hz);
  }

  _note(note) {
    this._play(note);
    this._lesson.hit(note);
    this._do({ do: "note", note });
  }

  _judge(value) {
    const iteration = (this._page.state.you?.turn?.iteration ?? 0) - 1;
    if (iteration < 0) this._lesson.notice("There is no action yet to judge. Play a note first.");
    else this._do({ do: "judge", iteration, value: Math.max(-1, Math.min(1, value)) });
  }

  _speak(language) {
    if (this._me) this._me.language = [...language];
    this._do({ do: "speak", language });
  }

  _editLanguage() {
    const { you } = this._page.state;
    if (you?.language) this._editor.show(this._hello, you.language);
  }

  _flipSound() {
    this._tools.sound = this._sound.on = !this._tools.sound;
    kept.set("sound", this._tools.sound ? "on" : "off");
    this._show();
  }

  _flipWait() {
    this._waits = !this._page.state.you?.waits;
    this._do({ do: "wait", on: this._waits });
  }

  async _flipMicrophone() {
    if (this._tools.microphone) {
      await this._microphoneOff();
    } else {
      try {
        const rate_hz = await this._microphone.start();
        this._tools.microphone = await this._do({ do: "microphone", rate_hz });
        if (!this._tools.microphone) await this._microphone.stop();
      } catch (error) {
        this._lesson.notice(error.message);
      }
    }
    this._show();
  }

  async _microphoneOff() {
    if (!this._tools.microphone) return;
    this._tools.microphone = false;
    await this._microphone.stop();
    if (this._page.state.you?.name) await this._do({ do: "microphone", rate_hz: null });
  }

  // ---- the keyboard

  _key(event) {
    if (!this._teaches() || this._lesson.root.hidden || event.repeat || keysTaken(event)) return;
    const asked = understood(event, this._hello.notes);
    if (asked === null) return;
    const onControl = event.target instanceof Element && event.target.closest("button, summary, a, [role=slider], input");
    if (event.key === " " && onControl) return; // the space bar presses the button that has the focus
    event.preventDefault();
    if ("note" in asked) this._note(asked.note);
    else if ("judge" in asked) this._judge(asked.judge);
    else {
      ({
        silent: () => this._do({ do: "silent", on: !this._page.state.you?.paused }),
        language: () => this._editLanguage(),
        hint: () => this._lesson.flip(),
        leave: () => this._leave(),
      })[asked.tool]();
    }
  }
}
