"""An identification study of one's own: how many poses does a calibration of a KR 60 HA need?"""

import numpy as np

import dbbd

nominal = dbbd.Robot.load("kr60ha")
low, high = nominal.limits_deg.T
balls = np.array([[1300.0, -300.0, 600.0], [1100.0, 500.0, 900.0]])
random = np.random.default_rng(1)
everywhere = random.uniform(low, high, (500, 6))


def aligned(found, true):
    """Root mean square of what a rigid motion does not explain, mm."""
    a, b = found - found.mean(0), true - true.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return np.sqrt(((a @ turn - b) ** 2).sum(1).mean())


for poses in (40, 80, 160):
    truth = nominal.drawn(seed=2)
    directions = random.normal(size=(4 * poses, 3))
    at = balls[np.arange(4 * poses) % 2] + 300.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    target = np.repeat(nominal.fk_deg([0, -90, 90, 0, 60, 0])[None], 4 * poses, 0)
    target[:, :3, 3] = at
    q = nominal.ik_deg(target, near=[0, -90, 90, 10, 60, 10]) + random.uniform(-4, 4, (4 * poses, 6)) * [0, 0, 0, 1, 1, 1]
    ball = np.arange(4 * poses) % 2 + 1
    keep = np.isfinite(q).all(1)
    q, ball = q[keep][:poses], ball[keep][:poses]
    lengths = dbbd.simulate(q, ball, robot=truth, balls_mm=balls, bar_mm=300.0, repeatability_um=30.0, seed=3)
    result = dbbd.identify(q, lengths, ball, robot=nominal, balls_mm=balls, prior="datasheet", model="geometric")
    places, sd = result.predict_deg(everywhere)
    true = truth.fk_deg(everywhere)[:, :3, 3]
    before = aligned(nominal.fk_deg(everywhere)[:, :3, 3], true)
    print(f"{poses:4} poses: 3-D error {before:.3f} -> {aligned(places, true):.3f} mm, predicted {np.sqrt((sd**2).mean()):.3f} mm")
