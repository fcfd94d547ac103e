"""Reads a capture (as MCAP) and an identification into NumPy, and draws what was measured.

    dbbd export run.dbbd --out export --mcap
    dbbd identify run.dbbd --prior datasheet --out result
    python polar.py export/run.mcap result polar.png

Needs Python 3.11, and `pip install numpy matplotlib mcap`. Lengths in mm, angles in rad unless a name says otherwise.
"""

import csv
import json
import sys
import tomllib
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mcap.reader import make_reader


def samples(path):
    """The bar's samples: seconds since the first (of the bar's clock where it has one), reading, valid, strobe."""
    with open(path, "rb") as file:
        rows = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=["samples"])]
    if not rows:
        sys.exit(f"{path}: holds no sample")
    if rows[0].get("ticks") is not None:
        # 32 bits of microseconds (dbb-cobs-1) that wrap; another protocol may count otherwise.
        ticks = np.array([row["ticks"] for row in rows], dtype=np.int64)
        t = np.concatenate([[0], np.cumsum(np.diff(ticks) % 2**32)]) * 1e-6
    else:
        t = np.array([row["host_ns"] for row in rows]) * 1e-9
        t -= t[0]
    columns = (np.array([row[name] for row in rows]) for name in ("reading_mm", "valid", "trigger"))
    return t, *columns


def ball(joints, tool_mm, axes_deg):
    """The tool ball in the robot base for axis angles (N x 6): row i is Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)."""

    def rotation(axis, angle):
        c, s = np.cos(angle), np.sin(angle)
        zero, one = np.zeros_like(c), np.ones_like(c)
        rows = {
            "x": [[one, zero, zero], [zero, c, -s], [zero, s, c]],
            "y": [[c, zero, s], [zero, one, zero], [-s, zero, c]],
            "z": [[c, -s, zero], [s, c, zero], [zero, zero, one]],
        }[axis]
        return np.moveaxis(np.array(rows), [0, 1], [-2, -1])

    point = np.broadcast_to(np.asarray(tool_mm, float), (len(axes_deg), 3))
    for joint, angle in zip(reversed(joints), np.asarray(axes_deg).T[::-1]):
        theta = np.radians(joint["sign"] * angle + joint["theta_offset_deg"])
        point = point + [0.0, 0.0, joint["d_mm"]]
        point = np.einsum("nij,nj->ni", rotation("z", theta), point) + [joint["a_mm"], 0.0, 0.0]
        tilt = rotation("y", np.radians(joint.get("beta_deg", 0.0))) @ rotation("x", np.radians(joint["alpha_deg"]))
        point = point @ tilt.T
    return point


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def main(mcap, result, picture):
    result = Path(result)
    t, reading, valid, strobe = samples(mcap)
    robot = tomllib.loads((result / "robot-identified.toml").read_text())
    found = {row["name"]: float(row["identified"]) for row in table(result / "parameters.csv")}
    lengths = table(result / "lengths.csv")
    axes = np.array([[float(row[f"a{i}_deg"]) for i in range(1, 7)] for row in lengths])
    measured = np.array([float(row["length_mm"]) for row in lengths])
    centre = np.array([[found[f"centre{row['centre']}_{axis}"] for axis in "xyz"] for row in lengths])
    computed = np.linalg.norm(ball(robot["joint"], robot["tool"]["ball_mm"], axes) - centre, axis=1)
    residual_um = 1000.0 * (measured - computed - found["bar_offset"])

    told = json.loads((result / "result.json").read_text())
    strobes = np.count_nonzero(np.diff(strobe.astype(int)) > 0)
    print(f"{len(t)} samples in {t[-1]:.1f} s, {np.count_nonzero(valid)} valid, {strobes} strobes")
    rms_um = np.sqrt(np.mean(residual_um**2))
    print(f"residual rms {rms_um:.3f} um here, {1000 * told['residual_mm']['after']['rms']:.3f} um in result.json")

    # Visits of the reference pose stand between the points of a circle; other observations may have no circles.
    circle = np.array([row.get("circle", "") if row.get("kind", "measure") == "measure" else "" for row in lengths])
    angle = np.radians([float(row.get("angle_deg") or "nan") for row in lengths])
    numbers = sorted({name for name, at in zip(circle, angle) if name and np.isfinite(at)}, key=int)
    figure = plt.figure(figsize=(4 * max(len(numbers), 2), 7), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 2])
    stroke = top.subplots()
    stroke.plot(t[valid], reading[valid], linewidth=0.5)
    stroke.set(xlabel="time (s)", ylabel="reading (mm)", title="What the bar read")
    for at, number in enumerate(numbers):
        polar = bottom.add_subplot(1, len(numbers), at + 1, projection="polar")
        here = (circle == number) & np.isfinite(angle)
        polar.plot(angle[here], residual_um[here], ".-", linewidth=0.6)
        polar.plot(np.linspace(0, 2 * np.pi, 200), np.zeros(200), color="black", linewidth=0.8)
        polar.set(title=f"circle {number}: residual (um)", rlim=(-3500 * told["noise_mm"]["length"], 3500 * told["noise_mm"]["length"]))
    figure.savefig(picture, dpi=110)
    print(f"wrote {picture}")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
