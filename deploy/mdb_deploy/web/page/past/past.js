// Past runs: the list, one of them on a time line, what can be downloaded, and a link to a moment.

import { button, el, press, say, show, svg, toggle } from "../teach/dom.js";
import { Archive } from "./archive.js";
import { TimeLine } from "./timeline.js";

/** Iterations shown in a second while it plays. */
const SPEEDS = [1, 2, 5, 10, 25];
/** A browser lets a page change its address so often only. */
const ADDRESS_MS = 400;
const KINDS = [
  ["Log", /\.mcap$/],
  ["Tables", /\.(csv|parquet)$/],
  ["Figures", /\.(png|svg|pdf)$/],
  ["Other files", /./],
];

/** The run and the moment in the address: {run, at}, or null. */
export function moment(hash = window.location.hash) {
  const said = new URLSearchParams(hash.replace(/^#/, ""));
  const run = said.get("run");
  const at = Number(said.get("at"));
  return run ? { run, at: Number.isInteger(at) && at >= 0 ? at : 0 } : null;
}

/** The address of a moment. The other words of the address stay. */
export function addressOf(run, at) {
  const said = new URLSearchParams(window.location.hash.replace(/^#/, ""));
  if (run === null) {
    said.delete("run");
    said.delete("at");
  } else {
    said.set("run", run);
    said.set("at", String(at));
  }
  const words = said.toString();
  return `${window.location.pathname}${window.location.search}${words ? `#${words}` : ""}`;
}

export function start(root, page) {
  new Past(root, page);
}

/** A size in words. */
function sized(bytes) {
  if (!Number.isFinite(bytes)) return "";
  if (bytes < 1000) return `${bytes} bytes`;
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

class Past {
  constructor(root, page) {
    this._page = page;
    this._archive = new Archive();
    this._name = null;
    this._build(root);
    page.openPast = (name) => this._enter(name, null);
    page.on("mode", (mode) => mode === "live" && this._name !== null && this._closed());
    for (const part of ["finished", "hello"]) page.on(part, () => page.state.mode === "live" && this._list());
    window.addEventListener("popstate", () => this._follow());
    this._list();
    this._follow();
  }

  _build(root) {
    this._runs = el("ul", { class: "runs" });
    this._none = el("p", { class: "plain" });
    this._said = el("p", { class: "failed", role: "status" });
    const list = el("div", { class: "past-list" },
      el("div", { class: "head" }, el("h2", { id: "past-title" }, "Past runs"),
        button("Look again", () => this._list(), { class: "aside", id: "runs-again", title: "Look for runs again" }),
        el("p", { class: "plain" }, "Open a run to see any moment of it. All panels show that moment.")),
      this._runs, this._none);

    this._heading = el("h3", { id: "past-run" });
    this._line = new TimeLine(el("div"), (iteration) => { this._stop(); this._go(iteration); });
    this._key = el("p", { class: "key time-key" });
    this._where = el("output", { class: "where" });
    this._play = toggle("Play", () => (this._timer ? this._stop() : this._start()), { id: "past-play" });
    this._speed = el("select", { id: "past-speed", "aria-label": "Pace of playing" },
      ...SPEEDS.map((speed) => el("option", { value: speed, selected: speed === 5 }, `${speed} a second`)));
    const step = (path, label, by) => button(svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true", class: "step-sign" }, svg("path", { d: path })),
      () => { this._stop(); by(); }, { "aria-label": label, title: label, class: "square" });
    this._link = button("Copy link to this moment", () => this._copy(), { id: "past-link" });
    this._files = el("div", { class: "files" });
    // At the bottom of the window, so that what a moment shows is in sight while it is moved.
    this._open = el("div", { class: "past-open", role: "group", "aria-labelledby": "past-run", hidden: true },
      this._line.root,
      el("div", { class: "buttons past-buttons" },
        step("M6 5v14M19 5L9 12l10 7z", "Phase before", () => this._phase(-1)),
        step("M16 5L7 12l9 7z", "One iteration back", () => this._go(this._at - 1)),
        this._play,
        step("M8 5l9 7-9 7z", "One iteration on", () => this._go(this._at + 1)),
        step("M18 5v14M5 5l10 7-10 7z", "Next phase", () => this._phase(1)),
        this._speed, this._where, this._key, this._link,
        button("Close", () => this._leave(), { class: "primary", id: "past-close", title: "Close this run and show what is now" })));
    this._about = el("div", { class: "past-about", hidden: true }, this._heading, this._files);
    root.append(list, this._said, this._about, this._open);
  }

  // ---- the list

  async _list() {
    try {
      const runs = await this._archive.runs();
      this._runs.replaceChildren(...runs.map((run) => {
        const made = button([el("strong", {}, run.name), el("span", { class: "plain" }, this._goesOn(run.name) ? "runs now; what was so far" : run.words)],
          () => this._enter(run.name, null), { class: "run", "data-run": run.name });
        press(made, run.name === this._name);
        return el("li", {}, made);
      }));
      say(this._none, runs.length ? "" : "There are no past runs yet. A run that has ended is listed here.");
    } catch (error) {
      say(this._none, error.message);
    }
  }

  /** Whether a run is the one that goes on now. */
  _goesOn(name) {
    const { hello, finished, mode } = this._page.state;
    return mode === "live" && Boolean(hello?.live) && hello.run === name && !finished;
  }

  /** Open what the address says. */
  _follow() {
    const said = moment();
    if (said === null) {
      if (this._name !== null) this._page.showLive();
    } else if (said.run !== this._name) {
      this._enter(said.run, said.at, { fromAddress: true });
    } else if (said.at !== this._at) {
      this._go(said.at);
    }
  }

  /** Open a run at a moment; without one at its end. */
  async _enter(name, at, { fromAddress = false } = {}) {
    this._stop();
    const asked = (this._asked = Symbol(name));
    say(this._said, `${name} is being read…`);
    try {
      const { hello, rows } = await this._archive.open(name);
      if (asked !== this._asked) return;
      if (!rows.iteration?.length) throw new Error(`The run ${name} has no iteration to show.`);
      const end = await this._archive.at(name, rows.iteration.at(-1));
      if (asked !== this._asked) return;
      this._name = name;
      this._hello = hello;
      this._shown = null;
      say(this._said, "");
      this._page.showPast({ hello, rows: { from: rows.iteration[0], ...rows } });
      this._line.run(hello, rows, end.control?.ended ?? []);
      say(this._heading, `${name}: ${hello.experiment?.name ?? "a run"}, ${rows.iteration.length} iterations`);
      this._keyOf(hello);
      this._showFiles(name);
      show(this._open, true);
      this._open.append(this._said); // what goes wrong is told where one looks
      show(this._about, true);
      for (const made of this._runs.querySelectorAll("button")) press(made, made.dataset.run === name);
      this._go(at ?? this._line.last, { push: !fromAddress });
      window.scrollTo({ top: 0 });
      if (!fromAddress) this._line.root.focus({ preventScroll: true });
    } catch (error) {
      if (asked !== this._asked) return;
      say(this._said, error.message);
    }
  }

  _leave() {
    this._page.showLive();
  }

  /** What is now is shown again. */
  _closed() {
    this._stop();
    this._name = null;
    show(this._open, false);
    show(this._about, false);
    this._about.before(this._said);
    for (const made of this._runs.querySelectorAll("button")) press(made, false);
    clearTimeout(this._addressTimer);
    this._addressTimer = 0;
    if (moment() !== null) window.history.pushState(null, "", addressOf(null));
  }

  // ---- one run

  _keyOf(hello) {
    const colours = this._line.teachers().map(({ name, colour }) => {
      const swatch = el("i", { class: "swatch" });
      swatch.style.background = `var(--${colour})`;
      return el("span", {}, swatch, `it obeys ${name}`);
    });
    const success = el("i", { class: "swatch thin" });
    success.style.background = "var(--green)";
    this._key.replaceChildren(...colours, el("span", {}, success, hello.successes?.join(", ") || "success"));
  }

  /** Show a moment. While one is fetched only the newest wish is kept. */
  _go(iteration, { push = false } = {}) {
    if (this._name === null) return;
    this._at = Math.max(this._line.first, Math.min(this._line.last, iteration));
    this._line.show(this._at);
    say(this._where, `iteration ${this._at} of ${this._line.last}`);
    this._writeAddress(push);
    this._fetch();
  }

  async _fetch() {
    if (this._fetching) return;
    this._fetching = true;
    try {
      while (this._name !== null && this._shown !== `${this._name} ${this._at}`) {
        const [name, at] = [this._name, this._at];
        const parts = await this._archive.at(name, at);
        if (name !== this._name) continue;
        this._shown = `${name} ${at}`;
        this._page.showPast({ ...parts, moment: at });
        if (at !== this._at) continue; // it is moved on: its picture is not waited for
        const picture = await this._archive.picture(name, at);
        if (name === this._name) this._page.showPast({ picture });
        say(this._said, picture.missing ?? "");
      }
    } catch (error) {
      this._stop();
      say(this._said, error.message);
    } finally {
      this._fetching = false;
    }
  }

  _phase(by) {
    const marks = this._line.marks();
    const to = by > 0 ? marks.find((mark) => mark > this._at) ?? this._line.last : marks.findLast((mark) => mark < this._at) ?? this._line.first;
    this._go(to);
  }

  _start() {
    if (this._at >= this._line.last) this._go(this._line.first);
    const beat = () => {
      if (!this._fetching) this._go(this._at + 1); // one that is slow to come is waited for
      if (this._at >= this._line.last) this._stop();
      else if (this._timer) this._timer = setTimeout(beat, 1000 / Number(this._speed.value));
    };
    this._timer = setTimeout(beat, 0);
    press(this._play, true);
    say(this._play, "Stop");
  }

  _stop() {
    clearTimeout(this._timer);
    this._timer = 0;
    press(this._play, false);
    say(this._play, "Play");
  }

  // ---- address and files

  _writeAddress(push) {
    const write = () => {
      this._addressTimer = 0;
      if (this._name !== null) window.history.replaceState(null, "", addressOf(this._name, this._at));
    };
    if (push) window.history.pushState(null, "", addressOf(this._name, this._at));
    else this._addressTimer ||= setTimeout(write, ADDRESS_MS);
  }

  async _copy() {
    const link = new URL(addressOf(this._name, this._at), window.location.href);
    link.searchParams.delete("token"); // a link is given to others, and the token is one's own
    try {
      await navigator.clipboard.writeText(link.href);
      say(this._link, "Copied");
      setTimeout(() => say(this._link, "Copy link to this moment"), 1500);
    } catch {
      say(this._said, `The browser does not let the page copy. The link: ${link.href}`);
    }
  }

  async _showFiles(name) {
    this._files.replaceChildren();
    let files;
    try {
      files = await this._archive.files(name);
    } catch (error) {
      say(this._said, error.message);
      return;
    }
    if (name !== this._name) return;
    let left = files;
    for (const [kind, pattern] of KINDS) {
      const some = left.filter((file) => pattern.test(file.path));
      left = left.filter((file) => !pattern.test(file.path));
      if (!some.length) continue;
      const items = some.map((file) => el("li", {},
        el("a", { href: this._archive.address(name, file.path), download: file.path.split("/").at(-1) }, file.path),
        el("span", { class: "plain" }, ` ${sized(file.bytes)}`)));
      this._files.append(el("details", { open: kind === "Log" || kind === "Figures" },
        el("summary", {}, `${kind} (${some.length})`), el("ul", {}, ...items)));
    }
  }
}
