/* The cell in three dimensions: drag turns it, the wheel or two fingers zoom, the slider chooses the pose. */
for (const figure of document.querySelectorAll("figure.viewer")) {
  const scene = JSON.parse(figure.querySelector("script").textContent);
  const canvas = figure.querySelector("canvas"), slider = figure.querySelector("input"), said = figure.querySelector("output");
  const pen = canvas.getContext("2d");
  const all = [...scene.balls.map(ball => ball.at), ...scene.poses.map(pose => pose.at), ...scene.poses.flatMap(pose => pose.arm)];
  const ends = axis => [Math.min(...all.map(p => p[axis])), Math.max(...all.map(p => p[axis]))];
  const box = [ends(0), ends(1), ends(2)], middle = box.map(([low, high]) => (low + high) / 2);
  const reach = Math.hypot(...box.map(([low, high]) => high - low)) / 2 || 1;
  const home = { turn: -0.9, tilt: 0.45, zoom: 1 };
  let view = { ...home }, chosen = 0, near = -1, fingers = new Map();

  function project(point) {
    const [x, y, z] = point.map((value, axis) => (value - middle[axis]) / reach);
    const [s, c] = [Math.sin(view.turn), Math.cos(view.turn)], [t, d] = [Math.sin(view.tilt), Math.cos(view.tilt)];
    const right = x * c - y * s, away = x * s + y * c;
    const size = 0.46 * Math.min(canvas.width, canvas.height) * view.zoom;
    return { x: canvas.width / 2 + size * right, y: canvas.height / 2 - size * (z * d - away * t), depth: away * d + z * t };
  }

  function colours() {
    const style = getComputedStyle(document.documentElement);
    return name => style.getPropertyValue("--" + name).trim();
  }

  /* Blue is short, orange long; grey where there is no residual. */
  function tint(pose, colour) {
    if (pose.value === null) return colour("after");
    const share = Math.max(-1, Math.min(1, pose.value / scene.largest)), size = Math.sqrt(Math.abs(share));
    const [from, to] = [[139, 148, 158], share > 0 ? [213, 94, 0] : [0, 114, 178]];
    return "rgb(" + from.map((low, at) => Math.round(low + (to[at] - low) * size)).join(",") + ")";
  }

  function line(points, colour, width) {
    pen.beginPath();
    points.map(project).forEach((p, at) => at ? pen.lineTo(p.x, p.y) : pen.moveTo(p.x, p.y));
    pen.strokeStyle = colour;
    pen.lineWidth = width * devicePixelRatio;
    pen.stroke();
  }

  function dot(point, radius, colour, ring) {
    const p = project(point);
    pen.beginPath();
    pen.arc(p.x, p.y, radius * devicePixelRatio, 0, 7);
    pen.fillStyle = colour;
    pen.fill();
    if (ring) {
      pen.strokeStyle = ring;
      pen.lineWidth = 1.5 * devicePixelRatio;
      pen.stroke();
    }
    return p;
  }

  function label(p, text, colour) {
    pen.fillStyle = colour;
    pen.fillText(text, p.x + 8 * devicePixelRatio, p.y - 8 * devicePixelRatio);
  }

  function draw() {
    const colour = colours();
    canvas.width = canvas.clientWidth * devicePixelRatio;
    canvas.height = canvas.clientHeight * devicePixelRatio;
    pen.font = 12 * devicePixelRatio + "px system-ui, sans-serif";
    pen.lineCap = pen.lineJoin = "round";
    const axis = reach * 0.25;
    [[axis, 0, 0, "X"], [0, axis, 0, "Y"], [0, 0, axis, "Z"]].forEach(([x, y, z, name]) => {
      line([[0, 0, 0], [x, y, z]], colour("soft"), 1);
      label(project([x, y, z]), name, colour("soft"));
    });
    scene.obstacles.forEach(edge => line(edge, colour("mark"), 1));
    const order = scene.poses.map((pose, at) => [project(pose.at).depth, at]).sort((a, b) => b[0] - a[0]);
    order.forEach(([, at]) => dot(scene.poses[at].at, at === near ? 5 : 3, tint(scene.poses[at], colour)));
    const pose = scene.poses[chosen];
    if (pose) {
      const ball = scene.balls.find(ball => ball.id === pose.ball);
      if (ball) line([ball.at, pose.at], colour("after"), 2.5);
      line(pose.arm, colour("rule"), 6);
      pose.arm.forEach(joint => dot(joint, 3.5, colour("paper"), colour("rule")));
      dot(pose.at, 6, tint(pose, colour), colour("ink"));
      said.textContent = spoken(pose.text);
    }
    scene.balls.forEach(ball => label(dot(ball.at, 7, colour("before"), colour("paper")), spoken("ball " + ball.id), colour("ink")));
    if (scene.poses[near] && near !== chosen) label(project(scene.poses[near].at), spoken(scene.poses[near].text), colour("ink"));
  }

  function nearest(event) {
    const area = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - area.left) * devicePixelRatio, (event.clientY - area.top) * devicePixelRatio];
    let best = -1, least = 14 * devicePixelRatio;
    scene.poses.forEach((pose, at) => {
      const p = project(pose.at), far = Math.hypot(p.x - x, p.y - y);
      if (least > far) [best, least] = [at, far];
    });
    return best;
  }

  function zoomed(factor) {
    view.zoom = Math.max(0.3, Math.min(30, view.zoom * factor));
  }

  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, moved: 0 });
  });
  canvas.addEventListener("pointermove", event => {
    const before = fingers.get(event.pointerId);
    if (!before) {
      const found = nearest(event);
      if (found !== near) { near = found; draw(); }
      return;
    }
    const [x, y] = [event.clientX - before.x, event.clientY - before.y];
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, finger]) => finger);
    if (others.length) {
      const apart = point => Math.hypot(point.x - others[0].x, point.y - others[0].y);
      zoomed(apart({ x: event.clientX, y: event.clientY }) / (apart(before) || 1));
    } else {
      view.turn += x * 0.008;
      view.tilt = Math.max(-1.57, Math.min(1.57, view.tilt + y * 0.008));
    }
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY, moved: before.moved + Math.hypot(x, y) });
    draw();
  });
  const lifted = event => {
    const finger = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (finger && 4 > finger.moved && event.type === "pointerup") {
      const found = nearest(event);
      if (found >= 0) { chosen = found; slider.value = found; draw(); }
    }
  };
  canvas.addEventListener("pointerup", lifted);
  canvas.addEventListener("pointercancel", lifted);
  /* The wheel and the thumb scroll the page until the view has the focus. */
  canvas.addEventListener("wheel", event => { if (document.activeElement !== canvas) return; event.preventDefault(); zoomed(Math.exp(-0.0015 * event.deltaY)); draw(); }, { passive: false });
  canvas.addEventListener("dblclick", () => { view = { ...home }; draw(); });
  canvas.addEventListener("keydown", event => {
    const step = { ArrowLeft: ["turn", -0.1], ArrowRight: ["turn", 0.1], ArrowUp: ["tilt", 0.1], ArrowDown: ["tilt", -0.1] }[event.key];
    if (event.key === "+") zoomed(1.2);
    else if (event.key === "-") zoomed(1 / 1.2);
    else if (step) view[step[0]] += step[1];
    else return;
    event.preventDefault();
    draw();
  });
  slider.max = Math.max(0, scene.poses.length - 1);
  slider.addEventListener("input", () => { chosen = Number(slider.value); draw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  figure.hidden = false;
  new ResizeObserver(draw).observe(canvas);
}
/* What is wider than the page says so. */
const hint = () => document.querySelectorAll(".scroll, .wide").forEach(part => {
  part.dataset.hint = spoken("wider than the page: scroll sideways");
  part.classList.toggle("more", part.scrollWidth > part.clientWidth + 2);
});
addEventListener("resize", hint);
hint();
