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
  if (!answer.ok) {
    throw new Error(text && text.length < 600 && !text.startsWith("<") ? text : `The console answered ${answer.status}.`);
  }
  return JSON.parse(text);
}

export class Archive {
  constructor() {
    this._moments = new Map();
  }

  /** All past runs, the newest first: [{name, words}]. */
  async runs() {
    return (await get("/runs")).map((run) => ({ name: run.name, words: this._words(run) }));
  }

  _words(run) {
    const when = new Date(run.when * 1000).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
    return [run.experiment, run.iterations ? `${run.iterations} iterations` : "", when].filter(Boolean).join(" · ");
  }

  /** What never changes of a run: {hello, rows}. */
  async open(name) {
    this._moments.clear();
    const [hello, rows] = await Promise.all([get(this._path(name, "hello")), get(this._path(name, "rows"))]);
    return { hello, rows };
  }

  /** All parts at a moment but the picture. */
  at(name, iteration) {
    return this._kept(this._path(name, "at", iteration));
  }

  /** The picture of a moment. It takes longer: the robot's episode is done again. */
  picture(name, iteration) {
    return this._kept(this._path(name, "picture", iteration));
  }

  async _kept(path) {
    let parts = this._moments.get(path);
    if (parts === undefined) {
      parts = await get(path);
      this._moments.set(path, parts);
      if (this._moments.size > KEPT) this._moments.delete(this._moments.keys().next().value);
    }
    return parts;
  }

  /** What can be downloaded: [{path, bytes}]. */
  files(name) {
    return get(this._path(name, "files"));
  }

  /** The address of a file. */
  address(name, path) {
    return this._path(name, "files", ...path.split("/"));
  }

  _path(name, ...rest) {
    return ["/runs", name, ...rest].map((part, place) => (place === 0 ? part : encodeURIComponent(part))).join("/");
  }
}
