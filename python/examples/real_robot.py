"""A real KUKA KR60: lengths that a laser tracker measured to three points. The data are not part of the project.

    python real_robot.py [DIRECTORY]      # with kr60/three_balls_approach.csv; else ../shared/data beside the checkout
"""

import csv
import pathlib
import sys

import numpy as np

import dbbd

beside = pathlib.Path(__file__).resolve().parents[3] / "shared" / "data"
path = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else beside) / "kr60" / "three_balls_approach.csv"
if not path.is_file():
    print(f"SKIPPED: the real robot: {path} is not there")
    sys.exit()

# %% The lengths
with open(path, newline="") as file:
    rows = list(csv.DictReader(file))
q = np.array([[float(row[f"a{axis}_deg"]) for axis in range(1, 7)] for row in rows])
approach = np.array([[int(row[f"approach{axis}"]) for axis in range(1, 7)] for row in rows])
lengths = np.array([float(row["length_mm"]) for row in rows])
ball = np.array([int(row["centre"]) for row in rows])
balls = [[270, -1490, 530], [760, -1570, 1030], [340, -1000, 1230]]

# %% Geometry alone, and with the errors of the joints
robot = dbbd.Robot.load("kr60ha").with_tool([0, 0, 104])
for model in ("geometric", "joints"):
    prior = "datasheet" if model == "geometric" else None
    result = dbbd.identify(q, lengths, ball, robot=robot, balls_mm=balls, approach=approach, model=model, prior=prior)
    rms = result.to_dict()["residual_mm"]
    print(f"{model:9}: residual rms {rms['before']['rms']:.3f} -> {rms['after']['rms']:.3f} mm")
    assert rms["after"]["rms"] < 0.1
