// The induced model: the satisfaction that it predicts over its two inputs that vary most, as a picture.

import {
  canvasIn,
  colour,
  diverging,
  el,
  faint,
  head,
  named,
  painter,
  say,
  show,
  short,
  signed,
  teller,
  ticks,
} from "../draw.js";

const LEFT = 58;
const BOTTOM = 40;
const TOP = 8;
const RIGHT = 74;
const BAR = 12;

export function start(root, { state, on }) {
  head(
    root,
    "What it learnt to want",
    "The model that acts when nobody teaches: how satisfying it predicts a situation to be. Dots are what it was " +
      "taught.",
  );
  const empty = el("p", { class: "empty" }, "It has learnt no satisfaction model yet.");
  const box = el("div", { class: "drawn map", id: "induced-map" });
  const told = el("p", { class: "tell" });
  const tell = teller(box);
  tell("No picture yet.");
  root.append(empty, box, told);
  let pointed = null;
  const { context, fresh } = canvasIn(box, () => touch());
  const picture = document.createElement("canvas");
  let pictureOf = null;

  const paint = () => {
    const induced = state.induced;
    show(empty, !induced);
    show(box, Boolean(induced));
    show(told, Boolean(induced));
    if (!induced) return;
    const { width, height } = fresh();
    if (width === 0) return;
    const { x, y, z, points } = induced;
    const frame = {
      left: LEFT,
      top: TOP,
      width: Math.max(10, width - LEFT - RIGHT),
      height: Math.max(10, height - TOP - BOTTOM),
    };
    const most = Math.max(1, ...z.flat().map(Math.abs));
    if (pictureOf !== induced || picture.dataset.ink !== colour("sunk")) {
      pictureOf = induced;
      picture.dataset.ink = colour("sunk");
      heat(picture, z, most);
    }
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    context.drawImage(picture, frame.left, frame.top, frame.width, frame.height);
    const toX = (value) => frame.left + place(x, value) * frame.width;
    const toY = (value) => frame.top + frame.height - place(y, value) * frame.height;
    axes(context, frame, withUnit(x, state.hello), withUnit(y, state.hello), toX, toY);
    context.save();
    context.beginPath();
    context.rect(frame.left, frame.top, frame.width, frame.height);
    context.clip();
    for (const [px, py, feedback] of points ?? []) {
      context.beginPath();
      context.arc(toX(px), toY(py), 3.2, 0, 2 * Math.PI);
      context.fillStyle =
        feedback === null ? faint("muted", 0.6) : `rgb(${diverging(feedback / most, "panel").join(" ")})`;
      context.fill();
      context.lineWidth = 1;
      context.strokeStyle = faint("ink", 0.75);
      context.stroke();
    }
    context.restore();
    legend(context, width - RIGHT + 16, frame.top, frame.height, most);
    const fixed = Object.entries(induced.fixed ?? {})
      .map(([name, value]) => `${named(name)} = ${short(value)}`)
      .join(", ");
    const here = pointed === null ? null : at(induced, frame, pointed);
    const rest = fixed === "" ? "" : ` With ${fixed}.`;
    say(told, here === null ? `Blue: it wants this. Orange: it avoids this.${rest}` : here);
    tell(inWords(induced));
  };
  const touch = painter(box, paint, 200);
  box.addEventListener("pointermove", (event) => {
    const edge = box.getBoundingClientRect();
    pointed = [event.clientX - edge.left, event.clientY - edge.top];
    touch();
  });
  box.addEventListener("pointerleave", () => {
    pointed = null;
    touch();
  });
  on("induced", (induced) => {
    // What is hidden is never seen, and so never drawn: it is shown as soon as there is something.
    show(empty, !induced);
    show(box, Boolean(induced));
    touch();
  });
}

/** Where a value is along an axis, 0 to 1. The picture's columns are evenly spread, their values need not be. */
function place(axis, value) {
  const { values } = axis;
  const last = values.length - 1;
  const i = Math.max(
    0,
    Math.min(
      last - 1,
      values.findLastIndex((one) => one <= value),
    ),
  );
  return (i + (value - values[i]) / (values[i + 1] - values[i])) / last;
}

/** The value at a place along an axis. */
function valueAt(axis, share) {
  const at = share * (axis.values.length - 1);
  const i = Math.min(axis.values.length - 2, Math.floor(at));
  return axis.values[i] + (at - i) * (axis.values[i + 1] - axis.values[i]);
}

function heat(canvas, z, most) {
  const [rows, columns] = [z.length, z[0].length];
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const data = context.createImageData(columns, rows);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const [r, g, b] = diverging(z[row][column] / most);
      // The first row is the lowest y; on a canvas the first row is above.
      data.data.set([r, g, b, 255], 4 * ((rows - 1 - row) * columns + column));
    }
  }
  context.putImageData(data, 0, 0);
}

function axes(context, frame, x, y, toX, toY) {
  context.strokeStyle = colour("line");
  context.lineWidth = 1;
  context.setLineDash([]);
  context.strokeRect(frame.left, frame.top, frame.width, frame.height);
  context.fillStyle = colour("muted");
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of ticks(x.low, x.high, frame.width / 80))
    context.fillText(short(value), toX(value), frame.top + frame.height + 5);
  context.fillStyle = colour("ink");
  context.fillText(axisName(x), frame.left + frame.width / 2, frame.top + frame.height + 22);
  context.fillStyle = colour("muted");
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of ticks(y.low, y.high, frame.height / 50))
    context.fillText(short(value), frame.left - 7, toY(value));
  context.save();
  context.translate(12, frame.top + frame.height / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillStyle = colour("ink");
  context.fillText(axisName(y), 0, 0);
  context.restore();
}

function legend(context, left, top, height, most) {
  for (let i = 0; i < height; i++) {
    context.fillStyle = `rgb(${diverging(1 - (2 * i) / height).join(" ")})`;
    context.fillRect(left, top + i, BAR, 1.5);
  }
  context.strokeStyle = colour("line");
  context.strokeRect(left, top, BAR, height);
  context.fillStyle = colour("muted");
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const share of [1, 0, -1]) {
    context.fillText(
      share === 0 ? "0" : signed(share * most, 1),
      left + BAR + 5,
      top + ((1 - share) / 2) * height * 0.96 + 0.02 * height,
    );
  }
}

function axisName(axis) {
  return axis.unit ? `${named(axis.name)} (${axis.unit})` : named(axis.name);
}

/** An axis with the unit of its actuator, where it is one and the server names none. */
function withUnit(axis, hello) {
  const unit = axis.unit ?? hello?.actuators?.[axis.name.split(".").at(-1)]?.unit;
  return { ...axis, unit };
}

function at({ x, y, z }, frame, [px, py]) {
  const [u, v] = [(px - frame.left) / frame.width, 1 - (py - frame.top) / frame.height];
  if (u < 0 || u > 1 || v < 0 || v > 1) return null;
  const value =
    z[Math.min(z.length - 1, Math.floor(v * z.length))][Math.min(z[0].length - 1, Math.floor(u * z[0].length))];
  const there = `${named(x.name)} ${short(valueAt(x, u))}, ${named(y.name)} ${short(valueAt(y, v))}`;
  return `${there}: predicted satisfaction ${signed(value)}`;
}

function inWords({ x, y, z, points }) {
  let best = [0, 0];
  let worst = [0, 0];
  z.forEach((row, i) =>
    row.forEach((value, j) => {
      if (value > z[best[0]][best[1]]) best = [i, j];
      if (value < z[worst[0]][worst[1]]) worst = [i, j];
    }),
  );
  const where = ([i, j]) =>
    `${named(x.name)} ${short(x.values[j])} and ${named(y.name)} ${short(y.values[i])}, ${signed(z[i][j])}`;
  const over = `Predicted satisfaction over ${named(x.name)} and ${named(y.name)}`;
  return `${over}, from ${points?.length ?? 0} pairs. Best at ${where(best)}. Worst at ${where(worst)}.`;
}
