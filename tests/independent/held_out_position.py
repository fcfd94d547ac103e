#!/usr/bin/env python3
"""3-D errors at poses that an identification has not seen, where each was measured to three balls: three lengths
give the measured position, by trilateration from the identified balls, and the robot's file gives the model's.

    venv/bin/python tests/independent/held_out_position.py DBBD OBSERVATIONS.csv CENTRES.csv ROBOT X,Y,Z

DBBD is the binary, X,Y,Z the tool ball. Half of the poses (numpy, seed 1) identify with `--prior datasheet`, the
other half check (`--validate`, and `--workspace` for the error that is predicted there), and the other way round.
Errors are taken after one rigid alignment. Positions whose geometry (root of the trace of the inverse of U'U, U
the directions to the balls) magnifies a length's error more than 4 times are left out: near the plane of the balls
lengths do not tell a position. The same from the lengths to each ball alone, at the same measured positions.
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
        gear = joint.get("gear_cos_rad", 0.0) * np.cos(np.radians(angle)) + joint.get("gear_sin_rad", 0.0) * np.sin(np.radians(angle))
        theta = np.radians(joint["sign"] * angle + joint["theta_offset_deg"]) + gear
        frame = frame @ turn(2, theta) @ shift([0, 0, joint["d_mm"]])
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


def identified(dbbd, seen, kept, centres, robot, tool):
    """The robot's file and the result of an identification from the lengths in `seen`."""
    out = Path(tempfile.mkdtemp())
    command = [dbbd, "identify", seen, "--centres", centres, "--robot", robot, "--tool", tool, "--prior", "datasheet"]
    command += ["--validate", kept, "--workspace", kept, "--out", out, "--quiet"]
    subprocess.run([*map(str, command)], capture_output=True)
    return tomllib.loads((out / "robot-identified.toml").read_text()), json.loads((out / "result.json").read_text())


def write(file, header, rows):
    with open(file, "w", newline="") as out:
        table = csv.DictWriter(out, header)
        table.writeheader()
        table.writerows(rows)
    return file


def main(dbbd, observations, centres, robot, tool):
    rows = list(csv.DictReader(open(observations)))
    places = list(csv.DictReader(open(centres)))
    poses = {}
    for row in rows:
        poses.setdefault(tuple(row[axis] for axis in AXES), {})[int(row["centre"])] = row
    whole = [pose for pose, found in poses.items() if len(found) == 3]
    order = np.random.default_rng(1).permutation(len(whole))
    for half in range(2):
        kept, seen = ([whole[i] for i in order[start::2]] for start in (half, 1 - half))
        folder = Path(tempfile.mkdtemp())
        file = {
            name: write(folder / f"{name}.csv", rows[0].keys(), [poses[pose][k] for pose in chosen for k in (1, 2, 3)])
            for name, chosen in (("seen", seen), ("kept", kept))
        }
        of_three, result = identified(dbbd, file["seen"], file["kept"], centres, robot, tool)
        value = {p["name"]: p["identified"] for p in result["parameters"]}
        balls = np.array([[value[f"centre{k}_{axis}"] for axis in "xyz"] for k in (1, 2, 3)])
        measured, axes = [], []
        for pose in kept:
            angles = [float(angle) for angle in pose]
            lengths = np.array([float(poses[pose][k]["length_mm"]) for k in (1, 2, 3)])
            position, magnified = trilaterate(balls, lengths, ball(of_three, angles))
            if magnified < 4:
                measured.append(position)
                axes.append(angles)
        print(f"half {half + 1}: {len(measured)} of {len(kept)} kept poses")

        def errors(robot):
            return aligned(np.array(measured), np.array([ball(robot, angles) for angles in axes]))

        def say(what, found, result):
            before, after = errors(dict(found["nominal"], tool=found["tool"])), errors(found)
            print(
                f"  {what}: 3-D error mean {before.mean():.3f} -> {after.mean():.3f} mm, largest {before.max():.3f} -> "
                f"{after.max():.3f}; lengths rms {result['validation']['before']['rms']:.3f} -> "
                f"{result['validation']['after']['rms']:.3f}; predicted there "
                f"{result['predicted_position_error_mm']['identified']['mean']:.3f}"
            )

        say("three balls", of_three, result)
        for k in (1, 2, 3):
            one = [
                write(folder / f"{name}{k}.csv", rows[0].keys(), [dict(poses[pose][k], centre=1) for pose in chosen])
                for name, chosen in (("seen", seen), ("kept", kept))
            ]
            place = write(folder / f"centre{k}.csv", places[0].keys(), [dict(places[k - 1], centre=1)])
            say(f"ball {k} alone", *identified(dbbd, *one, place, robot, tool))


if __name__ == "__main__":
    main(*sys.argv[1:])
