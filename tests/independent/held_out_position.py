#!/usr/bin/env python3
"""3-D errors at poses that an identification has not seen, where each was measured to three balls: three lengths
give the measured position, by trilateration from the identified balls, and the robot's file gives the model's.

    venv/bin/python tests/independent/held_out_position.py DBBD OBSERVATIONS.csv CENTRES.csv ROBOT X,Y,Z

DBBD is the binary, X,Y,Z the tool ball. Half of the poses (numpy, seed 1) identify with `--prior datasheet`, the
other half check (`--validate`, and `--workspace` for the error that is predicted there), and the other way round.
Errors are taken after one rigid alignment. Positions whose geometry (root of the trace of the inverse of U'U, U
the directions to the balls) magnifies a length's error more than 4 times are left out: near the plane of the balls
lengths do not tell a position.
"""
import csv
import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import numpy as np

AXES = [f"a{i}_deg" for i in range(1, 7)]


def ball(robot, axes_deg):
    frame = np.eye(4)
    for joint, angle in zip(robot["joint"], axes_deg):
        turns = [("beta_deg", 1), ("alpha_deg", 0)]
        for key, axis in turns:
            frame = frame @ turn(axis, np.radians(joint.get(key, 0.0)))
        frame = frame @ shift([joint["a_mm"], 0, 0])
        frame = frame @ turn(2, np.radians(joint["sign"] * angle + joint["theta_offset_deg"])) @ shift([0, 0, joint["d_mm"]])
    return (frame @ np.append(robot["tool"]["ball_mm"], 1))[:3]


def turn(axis, angle):
    matrix, (i, j) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i], matrix[i, j] = np.sin(angle), -np.sin(angle)
    return matrix


def shift(place):
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix


def trilaterate(balls, lengths, near):
    """The position with these lengths to the balls, and how much it magnifies their errors."""
    for _ in range(30):
        away = near - balls
        distance = np.linalg.norm(away, axis=1)
        directions = away / distance[:, None]
        near = near + np.linalg.solve(directions, lengths - distance)
    return near, np.sqrt(np.trace(np.linalg.inv(directions.T @ directions)))


def aligned(measured, model):
    a, b = measured.mean(0), model.mean(0)
    u, _, v = np.linalg.svd((model - b).T @ (measured - a))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return np.linalg.norm((model - b) @ rotation - (measured - a), axis=1)


def main(dbbd, observations, centres, robot, tool):
    rows = list(csv.DictReader(open(observations)))
    poses = {}
    for row in rows:
        poses.setdefault(tuple(row[axis] for axis in AXES), {})[int(row["centre"])] = row
    whole = [pose for pose, found in poses.items() if len(found) == 3]
    order = np.random.default_rng(1).permutation(len(whole))
    for half in range(2):
        kept, seen = ([whole[i] for i in order[start::2]] for start in (half, 1 - half))
        folder = Path(tempfile.mkdtemp())
        for name, chosen in (("seen.csv", seen), ("kept.csv", kept)):
            with open(folder / name, "w", newline="") as file:
                table = csv.DictWriter(file, rows[0].keys())
                table.writeheader()
                table.writerows(poses[pose][k] for pose in chosen for k in (1, 2, 3))
        command = [dbbd, "identify", folder / "seen.csv", "--centres", centres, "--robot", robot, "--tool", tool]
        command += ["--prior", "datasheet", "--validate", folder / "kept.csv", "--workspace", folder / "kept.csv"]
        subprocess.run([*map(str, command), "--out", str(folder / "out"), "--quiet"], capture_output=True)
        result = json.loads((folder / "out/result.json").read_text())
        value = {p["name"]: p["identified"] for p in result["parameters"]}
        balls = np.array([[value[f"centre{k}_{axis}"] for axis in "xyz"] for k in (1, 2, 3)])
        found = tomllib.loads((folder / "out/robot-identified.toml").read_text())
        nominal = dict(found["nominal"], tool=found["tool"])
        measured, model, before = [], [], []
        for pose in kept:
            axes = [float(angle) for angle in pose]
            lengths = np.array([float(poses[pose][k]["length_mm"]) for k in (1, 2, 3)])
            position, magnified = trilaterate(balls, lengths, ball(found, axes))
            if magnified < 4:
                measured.append(position)
                model.append(ball(found, axes))
                before.append(ball(nominal, axes))
        measured, model, before = map(np.array, (measured, model, before))
        after, at_first = aligned(measured, model), aligned(measured, before)
        print(
            f"{len(measured)} of {len(kept)} kept poses: 3-D error mean {at_first.mean():.3f} -> {after.mean():.3f} mm, "
            f"largest {at_first.max():.3f} -> {after.max():.3f}; lengths rms {result['validation']['before']['rms']:.3f} -> "
            f"{result['validation']['after']['rms']:.3f}; predicted there "
            f"{result['predicted_position_error_mm']['identified']['mean']:.3f}"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
