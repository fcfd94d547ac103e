"""How accurate and how honest `dbbd identify` is, on robots that this script simulates itself.

    python3 tests/independent/simulated_robots.py DBBD CAMPAIGN.. [--robots N] [--jobs N] [--assert]

Campaigns (or `all`); every robot has its own seed, so that a run repeats exactly:
    few         few lengths in random order, on the robots of `dbbd demo`; the order of the lines must not matter
    honesty     true against predicted errors at poses that no fit saw, with and without violations of the model
    no_change   robots without any change of the instrument: how many results report one
    changes     true changes amid the run: is the right one named, at its row
    second_run  an identified robot is measured again
    bar_scale   a bar that is not as long as stated, and the error that the result states
    tool        a ball that is beside its place on the flange: what a corrected program does at other tools
    load        an arm that sags, predicted with a payload of 50 kg that was never measured, one that was, and after lengths of a bar that pulls

--robots N takes N robots for each case in place of the full number. With --assert a violated limit or a failed command
gives exit code 1. Needs numpy. Lengths in mm, angles in rad, but the controller's axis angles in degrees.
"""
import argparse
import collections
import concurrent.futures
import copy
import json
import math
import os
import pathlib
import random
import re
import subprocess
import sys
import tempfile
import time
import tomllib

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import numpy as np

LIMITS = {  # what: lowest, highest
    "few: mean, 30": (0, 1.0), "few: largest, 30": (0, 2.0), "few: mean, 60": (0, .87), "few: largest, 60": (0, 1.5),
    "few: mean, 100": (0, .57), "few: largest, 100": (0, .9), "few: mean, 250": (0, .46), "few: largest, 250": (0, .75),
    "few: by the order of the lines": (0, 1e-6),
    "honesty: p/t": (.85, 1.25), "honesty: coverage": (.88, .99), "honesty: coverage, hard": (.85, 1),
    "no_change: share reported as certain": (0, .01),
    "changes: share named or possible": (.95, 1), "changes: share named alone": (.80, 1),
    "second_run: mean error over that of the first run": (0, 1), "second_run: share worse by 10 %": (0, .05),
    "tool: error over that with the true ball": (0, 1.15), "tool: error over that with the true ball and flange": (0, 1.15),
    "tool: error over that before": (0, 1), "tool: p/t": (.85, 1.25),
    "load: p/t, never measured": (.85, 3), "load: coverage, never measured": (.9, 1),
    "load: p/t, measured": (.85, 1.25), "load: coverage, measured": (.9, .98),
    "load: p/t, pulled": (.85, 1.25), "load: coverage, pulled": (.9, .98),
    "load: error over that without payload": (0, 1.3),
    "bar_scale: share with true <= 2 predicted": (.9, 1),
}
FULL = {"few": 40, "honesty": 100, "no_change": 200, "changes": 100, "second_run": 100, "bar_scale": 100, "load": 100, "tool": 100}
HARD = (("partly reversed", 1), ("ripple", 1))  # case and number of balls
CHANGES = ("bar_zero_step", "bar_zero_drift", "base_ball_moved", "tool_ball_moved", "wrong_ball", "rows_shifted",
           "tracker_moved", "tracker_drift", "joint_zero_step")
ROBOT = pathlib.Path(__file__).resolve().parents[2] / "robots" / "kr60ha.toml"
NOMINAL = ROBOT.read_text() + "\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n"  # a robot of the catalogue has no tool ball
PAYLOAD_MM = [0., 0, 150]  # its centre on the flange
BALLS = np.array([[1300., 0, 800], [300, 1300, 400], [500, -1100, 1500]])
AXES = [f"a{i}_deg" for i in range(1, 7)]
SENSES = [f"approach{i}" for i in range(1, 7)]


# ---- The simulated robot

class Geometry:
    """Modified DH rows Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d) of a robot file, and the tool ball."""

    def __init__(self, text=NOMINAL):
        data = tomllib.loads(text)
        row = lambda key: np.array([j.get(key, 0.0) for j in data["joint"]])
        self.alpha, self.beta, self.offset = (np.radians(row(k)) for k in ("alpha_deg", "beta_deg", "theta_offset_deg"))
        self.a, self.d, self.sign = row("a_mm"), row("d_mm"), row("sign")
        self.limits = np.array([j["limits_deg"] for j in data["joint"]])
        self.tool = np.array(data["tool"]["ball_mm"])
        self.length, self.angle = data["tolerance"]["length_mm"], math.radians(data["tolerance"]["angle_deg"])

    def frames(self, q, turn=0.0, scale=0.0):
        """Rotation and origin of each frame at axis angles q (n, 6); `turn` adds to theta, `scale` to links."""
        theta = self.sign * np.radians(q) + self.offset + turn
        scale = 1 + np.broadcast_to(scale, len(q))
        R, o, out = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)), []
        for i in range(6):
            (ca, cb), (sa, sb) = (f([self.alpha[i], self.beta[i]]) for f in (np.cos, np.sin))
            R = R @ np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]]) @ np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
            o = o + R[:, :, 0] * (self.a[i] * scale)[:, None]
            c, s, z, e = np.cos(theta[:, i]), np.sin(theta[:, i]), np.zeros(len(q)), np.ones(len(q))
            R = R @ np.array([[c, -s, z], [s, c, z], [z, z, e]]).transpose(2, 0, 1)
            o = o + R[:, :, 2] * (self.d[i] * scale)[:, None]
            out.append((R, o))
        return out

    def ball(self, q):
        R, o = self.frames(q)[5]
        return o + R @ self.tool


class Robot(Geometry):
    """A robot drawn within half its tolerance, with errors of its joints and the violations of the model in `cases`."""

    def __init__(self, rng, cases=(), joints=True, repeatability=.015, bar=.005):
        super().__init__()
        self.rng, self.repeatability, self.bar = rng, repeatability, bar
        self.cases = {cases} if isinstance(cases, str) else set(cases)
        draw = lambda sd, *size: rng.normal(0, sd, size)
        self.alpha, self.offset = self.alpha + draw(self.angle / 2, 6), self.offset + draw(self.angle / 2, 6)
        self.a, self.d = self.a + draw(self.length / 2, 6), self.d + draw(self.length / 2, 6)
        self.beta = self.beta + draw(self.angle / 2, 6) * (np.arange(6) == 2)  # axes 2 and 3 are parallel
        self.tool = self.tool + draw(self.length / 2, 3)
        self.balls = BALLS + draw(1, 3, 3)
        self.first = draw(100e-6 * joints, 2, 6)
        self.backlash = draw((60e-6 if "partly reversed" in self.cases else 30e-6) * joints, 6)
        self.higher = draw(60e-6 / math.sqrt(7), 7, 2, 6)
        self.ripple, self.phase = rng.integers(60, 146, 6), rng.uniform(0, 2 * np.pi, 6)
        self.coupling, self.shift = rng.uniform(.1e-3, .2e-3, 3), rng.uniform(0, 2 * np.pi, 3)
        self.waves, self.start = draw(2, 3, 8, 3), rng.uniform(0, 2 * np.pi, (3, 8))  # form of the balls

    def turn(self, q, sense, warm, payload=0.0, pull=None):
        """Errors of the joint angles; the payload (kg, for each pose) is at PAYLOAD_MM on the flange, the pull (N) at the ball."""
        x = np.radians(q)
        D = self.first[0] * np.cos(x) + self.first[1] * np.sin(x)
        if "partly reversed" in self.cases:  # a third of the last moves was too short to cross the play
            sense = np.where(self.rng.random(q.shape) < 1 / 3, self.rng.uniform(-1, 1, q.shape), sense)
        D = D + self.backlash * sense
        if "harmonics" in self.cases:
            D = D + sum(c * np.cos(n * x) + s * np.sin(n * x) for n, (c, s) in enumerate(self.higher, 2))
        if "ripple" in self.cases:
            D = D + 80e-6 * np.sin(self.ripple * x + self.phase)
        if "coupled" in self.cases:
            for (axis, by), c, shift in zip(((2, 1), (4, 3), (5, 4)), self.coupling, self.shift):
                D[:, axis] += c * np.sin(x[:, by] + shift)
        if "zeros drift" in self.cases:
            D[:, :2] += 40e-6 * warm[:, None]
        if "sag" in self.cases:
            f = self.frames(q)
            masses = ((1, 150, [425., 0, 0]), (2, 130, [145., 250, 0]), (5, 40, [0., 0, 0]))  # frame, kg, place in it
            for j, compliance in ((1, 2e-7), (2, 3e-7), (3, 5e-7), (4, 6e-7)):  # rad/(N m)
                for i, kg, place in (*masses, (5, payload, PAYLOAD_MM)):
                    if i >= j:
                        weight = np.multiply.outer(np.broadcast_to(kg, len(q)), [0, 0, -9.81e-3])
                        torque = np.cross(f[i][1] + f[i][0] @ place - f[j][1], weight)
                        D[:, j] += compliance * (torque * f[j][0][:, :, 2]).sum(1)
                if pull is not None:
                    torque = np.cross(f[5][1] + f[5][0] @ self.tool - f[j][1], pull) * 1e-3
                    D[:, j] += compliance * (torque * f[j][0][:, :, 2]).sum(1)
        return D

    def visit(self, q, sense, t, slip=0.0, payload=0.0, pull=None):
        """Places of the ball on one visit of each pose, at times t of the run (0..1); `slip` moves it on the flange, `pull` (N) is a
        force on it."""
        warm = 1 - np.exp(-3 * t)
        R, o = self.frames(q, self.turn(q, sense, warm, payload, pull), 40e-6 * warm if "links warm" in self.cases else 0.0)[5]
        p = o + np.einsum("nij,nj->ni", R, self.tool + np.broadcast_to(slip, o.shape))
        if "stem bends" in self.cases:  # by its weight, across itself
            down = np.array([0, 0, -1.0])
            p = p + .04 * (down - R[:, :, 2] * (R[:, :, 2] @ down)[:, None])
        if "pedestal tilts" in self.cases:  # to where the arm is
            p = p + 40e-6 * np.cross(np.cross([0, 0, 1.0], o * [1, 1, 0]) / 1500, p)
        noise = self.rng.standard_t(2.5 if "t(2.5)" in self.cases else 1e9, p.shape)
        return p + self.repeatability * noise

    def measure(self, p, ball, t, moved=0.0):
        """Lengths from positions of the tool ball to the base balls with these numbers (0..)."""
        v = p - self.balls[ball] - moved
        L = np.linalg.norm(v, axis=1)
        u = v / L[:, None]
        if "ball form" in self.cases:
            L = L + .004 / 2 * np.cos(np.einsum("nwi,ni->nw", self.waves[ball], u) + self.start[ball]).sum(1)
        if "bar warms" in self.cases:
            L = L * (1 + 60e-6 * t)
        return L + self.rng.normal(0, self.bar, len(L))

    def poses(self, n):
        """Axis angles within the limits, and the sense of the last move of each axis."""
        q = self.rng.uniform(*self.limits.T, (n + 1, 6))
        return q[1:], np.sign(np.diff(q, axis=0))

    def run(self, poses, balls, order="at once"):
        """Rows of a table of lengths: at each pose to all balls, or at each to one, the balls in turn or in blocks."""
        q, sense = self.poses(poses)
        t = np.linspace(0, 1, poses)
        p = self.visit(q, sense, t)
        k = np.arange(poses) * balls // poses if order == "blocks" else np.arange(poses) % balls
        if order == "at once":
            q, sense, t, p = (np.repeat(x, balls, axis=0) for x in (q, sense, t, p))
            k = np.tile(np.arange(balls), poses)
        return q, sense, k, t, self.measure(p, k, t)

    def kept(self, n=100, payload=0.0):
        """Poses that no fit sees, and where the ball is, after the run."""
        q, sense = self.poses(n)
        return q, sense, self.visit(q, sense, np.ones(n), payload=payload)


def on_sphere(robot, n, radius):
    """Axis angles that put the nominal robot's ball on a sphere about base ball 1, the tool turned at random."""
    nominal, rng = Geometry(), robot.rng
    u = rng.standard_normal((n, 3))
    u[:, 2] = abs(u[:, 2]) - .3
    goal = BALLS[0] + radius * u / np.linalg.norm(u, axis=1)[:, None]
    q = np.array([0, -60, 115, 0, 60, 0.0]) + rng.uniform(-1, 1, (n, 6)) * [0, 0, 0, 40, 25, 90]
    for _ in range(20):  # Newton with axes 1 to 3
        p = nominal.ball(q)
        J = np.stack([(nominal.ball(q + 1e-4 * np.eye(6)[j]) - p) / 1e-4 for j in range(3)], axis=2)
        q[:, :3] += np.clip(np.linalg.solve(J, (goal - p)[:, :, None])[:, :, 0], -10, 10)
    inside = ((q > robot.limits[:, 0]) & (q < robot.limits[:, 1])).all(1)
    return q[inside & (np.linalg.norm(nominal.ball(q) - goal, axis=1) < 1e-3)]


# ---- The program, its files and its results

class Bench:
    """Runs the program on files in one directory."""
    dbbd, seconds = None, []

    def __init__(self, directory):
        self.dir = pathlib.Path(directory)
        self.text("nominal.toml", [NOMINAL])

    def table(self, name, header, *columns):
        rows = zip(*(c.tolist() if isinstance(c, np.ndarray) else c for c in columns))
        self.text(name, [",".join(header)] + [",".join(map(repr, row)) for row in rows])

    def text(self, name, lines):
        (self.dir / name).write_text("\n".join(lines) + "\n")

    def lengths(self, q, sense, k, t, L, sigma=.005):
        """The tables of a run of an hour: lengths.csv, with the number of the row as index, from 1, and centres.csv."""
        self.table("lengths.csv", ["index", "centre", *AXES, "length_mm", "sigma_mm", *SENSES, "t_s"],
                   range(1, len(L) + 1), k + 1, *q.T, L, [sigma] * len(L), *sense.astype(int).T, 3600 * t)
        self.table("centres.csv", ["centre", "x_mm", "y_mm", "z_mm"], range(1, max(k) + 2), *BALLS[:max(k) + 1].T)

    def call(self, *args):
        command = [self.dbbd, *map(str, args), "--quiet"]
        done = subprocess.run(command, cwd=self.dir, capture_output=True, text=True, timeout=600)
        if done.returncode not in (0, 3):
            said = re.sub(r"\nstack backtrace.*", "", done.stderr.strip(), flags=re.S)[-200:]
            raise RuntimeError(f"exit code {done.returncode} of dbbd {' '.join(map(str, args))}: {said}")

    def identify(self, out, *args, robot="nominal.toml"):
        """Runs `identify`, with the base balls unless only positions are given; the content of result.json."""
        began = time.monotonic()
        centres = [] if args[0] == "positions.csv" else ["--centres", "centres.csv"]
        self.call("identify", *args, "--robot", robot, "--out", out, *centres)
        self.seconds.append(time.monotonic() - began)
        return json.loads((self.dir / out / "result.json").read_text())

    def predict(self, robot, q, sense=None, *options):
        """Positions and their standard deviations at axis angles."""
        columns = list(q.T) + ([] if sense is None else list(sense.astype(int).T))
        self.table("axes.csv", AXES + ([] if sense is None else SENSES), *columns)
        self.call("predict", "axes.csv", "--robot", robot, "--out", "p.csv", *options)
        out = np.genfromtxt(self.dir / "p.csv", delimiter=",", names=True)
        return np.stack([out["x_mm"], out["y_mm"], out["z_mm"]], axis=1), out["sd_mm"]

    def errors(self, out, q, sense, p, *options):
        """Errors of an identified robot at poses after one rigid alignment, and the predicted standard deviations."""
        at, sd = self.predict(f"{out}/robot-identified.toml", q, sense, *options)
        return distances(at, p), sd


def distances(a, b):
    """Distances after the rigid alignment of a to b."""
    x, y = a - a.mean(0), b - b.mean(0)
    U, _, V = np.linalg.svd(x.T @ y)
    return np.linalg.norm(x @ (U @ np.diag([1, 1, np.sign(np.linalg.det(U @ V))]) @ V) - y, axis=1)


def row(where):
    """The first index that a place names: a number, or words or members with numbers."""
    text = json.dumps(where)
    number = re.search(r"(?:index|indices|row|from)\D*(\d+)", text) or re.search(r"(\d+)", text)
    return int(number.group(1)) if number else None


def reported(result):
    """Changes in a result.json, present or former: (kind, index or None, whether certain); rivals are not certain."""
    if "hypotheses" in result:
        for h in result["hypotheses"]:
            yield h["name"], row(h["where"]), h["treated"] == "unknown"
            for rival in h.get("rivals", []):
                yield (rival if isinstance(rival, str) else rival["name"]), row(h["where"]), False
        return
    for finding in result["findings"]:
        values = finding["values"]
        step = "tracker_moved" if "size_mm" in values else "bar_zero_step" if "index" in values else "bar_zero_drift"
        kind = {"W1330": "rows_shifted", "W1331": "base_ball_moved", "W1333": step}.get(finding["code"])
        if kind:
            yield kind, values.get("index"), True


class Judge:
    """Runs a function for each robot, and compares with the limits."""

    def __init__(self, robots, jobs):
        self.robots, self.jobs, self.violated, self.failed = robots, jobs, [], collections.Counter()

    def fail(self, about, i, error):
        """Counts a failed command; the first one of a case is printed."""
        if about not in self.failed:
            print(f"  {about}, robot {i}: {error}")
        self.failed[about] += 1

    def limit(self, name, value, about=""):
        low, high = LIMITS[name]
        if not low <= value <= high:
            self.violated.append(f"{name}{about and ', ' + about}: {value:.4g}, must be {low:g} to {high:g}")

    def each(self, campaign, work, about):
        """The results of work(i, bench) for the robots i, without those that failed."""
        def one(i):
            with tempfile.TemporaryDirectory() as directory:
                try:
                    return work(i, Bench(directory))
                except (RuntimeError, subprocess.TimeoutExpired) as error:
                    self.fail(about, i, error)
        with concurrent.futures.ThreadPoolExecutor(self.jobs) as pool:
            return [r for r in pool.map(one, range(self.robots or FULL[campaign])) if r is not None]


# ---- Campaigns

def few(judge):
    """Demo robots and the first n of their lengths in random order."""
    counts = (30, 60, 100, 250)
    def work(i, bench):
        seed, shuffle = i % 8 + 1, i % 8 + 1 + 100 * (i // 8)
        bench.call("demo", "--circles", "--seed", seed, "--out", "demo")
        demo = bench.dir / "demo"
        header, *lines = (demo / "observations.csv").read_text().splitlines()
        random.Random(shuffle).shuffle(lines)
        truth, rng = Geometry((demo / "truth.toml").read_text()), np.random.default_rng(seed)
        q = rng.uniform(*truth.limits.T, (300, 6))
        assert abs(truth.ball(q) - bench.predict(demo / "truth.toml", q)[0]).max() < 1e-6
        bench.text("centres.csv", (demo / "plan" / "centres.csv").read_text().splitlines())
        error, order = {}, 0.0
        for n in counts:
            bench.text("lengths.csv", [header] + lines[:n])
            bench.identify(f"first{n}", "lengths.csv")
            at = bench.predict(f"first{n}/robot-identified.toml", q)[0]
            error[n] = distances(at, truth.ball(q)).mean()
            if i < 8:
                by_index = sorted(lines[:n], key=lambda line: int(line.split(",")[0]))
                bench.text("sorted.csv", [header] + by_index)
                bench.identify("sorted", "sorted.csv")
                order = max(order, abs(bench.predict("sorted/robot-identified.toml", q)[0] - at).max())
        return error, order
    results = judge.each("few", work, "few")
    if not results:
        return
    print("\nfew: true error, mm\n       n     mean  largest")
    for n in counts:
        e = np.array([r[0][n] for r in results])
        print(f"{n:8} {e.mean():8.3f} {e.max():8.3f}")
        judge.limit(f"few: mean, {n}", e.mean())
        judge.limit(f"few: largest, {n}", e.max())
    order = [r[1] for r in results[:8]]
    print(f"  largest change of a position by the order of the lines: {max(order):.3g} mm; "
          f"more than 1e-6 mm in {sum(x > 1e-6 for x in order)} of {len(order)} robots")
    judge.limit("few: by the order of the lines", max(order))


def honesty(judge):
    """True against predicted errors at kept poses, for each violation of the model of errors."""
    cases = ("none", "links warm", "zeros drift", "sag", "ball form", "bar warms", "harmonics", "ripple", "coupled",
             "partly reversed", "stem bends", "pedestal tilts", "t(2.5)")
    print("\nhonesty: p/t and coverage at kept poses, mm\n  case                       p/t  coverage   mean error")
    for case in cases:
        for balls, poses in ((3, 70), (1, 140)):
            def work(i, bench):
                robot = Robot(np.random.default_rng([2, i]), case)
                bench.lengths(*robot.run(poses, balls))
                bench.identify("out", "lengths.csv")
                return bench.errors("out", *robot.kept())
            about = f"{case}, {balls} balls"
            results = judge.each("honesty", work, about)
            if not results:
                continue
            e, sd = (np.concatenate(x) for x in zip(*results))
            ratio, coverage = np.sqrt((sd**2).mean() / (e**2).mean()), (e**2 <= 7.815 * sd**2 / 3).mean()
            print(f"  {about:24}{ratio:7.2f}{coverage:10.3f}{e.mean():13.4f}")
            judge.limit("honesty: p/t", ratio, about)
            judge.limit("honesty: coverage" + ", hard" * ((case, balls) in HARD), coverage, about)


def no_change(judge):
    """Robots with errors of the joints, sag and warming, but without any change of the instrument."""
    kinds = ["partly reversed", "harmonics", "sag", "links warm", "zeros drift", "all"]
    def work(i, bench):
        kind, (balls, order) = kinds[i % 6], ((1, "in turn"), (3, "in turn"), (3, "blocks"))[i // 6 % 3]
        robot = Robot(np.random.default_rng([3, i]), kinds[:5] if kind == "all" else kind)
        bench.lengths(*robot.run(200, balls, order))
        certain = sorted({c[0] for c in reported(bench.identify("out", "lengths.csv")) if c[2] and c[0] in CHANGES})
        return f"{kind}, {balls} ball{'s ' + order if balls > 1 else ''}: {', '.join(certain)}" if certain else ""
    results = judge.each("no_change", work, "no_change")
    wrong = [r for r in results if r]
    print(f"\nno_change: {len(wrong)} of {len(results)} report a change as certain")
    for text, count in collections.Counter(wrong).most_common():
        print(f"  {count:3} {text}")
    judge.limit("no_change: share reported as certain", len(wrong) / max(len(results), 1))


def changes(judge):
    """True changes amid the run, at a row of its middle half."""
    kinds = (("bar_zero_step", .05), ("base_ball_moved", .5), ("base_ball_moved", 2),
             ("tool_ball_moved", .5), ("wrong_ball", 10))
    print("\nchanges: share of the right kind within 10 rows: named as certain, at least possible, named and no other")
    print("  change                       named  possible   alone   reported as certain")
    for kind, size in kinds:
        for balls, rows in ((3, 252), (1, 210)):
            if kind == "wrong_ball" and balls == 1:
                continue
            def work(i, bench):
                robot = Robot(np.random.default_rng([4, i]))
                rng, n = robot.rng, np.arange(rows)
                at, hit, way = rng.integers(rows // 4, rows * 3 // 4), rng.integers(balls), rng.standard_normal(3)
                after, k, t = n >= at, n % balls, n / rows
                way = way / np.linalg.norm(way) * size * after[:, None]
                q, sense = robot.poses(rows)
                p = robot.visit(q, sense, t, way if kind == "tool_ball_moved" else 0.0)
                L = robot.measure(p, k, t, way * (k == hit)[:, None] if kind == "base_ball_moved" else 0.0)
                L = L + size * after * (kind == "bar_zero_step")
                k = (k + (after & (n < at + size) & (kind == "wrong_ball"))) % balls
                bench.lengths(q, sense, k, t, L, .015)
                found = [c for c in reported(bench.identify("out", "lengths.csv")) if c[0] in CHANGES]
                right = [c for c in found if c[0] == kind and c[1] is not None and abs(c[1] - at - 1) <= 10]
                certain = sorted(c[0] for c in found if c[2])
                if kind == "wrong_ball":  # one for each ball that was named wrongly
                    certain = sorted(set(certain))
                named = any(c[2] for c in right)
                # One change is one, not two that begin a row early and late.
                return named, bool(right), named and certain == [kind], ", ".join(certain) or "nothing"
            about = f"{kind} {size}, {balls} balls"
            results = judge.each("changes", work, about)
            if not results:
                continue
            share = [sum(r[j] for r in results) / len(results) for j in range(3)]
            said = collections.Counter(r[3] for r in results).most_common()
            print(f"  {about:28}{share[0]:8.2f}{share[1]:10.2f}{share[2]:8.2f}   " +
                  "; ".join(f"{count} {text}" for text, count in said))
            judge.limit("changes: share named or possible", share[1], about)
            judge.limit("changes: share named alone", share[2], about)


def second_run(judge):
    """Robots with errors of the joints: a run of lengths, then a shorter one of lengths, positions or both."""
    modes = {"lengths": ["lengths.csv"], "positions": ["positions.csv"]}
    modes["both"] = ["lengths.csv", "--positions", "positions.csv"]
    def work(i, bench):
        robot = Robot(np.random.default_rng([5, i]))
        bench.lengths(*robot.run(60, 3))
        joints = bench.identify("first", "lengths.csv")["model"] == "joint_errors"
        bench.lengths(*robot.run(25, 3))
        q, sense = robot.poses(25)
        R = np.linalg.qr(robot.rng.standard_normal((3, 3)))[0]
        p = robot.visit(q, sense, np.zeros(25)) @ (R * np.linalg.det(R)) + [3000., 500, 200]  # a tracker's frame
        p += robot.rng.normal(0, .01, p.shape)
        bench.table("positions.csv", [*AXES, "x_mm", "y_mm", "z_mm", *SENSES], *q.T, *p.T, *sense.astype(int).T)
        kept = robot.kept()
        error = {"first": bench.errors("first", *kept)[0].mean()}
        for mode, inputs in modes.items():
            try:
                bench.identify(mode, *inputs, robot="first/robot-identified.toml")
                error[mode] = bench.errors(mode, *kept)[0].mean()
            except RuntimeError as problem:
                judge.fail(f"second_run, {mode}", i, problem)
        return joints, error
    results = judge.each("second_run", work, "second_run")
    print(f"\nsecond_run: {sum(r[0] for r in results)} of {len(results)} first runs have errors of the joints\n"
          "  second run   robots   mean error first   then   worse by 10 %")
    for mode in modes:
        e = np.array([(r[1]["first"], r[1][mode]) for r in results if mode in r[1]]).reshape(-1, 2)
        if len(e):
            worse, (before, then) = e[:, 1] > 1.1 * e[:, 0], e.mean(0)
            print(f"  {mode:12}{len(e):7}{before:19.4f}{then:7.4f}{worse.sum():16}")
            judge.limit("second_run: mean error over that of the first run", then / before, mode)
            judge.limit("second_run: share worse by 10 %", worse.mean(), mode)


def bar_scale(judge):
    """One ball and a bar longer than the stated 300 mm, without certificate; a robot without errors of its joints."""
    modes = {"default": [], "geometric": ["--model", "geometric"], "none": ["--prior", "none"], "all": ["--estimate", "all"]}
    print("\nbar_scale: covered where true <= 2 predicted, mm\n  bar mm   mode        mean true   predicted   covered")
    for bar in (300.0, 300.3, 301.0, 302.0):
        def work(i, bench):
            robot = Robot(np.random.default_rng([6, i]), joints=False, repeatability=0, bar=.01)
            q = on_sphere(robot, 150, 300)[:120]
            sense, k, t = 0 * q, np.zeros(len(q), int), np.linspace(0, 1, len(q))
            bench.lengths(q, sense, k, t, robot.measure(robot.visit(q, sense, t), k, t) - (bar - 300), .01)
            kept, out = robot.kept(300), {}
            for mode, options in modes.items():
                predicted = bench.identify(mode, "lengths.csv", *options)["predicted_position_uncertainty_mm"]
                out[mode] = bench.errors(mode, *kept)[0].mean(), predicted["identified"]["mean"]
            return out
        results = judge.each("bar_scale", work, f"{bar} mm")
        for mode in modes if results else ():
            e, predicted = np.array([r[mode] for r in results]).T
            covered = (e <= 2 * predicted).mean()
            print(f"  {bar:6.1f}   {mode:10}{e.mean():11.3f}{predicted.mean():12.3f}{covered:10.2f}")
            judge.limit("bar_scale: share with true <= 2 predicted", covered, f"{bar} mm, {mode}")


def tool(judge):
    """Points corrected for a robot whose ball was mounted beside its place, at three tools.

    With the true ball d6 and theta6 are known from it, which no length to a ball of unknown place determines."""
    print("\ntool: points of a corrected program, mm\n  ball off   tool                    before    after   true ball   flange      p/t")
    points = {"0, 0, 200": [0, 0, 200.], "150, -80, 120": [150, -80, 120.], "-60, 200, 300": [-60, 200, 300.]}
    for off in (0.0, .3, 1.5):
        def work(i, bench):
            rng = np.random.default_rng([8, i])
            robot, nominal = Robot(rng), Geometry()
            robot.d[5] = nominal.d[5] + rng.normal(0, .05)
            robot.offset[5] = nominal.offset[5] + math.radians(rng.normal(0, .02))
            robot.tool = nominal.tool + off * rng.choice([-1, 1], 3)
            level = copy.deepcopy(robot)  # with the nominal flange
            level.d[5], level.offset[5] = nominal.d[5], nominal.offset[5]
            bench.lengths(*robot.run(70, 3))
            low, high = np.array([[-100, 100], [-110, -40], [60, 130], [-90, 90], [30, 100], [-90, 90.]]).T  # no singularity
            q = rng.uniform(low, high, (60, 6))
            lines = [f"PTP {{A1 {a:.9f}, A2 {b:.9f}, A3 {c:.9f}, A4 {d:.9f}, A5 {e:.9f}, A6 {f:.9f}}}" for a, b, c, d, e, f in q]
            bench.text("p.src", ["DEF P()", *lines, "END"])
            at = lambda model, q, x: model.frames(q)[5][1] + model.frames(q)[5][0] @ np.array(x)
            def reached(q, x, turn):
                R, o = robot.frames(q, turn)[5]
                return o + R @ np.array(x)
            out = {}
            told = re.sub(r"ball_mm = .*", f"ball_mm = {robot.tool.tolist()}\nball_u_mm = 0.001", NOMINAL)
            sense = np.sign(np.diff(q, axis=0, prepend=np.zeros((1, 6))))
            for name, content in (("found", NOMINAL), ("told", told)):
                (bench.dir / "robot.toml").write_text(content)
                bench.identify(name, "lengths.csv", robot="robot.toml")
                bench.call("compensate", "p.src", "--robot", f"{name}/robot-identified.toml", "--out", f"{name}_p", "--limit", "50",
                           "--tool", "0,0,100,0,0,0", "--base", "0,0,0,0,0,0")
                number = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
                found = re.findall(r"PTP \{" + ", ".join(f"A{k} ({number})" for k in range(1, 7)), (bench.dir / f"{name}_p/p.src").read_text())
                corrected = np.array(found, float)
                for tcp, x in points.items():
                    p = reached(corrected, x, robot.turn(corrected, sense, np.ones(len(q))))
                    out[name, tcp] = distances(p, at(nominal, q, x)).mean()
            for tcp, x in points.items():
                p = reached(q, x, robot.turn(q, sense, np.ones(len(q))))
                out["before", tcp] = distances(p, at(nominal, q, x)).mean()
                here, sd = bench.predict("found/robot-identified.toml", q, None, "--tool", ",".join(map(str, x)))
                e = distances(here, p)
                out["e2", tcp], out["s2", tcp] = (e**2).mean(), (sd**2).mean()
                out["flange", tcp] = distances(at(robot, q, x), at(level, q, x)).mean()
            return out
        results = judge.each("tool", work, f"{off} mm")
        for tcp in points if results else ():
            before, after, told, flange, e2, s2 = (
                np.mean([r[k, tcp] for r in results]) for k in ("before", "found", "told", "flange", "e2", "s2"))
            print(f"  {off:8.1f}   {tcp:18}{before:12.3f}{after:9.4f}{told:12.4f}{flange:9.4f}{math.sqrt(s2 / e2):9.2f}")
            about = f"{off} mm, {tcp}"
            judge.limit("tool: error over that with the true ball", after / told, about)
            judge.limit("tool: error over that with the true ball and flange", after / math.hypot(told, flange), about)
            judge.limit("tool: error over that before", after / before, about)
            judge.limit("tool: p/t", math.sqrt(s2 / e2), about)


def load(judge):
    """Production with 50 kg on the flange: predicted from a calibration without it, from half of the poses with it, and from a
    bar that pulls by 20 N at half of the poses and by 50 N at the same poses again."""
    print("\nload: kept poses with 50 kg, mm\n  case                          p/t  coverage   mean error   without payload")
    option = "50," + ",".join(map(str, PAYLOAD_MM))
    for balls, poses in ((3, 70), (1, 140)):
        for kind in ("never measured", "measured", "pulled"):
            measured = kind == "measured"
            def work(i, bench):
                robot = Robot(np.random.default_rng([7, i]), "sag")
                q, sense, k, t, L = robot.run(poses, balls)
                if kind == "pulled":
                    half = len(q) // 2
                    q[half:2 * half], sense[half:2 * half], k[half:2 * half] = q[:half], sense[:half], k[:half]
                    force = np.where(np.arange(len(q)) < half, 20.0, 50.0)
                    along = robot.balls[k] - robot.visit(q, sense, t)
                    pull = force[:, None] * along / np.linalg.norm(along, axis=1)[:, None]
                    L = robot.measure(robot.visit(q, sense, t, pull=pull), k, t)
                if measured:  # the second half again, with the payload
                    again = np.arange(len(q)) >= len(q) // 2
                    carried = np.where(again, 50.0, 0.0)
                    half = len(q) // 2
                    q[half:2 * half], sense[half:2 * half], k[half:2 * half] = q[:half], sense[:half], k[:half]
                    p = robot.visit(q, sense, t, payload=carried)
                    L = robot.measure(p, k, t)
                bench.lengths(q, sense, k, t, L)
                text = NOMINAL
                if kind == "pulled":
                    header, *lines = (bench.dir / "lengths.csv").read_text().splitlines()
                    bench.text("lengths.csv", [header + ",force_n"] + [f"{a},{b}" for a, b in zip(lines, force)])
                if measured:
                    header, *lines = (bench.dir / "lengths.csv").read_text().splitlines()
                    names = ["gripper" if kg else "bar" for kg in carried]
                    bench.text("lengths.csv", [header + ",payload"] + [f"{a},{b}" for a, b in zip(lines, names)])
                    text += f"""
[[payload]]
name = "bar"
kg = 0.0
centre_mm = [0.0, 0.0, 0.0]
[[payload]]
name = "gripper"
kg = 50.0
centre_mm = {PAYLOAD_MM}
"""
                (bench.dir / "robot.toml").write_text(text)
                bench.identify("out", "lengths.csv", robot="robot.toml")
                without = bench.errors("out", *robot.kept())
                return *bench.errors("out", *robot.kept(payload=50.0), "--payload", "gripper" if measured else option), *without
            about = f"{kind}, {balls} balls"
            results = judge.each("load", work, about)
            if not results:
                continue
            e, sd, plain, _ = (np.concatenate(x) for x in zip(*results))
            ratio, coverage = np.sqrt((sd**2).mean() / (e**2).mean()), (e**2 <= 7.815 * sd**2 / 3).mean()
            print(f"  {about:26}{ratio:7.2f}{coverage:10.3f}{e.mean():13.4f}{plain.mean():18.4f}")
            judge.limit(f"load: p/t, {kind}", ratio, about)
            judge.limit(f"load: coverage, {kind}", coverage, about)
            if kind != "never measured":
                judge.limit("load: error over that without payload", e.mean() / plain.mean(), about)


def main():
    campaigns = {f.__name__: f for f in (few, honesty, no_change, changes, second_run, bar_scale, load, tool)}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dbbd", type=pathlib.Path)
    parser.add_argument("campaigns", nargs="+", metavar="CAMPAIGN", choices=[*campaigns, "all"])
    parser.add_argument("--robots", type=int, metavar="N", help="robots for each case")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--assert", dest="strict", action="store_true", help="exit code 1 if a limit is violated")
    options = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)
    Bench.dbbd = options.dbbd.resolve()
    judge = Judge(options.robots, options.jobs)
    with tempfile.TemporaryDirectory() as directory:
        q = np.random.default_rng(0).uniform(-100, 30, (100, 6))
        difference = Bench(directory).predict("nominal.toml", q)[0] - Geometry().ball(q)
        assert abs(difference).max() < 1e-6, "not the kinematics of dbbd"
    for name in campaigns if "all" in options.campaigns else options.campaigns:
        Bench.seconds.clear()
        began = time.monotonic()
        campaigns[name](judge)
        if Bench.seconds:
            print(f"  {len(Bench.seconds)} identifications, median {np.median(Bench.seconds):.2f} s, "
                  f"largest {max(Bench.seconds):.2f} s; {time.monotonic() - began:.0f} s in all")
    judge.violated += [f"{count} failed: {about}" for about, count in judge.failed.items()]
    print(f"\n{len(judge.violated)} limits violated" + "".join(f"\n  {text}" for text in judge.violated))
    return 1 if judge.violated and options.strict else 0


if __name__ == "__main__":
    sys.exit(main())
