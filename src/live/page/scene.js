// The cell in three dimensions: arm as capsules, tool ball, bar, base balls, obstacles, planned poses, path, residuals.
// Nothing is drawn while nothing changes.

import { $, attempt, make } from "/frame.js";
import { ask } from "/link.js";
import * as moving from "/moving.js";
import { fixed, signed } from "/numbers.js";
import { t } from "/texts.js";
import * as T from "/vendor/three.js";

/** Program time a second of playing shows, s. */
const PLAY_SPEED = 10;
/** How near to a ball it is taken, pixels. */
const GRIP_PX = 14;
const MAGNIFICATIONS = [100, 500, 1000, 5000, 20000];
const DOWN = new T.Vector3(0, 1, 0);

/** @type {any} */
let cell = null;
let renderer, camera, scene, controls, arm, bar, toolBall, baseBalls, arrows, marks, path;
/** What can be moved: base balls, then obstacles. @type {any[]} */
let movables = [];
let at = 0;
let rows = [];
let playing = false;
let due = false;
let played = 0;

const colour = (name) => new T.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
const vector = (point) => new T.Vector3(...point);
const material = (name, more = {}) => new T.MeshLambertMaterial({ color: colour(name), ...more });

/**
 * A cylinder of unit length along Y with round ends where it is scaled: a capsule between two points. That it goes on from a thicker one
 * leaves out the end which cannot be seen.
 */
function link(radius, look, goesOn = false) {
  const group = new T.Group();
  const body = new T.Mesh(new T.CylinderGeometry(radius, radius, 1, 14, 1, true), look);
  const ends = [0, 1].map(() => ball(radius, look));
  group.add(body, ...(goesOn ? ends.slice(1) : ends));
  return {
    group,
    between(from, to) {
      const along = new T.Vector3().subVectors(to, from);
      const length = along.length();
      body.visible = length > 0.1;
      body.scale.set(1, Math.max(length, 0.1), 1);
      body.position.copy(from).addScaledVector(along, 0.5);
      if (length > 0.1) body.quaternion.setFromUnitVectors(DOWN, along.normalize());
      ends[0].position.copy(from);
      ends[1].position.copy(to);
    },
  };
}

function ball(radius, look, point) {
  const mesh = new T.Mesh(new T.SphereGeometry(radius, 14, 10), look);
  if (point) mesh.position.copy(vector(point));
  return mesh;
}

function obstacle(one) {
  const look = material("--soft", { transparent: true, opacity: 0.5 });
  if (one.shape === "floor") {
    const grid = new T.GridHelper(6000, 24, colour("--soft"), colour("--rule"));
    grid.rotation.x = Math.PI / 2;
    grid.position.z = one.z_mm;
    return grid;
  }
  if (one.shape === "box") {
    const size = [0, 1, 2].map((i) => one.high_mm[i] - one.low_mm[i]);
    const mesh = new T.Mesh(new T.BoxGeometry(...size), look);
    mesh.position.set(...[0, 1, 2].map((i) => (one.high_mm[i] + one.low_mm[i]) / 2));
    return mesh;
  }
  const post = link(one.radius_mm, look);
  post.between(vector(one.from_mm), vector(one.to_mm));
  return post.group;
}

/** Whether the processor draws in place of a graphics card. */
function isSoftware() {
  const probe = document.createElement("canvas").getContext("webgl2");
  const info = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? probe.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function build() {
  const canvas = $("scene-canvas");
  // Nothing shines through the view. Smooth edges cost a processor half of a frame.
  const context = canvas.getContext("webgl2", { alpha: false, antialias: !isSoftware(), stencil: false });
  renderer = new T.WebGLRenderer({ canvas, context });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  camera = new T.PerspectiveCamera(40, 1.6, 10, 30000);
  camera.up.set(0, 0, 1);
  scene = new T.Scene();
  scene.add(new T.AmbientLight(0xffffff, 1.6));
  const sun = new T.DirectionalLight(0xffffff, 2.2);
  sun.position.set(2000, -3000, 5000);
  scene.add(sun);
  controls = new T.OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.addEventListener("change", redraw);
  drag(canvas);
  controls.keyPanSpeed = 20;
  // The wheel and the thumb scroll the page until the view has the focus.
  controls.enableZoom = false;
  canvas.style.touchAction = "pan-y";
  canvas.addEventListener("pointerdown", () => canvas.focus());
  canvas.addEventListener("focus", () => (controls.enableZoom = true));
  canvas.addEventListener("blur", () => (controls.enableZoom = false));
  canvas.addEventListener("keydown", keys);
  // The arm is thinner than the body that the plan keeps clear of obstacles: its poses can be seen.
  const radius = Math.min(cell.arm_radius_mm, 90);
  const points = cell.path[0].arm.length;
  const radii = Array.from({ length: points - 1 }, (_, i) => (i === points - 2 ? cell.tool_radius_mm : radius * (1 - 0.09 * i)));
  arm = radii.map((one, i) => link(one, material("--near-fill"), one <= radii[i - 1]));
  arm.forEach((one) => scene.add(one.group));
  bar = link(Math.max(8, cell.bar_radius_mm / 2), material("--mark"));
  toolBall = ball(22, material("--over"));
  baseBalls = cell.balls.map((point) => ball(22, material("--good"), point));
  movables = [...baseBalls, ...cell.obstacles.map(obstacle)];
  scene.add(bar.group, toolBall, ...movables);
  path = new T.Line(new T.BufferGeometry(), new T.LineBasicMaterial({ color: colour("--soft") }));
  scene.add(path);
  marks = new T.Mesh(new T.BufferGeometry(), material("--mark"));
  scene.add(marks);
  drawPath();
  arrows = new T.LineSegments(new T.BufferGeometry(), new T.LineBasicMaterial({ color: colour("--over") }));
  scene.add(arrows);
  new ResizeObserver(resize).observe(canvas.parentElement);
  window.addEventListener("dbbd:theme", () => {
    scene.background = colour("--paper");
    redraw();
  });
  scene.background = colour("--paper");
  reset();
}

/** The path of the tool ball, and its measured poses: one body, which a processor draws faster than as many. */
function drawPath() {
  path.geometry.dispose();
  path.geometry = new T.BufferGeometry().setFromPoints(cell.path.map((one) => vector(one.arm.at(-1))));
  const measured = cell.path.filter(isMeasured).map((one) => one.arm.at(-1));
  const mark = new T.SphereGeometry(7, 4, 2);
  const corners = [...mark.index.array];
  /** An attribute of all marks; `isPlace` moves each to its own. */
  const all = (name, isPlace) => {
    const { array } = mark.attributes[name];
    const corner = (at, i) => [0, 1, 2].map((axis) => array[3 * i + axis] + (isPlace ? at[axis] : 0));
    return new T.Float32BufferAttribute(measured.flatMap((at) => corners.flatMap((i) => corner(at, i))), 3);
  };
  marks.geometry.dispose();
  marks.geometry = new T.BufferGeometry();
  marks.geometry.setAttribute("position", all("position", true));
  marks.geometry.setAttribute("normal", all("normal", false));
}

/** The plan of a changed job, while something is moved. @param {any} now */
function planned(now) {
  cell = { ...cell, path: now.path, balls: now.balls };
  $("scene-time").max = String(cell.path.length - 1);
  drawPath();
  table();
  show(Math.min(at, cell.path.length - 1));
}

/** Lets a ball or an obstacle be dragged: level, or upright with Shift. */
function drag(canvas) {
  const ray = new T.Raycaster();
  const pointer = new T.Vector2();
  let held = -1;
  let last = new T.Vector3();
  let normal = new T.Vector3();
  let from = [0, 0, 0];
  const aim = (event) => {
    const box = canvas.getBoundingClientRect();
    pointer.set((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    ray.setFromCamera(pointer, camera);
  };
  /** Where the ray meets the plane through `last`. */
  const met = () => {
    const { origin, direction } = ray.ray;
    const slope = direction.dot(normal);
    if (Math.abs(slope) < 1e-3) return null;
    const distance = new T.Vector3().subVectors(last, origin).dot(normal) / slope;
    return distance > 0 ? origin.clone().addScaledVector(direction, distance) : null;
  };
  /** The base ball under the finger: it is drawn smaller than a finger is. */
  const near = (event) => {
    const box = canvas.getBoundingClientRect();
    const away = (ball) => {
      const seen = ball.position.clone().project(camera);
      return Math.hypot(((seen.x + 1) / 2) * box.width - (event.clientX - box.left), ((1 - seen.y) / 2) * box.height - (event.clientY - box.top));
    };
    const ball = baseBalls.find((one) => away(one) < GRIP_PX);
    return ball && { object: ball, point: ball.position };
  };
  const place = (by) => movables[held].position.add(vector(by));
  canvas.addEventListener("pointerdown", (event) => {
    if ($("move").hidden || event.button !== 0) return;
    aim(event);
    // The floor is under everything: it is moved by typing.
    const hit = near(event) ?? ray.intersectObjects(movables.filter((_, i) => cell.obstacles[i - cell.balls.length]?.shape !== "floor"), true)[0];
    if (!hit) return;
    held = movables.findIndex((one) => one === hit.object || one === hit.object.parent);
    last = hit.point.clone();
    const level = new T.Vector3(0, 0, 1);
    normal = event.shiftKey ? new T.Vector3().subVectors(camera.position, last).setZ(0).normalize() : level;
    from = [0, 0, 0];
    controls.enabled = false;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (held < 0) return;
    aim(event);
    const point = met();
    if (!point) return;
    const by = [point.x - last.x, point.y - last.y, point.z - last.z].map((value, axis) => (normal.z ? axis < 2 : axis === 2) ? value : 0);
    last = point;
    from = from.map((value, axis) => value + by[axis]);
    place(by);
    redraw();
  });
  canvas.addEventListener("pointerup", () => {
    if (held < 0) return;
    controls.enabled = true;
    const at = held;
    // The job moves it as a whole.
    place(from.map((value) => -value));
    held = -1;
    if (from.some((value) => Math.abs(value) > 0.1)) moving.moveBy(at, from.map((value) => Math.round(10 * value) / 10));
    redraw();
  });
}

function resize() {
  const box = $("scene-canvas").parentElement;
  if (!box.clientWidth) return;
  renderer.setSize(box.clientWidth, box.clientHeight, false);
  camera.aspect = box.clientWidth / box.clientHeight;
  camera.updateProjectionMatrix();
  redraw();
}

/** The whole cell from the front right. */
function reset() {
  const far = Math.max(1200, ...cell.path.flatMap((one) => one.arm.map((point) => Math.hypot(...point))));
  const box = $("scene-canvas").parentElement;
  // A narrow view sees less to its sides.
  const back = far * Math.max(1, (1.2 * box.clientHeight) / (box.clientWidth || 1));
  controls.target.set(far * 0.35, 0, far * 0.3);
  camera.position.set(back * 0.75, -back * 1.45, back * 0.65).add(controls.target);
  controls.update();
  redraw();
}

function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    renderer.render(scene, camera);
  });
}

/** Shows a position of the path. @param {number} place */
function show(place) {
  at = Math.max(0, Math.min(cell.path.length - 1, place));
  const position = cell.path[at];
  const points = position.arm.map(vector);
  arm.forEach((one, i) => one.between(points[i], points[i + 1]));
  toolBall.position.copy(points.at(-1));
  const centre = cell.balls[position.ball - 1];
  const reach = centre ? vector(centre).distanceTo(points.at(-1)) : Infinity;
  // The bar is drawn where it can be: near its length.
  bar.group.visible = Math.abs(reach - cell.bar_length_mm) < 30;
  if (bar.group.visible) bar.between(vector(centre), points.at(-1));
  // The last row of the plan that was reached.
  let row = at;
  while (row > 0 && cell.path[row].index === null) row--;
  $("scene").dataset.pose = String(cell.path[row].index ?? 0);
  $("scene-time").value = String(at);
  const angles = position.axes_deg.map((deg, i) => `A${i + 1} ${fixed(deg, 1)}°`).join("  ");
  const near = position.axes_deg.some((deg, i) => Math.min(deg - cell.limits_deg[i][0], cell.limits_deg[i][1] - deg) < 5);
  $("scene-at").textContent = `${t("scene.at", { index: cell.path[row].index ?? "–", s: fixed(position.t_s, 0) })}  ${angles}${near ? `  ${t("scene.limit")}` : ""}`;
  redraw();
}

function drawArrows() {
  const factor = Number($("scene-magnify").value);
  const points = [];
  if ($("scene-arrows").checked) {
    for (const one of cell.residuals) {
      const from = vector(one.at);
      const centre = cell.balls[one.ball - 1];
      if (!centre) continue;
      const along = new T.Vector3().subVectors(from, vector(centre)).normalize();
      const size = one.residual_mm * factor;
      const tip = from.clone().addScaledVector(along, size);
      // A head of two short lines.
      const side = new T.Vector3().crossVectors(along, camera.up).normalize();
      const back = tip.clone().addScaledVector(along, -0.3 * size);
      points.push(from, tip);
      for (const way of [0.15, -0.15]) points.push(tip, back.clone().addScaledVector(side, way * size));
    }
  }
  arrows.geometry.dispose();
  arrows.geometry = new T.BufferGeometry().setFromPoints(points);
  redraw();
}

function play(on) {
  playing = on;
  $("scene").dataset.playing = String(on);
  $("scene-play").textContent = t(on ? "scene.pause" : "scene.play");
  if (!on) return;
  if (at === cell.path.length - 1) show(0);
  const start = performance.now();
  played = cell.path[at].t_s;
  const step = (now) => {
    if (!playing) return;
    const t_s = played + (PLAY_SPEED * (now - start)) / 1000;
    let place = at;
    while (place < cell.path.length - 1 && cell.path[place + 1].t_s <= t_s) place++;
    if (place !== at) show(place);
    if (place === cell.path.length - 1) return play(false);
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

/** The next or the previous row that is measured. @param {1 | -1} way */
function turnPage(way) {
  let place = at + way;
  while (place > 0 && place < cell.path.length - 1 && !isMeasured(cell.path[place])) place += way;
  show(place);
}

const isMeasured = (one) => one.kind !== null && one.kind !== "transit";

function orbit(sideways, up) {
  const arm = new T.Vector3().subVectors(camera.position, controls.target);
  arm.applyAxisAngle(new T.Vector3(0, 0, 1), sideways);
  const side = new T.Vector3().crossVectors(arm, camera.up).normalize();
  const tilted = arm.clone().applyAxisAngle(side, up);
  if (Math.abs(tilted.clone().normalize().z) < 0.98) arm.copy(tilted);
  camera.position.addVectors(controls.target, arm);
  controls.update();
  redraw();
}

function keys(event) {
  const zoom = (factor) => {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    redraw();
  };
  const acts = {
    ArrowLeft: () => orbit(-0.1, 0), ArrowRight: () => orbit(0.1, 0), ArrowUp: () => orbit(0, 0.1), ArrowDown: () => orbit(0, -0.1),
    "+": () => zoom(0.9), "-": () => zoom(1.1), " ": () => play(!playing), PageDown: () => turnPage(1), PageUp: () => turnPage(-1), Home: reset,
  };
  const act = acts[event.key];
  if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  event.stopPropagation();
  act();
}

function table() {
  const residual = new Map(cell.residuals.map((one) => [one.index, one.residual_mm]));
  rows = cell.path.map((one, place) => ({ one, place })).filter(({ one }) => isMeasured(one));
  $("scene-rows").replaceChildren(
    ...rows.map(({ one, place }) => {
      const row = make("tr", null);
      const head = make("th", null, { scope: "row" });
      const button = make("button", String(one.index), { type: "button" });
      button.addEventListener("click", () => show(place));
      head.append(button);
      const value = residual.get(one.index);
      const cells = [String(one.ball), ...one.axes_deg.map((deg) => fixed(deg, 2)), value === undefined ? "–" : signed(1e3 * value, 1)];
      row.append(head, ...cells.map((text) => make("td", text, { class: "num" })));
      return row;
    }),
  );
}

let text = "";

/** Shows the cell of a robot. @param {string} robot */
export async function open(robot) {
  const now = await ask("GET", `/workbench/${robot}/scene`);
  const same = JSON.stringify(now);
  if (same === text) return resize();
  const first = !cell;
  text = same;
  cell = now;
  if (first) wire();
  if (!first) {
    controls.dispose();
    renderer.dispose();
  }
  build();
  $("scene-time").max = String(cell.path.length - 1);
  $("scene-arrows").disabled = !cell.residuals.length;
  table();
  show(0);
  drawArrows();
  resize();
  await moving.open({
    robot,
    planned,
    place(at, by) {
      movables[at].position.add(vector(by));
      redraw();
    },
    restore() {
      text = "";
      attempt(() => open(robot));
    },
  });
}

/** Stops playing. */
export const pause = () => play(false);

function wire() {
  $("scene-magnify").append(...MAGNIFICATIONS.map((one) => new Option(`× ${one}`, String(one), false, one === 5000)));
  $("scene-play").addEventListener("click", () => play(!playing));
  $("scene-time").addEventListener("input", () => {
    play(false);
    show(Number($("scene-time").value));
  });
  $("scene-back").addEventListener("click", () => turnPage(-1));
  $("scene-next").addEventListener("click", () => turnPage(1));
  $("scene-reset").addEventListener("click", reset);
  $("scene-arrows").addEventListener("change", drawArrows);
  $("scene-magnify").addEventListener("change", drawArrows);
}
