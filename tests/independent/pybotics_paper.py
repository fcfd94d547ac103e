#!/usr/bin/env python3
"""The paper's thirteen parameters by pybotics and SciPy, beside python/examples/paper.py.

    pip install 'numpy<2' pybotics;  python tests/independent/pybotics_paper.py
"""
import csv
import time
import tomllib
from pathlib import Path

import numpy as np
from pybotics.kinematic_chain import MDHKinematicChain
from pybotics.robot import Robot
from scipy.optimize import least_squares

root = Path(__file__).resolve().parents[2]
file = tomllib.loads((root / "robots" / "kr60ha.toml").read_text())
joints = file["joint"]
mdh = [[np.radians(j["alpha_deg"]), j["a_mm"], np.radians(j["theta_offset_deg"]), j["d_mm"]] for j in joints]
robot = Robot(MDHKinematicChain(np.array(mdh)))
tool = np.array([30.0, 20.0, 10.0, 1.0])
rows = list(csv.DictReader(open(root / "examples" / "paper" / "observations.csv")))
q = np.radians([[float(row[f"a{axis}_deg"]) for axis in range(1, 7)] for row in rows]) * [j["sign"] for j in joints]
lengths = np.array([float(row["length_mm"]) for row in rows])
ball = np.loadtxt(root / "examples" / "paper" / "centres.csv", delimiter=",", skiprows=1)[1:]
names = [f"{name}{row if name in ('alpha', 'a') else row + 1}" for row in range(6) for name in ("alpha", "a", "theta", "d")]
asked = [f"{name}{i}" for name in ("alpha", "a") for i in range(1, 6)] + ["d4", "d5", "d6"]
mask = np.isin(names, asked)
nominal = robot.kinematic_chain.vector.copy()


def residuals(correction):
    vector = nominal.copy()
    vector[mask] += correction
    robot.kinematic_chain.vector = vector
    return [np.linalg.norm((robot.fk(axes) @ tool)[:3] - ball) - length for axes, length in zip(q, lengths)]


started = time.perf_counter()
found = least_squares(residuals, np.zeros(mask.sum()), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
seconds = time.perf_counter() - started
print({name: round(value, 6) for name, value in zip(np.array(names)[mask], found.x)})
print(f"{seconds:.2f} s, {found.nfev} evaluations, residual {np.sqrt((found.fun**2).mean()):.1e} mm")
started = time.perf_counter()
for axes in q:
    robot.fk(axes)
print(f"{(time.perf_counter() - started) / len(q) * 1e6:.1f} us a pose")
