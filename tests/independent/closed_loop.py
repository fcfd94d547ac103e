"""The closed loop of docs/explanation/accuracy.md computed apart from dbbd, in numpy: robots drawn from the tolerance, lengths with noise at
the poses of a plan, the likeliest robot, and a production program in a 1 m cube before and after compensation; and what
a sag of joints 2 and 3 leaves in lengths that a geometric model is fitted to.

    python tests/independent/closed_loop.py PLAN.csv [robots/kr60ha.toml]     (numpy, scipy)
"""
import csv
import sys
import tomllib

import numpy as np
from scipy.stats import chi2, ncx2

SIGMA = 0.02                                  # of one length, mm
BALL = np.array([1300.0, 0.0, 800.0])
OFF = np.array([0.8, -0.5, 0.3])              # where the ball truly stands, against the job
ROBOTS = 60

TOOL = [30.0, 20.0, 10.0]                     # the ball on the flange, in the job
robot = tomllib.load(open(sys.argv[2] if len(sys.argv) > 2 else "robots/kr60ha.toml", "rb"))
joints = robot["joint"]
column = lambda key, default=0.0: np.array([j.get(key, default) for j in joints], float)
SIGN, LIMITS = column("sign", 1), np.array([j["limits_deg"] for j in joints])
# alpha0-5, a0-5, theta1-6, d1-6, beta2, tool
NOMINAL = np.concatenate([np.radians(column("alpha_deg")), column("a_mm"), np.radians(column("theta_offset_deg")),
                          column("d_mm"), [0.0], TOOL])
MM, RAD = robot["tolerance"]["length_mm"], np.radians(robot["tolerance"]["angle_deg"])
SD = np.array([RAD] * 6 + [MM] * 6 + [RAD] * 6 + [MM] * 6 + [RAD] + [0.1] * 3)


def frames(p, q):
    """The six link frames: Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)."""
    here, all_frames = np.tile(np.eye(4), (len(q), 1, 1)), []
    for i in range(6):
        (ca, sa), angle = (np.cos(p[i]), np.sin(p[i])), SIGN[i] * q[:, i] + p[12 + i]
        (ct, st), d = (np.cos(angle), np.sin(angle)), p[18 + i]
        row = np.zeros((len(q), 4, 4))
        row[:, 0, 0], row[:, 0, 1], row[:, 0, 3] = ct, -st, p[6 + i]
        row[:, 1, 0], row[:, 1, 1], row[:, 1, 2], row[:, 1, 3] = st * ca, ct * ca, -sa, -sa * d
        row[:, 2, 0], row[:, 2, 1], row[:, 2, 2], row[:, 2, 3] = st * sa, ct * sa, ca, ca * d
        row[:, 3, 3] = 1.0
        if i == 2:
            c, s = np.cos(p[24]), np.sin(p[24])
            row = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]]) @ row
        here = here @ row
        all_frames.append(here)
    return all_frames


def ball(p, q):
    flange = frames(p, q)[-1]
    return flange[:, :3, 3] + flange[:, :3, :3] @ p[25:28], flange[:, :3, :3]


def miss(p, q, position, rotation):
    there, turned = ball(p, q)
    d = turned.transpose(0, 2, 1) @ rotation
    w = 0.5 * np.stack([d[:, 2, 1] - d[:, 1, 2], d[:, 0, 2] - d[:, 2, 0], d[:, 1, 0] - d[:, 0, 1]], 1)
    return np.concatenate([position - there, 300.0 * (turned @ w[:, :, None])[:, :, 0]], 1)


def inverse(p, q, position, rotation, steps, damping=0.0):
    """Axis angles near q, by Newton's method."""
    q = q.copy()
    for _ in range(steps):
        e, jacobian = miss(p, q, position, rotation), np.zeros((len(q), 6, 6))
        for k in range(6):
            beside = q.copy()
            beside[:, k] += 1e-6
            jacobian[:, :, k] = -(miss(p, beside, position, rotation) - e) / 1e-6
        t = jacobian.transpose(0, 2, 1)
        step = np.linalg.solve(t @ jacobian + (damping + 1e-9) * 9e4 * np.eye(6), t @ e[:, :, None])
        q += np.clip(step[:, :, 0], -0.3, 0.3)
    return q


def about(axis, angle):
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    m = np.tile(np.eye(3), (len(angle), 1, 1))
    m[:, i, i], m[:, j, j], m[:, i, j], m[:, j, i] = np.cos(angle), np.cos(angle), -np.sin(angle), np.sin(angle)
    return m


def production(count, random):
    """Poses in the cube, the tool within 30 degrees about Y and X of straight down and turned at will."""
    found = np.zeros((0, 6))
    while len(found) < count:
        position = BALL + random.uniform(-500, 500, (count, 3))
        turn = lambda most: np.radians(random.uniform(-most, most, count))
        rotation = about(2, turn(180)) @ about(1, turn(30)) @ about(0, np.pi + turn(30))
        best, missed = np.zeros((count, 6)), np.full(count, np.inf)
        for k in range(8):
            start = np.tile(np.radians([0.0, -60.0, 90.0, 0.0, 60.0, 45.0 * k - 180.0]), (count, 1))
            start[:, 0] = SIGN[0] * np.arctan2(position[:, 1], position[:, 0])
            q = inverse(NOMINAL, start, position, rotation, 25, 1e-4)
            turned = np.abs(ball(NOMINAL, q)[1] - rotation).max((1, 2))
            off = np.linalg.norm(miss(NOMINAL, q, position, rotation), axis=1) + turned + 10.0 * (q[:, 4] < 0)
            best[off < missed], missed = q[off < missed], np.minimum(off, missed)
        degrees = np.degrees(best)
        within = ((degrees > LIMITS[:, 0] + 1) & (degrees < LIMITS[:, 1] - 1)).all(1)
        found = np.concatenate([found, best[(missed < 1e-3) & within & (degrees[:, 4] > 10)]])
    return found[:count]


def turned_anyhow(count, random):
    """Poses in the cube, the tool turned anyhow, in the branch of the plan's poses."""
    found = np.zeros((0, 6))
    while len(found) < count:
        q = np.radians(random.uniform(LIMITS[:, 0] + 1, LIMITS[:, 1] - 1, (4000, 6)))
        degrees = np.degrees(q)
        inside = (np.abs(ball(NOMINAL, q)[0] - BALL) < 500).all(1)
        found = np.concatenate([found, q[inside & (degrees[:, 4] > 10) & (np.abs(degrees[:, 0]) < 60) & (degrees[:, 2] > 15)]])
    return found[:count]


def aligned(a, b):
    """Distances after one best rigid motion."""
    a, b = a - a.mean(0), b - b.mean(0)
    u, _, v = np.linalg.svd(b.T @ a)
    return np.linalg.norm(b @ u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v - a, axis=1)


def in_base(a, b):
    """Distances in a base that each robot measures by three points far apart: origin, one on X, one in the XY plane."""
    triples = [(i, j, k) for i in range(30) for j in range(30) for k in range(30)]
    o, x, y = max(triples, key=lambda t: np.linalg.norm(np.cross(a[t[1]] - a[t[0]], a[t[2]] - a[t[0]])))

    def seen(places):
        ex = places[x] - places[o]
        ez = np.cross(ex, places[y] - places[o])
        ex, ez = ex / np.linalg.norm(ex), ez / np.linalg.norm(ez)
        return (places - places[o]) @ np.stack([ex, np.cross(ez, ex), ez], 1)

    return np.linalg.norm(seen(a) - seen(b), axis=1)


def drawn(random):
    """A true robot: d3 and the tool ball are held, as `dbbd simulate` draws it."""
    error = SD * random.standard_normal(28)
    error[[20, 25, 26, 27]] = 0.0
    return NOMINAL + error


def lengths(x, q):
    """Of the parameters, base ball and bar offset x."""
    return np.linalg.norm(ball(x[:28], q)[0] - x[28:31], axis=1) + x[31]


def jacobian(x, q):
    steps = np.where(np.isin(np.arange(32), [*range(6), *range(12, 18), 24]), 1e-6, 1e-4)
    return np.stack([(lengths(x + e, q) - lengths(x - e, q)) / (2 * h) for h, e in zip(steps, np.diag(steps))], 1)


def likeliest(q, measured, bar, sigma):
    """Given the tolerance, a ball known to 10 mm and a bar known to `bar` mm."""
    start, sd = np.concatenate([NOMINAL, BALL, [0.0]]), np.concatenate([SD, [10.0] * 3, [bar]])
    x = start.copy()
    for _ in range(5):
        rows = np.vstack([jacobian(x, q) * sd / sigma, np.eye(32)])
        left = np.concatenate([(measured - lengths(x, q)) / sigma, (start - x) / sd])
        x = x + sd * np.linalg.lstsq(rows, left, rcond=None)[0]
    return x[:28]


def loop(q, targets, bar, noise, off=aligned):
    wanted, rotation = ball(NOMINAL, targets)
    pairs = []
    for seed in range(ROBOTS):
        random = np.random.default_rng([1, seed])
        true = drawn(random)
        measured = lengths(np.concatenate([true, BALL + OFF, [0.0]]), q) + noise * random.standard_normal(len(q))
        told = inverse(likeliest(q, measured, bar, noise), targets, wanted, rotation, 4)
        pairs.append([off(wanted, ball(true, axes)[0]).mean() for axes in (targets, told)])
    before, after = np.array(pairs).T
    factor = before / after
    return (f"before {before.mean():.3f} mm ({before.min():.3f} at least), after {after.mean():.4f} ({after.max():.4f} at most); "
            f"factor {np.median(factor):.1f} in the middle, {factor.min():.1f} at least, 25 for {np.mean(factor >= 25):.0%}")


MASSES = [(1, 150.0, [425.0, 0.0, 0.0]), (2, 120.0, [145.0, -300.0, 0.0]), (5, 60.0, [0.0] * 3)]


def torque(q, joint):
    all_frames = frames(NOMINAL, q)
    axis, at = all_frames[joint][:, :3, 2], all_frames[joint][:, :3, 3]
    lever = lambda k, c: all_frames[k][:, :3, 3] + all_frames[k][:, :3, :3] @ np.array(c) - at
    return sum(np.einsum("ij,ij->i", axis, np.cross(lever(k, c), [0, 0, -kg * 9.81e-3])) for k, kg, c in MASSES if k >= joint)


def sag(q):
    """What 0.2 mrad of joint 2 and 0.14 mrad of joint 3, at most, leave in the lengths when all else is fitted."""
    anywhere = np.radians(np.random.default_rng(2).uniform(LIMITS[:, 0], LIMITS[:, 1], (500, 6)))
    x = np.concatenate([NOMINAL, BALL, [0.0]])
    given_way = []
    for joint, most in ((1, 0.2e-3), (2, 0.14e-3)):
        bent = q.copy()
        bent[:, joint] += most / np.abs(torque(anywhere, joint)).max() * torque(q, joint)
        given_way.append(lengths(x, bent) - lengths(x, q))
    scaled = jacobian(x, q)[:, :31] * np.concatenate([SD, [10.0] * 3])
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    u = u[:, s > 1e-8 * s[0]]
    left = [way - u @ (u.T @ way) for way in given_way]
    both, freedom = sum(left), len(q) - u.shape[1]
    direct = np.stack(left, 1)
    print(f"sag: {1e3 * np.sqrt(np.mean(sum(given_way) ** 2)):.0f} um rms in the lengths, {1e3 * np.sqrt(np.mean(both ** 2)):.1f} "
          f"um after the fit of the geometry ({freedom} degrees of freedom)")
    for sigma in (0.02, 0.01, 0.005, 0.002):
        excess = both @ both / sigma ** 2
        told = np.sum((direct @ np.linalg.lstsq(direct, both, rcond=None)[0]) ** 2) / sigma ** 2
        print(f"  lengths of {1e3 * sigma:.0f} um: chi-square grows by {excess:.1f}; noticed at 1 % by "
              f"{ncx2.sf(chi2.ppf(0.99, freedom), freedom, excess):.0%}, by a test for these two compliances alone "
              f"{ncx2.sf(chi2.ppf(0.99, 2), 2, told):.0%}")


if __name__ == "__main__":
    rows = [row for row in csv.DictReader(open(sys.argv[1])) if row["kind"] != "transit"]
    poses = np.radians([[float(row[f"a{k}_deg"]) for k in range(1, 7)] for row in rows])
    targets = production(150, np.random.default_rng(1))
    print(f"{len(poses)} lengths")
    for words, bar, noise in [("bar exact", 1e-9, SIGMA), ("bar to 1 um", 1e-3, SIGMA), ("bar to 50 um", 0.05, SIGMA),
                              ("bar to 1 um, lengths of 10 um", 1e-3, 0.01), ("bar to 1 um, lengths of 2 um", 1e-3, 0.002)]:
        print(f"{words}: {loop(poses, targets, bar, noise)}", flush=True)
    anyhow = turned_anyhow(200, np.random.default_rng(1))
    print(f"bar exact, tool turned anyhow: {loop(poses, anyhow, 1e-9, SIGMA)}", flush=True)
    print(f"bar to 1 um, in a base of three points: {loop(poses, targets, 1e-3, SIGMA, in_base)}", flush=True)
    sag(poses)
