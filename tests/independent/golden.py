#!/usr/bin/env python3
"""Golden poses and lengths of the KUKA KR 60 HA from Pinocchio, which shares no code with dbbd.

    python3 -m venv venv && venv/bin/pip install numpy pin
    venv/bin/python tests/independent/golden.py

writes examples/paper/*.csv and fixtures/golden/*.csv; the same bytes each time with one version of
numpy and pin (written with pin 4.1.0, numpy 2.4.6).
"""
import csv
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

ROOT = Path(__file__).resolve().parents[2]
SIGN = [-1, 1, 1, -1, 1, -1]
NOMINAL = dict(
    alpha=[0, -math.pi / 2, 0, -math.pi / 2, math.pi / 2, -math.pi / 2],
    a=[0, 350.0, 850.0, 145.0, 0, 0],
    theta=[0, 0, -math.pi / 2, 0, 0, math.pi],
    d=[815.0, 0, 0, 820.0, 0, 170.0],
    beta=[0, 0, 0, 0, 0, 0],
    tool=[30.0, 20.0, 10.0],
)
LIMITS = [(-185, 185), (-135, 35), (-120, 158), (-350, 350), (-119, 119), (-350, 350)]
# Masses (kg) of the links after joints 2 and 3 and of a payload, for the sagging robot; centres in mm.
MASSES = {2: (120.0, [420.0, 0.0, 60.0]), 3: (90.0, [90.0, -200.0, 0.0]), 6: (60.0, [0.0, 0.0, 150.0])}


def rotation(axis, angle):
    return pin.SE3(pin.AngleAxis(angle, np.array(axis, float)).toRotationMatrix(), np.zeros(3))


def shift(x, y, z):
    return pin.SE3(np.eye(3), np.array([x, y, z], float))


def build(p):
    """The chain as a Pinocchio model; lengths in mm."""
    model = pin.Model()
    model.gravity.linear = np.array([0, 0, -9.80665])
    parent, offset = 0, pin.SE3.Identity()
    for i in range(6):
        placement = (
            offset
            * rotation([0, 1, 0], p["beta"][i])
            * rotation([1, 0, 0], p["alpha"][i])
            * shift(p["a"][i], 0, 0)
            * rotation([0, 0, 1], p["theta"][i])
        )
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{i + 1}")
        offset = shift(0, 0, p["d"][i])
        if i + 1 in MASSES:
            kg, centre = MASSES[i + 1]
            # The frame after the row stands d further along z than the joint's.
            lever = np.array(centre) + [0, 0, p["d"][i]]
            model.appendBodyToJoint(parent, pin.Inertia(kg, lever, np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("flange", parent, 0, offset, pin.FrameType.OP_FRAME))
    ball = offset * shift(*p["tool"])
    model.addFrame(pin.Frame("ball", parent, 0, ball, pin.FrameType.OP_FRAME))
    return model, model.createData()


def frame(robot, name, q):
    model, data = robot
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(name)]


def joint_angles(axes_deg):
    return np.radians(np.array(axes_deg) * SIGN)


def solve(robot, target, q):
    """Axis angles for a pose of the ball by damped Gauss-Newton from q."""
    model, data = robot
    for _ in range(200):
        error = pin.log6(frame(robot, "ball", q).actInv(target)).vector
        if np.linalg.norm(error[:3]) < 1e-10 and np.linalg.norm(error[3:]) < 1e-13:
            return q
        jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("ball"), pin.LOCAL)
        scale = np.diag([1, 1, 1, 1000, 1000, 1000.0])
        step = np.linalg.lstsq(scale @ jacobian, scale @ error, rcond=None)[0]
        q = q + step * min(1.0, 0.3 / np.abs(step).max())
    raise RuntimeError("no axis angles")


def circle(robot, plane, points, amplitude_deg, tilt_deg=0.0, centre=(1300.0, 0.0, 800.0), radius=300.0):
    """Axis angles (deg) on a circle, turned by Rz(A sin 2t) Ry(A sin 3t) Rx(A sin 5t) from the base orientation."""
    amplitude = math.radians(amplitude_deg)
    q, poses = joint_angles([0, -60, 90, 0, 60, 0]), []
    for i in range(points):
        t = 2 * math.pi * i / points
        turn = (
            rotation([0, 0, 1], amplitude * math.sin(2 * t))
            * rotation([0, 1, 0], amplitude * math.sin(3 * t))
            * rotation([1, 0, 0], amplitude * math.sin(5 * t))
            * rotation([0, 1, 0], math.radians(tilt_deg))
            * rotation([1, 0, 0], math.pi)
        )
        place = np.array(centre) + plane @ np.array([math.cos(t), math.sin(t), 0]) * radius
        q = solve(robot, pin.SE3(turn.rotation, place), q)
        poses.append(np.degrees(q) * SIGN)
    return poses


def write(path, header, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(header)
        table.writerows(rows)


OBSERVATION = ["index", "centre"] + [f"a{i}_deg" for i in range(1, 7)] + ["length_mm"]


def observations(path, poses, lengths):
    rows = [[i + 1, 1, *map(repr, map(float, pose)), repr(float(length))] for i, (pose, length) in enumerate(zip(poses, lengths))]
    write(path, OBSERVATION, rows)


def with_errors(errors):
    p = {key: list(values) for key, values in NOMINAL.items()}
    for name, error in errors.items():
        key = name.rstrip("0123456789")
        at = int(name[len(key):]) - (1 if key in ("theta", "d") else 0)
        p[key][at] += error
    return p


def main():
    nominal = build(NOMINAL)
    centre = np.array([1300.0, 0.0, 800.0])
    flat, upright = np.eye(3), rotation([1, 0, 0], math.pi / 2).rotation
    planes = [flat, upright, rotation([0, 0, 1], math.pi / 2).rotation @ upright]

    # The flange at random axis angles.
    random = np.random.default_rng(1)
    rows = []
    for _ in range(50):
        axes = [random.uniform(low, high) for low, high in LIMITS]
        flange = frame(nominal, "flange", joint_angles(axes))
        rows.append([*map(repr, axes), *map(lambda x: repr(float(x)), flange.translation), *map(lambda x: repr(float(x)), flange.rotation.ravel())])
    names = [f"a{i}_deg" for i in range(1, 7)] + ["x_mm", "y_mm", "z_mm"] + [f"r{i}{j}" for i in range(3) for j in range(3)]
    write(ROOT / "fixtures/golden/flange.csv", names, rows)

    # The paper's experiment: Table 2's designed errors on the horizontal circle.
    designed = dict(
        alpha1=-0.0049, alpha2=0.0031, alpha3=0.0011, alpha4=-0.0002, alpha5=-0.0023,
        a1=0.1391, a2=0.0331, a3=0.0345, a4=0.1703, a5=0.0300, d4=-0.0968, d5=-0.0076, d6=-0.1091,
    )
    truth = build(with_errors(designed))
    poses = circle(nominal, flat, 80, 45.0)
    lengths = [np.linalg.norm(frame(truth, "ball", joint_angles(pose)).translation - centre) for pose in poses]
    observations(ROOT / "examples/paper/observations.csv", poses, lengths)
    write(ROOT / "examples/paper/centres.csv", ["centre", "x_mm", "y_mm", "z_mm"], [[1, 1300, 0, 800]])

    # Three planes on a robot with errors in all parameters, the ball 3 mm off.
    names = [f"alpha{i}" for i in range(1, 6)] + [f"a{i}" for i in range(1, 6)] + [f"theta{i}" for i in range(2, 6)]
    names += ["d2", "d4", "d5", "beta2"]
    errors = {name: float(random.normal(0, 0.5 if name[0] in "ad" and not name.startswith("alpha") else 0.00087)) for name in names}
    true_centre = centre + [1.5, -2.0, 1.0]
    truth = build(with_errors(errors))
    poses = [pose for plane in planes for pose in circle(nominal, plane, 80, 25.0, tilt_deg=30.0)]
    lengths = [np.linalg.norm(frame(truth, "ball", joint_angles(pose)).translation - true_centre) for pose in poses]
    observations(ROOT / "fixtures/golden/three_planes.csv", poses, lengths)
    truths = list(errors.items()) + [(f"centre1_{axis}", float(offset)) for axis, offset in zip("xyz", true_centre - centre)]
    write(ROOT / "fixtures/golden/three_planes_truth.csv", ["name", "error"], [[name, repr(error)] for name, error in truths])

    # The same robot, sagging under its weight, with play in its joints and a gear error twice per turn.
    compliance, play, gear = [0, 4e-7, 6e-7, 0, 2e-6, 0], math.radians(0.01), 1.5e-4
    model, data = truth
    lengths, last = [], joint_angles(poses[-1])
    for pose in poses:
        q = joint_angles(pose)
        # Lengths are in mm, so this comes in N mm.
        torque = pin.computeGeneralizedGravity(model, data, q) * 1e-3
        bent = q - np.array(compliance) * torque - np.sign(q - last) * play / 2
        bent[1:3] += gear * np.sin(2 * q[1:3])
        last = q
        lengths.append(np.linalg.norm(frame(truth, "ball", bent).translation - true_centre) + random.normal(0, 0.005))
    observations(ROOT / "fixtures/golden/unmodelled.csv", poses, lengths)


if __name__ == "__main__":
    main()
