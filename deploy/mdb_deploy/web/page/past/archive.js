// What the server tells of past runs, fetched. A moment that was fetched is kept for a while.

const KEPT = 200;
/** A run that was never looked at is read first, which takes its time. */
const WAIT_MS = 60000;

/** Fetch JSON. Throws an Error in plain words. */
async function get(path) {
  let answer;
  try {
    answer = await fetch(path, { signal: AbortSignal.timeout(WAIT_MS) });
  } catch (error) {
    throw new Error(error.name === "TimeoutError" ? "The console did not answer within a minute." : "There is no connection to the console.");
  }
  const text = await answer.text();
  let said;
  try {
    said = JSON.parse(text);
  } catch {
    said = text;
  }
  if (!answer.ok) {
    const words = typeof said === "string" ? said : said?.words ?? said?.error;
    throw new Error(words && words.length < 500 ? words : `The console answered ${answer.status}.`);
  }
  return said;
}

export class Archive {
  constructor() {
    this._moments = new Map();
  }

  /** All past runs, the newest first: [{name, words}]. */
  async runs() {
    const said = await get("/runs");
    const runs = Array.isArray(said) ? said : said.runs ?? [];
    return runs.map((run) => (typeof run === "string" ? { name: run, words: "" } : { name: run.name, words: this._words(run) }));
  }

  _words(run) {
    const when = run.when ?? run.changed ?? run.modified;
    return [
      typeof run.experiment === "string" ? run.experiment : run.experiment?.name,
      run.iterations ? `${run.iterations} iterations` : null,
      typeof when === "number" ? new Date(when * 1000).toLocaleString([], { dateStyle: "medium", timeStyle: "short" }) : when,
      run.live ? "runs now" : null,
      run.trouble ?? null,
    ].filter(Boolean).join(" · ");
  }

  /** What never changes of a run: {hello, rows}. */
  async open(name) {
    this._moments.clear();
    const [hello, rows] = await Promise.all([get(this._path(name, "hello")), get(this._path(name, "rows"))]);
    return { hello, rows: rows.rows ?? rows };
  }

  /** All parts at a moment. */
  async at(name, iteration) {
    const path = this._path(name, "at", iteration);
    let parts = this._moments.get(path);
    if (parts === undefined) {
      parts = await get(path);
      this._moments.set(path, parts);
      if (this._moments.size > KEPT) this._moments.delete(this._moments.keys().next().value);
    }
    return parts;
  }

  /** What can be downloaded: [{path, bytes}]. */
  async files(name) {
    const said = await get(this._path(name, "files"));
    return Array.isArray(said) ? said : said.files ?? [];
  }

  /** The address of a file. */
  address(name, path) {
    return this._path(name, "files", ...path.split("/"));
  }

  _path(name, ...rest) {
    return ["/runs", name, ...rest].map((part, place) => (place === 0 ? part : encodeURIComponent(part))).join("/");
  }
}
