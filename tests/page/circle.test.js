// node --test tests/page
import assert from "node:assert/strict";
import { test } from "node:test";

import { fitCircle, largestGap, quantities } from "../../src/live/page/circle.js";

const around = (count, deviation, clockwise = false, arc = 360) =>
  Array.from({ length: count }, (_, at) => {
    const angle_deg = (arc * at) / count;
    return { angle_deg, clockwise, deviation_mm: deviation((angle_deg * Math.PI) / 180) };
  });
const near = (value, wanted) => assert.ok(Math.abs(value - wanted) < 1e-9, `${value} is not ${wanted}`);

test("the centre of a circle is no circular deviation", () => {
  const points = around(36, (turn) => 0.02 + 0.3 * Math.cos(turn) - 0.1 * Math.sin(turn));
  const { mean, x, y } = fitCircle(points);
  near(mean, 0.02);
  near(x, 0.3);
  near(y, -0.1);
  const found = quantities(points);
  near(found.G, 0);
  near(found.D, 0.02);
  near(found.F_max, 0.02);
  near(found.F_min, 0.02);
});

test("an ellipse has the circular deviation of its second harmonic", () => {
  // cos(2 angle) reaches 1 and -1 at multiples of 10 degrees.
  const found = quantities(around(36, (turn) => 0.01 * Math.cos(2 * turn)));
  near(found.G, 0.02);
  near(found.D, 0);
  near(found.F_max, 0.01);
  near(found.F_min, -0.01);
});

test("each sense has a mean and a centre of its own", () => {
  const both = [...around(36, (turn) => 0.03 + 0.2 * Math.cos(turn)), ...around(36, () => -0.01, true)];
  const found = quantities(both);
  near(found.G, 0);
  near(found.D, 0.01);
});

test("a short arc has no centre", () => {
  assert.equal(fitCircle(around(20, () => 0, false, 90)), null);
  const found = quantities(around(20, () => 0.05, false, 90));
  assert.deepEqual(found, { G: null, D: null, F_max: 0.05, F_min: 0.05 });
  assert.deepEqual(quantities([]), { G: null, D: null, F_max: null, F_min: null });
});

test("the gap is counted over the zero of the angle", () => {
  near(largestGap([350, 10, 180]), 170);
  near(largestGap([-10, 10, 180]), 170);
});
