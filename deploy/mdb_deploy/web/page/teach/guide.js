// The guided minute: a few steps that point at the panels. On the first visit, and whenever "?" is pressed.

import { button, el, kept, say } from "./dom.js";
import { justWatch } from "./try.js";

const GAP = 12;

/** Each step points at a panel: the first of the places that is there. */
const STEPS = [
  { at: ["#scene"], title: "This is the robot",
    words: "It has a brain that knows nothing at first: not what its actions do, and not what is good. It learns both while it acts." },
  { at: ["#teach"], title: "A teacher plays notes",
    words: "Before each action a teacher plays a note. The robot hears it, and does not know what it means. After the action the teacher says how good that was: from −1 to +1." },
  { at: ["#choosing"], title: "It chooses by prediction",
    words: "For every action the world model predicts what will come, and the satisfaction model says how good that is. The best action is done. Then you see what really came." },
  { at: ["#top .badge", "#top"], title: "Why it does this",
    words: "The badge says it in words: it obeys a teacher, it explores, or it acts on its own by what it learnt." },
  { at: ["#believes"], title: "What it believes",
    words: "For each note and each action: the feedback that it expects. The table fills while it learns the teacher’s language." },
  { at: ["#curves"], title: "How it gets better",
    words: "Errors of its models fall, and successes come more often. When the teacher leaves, it goes on by the models that it made: this is the induced behaviour." },
  { at: ["#try"], title: "Try what you like",
    words: "Pause it, change its body, move the object. Further down you find past runs. Now teach it a language of your own, or just watch." },
];

/** Where the panel of a step is now, or null. */
function target(step) {
  for (const place of step.at) {
    const found = document.querySelector(place);
    if (found && found.getClientRects().length > 0) return found;
  }
  return null;
}

export function start(root, page) {
  const guide = new Guide(root, page);
  page.openGuide = () => guide.open();
  const toMoment = window.location.hash.includes("run=");
  if (kept.get("guided") === null && !toMoment) {
    const end = page.on("hello", (hello) => {
      if (!hello?.live || page.state.mode !== "live") return; // nothing moves yet: there is nothing to show
      queueMicrotask(() => end());
      // The other panels draw themselves first, so that there is something to point at.
      setTimeout(() => document.querySelector("dialog[open]") ?? guide.open(), 600);
    });
  }
}

class Guide {
  constructor(root, page) {
    this._page = page;
    this._step = 0;
    this._title = el("h2", { id: "guide-title" });
    this._words = el("p", { id: "guide-words" });
    this._place = el("p", { class: "guide-place plain" });
    this._said = el("p", { class: "failed", role: "status" });
    this._back = button("Back", () => this._go(this._step - 1), { id: "guide-back" });
    this._next = button("Next", () => this._go(this._step + 1), { id: "guide-next", class: "primary" });
    this._teach = button("Teach it", () => this._toTeach(), { id: "guide-teach", class: "primary" });
    this._watch = button("Just watch: ten times the pace", () => this._toWatch(), { id: "guide-watch" });
    this._skip = button("Skip", () => this._dialog.close(), { id: "guide-skip", title: "Skip the guide (Escape)" });
    this._ring = el("div", { class: "guide-ring", "aria-hidden": "true" });
    this._card = el("div", { class: "guide-card" }, this._place, this._title,
      el("div", { "aria-live": "polite" }, this._words), this._said,
      el("div", { class: "buttons" }, this._skip, this._back, this._next, this._watch, this._teach));
    this._dialog = el("dialog", { class: "guide", "aria-labelledby": "guide-title", "aria-describedby": "guide-words",
      close: () => this._closed(), keydown: (event) => this._key(event) }, this._ring, this._card);
    const again = button("?", () => this.open(), { id: "open-guide", "aria-label": "Show the guide", title: "Show the guide" });
    again.classList.add("square");
    this._again = again;
    root.append(this._dialog);
    this._putButton(root);
    for (const kind of ["resize", "scroll"]) {
      window.addEventListener(kind, () => this._dialog.open && this._point(), { passive: true, capture: true });
    }
  }

  /** The "?" goes into the header, beside the other buttons; without a header it is in the corner. */
  _putButton(root) {
    const put = () => {
      const home = document.querySelector("#top .state");
      if (home && !home.contains(this._again)) home.append(this._again);
      else if (!home) root.append(this._again);
      this._again.classList.toggle("is-corner", !home);
    };
    put();
    this._page.on("hello", put);
    setTimeout(put, 500);
  }

  open() {
    if (this._dialog.open) return;
    this._top = window.scrollY;
    this._dialog.showModal();
    this._go(0);
  }

  _go(step) {
    if (step < 0 || step >= STEPS.length) return;
    this._step = step;
    const last = step === STEPS.length - 1;
    say(this._place, `Step ${step + 1} of ${STEPS.length}`);
    say(this._title, STEPS[step].title);
    say(this._words, STEPS[step].words);
    say(this._said, "");
    this._back.hidden = step === 0;
    say(this._skip, last ? "Close" : "Skip");
    this._next.hidden = last;
    this._teach.hidden = !last;
    this._watch.hidden = !last;
    (last ? this._teach : this._next).focus({ preventScroll: true });
    const at = target(STEPS[step]);
    at?.scrollIntoView({ block: "nearest" });
    this._point();
    requestAnimationFrame(() => this._point());
  }

  /** Put the ring around the panel and the card beside it, where there is room. */
  _point() {
    const at = target(STEPS[this._step]);
    const [wide, high] = [document.documentElement.clientWidth, window.innerHeight];
    const box = at ? at.getBoundingClientRect() : { left: wide / 2, top: high / 2, right: wide / 2, bottom: high / 2 };
    const seen = { left: Math.max(4, box.left - 4), top: Math.max(4, box.top - 4), right: Math.min(wide - 4, box.right + 4), bottom: Math.min(high - 4, box.bottom + 4) };
    Object.assign(this._ring.style, {
      left: `${seen.left}px`, top: `${seen.top}px`, width: `${Math.max(0, seen.right - seen.left)}px`, height: `${Math.max(0, seen.bottom - seen.top)}px`,
    });
    const card = this._card.getBoundingClientRect();
    const bound = (value, size, whole) => Math.max(GAP, Math.min(value, whole - size - GAP));
    let left = bound((seen.left + seen.right - card.width) / 2, card.width, wide);
    let top = bound((seen.top + seen.bottom - card.height) / 2, card.height, high);
    if (high - seen.bottom > card.height + 2 * GAP) top = seen.bottom + GAP;
    else if (seen.top > card.height + 2 * GAP) top = seen.top - card.height - GAP;
    else if (wide - seen.right > card.width + 2 * GAP) left = seen.right + GAP;
    else if (seen.left > card.width + 2 * GAP) left = seen.left - card.width - GAP;
    else top = high - card.height - GAP;
    Object.assign(this._card.style, { left: `${left}px`, top: `${top}px` });
  }

  _key(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    this._go(this._step + step);
  }

  _toTeach() {
    this._top = null;
    this._dialog.close();
    const teach = document.getElementById("teach");
    teach?.scrollIntoView({ block: "nearest" });
    (document.getElementById("teach-name") ?? teach)?.focus({ preventScroll: true });
  }

  async _toWatch() {
    const words = await justWatch(this._page);
    if (words !== null) {
      say(this._said, words);
      this._point();
      return;
    }
    this._top = null;
    this._dialog.close();
    document.getElementById("scene")?.scrollIntoView({ block: "nearest" });
  }

  _closed() {
    kept.set("guided", "yes");
    if (this._top !== null) window.scrollTo({ top: this._top }); // back to where the visitor was
  }
}
