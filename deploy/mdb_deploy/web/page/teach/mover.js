// Moves the object: with the mouse or a finger in the scene, or by buttons.

import { button, el, press, say, show, toggle } from "./dom.js";

/** A mouse this near to the object, in metres, takes it. */
const NEAR_M = 0.35;
/** The buttons put the object so far from the robot. */
const AWAY_M = 1.0;
const SIDES = [["In front", 0], ["Left", 90], ["Right", -90], ["Behind", 180]];

export class Mover {
  /** `onMove(settings)` is called with the new place. */
  constructor(page, onMove) {
    this._page = page;
    this._onMove = onMove;
    this._allowed = false;
    this._drags = false;
    this._scene = document.getElementById("scene");
    this._mark = el("div", { class: "drag-mark", "aria-hidden": "true", hidden: true });
    document.body.append(this._mark);
    this._touch = toggle("Move it by touch", () => this._arm(), { id: "move-object" });
    this._place = el("p", { class: "plain" });
    this.root = el("div", { class: "try-part" },
      el("h3", {}, "Move the object"),
      el("p", { class: "plain" }, "Drag it in the scene with the mouse. Or put it somewhere around the robot:"),
      el("div", { class: "buttons", role: "group", "aria-label": "Put the object" },
        ...SIDES.map(([words, degrees]) => button(words, () => this._put(degrees), { "data-put": words })), this._touch),
      this._place);
    this._scene.addEventListener("pointerdown", (event) => this._down(event));
    this._scene.addEventListener("pointermove", (event) => this._move(event));
    this._scene.addEventListener("pointerup", (event) => this._up(event));
    this._scene.addEventListener("pointercancel", () => this._drop());
    document.addEventListener("keydown", (event) => event.key === "Escape" && this._drags && this._drop());
  }

  /** Whether the object can be moved in this run, by this person. */
  allow(on) {
    this._allowed = on;
    show(this.root, on);
    if (!on) this._drop();
  }

  /** Renew what is told of the place. */
  show() {
    const now = this._now();
    if (now) say(this._place, `It is at x ${now.object_x_m.toFixed(1)} m, y ${now.object_y_m.toFixed(1)} m.`);
  }

  _now() {
    const now = this._page.state.scene?.now;
    return this._allowed && now && Number.isFinite(now.object_x_m) && Number.isFinite(now.object_y_m) ? now : null;
  }

  _arm() {
    this._armed = !this._armed;
    press(this._touch, this._armed);
    this._scene.classList.toggle("is-armed", this._armed);
  }

  _put(degrees) {
    const now = this._now();
    if (!now || !Number.isFinite(now.heading_rad)) return;
    const towards = now.heading_rad + (degrees * Math.PI) / 180;
    this._say(now.x_m + AWAY_M * Math.cos(towards), now.y_m + AWAY_M * Math.sin(towards));
  }

  _say(x, y) {
    this._onMove({ object_x_m: Number(x.toFixed(3)), object_y_m: Number(y.toFixed(3)) });
  }

  /** Where in the scene a pointer is: {x, y} in metres, or null. */
  _point(event) {
    return this._page.scenePoint?.(event) ?? null;
  }

  _near(event) {
    const now = this._now();
    const at = now && this._point(event);
    return Boolean(at) && Math.hypot(at.x - now.object_x_m, at.y - now.object_y_m) < NEAR_M;
  }

  _down(event) {
    if (event.button !== 0 || !this._now()) return;
    const takes = this._armed ? this._point(event) !== null : event.pointerType === "mouse" && this._near(event);
    if (!takes) return;
    event.preventDefault();
    this._drags = true;
    this._scene.setPointerCapture(event.pointerId);
    this._scene.classList.add("is-dragged");
    this._follow(event);
  }

  _move(event) {
    if (this._drags) this._follow(event);
    else if (event.pointerType === "mouse") this._scene.classList.toggle("is-near", this._near(event));
  }

  _follow(event) {
    show(this._mark, true);
    this._mark.style.left = `${event.clientX}px`;
    this._mark.style.top = `${event.clientY}px`;
  }

  _up(event) {
    if (!this._drags) return;
    const at = this._point(event);
    this._drop();
    if (at) this._say(at.x, at.y);
    if (this._armed) this._arm();
  }

  _drop() {
    this._drags = false;
    show(this._mark, false);
    this._scene.classList.remove("is-dragged", "is-near");
  }
}
