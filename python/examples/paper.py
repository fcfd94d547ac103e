"""The experiment of the paper: thirteen parameters from one circle, and why d2 and d3 are none of them."""

import csv
import pathlib

import numpy as np

import dbbd

# %% The lengths
folder = pathlib.Path(__file__).resolve().parents[2] / "examples" / "paper"
with open(folder / "observations.csv", newline="") as file:
    rows = list(csv.DictReader(file))
q = np.array([[float(row[f"a{axis}_deg"]) for axis in range(1, 7)] for row in rows])
lengths = np.array([float(row["length_mm"]) for row in rows])
balls = np.loadtxt(folder / "centres.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]
robot = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])

# %% Thirteen parameters
result = dbbd.identify(q, lengths, 1, robot=robot, balls_mm=balls, estimate="alpha1-5,a1-5,d4-6")
for parameter in result.parameters:
    if parameter["status"] == "identified":
        print(f"{parameter['name']:8} {parameter['correction']:+.4f} {parameter['unit']}")
found = {parameter["name"]: parameter["correction"] for parameter in result.parameters}
assert abs(found["a4"] - 0.1703) < 1e-4 and abs(found["alpha1"] + 0.0049) < 1e-4

# %% With d2 and d3
result = dbbd.identify(q, lengths, 1, robot=robot, balls_mm=balls, estimate="alpha1-5,a1-5,d2-6")
for combination in result.to_dict()["combinations"]:
    print(" + ".join(f"{share:.4g} {name}" for name, share in combination["members"].items()), "is identifiable")
    assert set(combination["members"]) == {"alpha1", "d2", "d3"}
