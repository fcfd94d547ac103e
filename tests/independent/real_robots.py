"""How accurate and how honest `dbbd identify` is on data of real robots, at poses that it did not see. Needs numpy and scipy.

    python3 tests/independent/real_robots.py DBBD --shared DIR [--jobs N] [--only NAME] [--splits K..] [--assert]
        [--keep DIR]

UR5 and UR10 (Universal Robots, laser tracker) are in fixtures/real. DIR/data has measurements that are not part of the
project: kr60 (KUKA KR60, laser tracker), ur10/grid.csv (the UR10 four months before) and irb120_drawwire (ABB IRB 120). --only takes the cases with NAME in their name, --keep leaves all files.

Tracked robots: a case is the robot, the number of poses to learn, the input (lengths to three balls or one, or
positions), and whether the sense of approach is known. Lengths of UR5 and UR10 are those to virtual balls. Split K
learns the first poses of numpy.random.default_rng(K).permutation(N) and keeps the next 1000 at most. The KR60 keeps 35
poses, and has twelve splits; the others have three. `dbbd predict`
says where the ball is at the kept poses; after one best rigid alignment of a split this is compared with where it was.
    error     mean 3-D error, mm
    p/t       predicted over true: root of the sum of sd^2 over that of error^2, all splits together
    coverage  share of the poses whose error e is in the 95 % ellipsoid of its covariance C with nu degrees of freedom:
              e' C^-1 e / 3 <= F(0.95; 3, nu)
    seconds   wall time of one `identify`, without cross-validation
Checks: after the same identification `dbbd check` of 24 other poses, which 20 splits draw; the robot did not change.
    changed   checks that find a change although there is none; of all together at most the 99 % quantile of the rate that
              they state
Draw-wire: row i is kept in fold i mod 12.
    rms       of the residuals of the kept lengths, mm; `worst` is that of the worst fold (10 lengths)
    zeros     folds in which a zero changed or something was subtracted (W1333, W1331)

Exit code 1 if a command fails, or with --assert if a figure is beyond its limit; 2 for wrong usage or without data.
"""
import argparse
import collections
import concurrent.futures
import csv
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from scipy.stats import binom, f as fisher

# The limits of --assert.
ERROR = {                      # mean 3-D error at most, mm: with the sense of approach, without
    "kr60 105 three balls": (0.055, 0.103),
    "kr60 105 one ball": (0.138, 0.154),
    "ur5 700 three balls": (0.052, 0.056),
    "ur5 300 one ball": (0.101, 0.101),
    "ur10 300 three balls": (0.096, 0.105),
    "ur10-july 300 three balls": (0.099, 0.112),
}
RATIO = (0.7, 1.5)             # p/t of each case
MEAN_RATIO = (0.9, 1.15)       # geometric mean of p/t over all cases; not with --only
COVERAGE = (0.85, 1.0)
CHECKED, CHECKS = 24, range(21, 41)  # poses of a check, and its splits
WIRE_RMS = 0.31                # mm, in every mode, and no zero changed

Source = collections.namedtuple("Source", "files robot tool learn frame splits")
SOURCES = {
    "kr60": Source(["kr60/three_balls_approach.csv"], "kr60ha", "0,0,104", [105], "robot base", range(5, 17)),
    "ur5": Source(["ur5/grid.csv"], "ur5", "0,0,0", [300, 700], "robot base", range(5, 8)),
    "ur10": Source(["ur10/random.csv"], "ur10", "0,0,93", [300, 1000], "tracker", range(5, 8)),
    "ur10-july": Source(["ur10/grid.csv"], "ur10", "0,0,93", [300], "tracker", range(5, 8)),
}
FIXTURES = pathlib.Path(__file__).resolve().parents[2] / "fixtures/real"
KEPT = 1000                    # poses, at most
VIRTUAL = np.array([[0.0, 0, -500], [400, 300, 0], [-300, 400, 200]])
TAPED = np.array([[270.0, -1490, 530], [760, -1570, 1030], [340, -1000, 1230]])  # base balls of the KR60, to 10 mm
# Their exact triangle: the fit of all lengths gives its sides to 2 um as the roots of 500000, 740000, 540000 mm^2.
TRIANGLE = np.array([[0.0, 0, 0], [500, 0, 500], [0, 500, 700]])
AXES, SENSE = [f"a{i}_deg" for i in range(1, 7)], [f"approach{i}" for i in range(1, 7)]
XYZ = ["x_mm", "y_mm", "z_mm"]

WIRE_MODES = {"default": [], "geometric": ["--model", "geometric"], "datasheet": ["--prior", "datasheet"]}
WIRE_FOLDS = 12
WIRE_END = np.array([[220.0, -470, -40]])
IRB120 = 'name = "ABB IRB 120"\nconvention = "modified-dh"\n' + "".join(
    f"[[joint]]\nalpha_deg = {alpha}\na_mm = {a}\ntheta_offset_deg = {theta}\nd_mm = {d}\nsign = 1\n"
    f"limits_deg = [-{limit}, {limit}]\nmax_speed_deg_s = {speed}\n"
    for alpha, a, theta, d, limit, speed in [
        (0, 0, 0, 290, 165, 250), (-90, 0, -90, 0, 110, 250), (0, 270, 0, 0, 110, 250),
        (-90, 70, 0, 302, 160, 320), (90, 0, 0, 0, 120, 320), (-90, 0, 180, 72, 400, 420)]
) + "[tool]\nball_mm = [7, -2, 48]\n[tolerance]\nlength_mm = 0.5\nangle_deg = 0.05\n"

Case = collections.namedtuple("Case", "robot learn input sense")


# ---- tables and commands

def read(path, columns):
    with open(path, newline="") as file:
        return np.array([[float(row[name]) for name in columns] for row in csv.DictReader(file)])


def senses(axes):
    """The sense in which each axis came to each pose of a series, in the order in which it was measured; 0: not known."""
    found = np.zeros(axes.shape, int)
    for at in range(1, len(axes)):
        moved = np.sign(axes[at] - axes[at - 1])
        found[at] = np.where(moved != 0, moved, found[at - 1])
    return found


def write(path, columns, *parts):
    """Columns side by side as a CSV file; whole numbers without a point."""
    with open(path, "w", newline="") as file:
        rows = np.column_stack(parts).tolist()
        csv.writer(file).writerows([columns] + [[int(x) if x == int(x) else repr(x) for x in row] for row in rows])


def run(dbbd, at, *arguments, known=(0, 3)):
    """Runs a command in a directory; a warning (exit code 3) is no failure. The wall time, s."""
    begin = time.monotonic()
    done = subprocess.run([dbbd, *arguments], cwd=at, capture_output=True, text=True, errors="replace",
                          stdin=subprocess.DEVNULL, env={**os.environ, "NO_COLOR": "1"})
    if done.returncode not in known:
        said = (done.stderr.strip() or "nothing said").splitlines()
        raise RuntimeError(f"{arguments[0]} in {at.name}: exit code {done.returncode}: {' | '.join(said[:3])}")
    return time.monotonic() - begin


def identify(dbbd, at, *arguments):
    """The result and the wall time, s."""
    seconds = run(dbbd, at, "identify", *arguments, "--out", "o", "--folds", "0")
    return json.loads((at / "o/result.json").read_text()), seconds


def predict(dbbd, at, columns, *parts, robot="o/robot-identified.toml"):
    """Places of the tool ball at these axis angles, their covariances, and the degrees of freedom of these."""
    write(at / "axes.csv", columns, *parts)
    run(dbbd, at, "predict", "axes.csv", "--robot", robot, "--out", "p.csv")
    table = read(at / "p.csv", XYZ + ["cxx", "cxy", "cxz", "cyy", "cyz", "czz", "nu"])
    return table[:, :3], table[:, 3:9][:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]], table[:, 9]


# ---- geometry

def aligned(moved, fixed):
    """The best rigid motion of places onto others, as a function."""
    a, b = moved.mean(0), fixed.mean(0)
    u, _, v = np.linalg.svd((moved - a).T @ (fixed - b))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return lambda places: (places - a) @ turn + b


def trilaterated(lengths, there):
    """The places with these lengths to the three balls of the KR60, beside predicted ones."""
    balls, places = aligned(TRIANGLE, TAPED)(TRIANGLE), there
    for step in range(60):
        if step == 30:  # once more from predictions in the frame of the balls: a place may be near their plane
            places = aligned(there, places)(there)
        away = places[:, None] - balls
        distance = np.linalg.norm(away, axis=2, keepdims=True)
        places = places + np.linalg.solve(away / distance, lengths[..., None] - distance)[..., 0]
    return places


# ---- tracked robots

class Robot:
    """What was measured on a robot: axis angles, senses of approach, lengths to three balls, and places if known."""

    def __init__(self, dbbd, source, data, at):
        self.dbbd, self.options = dbbd, ["--robot", source.robot, "--tool", source.tool]
        if source.robot == "kr60ha":
            table = read(data / source.files[0], AXES + SENSE + ["sigma_mm", "length_mm", "centre"])
            one, *_ = balls = [table[table[:, -1] == ball] for ball in (1, 2, 3)]
            assert all((ball[:, :13] == one[:, :13]).all() for ball in balls), "the balls have other poses"
            self.lengths, self.sigma = np.column_stack([ball[:, 13] for ball in balls]), one[:, 12:13]
            self.places, self.start = None, TAPED
        else:
            series = [read(at / file, AXES + XYZ) for file in source.files
                      for at in [FIXTURES if (FIXTURES / file).exists() else data]]
            one = np.vstack([np.hstack([rows[:, :6], senses(rows[:, :6]), rows[:, 6:]]) for rows in series])
            self.places, self.sigma = one[:, 12:], one[:, :0]
        self.axes, self.sense = one[:, :6], one[:, 6:12]
        if self.places is not None:
            self.add_virtual_balls(source, at)

    def add_virtual_balls(self, source, at):
        """Lengths from the places; the balls start at their true places in the robot base to 10 mm."""
        balls = self.places.mean(0) + max(np.ptp(self.places, axis=0).mean(), 300) / 1000 * VIRTUAL
        self.lengths = np.linalg.norm(self.places[:, None] - balls, axis=2)
        if source.frame == "tracker":
            nominal = pathlib.Path(__file__).resolve().parents[2] / f"robots/{source.robot}.toml"
            at.mkdir(parents=True)
            (at / "nominal.toml").write_text(nominal.read_text() + f"\n[tool]\nball_mm = [{source.tool}]\n")
            there, *_ = predict(self.dbbd, at, AXES, self.axes, robot="nominal.toml")
            balls = aligned(self.places, there)(balls)
        self.start = balls.round(-1)

    def observations(self, at, poses, case):
        """Writes what a case learns from; the arguments of `identify`."""
        names = AXES + ["sigma_mm"] * self.sigma.shape[1] + SENSE * case.sense
        given = [self.axes[poses], self.sigma[poses]] + [self.sense[poses]] * case.sense
        if case.input == "positions":
            write(at / "obs.csv", names + XYZ, *given, self.places[poses])
            return ["obs.csv", *self.options]
        count = 3 if case.input == "three balls" else 1
        rows = np.vstack([np.column_stack([np.full(len(poses), k + 1), *given, self.lengths[poses, k]])
                          for k in range(count)])
        write(at / "obs.csv", ["index", "centre"] + names + ["length_mm"], np.arange(len(rows)) + 1, rows)
        write(at / "C.csv", ["centre"] + XYZ, np.arange(count) + 1, self.start[:count])
        return ["obs.csv", *self.options, "--centres", "C.csv"]

    def kept(self, at, case, split):
        """Learns a split: errors at the kept poses, their predicted squares, whether they are inside their regions, seconds."""
        at.mkdir(parents=True)
        order = np.random.default_rng(split).permutation(len(self.axes))
        poses = order[case.learn:case.learn + KEPT]
        _, seconds = identify(self.dbbd, at, *self.observations(at, order[:case.learn], case))
        given = [self.axes[poses]] + [self.sense[poses]] * case.sense
        there, covariances, freedom = predict(self.dbbd, at, AXES + SENSE * case.sense, *given)
        places = trilaterated(self.lengths[poses], there) if self.places is None else self.places[poses]
        off = aligned(places, there)(places) - there
        deviates = np.einsum("ni,ni->n", off, np.linalg.solve(covariances, off[..., None])[..., 0])
        squares = np.trace(covariances, axis1=1, axis2=2)
        return np.linalg.norm(off, axis=1), squares, deviates / 3 <= fisher.ppf(0.95, 3, freedom), seconds


    def checked(self, at, case, split):
        """Learns a split and checks other poses of the unchanged robot: whether it is said to have changed, and the stated rate."""
        at.mkdir(parents=True)
        order = np.random.default_rng(split).permutation(len(self.axes))
        identify(self.dbbd, at, *self.observations(at, order[:case.learn], case))
        observations, *_ = self.observations(at, order[case.learn:case.learn + CHECKED], case)
        run(self.dbbd, at, "check", observations, "--robot", "o/robot-identified.toml", "--centres", "C.csv", "--out", "c",
            known=(0, 1, 3))
        test = json.loads((at / "c/check.json").read_text())["test"]
        return test["changed"], test["false_alarm"]


def tracked_line(case, splits):
    """The line of a case, its p/t, and what is beyond the limits."""
    errors, squares, inside = (np.concatenate([split[part] for split in splits]) for part in range(3))
    mean, ratio, coverage = errors.mean(), math.sqrt(squares.sum() / (errors ** 2).sum()), inside.mean()
    most = ERROR.get(f"{case.robot} {case.learn} {case.input}", (math.inf, math.inf))[0 if case.sense else 1]
    beyond = [f"{name} {value:.4f}, limits {low} to {high}" for name, value, (low, high) in
              [("error", mean, (0, most)), ("p/t", ratio, RATIO), ("coverage", coverage, COVERAGE)]
              if not low <= value <= high]
    seconds = np.mean([split[3] for split in splits])
    return f"{mean:8.4f}{ratio:8.3f}{coverage:10.3f}{seconds:9.2f}{len(errors):8d}", [ratio], beyond


def false_alarms(checks):
    """Prints how many checks of unchanged robots find a change, and says if they are too many."""
    changed, rate = sum(changed for changed, _ in checks), checks[0][1]
    most = int(binom.ppf(0.99, len(checks), rate))
    print(f"{'all checks':32}{changed:8d}{len(checks):8d}  at most {most} at the stated {rate:.0%}")
    return [f"{changed} of {len(checks)} checks of unchanged robots find a change, at most {most}"] * (changed > most)


# ---- the draw-wire

def wire_fold(dbbd, data, at, mode, fold):
    """Residuals of the kept lengths of a fold, and the codes of a changed zero."""
    at.mkdir(parents=True)
    (at / "irb120.toml").write_text(IRB120)
    columns = ["index", "centre"] + AXES + ["length_mm", "sigma_mm"]
    rows = read(data / "irb120_drawwire/lengths.csv", columns)
    is_kept = np.arange(len(rows)) % WIRE_FOLDS == fold
    write(at / "obs.csv", columns, rows[~is_kept])
    write(at / "C.csv", ["centre"] + XYZ, [1], WIRE_END)
    result, _ = identify(dbbd, at, "obs.csv", "--robot", "irb120.toml", "--centres", "C.csv", *WIRE_MODES[mode])
    there, *_ = predict(dbbd, at, AXES, rows[is_kept, 2:8])
    found = {p["name"]: p["identified"] for p in result["parameters"]}
    away = np.linalg.norm(there - [found[f"centre1_{axis}"] for axis in "xyz"], axis=1)
    codes = {finding["code"] for finding in result["findings"]} & {"W1333", "W1331"}
    return rows[is_kept, 8] - away - found["bar_offset"], codes


def wire_line(folds):
    """The line of a mode, and what is beyond the limits."""
    rms, worst = (math.sqrt(how([np.mean(residuals ** 2) for residuals, _ in folds])) for how in (np.mean, max))
    changed, codes = sum(bool(found) for _, found in folds), " ".join(sorted(set.union(*[c for _, c in folds])))
    beyond = [f"rms {rms:.3f} mm, at most {WIRE_RMS}"] * (rms > WIRE_RMS)
    beyond += [f"a zero changed in {changed} folds ({codes})"] * (changed > 0)
    return f"{rms:8.3f}{worst:8.3f}{changed:8d} {codes}", [], beyond


# ---- the campaign

def campaign(args, work):
    """Runs the cases and prints their lines; failures of commands, and figures beyond the limits."""
    data, failed, beyond, ratios = args.shared / "data", [], [], []
    cases = {f"{robot} {learn} {kind}, {'sense' if sense else 'no sense'}": Case(robot, learn, kind, sense)
             for robot, source in SOURCES.items() for learn in source.learn
             for kind in ["three balls", "one ball"] + ["positions"] * (robot != "kr60") for sense in (True, False)}
    cases = {name: case for name, case in cases.items() if args.only in name}
    modes = {f"irb120 draw-wire, {mode}": mode for mode in WIRE_MODES if args.only in f"irb120 draw-wire, {mode}"}
    checked = {f"{robot} {min(source.learn[-1], 400)} {kind}, checks": Case(robot, min(source.learn[-1], 400), kind, True)
               for robot, source in SOURCES.items() for kind in ("three balls", "one ball")}
    checked = {name: case for name, case in checked.items() if args.only in name}
    if not cases and not modes and not checked:
        sys.exit(f"no case has {args.only} in its name")
    robots = {name: Robot(args.dbbd, SOURCES[name], data, work / name) for name in {case.robot for case in (cases | checked).values()}}

    def directory(name):
        return name.replace(",", "").replace(" ", "-")

    def line(name, parts, make):
        """Prints the line of a case when all its parts are done."""
        try:
            text, more, faults = make([part.result() for part in parts])
        except (RuntimeError, OSError, KeyError, ValueError, np.linalg.LinAlgError) as why:
            failed.append(f"{name}: {why}")
            text, more, faults = f"{'failed':>8}", [], []
        print(f"{name:32}{text}", flush=True)
        ratios.extend(more)
        beyond.extend(f"{name}: {fault}" for fault in faults)

    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        tracked = {name: [pool.submit(robots[case.robot].kept, work / directory(name) / str(k), case, k)
                          for k in args.splits or SOURCES[case.robot].splits] for name, case in cases.items()}
        wire = {name: [pool.submit(wire_fold, args.dbbd, data, work / directory(name) / str(fold), mode, fold)
                       for fold in range(WIRE_FOLDS)] for name, mode in modes.items()}
        checks = {name: [pool.submit(robots[case.robot].checked, work / directory(name) / str(k), case, k) for k in CHECKS]
                  for name, case in checked.items()}
        if cases:
            print(f"{'':32}{'error':>8}{'p/t':>8}{'coverage':>10}{'seconds':>9}{'poses':>8}")
        for name, parts in tracked.items():
            line(name, parts, lambda splits: tracked_line(cases[name], splits))
        if ratios:
            mean = math.exp(np.log(ratios).mean())
            print(f"{'geometric mean':32}{mean:16.3f}")
            if not args.only and not MEAN_RATIO[0] <= mean <= MEAN_RATIO[1]:
                beyond.append(f"geometric mean of p/t {mean:.3f}, limits {MEAN_RATIO[0]} to {MEAN_RATIO[1]}")
        if checks:
            print(f"\n{'':32}{'changed':>8}{'checks':>8}")
        for name, parts in checks.items():
            line(name, parts, lambda found: (f"{sum(changed for changed, _ in found):8d}{len(found):8d}", [], []))
        if checks:
            beyond.extend(false_alarms([part.result() for parts in checks.values() for part in parts]))
        if wire:
            print(f"\n{'':32}{'rms':>8}{'worst':>8}{'zeros':>8}")
        for name, parts in wire.items():
            line(name, parts, wire_line)
    return failed, beyond


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("dbbd", type=pathlib.Path)
    parser.add_argument("--shared", type=pathlib.Path, required=True, metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--only", default="", metavar="NAME")
    parser.add_argument("--splits", type=int, nargs="+", metavar="K")
    parser.add_argument("--assert", action="store_true", dest="is_asserted", help="check the limits")
    parser.add_argument("--keep", type=pathlib.Path, metavar="DIR", help="working directory, must be empty")
    args = parser.parse_args()
    args.dbbd, args.shared = args.dbbd.resolve(), args.shared.resolve()
    if not (args.shared / "data").is_dir() or not args.dbbd.is_file():
        parser.error("DBBD or DIR/data is not there")
    if args.keep and args.keep.is_dir() and any(args.keep.iterdir()):
        parser.error(f"{args.keep} is not empty")
    with tempfile.TemporaryDirectory() as temporary:
        try:
            failed, beyond = campaign(args, pathlib.Path(args.keep or temporary).resolve())
        except RuntimeError as why:
            sys.exit(f"failed: {why}")
    for title, texts in (("failed", failed), ("beyond the limits", beyond)):
        if texts:
            print(f"\n{title}:\n  " + "\n  ".join(texts))
    sys.exit(1 if failed or (args.is_asserted and beyond) else 0)


if __name__ == "__main__":
    main()
