// node --test tests/page
import assert from "node:assert/strict";
import { test } from "node:test";

import { changedKeys, freeId } from "../../src/live/page/job_changes.js";

const JOB = {
  robot: "kr60ha",
  bar: { length_mm: 300, stroke_mm: [-5, 5], serial: "B1" },
  centre: [{ id: 3, xyz_mm: [1300, 0, 800], serial: "K3" }, { id: 7, xyz_mm: [0, 1300, 800] }],
  circle: [{ centre: 7, plane: "XY", points: 40 }],
};
/** What the form has of an unchanged job: no key that it has no field for. */
const form = () => ({
  robot: "kr60ha",
  serial: null,
  bar: { length_mm: 300, stroke_mm: [-5, 5], serial: "B1", margin_mm: null },
  centre: [{ row: 0, id: 3, xyz_mm: [1300, 0, 800], taught_deg: null }, { row: 1, id: 7, xyz_mm: [0, 1300, 800], taught_deg: null }],
  circle: [{ row: 0, centre: 7, plane: "XY", points: 40, tilt_deg: null }],
});

test("nothing changed is nothing sent", () => {
  assert.deepEqual(changedKeys(JOB, form()), {});
});

test("only what was changed is sent, and what was emptied is removed", () => {
  const now = form();
  now.bar = { ...now.bar, length_mm: 300.01, stroke_mm: [-4, 5], serial: null };
  assert.deepEqual(changedKeys(JOB, now), { bar: { length_mm: 300.01, stroke_mm: [-4, 5], serial: null } });
});

test("a changed row keeps its index, and the others are listed", () => {
  const now = form();
  now.centre[1].xyz_mm = [0, 1301, 800];
  assert.deepEqual(changedKeys(JOB, now), { centre: [{ row: 0 }, { row: 1, xyz_mm: [0, 1301, 800] }] });
});

test("a removed row is not listed, and the others keep their index and id", () => {
  const now = form();
  now.centre.shift();
  assert.deepEqual(changedKeys(JOB, now), { centre: [{ row: 1 }] });
  assert.deepEqual(changedKeys(JOB, { ...form(), circle: [] }), { circle: [] });
});

test("a new row has all its keys", () => {
  const now = form();
  now.centre.push({ row: undefined, id: 1, xyz_mm: [1, 2, 3], taught_deg: null });
  assert.deepEqual(changedKeys(JOB, now), { centre: [{ row: 0 }, { row: 1 }, { id: 1, xyz_mm: [1, 2, 3] }] });
});

test("of a new robot all keys are sent", () => {
  const { centre, ...rest } = form();
  const rows = centre.map(({ row: _, ...keys }) => keys);
  const sent = changedKeys({}, { ...rest, centre: rows, circle: [] });
  assert.deepEqual(sent, {
    robot: "kr60ha",
    bar: JOB.bar,
    centre: [{ id: 3, xyz_mm: [1300, 0, 800] }, { id: 7, xyz_mm: [0, 1300, 800] }],
  });
});

test("a table that the file does not have is sent as far as it is filled", () => {
  assert.deepEqual(changedKeys(JOB, { tool: { ball_mm: [0, 0, 150], ball_u_mm: null } }), { tool: { ball_mm: [0, 0, 150] } });
  assert.deepEqual(changedKeys(JOB, { tool: { ball_u_mm: null }, obstacle: [] }), {});
});

test("a new ball has the smallest free number", () => {
  assert.equal(freeId([]), 1);
  assert.equal(freeId([3, 7]), 1);
  assert.equal(freeId([2, 1, 4]), 3);
});
