"""An identification study of one's own: how many poses does a calibration of a KR 60 HA need? Means over eight drawn robots."""

import numpy as np

import dbbd

nominal = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])
balls = [[1300.0, -300.0, 600.0], [1100.0, 500.0, 900.0]]
home, turns = np.array([0, -90, 90, 0, 60, 0]), np.array([60, 30, 30, 90, 50, 120])
others = home + np.random.default_rng(0).uniform(-1, 1, (300, 6)) * turns


def distance_error(places, robot):
    """Root mean square error of the distances between places, which no alignment changes, mm."""
    distances = [np.linalg.norm(np.diff(at, axis=0), axis=1) for at in (places, robot.fk_deg(others)[:, :3, 3])]
    return np.sqrt(np.mean((distances[0] - distances[1]) ** 2))


for poses in (40, 80, 160):
    errors = []
    for seed in range(1, 9):
        truth, random = nominal.drawn(seed=seed), np.random.default_rng(seed)
        q, ball = home + random.uniform(-1, 1, (poses, 6)) * turns, np.arange(poses) % 2 + 1
        lengths = dbbd.simulate(q, ball, robot=truth, balls_mm=balls, bar_mm=300.0, repeatability_um=30.0, seed=seed)
        result = dbbd.identify(q, lengths, ball, robot=nominal, balls_mm=balls, prior="datasheet", model="geometric")
        errors.append([distance_error(at, truth) for at in (nominal.fk_deg(others)[:, :3, 3], result.predict_deg(others)[0])])
    before, after = np.mean(errors, axis=0)
    print(f"{poses:4} poses: error of a distance {before:.3f} -> {after:.3f} mm")
