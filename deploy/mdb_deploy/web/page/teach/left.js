// After a lesson: what came of it, and what the robot does since then.

import { named } from "../draw.js";
import { button, el, say } from "./dom.js";

/** Whether a script of the experiment teaches in this run, or would if it were let. */
export function scripted(state) {
  return (state.alive ?? []).some((token) => token === "teacher/script");
}

/** Whether the script teaches now. */
function scriptTeaches(state) {
  return scripted(state) && state.control?.script !== false && Boolean(state.phase?.teacher);
}

export class Left {
  /** `again()`: come back as somebody else; `script(on)`: let the script teach or not, a promise of whether it went well. */
  constructor(page, again, script) {
    this._page = page;
    this._again = again;
    this._script = script;
    this.told = false;
    this.root = el("div", { class: "left", tabindex: -1, hidden: true });
    for (const part of ["scene", "control", "phase", "finished"]) page.on(part, () => this._renew());
  }

  /** Forget the lesson. */
  clear() {
    this.told = false;
    this.root.replaceChildren();
  }

  /** Tell of a lesson that has ended. `trouble`: why, if nobody wanted it. */
  tell(hello, summary, trouble) {
    const { scene } = this._page.state;
    this._hello = hello;
    this._from = scene ? { iteration: scene.iteration, successes: scene.successes } : null;
    this._title = el("h3");
    this._ended = trouble ? "Your lesson is over." : "You have left.";
    this._since = el("p", { class: "since" });
    this._how = el("p");
    this._back = button("Come back as somebody else", this._again, { id: "come-back" });
    this._alone = button("Let it go on alone", () => this._script(false), { id: "go-alone" });
    this._give = button("Give back to the scripted teacher", () => this._script(true), { id: "give-back-after" });
    this.root.replaceChildren(this._title, ...(trouble ? [el("p", {}, trouble)] : []), this._since, this._how, this._summary(summary),
      el("div", { class: "buttons" }, this._back, this._alone, this._give));
    this.told = true;
    this._renew();
  }

  _summary(summary) {
    if (!summary?.commands) return el("p", {}, "You played no note this time.");
    const line = (name, words) => [el("dt", {}, name), el("dd", {}, words)];
    const percent = (share) => (share === null || share === undefined ? "–" : `${Math.round(100 * share)} %`);
    return el("dl", { class: "summary" },
      ...line("Notes you played", String(summary.commands)),
      ...line("Times it obeyed", `${summary.obeyed} of ${summary.judged}`),
      ...line("Obedience, your first notes", percent(summary.first)),
      ...line("Obedience, your last notes", percent(summary.last)),
      ...line("Times you praised", String(summary.rewards)),
      ...line("Times you punished", String(summary.punishments)),
      ...line("Successes while you taught", String(summary.successes)));
  }

  _renew() {
    const { state } = this._page;
    if (!this.told || state.mode !== "live") return;
    const taught = scriptTeaches(state);
    const operates = Boolean(this._hello?.rights?.operate) && scripted(state) && !state.finished;
    this._back.hidden = Boolean(state.finished);
    if (state.finished) {
      say(this._title, "This is what came of your lesson.");
      say(this._how, "");
    } else {
      this._tellNow(state, taught);
    }
    this._alone.hidden = !(operates && taught);
    this._give.hidden = !(operates && state.control?.script === false);
    const { scene } = state;
    if (!this._from || !scene || scene.iteration <= this._from.iteration) return; // nothing yet, or another run
    const what = this._hello?.successes?.length === 1 ? this._hello.successes[0] : "success";
    const count = (number, word) => `${number} ${word}${number === 1 ? "" : "s"}`;
    const [times, actions] = [scene.successes - this._from.successes, scene.iteration - this._from.iteration];
    say(this._since, `Since you left: ${count(times, "time")} “${named(what)}” in ${count(actions, "action")}.`);
  }

  _tellNow(state, taught) {
    say(this._title, `${this._ended} ${taught ? "The scripted teacher goes on." : "Now watch: it goes on alone."}`);
    say(this._how, taught ? `${state.phase.teacher} teaches it now, in a language of its own.`
      : `Nobody teaches it now. It acts by the model that it made from the feedback.${
        scripted(state) && state.control?.script === false ? " The scripted teacher stays silent until you give the robot back to it." : ""}`);
  }
}
