// Pure: which part of a drawing is seen, and shapes between two drawings.

/** A window is so much larger than the next smaller one: few sizes, so that the picture seldom jumps. */
const STEP = Math.SQRT2;
/** A window that shows so much more than it must becomes smaller. */
const FAR_TOO_WIDE = 2;

/**
 * The window for a drawing, {x, y, span}: the same as long as all that must be seen is in it and it is not far too
 * wide.
 * `span` is what is seen along the shorter side; aspect: width by height of where it is drawn.
 */
export function follow(window, drawing, aspect) {
  const [left, low, right, high] = drawing.box;
  const [across, up] = [Math.max(1, aspect), Math.max(1, 1 / aspect)];
  const needed = Math.max((right - left) / across, (high - low) / up);
  if (window !== null && window.span <= FAR_TOO_WIDE * needed) {
    const inX = Math.max(right - window.x, window.x - left) <= (window.span * across) / 2;
    const inY = Math.max(high - window.y, window.y - low) <= (window.span * up) / 2;
    if (inX && inY) return window;
  }
  const steps = Math.ceil(Math.log(needed) / Math.log(STEP) - 1e-9);
  return { x: (left + right) / 2, y: (low + high) / 2, span: STEP ** steps };
}

/** The window at `share` (0 to 1) of the way between two. */
export function windowBetween(from, to, share) {
  if (from === null || share >= 1) return to;
  return {
    x: mix(from.x, to.x, share),
    y: mix(from.y, to.y, share),
    span: Math.exp(mix(Math.log(from.span), Math.log(to.span), share)),
  };
}

/**
 * Match the shapes of a drawing with those of the one before: the same kind, the same `what`, the same place among
 * these, as many points. A line that got one more point (a trail) is matched as one whose last point moved on.
 * Returns for each new shape the one before it, or null.
 */
export function match(before, after) {
  const byKind = new Map();
  for (const shape of before) {
    const name = `${shape.kind} ${shape.what}`;
    if (!byKind.has(name)) byKind.set(name, []);
    byKind.get(name).push(shape);
  }
  const used = new Map();
  return after.map((shape) => {
    const name = `${shape.kind} ${shape.what}`;
    const place = used.get(name) ?? 0;
    used.set(name, place + 1);
    const old = byKind.get(name)?.[place];
    if (old === undefined) return null;
    const missing = shape.points.length - old.points.length;
    if (missing === 0) return old;
    if (missing === 1 && shape.kind === "line" && shape.what === "trail" && alike(old.points, shape.points)) {
      return { ...old, points: [...old.points, old.points.at(-1)] };
    }
    return null;
  });
}

/** A shape at `share` of the way from `old` (null: there was none) to `shape`. */
export function between(old, shape, share) {
  if (old === null || share >= 1) return shape;
  const turned =
    shape.kind === "line" && shape.points.length > 1 && (shape.what === "robot" || shape.what === "sensed");
  const points = turned
    ? chain(old.points, shape.points, share)
    : shape.points.map((point, i) => mixed(old.points[i], point, share));
  return { ...shape, points, radius: mix(old.radius ?? 0, shape.radius ?? 0, share) };
}

/** Whether the robot was put elsewhere: no way of its own leads there between two pictures. */
export function jumped(before, after, pairs) {
  const [left, low, right, high] = before.box;
  const span = Math.hypot(right - left, high - low);
  const trails = [before, after].map((one) =>
    one.shapes.filter((shape) => shape.what === "trail").reduce((n, s) => n + s.points.length, 0),
  );
  if (trails[1] < trails[0] && trails[0] - trails[1] > 1) return true;
  return after.shapes.some(
    (shape, i) =>
      shape.what === "robot" && pairs[i] !== null && distance(pairs[i].points[0], shape.points[0]) > 0.6 * span,
  );
}

// The first point moves straight, each further one is turned about the one before it and so keeps its length: a line
// that says where the front is does not shrink while the robot turns, nor do the links of an arm.
function chain(from, to, share) {
  const points = [mixed(from[0], to[0], share)];
  for (let i = 1; i < to.length; i++) {
    const was = [from[i][0] - from[i - 1][0], from[i][1] - from[i - 1][1]];
    const is = [to[i][0] - to[i - 1][0], to[i][1] - to[i - 1][1]];
    const angle = Math.atan2(was[1], was[0]);
    const turn = Math.atan2(Math.sin(Math.atan2(is[1], is[0]) - angle), Math.cos(Math.atan2(is[1], is[0]) - angle));
    const length = mix(Math.hypot(...was), Math.hypot(...is), share);
    points.push([
      points[i - 1][0] + length * Math.cos(angle + share * turn),
      points[i - 1][1] + length * Math.sin(angle + share * turn),
    ]);
  }
  return points;
}

function alike(old, news) {
  return old.length > 0 && old.every((point, i) => distance(point, news[i]) < 1e-9);
}

function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
}

function mixed(a, b, share) {
  return [mix(a[0], b[0], share), mix(a[1], b[1], share)];
}

function mix(a, b, share) {
  return a + (b - a) * share;
}
