// Starts every panel of the page. A panel that fails says so in its place; the others go on.

import * as store from "./state.js";

/** What a panel gets: the state, and how to read and to change it. */
const page = { ...store };

const PANELS = {
  top: "./watch/badge.js",
  scene: "./watch/scene.js",
  choosing: "./watch/choosing.js",
  believes: "./watch/believes.js",
  induced: "./watch/induced.js",
  curves: "./watch/curves.js",
  networks: "./watch/networks.js",
  memory: "./watch/memory.js",
  teach: "./teach/teach.js",
  try: "./teach/try.js",
  guide: "./teach/guide.js",
  past: "./past/past.js",
};

async function start(id, path) {
  const root = document.getElementById(id);
  try {
    const panel = await import(path);
    await panel.start(root, page);
  } catch (error) {
    console.error(`The panel ${id} did not start:`, error);
    const words = document.createElement("p");
    words.className = "failed";
    words.textContent = `This part of the page did not start: ${error.message}`;
    root.append(words);
  }
}

await Promise.all(Object.entries(PANELS).map(([id, path]) => start(id, path)));
page.connect();
document.documentElement.dataset.ready = "yes";
