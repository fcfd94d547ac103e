"""Plans of `dbbd plan` for a goal beside a brute-force search in numpy.

    python3 tests/independent/goal_plans.py DBBD [--goals N] [--first SEED] [--assert]

Jobs with a [goal] are drawn: a KR 60 HA or a UR10, two to four places of base balls, one or two bars, all of the reach or a box.
The criterion is that of linear Gaussian unknowns: the root mean square of the position error of the tool ball that lengths leave,
over poses of the reach or of the box, after the best rigid motion. Unknowns, with what the program takes for their sizes:
geometry within its tolerance, flange, tool ball, bar, base balls, first harmonics and smooth errors of the joints. As in
docs/explanation/identification.md, the smooth error of a joint is taken as nothing beyond the measured angles.

An accepted plan: for each bar and each set of places poses are added one after the other and exchanged, until they leave no more
than the poses of the plan, times the goal over what robots keep after the plan. Ratio: the time of the plan over that of the shortest of these runs, both by the prices of the job.
A refused goal: the least that any set leaves with 360 poses, times the most that accepted plans in the same kind of cell keep over
their criterion, is to be beyond the goal; and the refusal is to say what limits it.

With --assert a violated limit gives exit code 1. Needs numpy. Lengths in mm, angles in rad, but the controller's axis angles in
degrees.
"""
import argparse
import collections
import csv
import itertools
import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import tomllib

from simulated_robots import AXES, Geometry
import numpy as np

# Time of an accepted plan over that of the shortest run of the brute force: a plan is to be at most a quarter longer.
MAX_RATIO = 1.25
# Fewer accepted plans in the same kind of cell do not say what a plan keeps over its criterion.
MIN_LEARNT = 3
ROBOTS = ("kr60ha", "ur10")
TOOL_MM, TOOL_U_MM = [30.0, 20.0, 10.0], .5   # the second is the default of a job, a standard uncertainty
TOLERANCE = "[tolerance]\nlength_mm = 1.0\nangle_deg = 0.1\n"   # of a robot file that states none
FLANGE_MM, FLANGE_RAD = .05, math.radians(.02)
BAR_U_MM, BAR_SIGMA_MM = .004, .002           # the first is expanded, k = 2
BALL_MM = 10.0                                # of a base ball: the lengths find it in any case
REPEATABILITY = 3.616                         # ISO 9283: mean and three standard deviations of a distance, per coordinate
# Standard deviations over all robots: medians of log-normal distributions, whose logarithms have a standard deviation of 1
# (of a joint among others 0.5), times exp(variance). Smooth errors are two processes with these lengths.
HARMONIC_RAD, SMOOTH_RAD, SMOOTH_LENGTHS_RAD = 5e-4 * math.e, 1e-4 * math.exp(1.25), (.15, .5)
GOAL_POSES, CANDIDATES = 100, 250             # the second: about each place
MAX_BALLS, MIN_POSES, MAX_POSES = 4, 12, 360
POSES_OF_BRANCH = 40                          # by which branches are compared
BAR_S, BALL_S, POSE_S = 360.0, 240.0, 12.0    # the prices of the jobs
REFERENCE = 1.05                              # every twentieth pose a reference is visited
NEAR_BEST = 1.2                               # runs that are this near to the shortest one are improved
MIN_DEG, OVERHEAD_MM = 5.0, 50.0            # from a singular wrist and elbow, and of the wrist centre from axis 1


class Arm(Geometry):
    """A robot of the catalogue with its unknowns, the prior standard deviations of which are `sd`."""

    def __init__(self, name):
        text = (pathlib.Path(__file__).resolve().parents[2] / f"robots/{name}.toml").read_text()
        text += "" if "[tolerance]" in text else TOLERANCE
        super().__init__(f"{text}\n[tool]\nball_mm = {TOOL_MM}\n")
        self.sigma_mm = math.hypot(BAR_SIGMA_MM, tomllib.loads(text)["repeatability_mm"] / REPEATABILITY)
        self.reach = abs(self.a[1]) + abs(self.a[2]) + math.hypot(self.a[3], self.d[3])
        self.parallel = [i for i in range(1, 6) if abs(math.sin(self.alpha[i])) < 1e-3]
        angles, lengths = np.full(6, self.angle), np.full(6, self.length)
        self.sd = np.concatenate([angles, lengths, [*angles[:5], FLANGE_RAD], [*lengths[:5], FLANGE_MM], angles[:len(self.parallel)],
                                  [TOOL_U_MM] * 3, [HARMONIC_RAD] * 12])

    def derivatives(self, q):
        """Of the tool ball at axis angles q by alpha, a, theta, d, beta, tool and harmonics: (n, 3, unknowns)."""
        frames = [(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))), *self.frames(q)]
        p = frames[6][1] + frames[6][0] @ self.tool
        turned = lambda frame, axis: np.cross(frames[frame][0][:, :, axis], p - frames[frame][1])
        theta = [turned(i, 2) for i in range(1, 7)]
        x = np.radians(q)
        columns = [turned(i, 0) for i in range(6)] + [frames[i][0][:, :, 0] for i in range(6)] + theta
        columns += [frames[i][0][:, :, 2] for i in range(1, 7)] + [turned(i, 1) for i in self.parallel]
        columns += [frames[6][0][:, :, i] for i in range(3)]
        columns += [f(x[:, i, None]) * theta[i] for f in (np.cos, np.sin) for i in range(6)]
        return np.stack(columns, axis=2)

    def check_derivatives(self):
        """Against differences of the kinematics, by every parameter of the table and the zero of every joint."""
        q = np.random.default_rng(0).uniform(-100, 30, (20, 6))
        found, before = self.derivatives(q), self.ball(q)
        for at, field in enumerate((self.alpha, self.a, self.offset, self.d)):
            for i in range(6):
                field[i] += 1e-6
                assert abs((self.ball(q) - before) / 1e-6 - found[:, :, 6 * at + i]).max() < .01, "not a derivative"
                field[i] -= 1e-6
        for at, i in enumerate(self.parallel):
            self.beta[i] += 1e-6
            assert abs((self.ball(q) - before) / 1e-6 - found[:, :, 24 + at]).max() < .01, "not a derivative"
            self.beta[i] -= 1e-6

    def inside(self, q):
        return ((q >= self.limits[:, 0]) & (q <= self.limits[:, 1])).all(1)

    def branches(self, q):
        """The side of each of the three singular positions on which the arm is, -1 where it is too near."""
        f = self.frames(q)
        forward = ((f[4][1] - f[0][1]) * f[0][0][:, :, 0]).sum(1)
        upper, lower = f[2][1] - f[1][1], f[3][1] - f[2][1]
        elbow = np.arctan2((np.cross(upper, lower) * f[1][0][:, :, 2]).sum(1), self.flat(f, upper, lower))
        wrist = self.sign[4] * np.radians(q[:, 4]) + self.offset[4]
        near = np.minimum(abs(np.sin(elbow)), abs(np.sin(wrist))) < math.sin(math.radians(MIN_DEG))
        bits = (forward > 0) + 2 * (elbow > 0) + 4 * (np.sin(wrist) > 0)
        return np.where(near | (abs(forward) < OVERHEAD_MM), -1, bits)

    @staticmethod
    def flat(f, upper, lower):
        """The scalar product of two links in the plane that is square to axis 2."""
        along = lambda link: (link * f[1][0][:, :, 2]).sum(1)
        return (upper * lower).sum(1) - along(upper) * along(lower)

    def newton(self, q, position, rotation=None):
        """Axis angles near q, degrees, with the tool ball at a position: by axes 1 to 3 alone, or by all for a rotation of the flange. And
        which of them were found."""
        arm_mm, count = 300.0, 3 if rotation is None else 6
        for _ in range(20):
            frames = self.frames(q)
            p = frames[5][1] + frames[5][0] @ self.tool
            axes = np.stack([R[:, :, 2] for R, _ in frames[:count]], axis=2) * np.radians(self.sign[:count])
            J = np.cross(axes, np.stack([p - o for _, o in frames[:count]], axis=2), axis=1)
            away = position - p
            if rotation is not None:
                turn = rotation @ frames[5][0].transpose(0, 2, 1)
                w = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1) / 2
                away, J = np.concatenate([away, arm_mm * w], 1), np.concatenate([J, arm_mm * axes], 1)
            size = np.linalg.norm(away, axis=1)
            damped = J.transpose(0, 2, 1) @ J + 1e-3 * np.eye(count)
            q[:, :count] += np.clip(np.linalg.solve(damped, J.transpose(0, 2, 1) @ away[:, :, None])[:, :, 0], -20, 20)
        return q, size < 1e-3

    def goal_poses(self, rng, box):
        """Axis angles over which the error is taken: uniform within the limits, or of a box, the tool down within 45 degrees and the arm
        in the position that is nearest to the usual one."""
        if box is None:
            return rng.uniform(*self.limits.T, (GOAL_POSES, 6))
        home, tries = np.array([0, -60, 90, 0, 60, 0.0]), 24
        c, s = (f(rng.uniform(-np.pi / 4, np.pi / 4, (3, GOAL_POSES))) for f in (np.cos, np.sin))
        down = np.stack([np.eye(3)] * GOAL_POSES) * [1, -1, -1]
        for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            R = np.stack([np.eye(3)] * GOAL_POSES)
            R[:, i, i], R[:, j, j], R[:, i, j], R[:, j, i] = c[axis], c[axis], -s[axis], s[axis]
            down = R @ down
        position, best, off = rng.uniform(*box, (GOAL_POSES, 3)), np.zeros((GOAL_POSES, 6)), np.full(GOAL_POSES, np.inf)
        for _ in range(tries):
            q, found = self.newton(rng.uniform(-180, 180, (GOAL_POSES, 6)), position, down)
            q = home + (q - home + 180) % 360 - 180
            away = np.where(found, abs(q - home).max(1), np.inf)
            best, off = np.where((away < off)[:, None], q, best), np.minimum(away, off)
        return best[np.isfinite(off) & self.inside(best)]

    def goal_errors(self, q):
        """The position errors at poses, and the matrix that takes the rigid motions of all poses out of them, scaled so that the sum of
        the squares of its product is the mean square."""
        J, p = self.derivatives(q), self.ball(q)
        away = p - p.mean(0)
        rigid = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 3, 3)),
                                np.stack([np.cross(unit, away) for unit in np.eye(3)], axis=2)], axis=2).reshape(-1, 6)
        motions = np.linalg.qr(rigid)[0]
        rest = (np.eye(len(rigid)) - motions @ motions.T) / math.sqrt(len(q))
        J = J.reshape(len(rigid), -1)
        return Errors(J * self.sd, J[:, 12:18], np.repeat(np.radians(q), 3, axis=0)), rest

    def lengths(self, q, place, ball):
        """The errors of lengths from ball number `ball`, 0 to 3, at a place."""
        away = self.ball(q) - place
        u = away / np.linalg.norm(away, axis=1)[:, None]
        J = np.einsum("ni,nij->nj", u, self.derivatives(q))
        own = np.zeros((len(q), 3 * MAX_BALLS + 1))
        own[:, 3 * ball:3 * ball + 3], own[:, -1] = BALL_MM * u, BAR_U_MM / 2
        return Errors(np.concatenate([J * self.sd, own], 1), J[:, 12:18], np.radians(q))

    def candidates(self, rng, place, bar):
        """Poses with the tool ball at the length of the bar from a place, no axis beyond half a turn: those of each branch that has at
        least half as many as the one that has most."""
        low, high = np.clip(self.limits, -180, 180).T
        found, here = np.zeros((0, 6)), np.zeros(0, bool)
        for _ in range(40):
            u = rng.standard_normal((600, 3))
            target = place + bar * u / np.linalg.norm(u, axis=1)[:, None]
            q, reached = self.newton(rng.uniform(low, high, (600, 6)), target)
            q = (q + 180) % 360 - 180
            found = np.concatenate([found, q[reached & self.inside(q)]])
            branches = self.branches(found)
            counts = np.bincount(branches[branches >= 0], minlength=8)
            if counts.max() >= CANDIDATES:
                break
        return [found[branches == branch][:CANDIDATES] for branch in np.flatnonzero(2 * counts >= max(counts.max(), 2))]


class Errors:
    """Errors that depend linearly on the unknowns: `rows` in units of the prior, `by_joint` the derivatives by the angles of the joints,
    at axis angles x."""

    def __init__(self, rows, by_joint, x):
        self.rows, self.by_joint, self.x = rows, by_joint, x

    def covariance(self, other):
        """The prior covariance with other errors; those that do not have the last unknowns do not depend on them."""
        common = min(self.rows.shape[1], other.rows.shape[1])
        found = self.rows[:, :common] @ other.rows[:, :common].T
        for i in range(6):
            found += np.multiply.outer(self.by_joint[:, i], other.by_joint[:, i]) * smooth(self.x[:, i, None] - other.x[:, i])
        return found

    def within(self, low, high):
        """Errors at poses, three rows each, after an identification of lengths between these angles: beyond them it takes the smooth error
        of a joint as nothing, at each pose by itself as uncertain as before."""
        outside = (self.x < low - SMOOTH_LENGTHS_RAD[0]) | (self.x > high + SMOOTH_LENGTHS_RAD[0])
        alone = 1e3 * (1 + np.arange(len(self.x)) // 3)[:, None]
        return Errors(self.rows, self.by_joint, np.where(outside, alone, self.x))

    @staticmethod
    def joined(parts):
        return Errors(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("rows", "by_joint", "x")))


def smooth(apart):
    """The covariance of the smooth errors of a joint at angles that are this far apart: Matern's with the exponent 5/2."""
    found = 0.0
    for length in SMOOTH_LENGTHS_RAD:
        r = math.sqrt(5) / length * abs(apart)
        found = found + (1 + r + r * r / 3) * np.exp(-r)
    return SMOOTH_RAD**2 * found


class Choice:
    """Lengths that are chosen among candidates. `known` is the covariance of the lengths that is left by those that are chosen,
    `left` that of the goal's errors with them, `square` the mean square of the goal's errors."""

    def __init__(self, lengths, goal, noise_mm):
        errors, rest = goal
        self.known, self.left = lengths.covariance(lengths), rest @ errors.covariance(lengths)
        self.square = np.einsum("ij,jk,ik->", rest, errors.covariance(errors), rest, optimize=True)
        self.variance, self.chosen, self.change = noise_mm**2, [], np.empty_like(self.known)

    def take(self, j, sign=1):
        """Takes a length, or gives it back."""
        v, w = self.known[:, j].copy(), self.left[:, j].copy()
        q = sign / (self.variance + sign * v[j])
        self.known -= np.outer(q * v, v, out=self.change)
        self.left -= np.outer(q * w, v)
        self.square -= q * (w @ w)
        self.chosen.append(j) if sign > 0 else self.chosen.remove(j)

    def gains(self, sign=1):
        return (self.left**2).sum(0) / (self.variance + sign * np.diag(self.known))

    def best(self):
        gains = self.gains()
        gains[self.chosen] = -1
        return gains.argmax()

    def start(self, ball_of):
        """Four poses about each ball, which show where it is."""
        for ball in range(max(ball_of) + 1):
            for _ in range(4):
                size = np.diag(self.known) * (ball_of == ball)
                size[self.chosen] = -1
                self.take(size.argmax())

    def extend(self, square, most):
        """Adds poses until they leave this mean square; whether they do."""
        while self.square > square or len(self.chosen) < MIN_POSES:
            if len(self.chosen) >= min(most, len(self.known)):
                return False
            self.take(self.best())
        return True

    def shorten(self, square):
        """Gives back poses and exchanges the others, as long as they leave no more than this mean square; how many remain."""
        while len(self.chosen) > MIN_POSES:
            costs = self.gains(-1)
            self.take(min(self.chosen, key=lambda j: costs[j]), -1)
            for j in list(self.chosen):
                if self.square <= square:
                    break
                self.take(j, -1)
                self.take(self.best())
            if self.square > square:
                return len(self.chosen) + 1
        return len(self.chosen)


def rms_mm(lengths, goal, noise_mm):
    """The criterion of lengths, without updates."""
    errors, rest = goal[0].within(lengths.x.min(0), lengths.x.max(0)), goal[1]
    by_length = rest @ errors.covariance(lengths)
    found = np.linalg.solve(lengths.covariance(lengths) + noise_mm**2 * np.eye(len(lengths.x)), by_length.T)
    return math.sqrt((rest @ errors.covariance(errors) @ rest.T).trace() - (by_length.T * found).sum())


class Search:
    """All bars with all sets of at most four places that have poses. About a place they are in the branch in which poses about it alone
    leave least: of a UR10 all branches have as many poses."""

    def __init__(self, job, rng):
        self.arm = job.arm
        self.goal = job.arm.goal_errors(job.arm.goal_poses(rng, job.box))
        self.places = job.places
        self.about = {bar: [self.best_branch(place, job.arm.candidates(rng, place, bar)) for place in job.places] for bar in job.bars}
        sizes = range(1, min(MAX_BALLS, len(job.places)) + 1)
        sets = [chosen for size in sizes for chosen in itertools.combinations(range(len(job.places)), size)]
        self.runs = [(bar, chosen) for bar in job.bars for chosen in sets
                     if all(len(self.about[bar][at]) >= 40 for at in chosen)]

    def best_branch(self, place, branches):
        def left(q):
            choice = self.choice(self.arm.lengths(q, place, 0), np.zeros(len(q), int))
            choice.extend(0.0, POSES_OF_BRANCH)
            return choice.square
        return min(branches, key=left, default=np.zeros((0, 6)))

    def lengths(self, run):
        bar, chosen = run
        return Errors.joined([self.arm.lengths(self.about[bar][at], self.places[at], ball) for ball, at in enumerate(chosen)])

    def choice_of(self, run):
        return self.choice(self.lengths(run), np.repeat(np.arange(len(run[1])), [len(self.about[run[0]][at]) for at in run[1]]))

    def choice(self, lengths, ball_of):
        errors, rest = self.goal
        # The chosen poses reach nearly as far as all of them.
        goal = errors.within(*np.quantile(lengths.x, [.02, .98], axis=0)), rest
        choice = Choice(lengths, goal, self.arm.sigma_mm)
        choice.start(ball_of)
        return choice

    def shortest(self, target_mm):
        """The shortest run that leaves at most this: its time in s, bar, places and number of poses."""
        found, best_s = [], math.inf
        time_s = lambda run, poses: BAR_S + BALL_S * len(run[1]) + REFERENCE * POSE_S * poses
        for run in self.runs:
            choice, left_s = self.choice_of(run), NEAR_BEST * best_s - time_s(run, 0)
            if choice.extend(target_mm**2, min(MAX_POSES, left_s / (REFERENCE * POSE_S))):
                found.append((time_s(run, len(choice.chosen)), run, choice))
                best_s = min(best_s, found[-1][0])
        improved = [(time_s(run, poses), run, poses) for greedy_s, run, choice in found if greedy_s <= NEAR_BEST * best_s
                    for poses in [choice.shorten(target_mm**2)]]
        return min(improved, default=(math.inf, None, 0))

    def min_mm(self):
        """The least that any run leaves, and its bar and places."""
        least = []
        for run in self.runs:
            choice = self.choice_of(run)
            choice.extend(0.0, MAX_POSES)
            least.append((math.sqrt(choice.square), run))
        return min(least, default=(math.inf, None))


class Job:
    """A job that is drawn: see `drawn_job` of tests/suite/goals_are_reached.rs."""

    def __init__(self, rng, arms):
        self.robot = str(rng.choice(ROBOTS))
        self.arm = arm = arms[self.robot]
        self.box = None
        in_box = rng.random() < .5
        self.goal_mm = round((.15 if in_box else .5) * 8**rng.random(), 3)
        if in_box:
            centre = np.array([rng.uniform(.45, .6), 0, rng.uniform(.2, .4)]) * arm.reach
            self.box = np.round([centre - .12 * arm.reach, centre + .12 * arm.reach])
        self.bars = [round(share * arm.reach) for share in (.2, .35)[:rng.integers(1, 3)]]
        at = np.arange(rng.integers(2, 5))
        angle, away = 1.4 * at - 2 + rng.uniform(-.4, .4, len(at)), arm.reach * rng.uniform(.4, .65, len(at))
        self.places = np.stack([away * np.cos(angle), away * np.sin(angle), arm.reach * rng.uniform(.05, .6, len(at))], 1).round(1)
        self.kind = f"{self.robot}, {'box' if in_box else 'reach'}"

    def text(self):
        lines = [f'robot = "{self.robot}"', "[tool]", f"ball_mm = {TOOL_MM}", "[bar]", "stroke_mm = [-25.0, 25.0]",
                 f"length_u_mm = {BAR_U_MM}", f"sigma_um = {1e3 * BAR_SIGMA_MM}", "[motion]", "feed_mm_s = 150.0", "[limits]",
                 f"min_overhead_mm = {OVERHEAD_MM}", f"min_a5_deg = {MIN_DEG}", f"min_elbow_deg = {MIN_DEG}",
                 "[goal]", f"position_mm = {self.goal_mm}", f"minutes_per_ball = {BALL_S / 60}", f"minutes_per_bar = {BAR_S / 60}",
                 f"seconds_per_pose = {POSE_S}"]
        lines += [] if self.box is None else [f"region_mm = {self.box.tolist()}"]
        lines += [f"[[bar_choice]]\nlength_mm = {bar}.0" for bar in self.bars]
        lines += [f"[[place]]\nxyz_mm = {place.tolist()}" for place in self.places]
        return "\n".join(lines) + "\n"


def plan(dbbd, job, directory):
    """The directory of the plan, or what the refusal says."""
    (directory / "job.toml").write_text(job.text())
    done = subprocess.run([dbbd, "plan", "job.toml", "--out", "plan"], cwd=directory, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"exit code {done.returncode}: {done.stderr[-400:]}")
    return (directory / "plan", None) if done.returncode == 0 else (None, done.stderr)


class Plan:
    """The dwells of a plan: their errors, and their time in s."""

    def __init__(self, job, directory):
        chosen = tomllib.loads((directory / "job.toml").read_text())
        with open(directory / "plan.csv") as file:
            rows = [row for row in csv.DictReader(file) if row["kind"] != "transit"]
        parts, bar = [], round(chosen["bar"]["length_mm"])
        for centre in chosen["centre"]:
            here = [row for row in rows if int(row["centre"]) == centre["id"]]
            q, xyz = (np.array([[float(row[key]) for key in keys] for row in here]) for keys in (AXES, ("x_mm", "y_mm", "z_mm")))
            assert abs(job.arm.ball(q) - xyz).max() < .02, "not the kinematics of dbbd"
            at = np.linalg.norm(job.places - centre["xyz_mm"], axis=1).argmin()
            parts.append(job.arm.lengths(q, job.places[at], len(parts)))
        self.lengths, self.time_s = Errors.joined(parts), BAR_S + BALL_S * len(parts) + POSE_S * len(rows)
        self.text = f"bar {bar} mm, {len(parts)} balls, {len(rows)} dwells"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dbbd", type=pathlib.Path)
    parser.add_argument("--goals", type=int, default=40, metavar="N", help="jobs")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="seed of the first job")
    parser.add_argument("--assert", dest="strict", action="store_true", help="exit code 1 if a limit is violated")
    options = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)
    arms = {name: Arm(name) for name in ROBOTS}
    for arm in arms.values():
        arm.check_derivatives()
    ratios, kept, refused, violated, began = [], collections.defaultdict(list), [], [], time.monotonic()
    for seed in range(options.first, options.first + options.goals):
        rng = np.random.default_rng(seed)
        job = Job(rng, arms)
        about = f"{seed:3} {job.kind:13} goal {job.goal_mm:.3f} mm"
        with tempfile.TemporaryDirectory() as directory:
            planned, refusal = plan(options.dbbd.resolve(), job, pathlib.Path(directory))
            if refusal is not None:
                min_mm, run = Search(job, rng).min_mm()
                refused.append((about, job, refusal, min_mm, run))
                continue
            header = json.loads((planned / "plan.json").read_text())
            if header.get("stage"):
                print(f"{about}: a stage, not compared")
                continue
            found = Plan(job, planned)
        search = Search(job, rng)
        criterion_mm = rms_mm(found.lengths, search.goal, job.arm.sigma_mm)
        reached_mm = header["goal"]["reached_mm"]
        # A plan may leave less than the goal: the brute force is to reach the goal, by what robots keep over the criterion.
        best_s, run, poses = search.shortest(criterion_mm * max(job.goal_mm / reached_mm, 1.0))
        # Where no run of the brute force leaves as little, none is shorter.
        ratios.append(found.time_s / best_s if run else 1.0)
        kept[job.kind].append(reached_mm / criterion_mm)
        print(f"{about}: reached {reached_mm:.3f}, criterion {criterion_mm:.3f}, {found.text}, {found.time_s / 60:.0f} min; brute force "
              f"{run and f'bar {run[0]} mm, {len(run[1])} balls, {poses} poses'}, {best_s / 60:.0f} min: ratio {ratios[-1]:.3f}")
        if ratios[-1] > MAX_RATIO:
            violated.append(f"{about}: ratio {ratios[-1]:.3f}")
    judged = 0
    for about, job, refusal, min_mm, run in refused:
        codes = sorted(set(re.findall(r"\b[EI]\d{4}\b", refusal)))
        stated = re.search(r"leaves ([\d.]+) mm", refusal)
        of_kind = kept.get(job.kind, [])
        kept_mm = min_mm * max(of_kind, default=math.nan)
        is_judged = len(of_kind) >= MIN_LEARNT
        judged += is_judged
        print(f"{about}: refused by {' '.join(codes)}, best {stated[1] if stated else '?'} mm; brute force leaves {min_mm:.3f}, robots "
              f"keep {kept_mm:.3f} mm, {run and f'bar {run[0]} mm, {len(run[1])} balls'}{'' if is_judged else ', not judged'}")
        if is_judged and kept_mm <= job.goal_mm:
            violated.append(f"{about}: refused, but {kept_mm:.3f} mm can be kept")
        if not ("E0750" in codes and any(code in codes for code in ("I0751", "I0752", "I0753"))):
            violated.append(f"{about}: the refusal names no limit: {' '.join(codes)}")
    print(f"\n{options.goals} goals, {len(ratios)} compared: ratio {np.mean(ratios or [0]):.3f} in the mean, "
          f"{max(ratios, default=0):.3f} at most; {len(refused)} refused, {judged} judged; {time.monotonic() - began:.0f} s")
    for kind, values in sorted(kept.items()):
        print(f"  {kind}: {len(values)} plans keep {min(values):.2f} to {max(values):.2f} times their criterion")
    print(f"{len(violated)} limits violated" + "".join(f"\n  {text}" for text in violated))
    return 1 if violated and options.strict else 0


if __name__ == "__main__":
    sys.exit(main())
