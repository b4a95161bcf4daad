// What it believes: the feedback that it predicts for every note and every action, filling while it learns.

import { divergingText, el, head, kept, painter, say, show, signed, withoutCommon } from "../draw.js";

/** The square in a cell is at least so large, however little supports it. */
const SMALLEST = 0.3;

export function start(root, { state, on }) {
  const box = el("input", { type: "checkbox", id: "show-meanings" });
  box.checked = kept.get("meanings") === "yes";
  head(
    root,
    "What it believes the notes mean",
    "Each cell is the feedback that it predicts for an action after a note. A full cell is well known, a small one " +
      "is a guess.",
    el("label", { class: "check" }, box, "Show what the notes mean"),
  );
  const empty = el("p", { class: "empty" });
  const body = el("tbody");
  const heads = el("thead");
  const table = el(
    "table",
    { class: "beliefs", id: "beliefs", "aria-label": "Predicted feedback for each note and action" },
    heads,
    body,
  );
  const told = el("p", { class: "tell", id: "belief" });
  const yours = el("li", {}, el("i", { class: "outlined" }), el("span", {}, "what you mean"));
  const theirs = el("li", {}, el("i", { class: "outlined dashed" }), el("span", {}));
  const key = el("ul", { class: "key" }, el("li", {}, "bad", el("i", { class: "ramp" }), "good"), yours, theirs);
  const scroll = el("div", { class: "scroll" }, table);
  root.append(empty, scroll, told, key);

  let shape = "";
  let cells = [];
  let focus = [0, 0];
  let pointed = null;

  const build = (beliefs) => {
    const { middles, around } = shortened(beliefs.actions);
    heads.replaceChildren(
      el("tr", {}, el("td", {}, around), ...middles.map((name) => el("th", { scope: "col" }, name))),
    );
    cells = beliefs.notes.map((note, i) =>
      beliefs.actions.map((_, j) => {
        const square = el("i");
        const number = el("span");
        const cell = el(
          "td",
          {
            tabindex: i === 0 && j === 0 ? "0" : "-1",
            mouseenter: () => point([i, j]),
            mouseleave: () => point(null),
            focus: () => point([i, j]),
            blur: () => point(null),
          },
          square,
          number,
        );
        return { cell, square, number };
      }),
    );
    focus = [0, 0];
    table.dataset.many = beliefs.actions.length > 10 ? "yes" : "no";
    body.replaceChildren(
      ...beliefs.notes.map((note, i) =>
        el("tr", {}, el("th", { scope: "row" }, noteName(note)), ...cells[i].map((one) => one.cell)),
      ),
    );
  };
  const point = (place) => {
    pointed = place;
    touch();
  };
  body.addEventListener("keydown", (event) => {
    const moves = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
    const move = moves[event.key];
    if (move === undefined || cells.length === 0) return;
    event.preventDefault();
    cells[focus[0]][focus[1]].cell.tabIndex = -1;
    const inside = (value, most) => Math.max(0, Math.min(most - 1, value));
    focus = [inside(focus[0] + move[0], cells.length), inside(focus[1] + move[1], cells[0].length)];
    const next = cells[focus[0]][focus[1]].cell;
    next.tabIndex = 0;
    next.focus();
  });
  body.addEventListener("focusin", (event) => {
    const i = cells.findIndex((line) => line.some((one) => one.cell === event.target));
    if (i < 0) return;
    cells[focus[0]][focus[1]].cell.tabIndex = -1;
    focus = [i, cells[i].findIndex((one) => one.cell === event.target)];
    event.target.tabIndex = 0;
  });

  const paint = () => {
    const { beliefs, hello } = state;
    const none = !beliefs || beliefs.notes.length === 0 || beliefs.actions.length === 0;
    show(empty, none);
    for (const part of [scroll, told, key]) show(part, !none);
    if (none) {
      say(
        empty,
        hello && hello.notes === 0
          ? "This machine hears no notes: its teacher only judges."
          : "Nothing was learnt about the notes yet.",
      );
      return;
    }
    const now = JSON.stringify([beliefs.notes, beliefs.actions]);
    if (now !== shape) {
      shape = now;
      build(beliefs);
    }
    const most = Math.max(1, ...beliefs.feedback.flat().map((value) => Math.abs(value ?? 0)));
    const [mine, other] = box.checked ? meanings(state) : [null, null];
    for (const [i, note] of beliefs.notes.entries()) {
      const row = body.children[i];
      row.dataset.now = state.thought?.note === note ? "yes" : "no";
      for (const [j, name] of beliefs.actions.entries()) {
        const { cell, square, number } = cells[i][j];
        const value = beliefs.feedback[i][j];
        const support = Math.max(0, Math.min(1, beliefs.support?.[i]?.[j] ?? 1));
        square.style.backgroundColor = divergingText((value ?? 0) / most);
        square.style.transform = `scale(${(SMALLEST + (1 - SMALLEST) * support).toFixed(2)})`;
        say(number, signed(value, 2));
        mark(cell, "yours", mine?.get(note) === name);
        mark(cell, "theirs", other !== null && other.map.get(note) === name);
        mark(cell, "told", pointed !== null && pointed[0] === i && pointed[1] === j);
      }
    }
    show(yours, mine !== null);
    show(theirs, other !== null);
    if (other !== null) say(theirs.lastChild, `what ${other.name} means`);
    if (pointed !== null && cells[pointed[0]]?.[pointed[1]]) {
      const [i, j] = pointed;
      const support = Math.round(100 * (beliefs.support?.[i]?.[j] ?? 1));
      const value = signed(beliefs.feedback[i][j]);
      const what = `After ${noteName(beliefs.notes[i])}, “${beliefs.actions[j]}”`;
      say(told, `${what}: predicted feedback ${value}, known to ${support} %.`);
    } else {
      say(told, "Point at a cell, or go there with Tab and the arrow keys, to read its number.");
    }
  };
  const touch = painter(root, paint, 100);
  box.addEventListener("change", () => {
    kept.set("meanings", box.checked ? "yes" : "no");
    touch();
  });
  for (const part of ["beliefs", "teachers", "you", "hello"]) on(part, touch);
  on("thought", touch);
}

/** Names without the words that all of them begin or end with, which are told once: {middles, around}. */
function shortened(names) {
  const points = names.map((name) => name.split(", ").map((part) => /^(\S+) ([+-]?[\d.]+)( \S+)?$/.exec(part)));
  if (points.length > 1 && points[0].length > 1 && points.every((one) => one.every(Boolean))) return moved(points);
  const words = names.map((name) => name.split(" "));
  const fewest = Math.min(...words.map((one) => one.length));
  const alike = (place) => words.every((one) => one.at(place) === words[0].at(place));
  let first = 0;
  while (names.length > 1 && first < fewest - 1 && alike(first)) first += 1;
  let last = 0;
  while (names.length > 1 && last < fewest - 1 - first && alike(-1 - last)) last += 1;
  return {
    middles: words.map((one) =>
      one
        .slice(first, one.length - last)
        .join(" ")
        .replace("-", "\u2212"),
    ),
    around: [...words[0].slice(0, first), ...(last > 0 ? [`(${words[0].slice(-last).join(" ")})`] : [])].join(" "),
  };
}

/** Names of points of ranges: what is not 0 alone. `points`: of each point its parts, [, name, value, unit]. */
function moved(points) {
  const places = withoutCommon(points[0].map(([, name]) => name));
  const middles = points.map((parts) => {
    const told = parts.map(([, , value], i) => (Number(value) === 0 ? "" : `${places[i]} ${signed(Number(value))}`));
    return told.filter(Boolean).join(" ") || "all 0";
  });
  const units = [...new Set(points[0].map(([, , , unit]) => unit?.trim()).filter(Boolean))];
  return { middles, around: units.length > 0 ? `(${units.join(", ")})` : "" };
}

function mark(cell, name, is) {
  if (is) cell.dataset[name] = "yes";
  else delete cell.dataset[name];
}

function noteName(note) {
  return `note ${note}`;
}

/**
 * What the notes mean: a map from note to the action's name, for the visitor and for the teacher who is obeyed (with
 * the name). null where there is no such language.
 */
function meanings({ hello, you, teachers, beliefs, phase }) {
  const commands = hello?.commands?.length > 0 ? hello.commands : beliefs.actions;
  const map = (language) => new Map(language.map((note, i) => [note, commands[i]]));
  const mine = you?.name && you.language ? map(you.language) : null;
  const obeyed = teachers?.find((one) => one.obeyed)?.name ?? phase?.teacher ?? null;
  const spoken = teachers?.find((one) => one.name === obeyed)?.notes ?? hello?.languages?.[obeyed] ?? null;
  const other = obeyed !== null && spoken && obeyed !== you?.name ? { name: obeyed, map: map(spoken) } : null;
  return [mine, other];
}
