// The quantities of a circle while it is measured, from deviations at its dwells: what ISO 230-4 calls circular deviation G, mean
// radial deviation D and radial deviation F. The circular test after the run has them with their uncertainty.

/** @typedef {{ angle_deg: number, deviation_mm: number, clockwise: boolean }} Deviation */

/** A smaller arc does not determine its centre, degrees; the circular test has the same limit by its condition number. */
const MIN_ARC_DEG = 120;
/** F is about the fitted centre where no larger part of the circle is missing, degrees. */
const MAX_GAP_DEG = 60;
const MIN_POINTS = 5;

/** The largest gap between neighbouring angles, degrees. @param {number[]} angles */
export function largestGap(angles) {
  const sorted = angles.map((angle) => ((angle % 360) + 360) % 360).sort((a, b) => a - b);
  const gaps = sorted.map((angle, at) => (at ? angle - sorted[at - 1] : angle + 360 - sorted[sorted.length - 1]));
  return Math.max(0, ...gaps);
}

/**
 * Least squares of deviation = mean + x cos(angle) + y sin(angle): the circle about the ball as its lengths show it. The
 * deviations are small against the radius. Null where the arc is too short.
 * @param {Deviation[]} points
 * @returns {{ mean: number, x: number, y: number } | null}
 */
export function fitCircle(points) {
  if (points.length < MIN_POINTS || 360 - largestGap(points.map((point) => point.angle_deg)) < MIN_ARC_DEG) return null;
  // Normal equations with the right side as the fourth column.
  const rows = [0, 1, 2].map(() => [0, 0, 0, 0]);
  for (const { angle_deg, deviation_mm } of points) {
    const turn = (angle_deg * Math.PI) / 180;
    const design = [1, Math.cos(turn), Math.sin(turn), deviation_mm];
    for (let i = 0; i < 3; i++) for (let j = 0; j < 4; j++) rows[i][j] += design[i] * design[j];
  }
  for (let i = 0; i < 3; i++) {
    for (let k = 0; k < 3; k++) {
      if (k === i) continue;
      const factor = rows[k][i] / rows[i][i];
      for (let j = 0; j < 4; j++) rows[k][j] -= factor * rows[i][j];
    }
  }
  const [mean, x, y] = rows.map((row, i) => row[3] / row[i]);
  return { mean, x, y };
}

/** @param {Deviation} point @param {{ x: number, y: number }} centre */
const about = (point, { x, y }) => point.deviation_mm - x * Math.cos((point.angle_deg * Math.PI) / 180) - y * Math.sin((point.angle_deg * Math.PI) / 180);

/**
 * The quantities so far, mm; null where they are not defined yet. G: the largest of the traces, each about its own centre. D: the
 * mean of the traces. F: about the centre of all points on a full circle, else about the programmed one.
 * @param {Deviation[]} points
 * @returns {{ G: number | null, D: number | null, F_max: number | null, F_min: number | null }}
 */
export function quantities(points) {
  const traces = [true, false].map((clockwise) => points.filter((point) => point.clockwise === clockwise));
  const fitted = traces.flatMap((trace) => {
    const circle = fitCircle(trace);
    if (!circle) return [];
    const around = trace.map((point) => about(point, circle));
    return [{ mean: circle.mean, G: Math.max(...around) - Math.min(...around) }];
  });
  const whole = largestGap(points.map((point) => point.angle_deg)) <= MAX_GAP_DEG ? fitCircle(points) : null;
  const radial = points.map((point) => (whole ? about(point, whole) : point.deviation_mm));
  return {
    G: fitted.length ? Math.max(...fitted.map((one) => one.G)) : null,
    D: fitted.length ? fitted.reduce((sum, one) => sum + one.mean, 0) / fitted.length : null,
    F_max: radial.length ? Math.max(...radial) : null,
    F_min: radial.length ? Math.min(...radial) : null,
  };
}
