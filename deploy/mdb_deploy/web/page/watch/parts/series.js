// Pure: what the curves show, from the rows.

/**
 * The mean of the last `count` values that are there, at each place; null where none was for `gap` rows, or where
 * they are fewer than a quarter of `count`.
 */
export function runningMean(values, count, gap) {
  const held = [];
  const made = new Array(values.length).fill(null);
  let sum = 0;
  let since = Infinity;
  for (let i = 0; i < values.length; i++) {
    const value = values[i];
    since += 1;
    if (Number.isFinite(value)) {
      // After a long silence what was before is another time: the mean begins afresh.
      if (since > gap) {
        held.length = 0;
        sum = 0;
      }
      since = 0;
      held.push(value);
      sum += value;
      if (held.length > count) sum -= held[held.length - 1 - count];
    }
    if (since <= gap && held.length >= count / 4) made[i] = sum / Math.min(held.length, count);
  }
  return made;
}

/** How often something was in the last `count` rows; of the first rows, scaled up. */
export function perRows(values, count) {
  const made = new Array(values.length);
  let sum = 0;
  for (let i = 0; i < values.length; i++) {
    sum += values[i] ? 1 : 0;
    if (i >= count) sum -= values[i - count] ? 1 : 0;
    made[i] = i + 1 < count / 4 ? null : (sum * count) / Math.min(i + 1, count);
  }
  return made;
}

/** At most `most` of the places 0 to n - 1, evenly, the last one among them. */
export function places(n, most) {
  const step = Math.max(1, Math.ceil(n / most));
  const found = [];
  for (let i = (n - 1) % step; i < n; i += step) found.push(i);
  return found;
}

/** Spans of teachers: {from, to, teacher} in iterations, from the rows; then the phases that are still to come. */
export function spans(rows, phases, total) {
  const made = [];
  for (let i = 0; i < rows.iteration.length; i++) {
    const teacher = rows.teacher[i] ?? null;
    const last = made.at(-1);
    // A teacher who is silent for a moment has not left.
    if (last !== undefined && last.teacher === teacher) last.to = rows.iteration[i];
    else made.push({ from: rows.iteration[i], to: rows.iteration[i], teacher });
  }
  const long = [];
  for (const span of made) {
    const last = long.at(-1);
    const brief = span.to - span.from < 5;
    if (last !== undefined && (brief || last.teacher === span.teacher)) last.to = span.to;
    else {
      if (last !== undefined) last.to = span.from;
      long.push({ ...span });
    }
  }
  const end = long.at(-1)?.to ?? 0;
  for (const [i, phase] of phases.entries()) {
    const to = phases[i + 1]?.start ?? total;
    const last = long.at(-1);
    if (to <= end) continue;
    if (last !== undefined && last.teacher === (phase.teacher ?? null)) last.to = to;
    else long.push({ from: Math.max(end, phase.start), to, teacher: phase.teacher ?? null });
  }
  return long;
}
