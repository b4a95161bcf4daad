// The panel of somebody who teaches: whose turn it is, feedback, notes, what was said and done.

import { el, button, press, say, show, toggle } from "./dom.js";
import { NoteKeys, faces, signed } from "./keys.js";

const NOTICE_MS = 5000;

/** What the teacher is to do now. */
const TURNS = {
  both: "Your turn: judge, then play.",
  play: "Your turn: play a note, then judge.",
  judge: "Your turn: judge what it did.",
  watch: "Watch what it does.",
  over: "The run is over.",
};

/**
 * Who is being obeyed in the place of this teacher, or null. A script that was told to be silent, or whose phase is
 * over, says no more: whoever plays next is obeyed.
 */
function rivalOf(hello, you, { control, phase }) {
  const other = you.obeyed ?? null;
  if (other === null || other === you.name) return null;
  const scripted = (hello.phases ?? []).some((each) => each.teacher === other);
  if (scripted && (control?.script === false || (phase && phase.teacher !== other))) return null;
  return other;
}

/** Some iterations as lines of a table. */
function lines(hello, exchanges) {
  const name = (command) => (command === null || command === undefined ? "" : hello.commands[command] ?? `command ${command}`);
  return exchanges.map((each) => {
    const done = each.did === null || each.did === undefined ? "" : name(each.did);
    const mark = each.obeyed === true ? " ✓" : each.obeyed === false ? " ✗" : "";
    return el("tr", { class: each.obeyed === true ? "is-good" : each.obeyed === false ? "is-bad" : null },
      el("th", { scope: "row" }, String(each.iteration)),
      el("td", {}, each.note === null || each.note === undefined ? "silent" : name(each.command)),
      el("td", {}, done, mark && el("span", { "aria-label": each.obeyed ? "as you said" : "not as you said", role: "img" }, mark)),
      el("td", {}, each.heard === false ? "your note did not count" : signed(each.feedback)));
  });
}

export class Lesson {
  /** `acts`: note(n), judge(iteration, value), and one function for each tool. */
  constructor(acts) {
    this._acts = acts;
    this.hint = true;
    this._until_ms = null;
    this._whole_ms = 1;
    this._turn = "";
    this._heldNotice = null;
    this._build();
  }

  _build() {
    const acts = this._acts;
    this._obeyed = el("p", { class: "who-counts", "aria-live": "polite" });
    this._take = button("Take over from the scripted teacher", () => acts.script(false), { id: "take-over", class: "primary" });
    this._give = button("Give back to the script", () => acts.script(true), { id: "give-back", title: "The scripted teacher teaches again" });
    this._trouble = el("p", { class: "trouble", role: "status" });
    this._notice = el("p", { class: "notice", role: "status" });
    this._words = el("p", { id: "turn-words", class: "turn-words", "aria-live": "polite", "aria-atomic": "true" });
    this._bar = el("div", { class: "countdown-bar" });
    this._left = el("span", { class: "countdown-left" });
    this._countdown = el("div", { class: "countdown", "aria-hidden": "true" },
      el("div", { class: "countdown-track" }, this._bar), this._left);
    this._wait = toggle("Let it wait for me", () => acts.wait(), { id: "let-it-wait", title: "The robot does nothing until you have played and judged" });

    this._last = el("p", { class: "last-action" });
    this._advice = el("p", { class: "advice" });
    this._faces = faces((value) => acts.judge(value));
    this._slider = el("input", { type: "range", id: "exact", min: -1, max: 1, step: 0.05, value: 0.5,
      "aria-label": "Exact feedback", input: () => this._showExact() });
    this._give_exact = button("Give +0.5", () => acts.judge(Number(this._slider.value)), { id: "give-exact" });
    this._judge = el("div", { class: "step step-judge" },
      el("h3", {}, "Judge"), this._last, this._advice,
      el("div", { class: "faces", role: "group", "aria-label": "Your feedback" }, ...this._faces),
      el("div", { class: "exact" }, el("span", { class: "plain" }, "exact:"), this._slider, this._give_exact));

    this._wanted = el("p", { class: "wanted" });
    this._hint = toggle("Hint", () => this._flip(), { id: "hint", "aria-keyshortcuts": "h", title: "Which note is right now (key h)" });
    const silence = button(["say nothing", el("kbd", {}, "space")], () => acts.note(null),
      { class: "note-key silence", "data-note": "none" });
    this._notes = new NoteKeys((note) => acts.note(note), silence);
    this._play = el("div", { class: "step step-play" }, el("h3", {}, "Play"), this._wanted, this._notes.root);

    this._obedience = el("p", { class: "obedience" });
    this._filled = el("div", { class: "meter-filled" });
    this._meter = el("div", { class: "meter", "aria-hidden": "true" }, this._filled);

    this._sound = toggle("Sound", acts.sound, { id: "sound", title: "Let your notes sound here" });
    this._silent = toggle("Stay silent", acts.silent, { id: "silent", "aria-keyshortcuts": "p", title: "Be there but say nothing; the robot does not wait (key p)" });
    this._auto = toggle("Teach by itself", acts.auto, { id: "auto", title: "A script teaches with your language, under your name" });
    this._ear = toggle("Microphone", acts.microphone, { id: "microphone" });
    this._loud = el("div", { class: "meter-filled" });
    this._heard = el("span", { class: "heard-words", "aria-live": "polite" });
    this._hears = el("div", { class: "hears" }, el("div", { class: "meter loudness", "aria-hidden": "true" }, this._loud), this._heard);

    this._list = el("tbody");
    const exchanges = el("details", { class: "exchanges", open: window.matchMedia("(min-width: 1000px)").matches },
      el("summary", {}, "What was said, done and judged"),
      el("div", { class: "exchanges-list", tabindex: 0, role: "region", "aria-label": "What was said, done and judged" },
        el("table", {},
          el("thead", {}, el("tr", {}, ...["iteration", "you said", "it did", "feedback"].map((words) => el("th", { scope: "col" }, words)))),
          this._list)));

    this.root = el("div", { class: "lesson", tabindex: -1, "aria-label": "Your lesson", role: "group" },
      el("div", { class: "counts" }, this._obeyed, this._take),
      this._trouble,
      el("div", { class: "turn" }, this._words, el("div", { class: "turn-row" }, this._countdown, this._wait, this._hint)),
      this._notice, this._judge, this._play,
      el("div", { class: "obeys" }, this._obedience, this._meter),
      el("div", { class: "buttons tools" },
        this._sound,
        button("Language", acts.language, { id: "open-language", "aria-keyshortcuts": "l", title: "What your notes mean (key l)" }),
        this._silent, this._ear, this._auto, this._give),
      this._hears, exchanges, this._keysHelp());
    this._showExact();
  }

  _keysHelp() {
    const key = (letter, words) => [el("kbd", {}, letter), ` ${words}  `];
    return el("p", { class: "plain keys-help" }, "Keys: ", ...key("0", "worst to"), ...key("9", "best,"), ...key("−", "and"), ...key("+", "full,"),
      ...key("space", "say nothing,"), ...key("p", "stay silent,"), ...key("l", "language,"), ...key("h", "hint,"), ...key("q", "leave."));
  }

  _flip() {
    this.hint = !this.hint;
    this._acts.changed();
  }

  /** Turn the hint on or off, as the key does. */
  flip() {
    this._flip();
  }

  _showExact() {
    const words = signed(Number(this._slider.value));
    say(this._give_exact, `Give ${words}`);
    this._slider.setAttribute("aria-valuetext", words);
  }

  /** Show that a note was played. */
  hit(note) {
    if (note !== null) this._notes.flash(note);
  }

  /** Show for some seconds what became of an order. */
  notice(words) {
    say(this._notice, words ?? "");
    this._noticed_ms = performance.now();
  }

  /** Show how loud the microphone is, 0 to 1. */
  loud(share) {
    this._loud.style.width = `${Math.round(100 * Math.min(1, share * 2))}%`;
  }

  /**
   * Renew all. `you`: as the server says. `now`: {tools: what is on, on this side; control: as the operator said;
   * rights; scripted: whether there is a scripted teacher; phase: as the script says; explores: whether the robot
   * tries actions only to learn}.
   */
  show(hello, you, now) {
    const { tools } = now;
    const turn = you.turn ?? { kind: "watch", iteration: 0, left_s: null };
    const rival = rivalOf(hello, you, now);
    this._showTurn(hello, you, turn, rival, Boolean(now.control?.paused));
    this._showCounts(you, now, rival, new Set((hello.phases ?? []).map((each) => each.teacher)));
    this._showJudge(hello, you, turn);
    this._showPlay(hello, you, turn);
    this._showMeasures(you);
    press(this._wait, you.waits);
    press(this._hint, this.hint);
    press(this._sound, tools.sound);
    press(this._silent, you.paused);
    press(this._auto, you.auto);
    press(this._ear, tools.microphone);
    show(this._ear, hello.ear);
    show(this._hears, tools.microphone);
    if (you.notice && you.notice !== this._heldNotice) this.notice(you.notice);
    this._heldNotice = you.notice ?? null;
    this._showHeard(you, tools);
    const rows = JSON.stringify(you.exchanges ?? []);
    if (rows !== this._rows) {
      this._rows = rows;
      this._list.replaceChildren(...lines(hello, (you.exchanges ?? []).slice(0, 20)));
    }
  }

  _showTurn(hello, you, turn, rival, halted) {
    const another = rival !== null && turn.kind !== "over";
    const mine = you.paused ? "You stay silent. It goes on without you."
      : halted && turn.kind !== "over" ? "The robot is paused. Press “Go on” under “Try”."
      : another ? "Watch: somebody else is being obeyed." : TURNS[turn.kind] ?? TURNS.watch;
    say(this._words, mine);
    this.root.dataset.turn = you.paused || another || halted ? "watch" : turn.kind;
    const left_s = turn.left_s;
    if (left_s === null || left_s === undefined || you.waits || you.paused) {
      this._until_ms = null;
    } else {
      const now = performance.now();
      const whole_s = Math.max(...(hello.patience_s ?? []), left_s, 0.1);
      const again = `${turn.iteration} ${turn.kind}` !== this._turn;
      // The clock of the page goes on by itself; a frame that says nearly the same does not make the bar jump.
      if (again || this._until_ms === null || Math.abs(this._until_ms - (now + 1000 * left_s)) > 250) {
        this._until_ms = now + 1000 * left_s;
        this._whole_ms = 1000 * whole_s;
      }
    }
    this._turn = `${turn.iteration} ${turn.kind}`;
    this._waiting = Boolean(you.waits) && !you.paused && !another && ["play", "judge", "both"].includes(turn.kind) && !halted;
  }

  /** Draw the time that is left; called for each picture of the screen. */
  tick(now_ms) {
    if (this._noticed_ms && now_ms - this._noticed_ms > NOTICE_MS) {
      this._noticed_ms = null;
      say(this._notice, "");
    }
    const left_ms = this._until_ms === null ? null : Math.max(0, this._until_ms - now_ms);
    const share = this._waiting ? 1 : left_ms === null ? 0 : left_ms / this._whole_ms;
    this._bar.style.transform = `scaleX(${Math.min(1, share).toFixed(3)})`;
    this._countdown.classList.toggle("is-waiting", this._waiting);
    say(this._left, this._waiting ? "it waits for you" : left_ms === null ? "" : left_ms === 0 ? "it goes on" : `${(left_ms / 1000).toFixed(1)} s`);
  }

  _showCounts(you, { control, rights, scripted, explores }, rival, script) {
    const mine = you.obeyed === you.name;
    const others = (you.others ?? []).filter((each) => each !== you.obeyed && each !== "script");
    const also = others.length ? ` Also here: ${others.join(", ")}.` : "";
    const other = `“${rival}”`;
    const words = rival !== null ? `${other} is being obeyed. Your notes do not count until ${other} is silent or leaves.`
      : you.paused ? "You stay silent: nobody is being obeyed."
        : !mine ? "Nobody is being obeyed now: play a note."
          : explores ? "Your notes count. Now it tries actions, to learn. Later it obeys more often."
            : "You are being obeyed: your notes count.";
    say(this._obeyed, words + also);
    // The session says the same of who is obeyed; once is enough.
    say(this._trouble, rival !== null && you.trouble?.startsWith(`${rival} `) ? "" : you.trouble ?? "");
    this._obeyed.classList.toggle("is-good", mine && !you.paused);
    this._obeyed.classList.toggle("is-bad", rival !== null);
    const on = control?.script !== false;
    show(this._take, rights.operate && scripted && on && (you.paused || script.has(rival)));
    show(this._give, rights.operate && scripted && !on);
  }

  _showJudge(hello, you, turn) {
    const iteration = turn.iteration - 1;
    const last = (you.exchanges ?? []).find((each) => each.iteration === iteration);
    const name = (command) => hello.commands[command] ?? `command ${command}`;
    const known = last && last.did !== null && last.did !== undefined;
    const said = last && last.command !== null && last.command !== undefined ? `You said “${name(last.command)}”. ` : "";
    say(this._last, iteration < 0 ? "It has done nothing yet." : known ? `${said}It did “${name(last.did)}”.` : said || "It has acted.");
    const judged = last?.feedback ?? null;
    const advice = judged !== null ? `You gave ${signed(judged)}.`
      : !this.hint || !said ? ""
        : last.obeyed === true ? "It obeyed: praise it."
          : last.obeyed === false ? "It did not obey: punish it, less if it was near." : "";
    say(this._advice, advice);
    for (const key of this._faces) press(key, judged !== null && Math.abs(Number(key.dataset.value) - judged) < 0.01);
    this._judge.classList.toggle("is-due", ["judge", "both"].includes(turn.kind) && !you.paused);
  }

  _showPlay(hello, you, turn) {
    const wanted = you.wanted ?? null;
    const note = wanted === null ? null : you.language[wanted];
    const due = ["play", "both"].includes(turn.kind) && !you.paused;
    const words = !this.hint || !due ? ""
      : note === null ? "No note is better than another now."
        : `Right now: “${hello.commands[wanted]}”.`;
    say(this._wanted, words);
    const said = (you.exchanges ?? []).find((each) => each.iteration === turn.iteration);
    const last = said && said.note !== null ? said.note : null;
    this._notes.show(hello, you.language, this.hint && due ? note : null, last);
    this._play.classList.toggle("is-due", due);
  }

  _showMeasures(you) {
    const share = you.obedience;
    const known = share !== null && share !== undefined && you.judged > 0;
    say(this._obedience, known ? `It obeys: ${Math.round(share * you.judged)} of your last ${you.judged} notes` : "It obeys: you have played no note yet");
    this._filled.style.width = `${known ? Math.round(100 * share) : 0}%`;
  }

  _showHeard(you, tools) {
    if (!tools.microphone) return;
    const heard = you.heard;
    if (!heard) {
      say(this._heard, "The microphone listens: whistle, sing or play a note.");
      return;
    }
    const hz = heard.hz === null || heard.hz === undefined ? "" : `${Math.round(heard.hz)} Hz`;
    const note = heard.note === null || heard.note === undefined ? "no note of the scale" : `note ${heard.note}`;
    say(this._heard, `Heard: ${[hz, note].filter(Boolean).join(", ")}`);
  }
}
