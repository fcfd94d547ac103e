#!/usr/bin/env python3
"""Times of other programs on the problem of benches/identify.rs: 13 parameters from lengths to one ball.

    python3 -m venv venv && venv/bin/pip install numpy scipy pin pybotics
    OPENBLAS_NUM_THREADS=1 venv/bin/python benches/peers/times.py            times of the others
    OPENBLAS_NUM_THREADS=1 venv/bin/python benches/peers/times.py --assert   and of dbbd, beside them; fails if it lost its lead

Random poses within the limits, errors of 0.05 deg and 0.5 mm, sigma 0.01 mm; medians of 5 runs in ms.
"""
import math
import pathlib
import re
import statistics
import subprocess
import sys
import time

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

SIGN = np.array([-1, 1, 1, -1, 1, -1.0])
LIMITS = np.array([(-185, 185), (-135, 35), (-120, 158), (-350, 350), (-119, 119), (-350, 350)])
ALPHA = np.array([0, -math.pi / 2, 0, -math.pi / 2, math.pi / 2, -math.pi / 2])
A = np.array([0, 350.0, 850, 145, 0, 0])
THETA = np.array([0, 0, -math.pi / 2, 0, 0, math.pi])
D = np.array([815.0, 0, 0, 820, 0, 170])
TOOL = np.array([30.0, 20, 10])
CENTRE = np.array([1300.0, 0, 800])


def table(x):
    alpha, a, d = ALPHA.copy(), A.copy(), D.copy()
    alpha[1:] += x[:5]
    a[1:] += x[5:10]
    d[3:] += x[10:]
    return alpha, a, d


def forward(x, q):
    """All poses at once: ball positions, and origins, x and z axes of every row."""
    alpha, a, d = table(x)
    n = len(q)
    rotation, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    screws = []
    for i in range(6):
        before = (origin, rotation[:, :, 0])
        ca, sa = math.cos(alpha[i]), math.sin(alpha[i])
        rotation = rotation @ np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
        origin = origin + rotation[:, :, 0] * a[i]
        theta = SIGN[i] * q[:, i] + THETA[i]
        c, s = np.cos(theta), np.sin(theta)
        rz = np.zeros((n, 3, 3))
        rz[:, 0, 0], rz[:, 0, 1], rz[:, 1, 0], rz[:, 1, 1], rz[:, 2, 2] = c, -s, s, c, 1
        rotation = rotation @ rz
        screws.append((before, rotation[:, :, 2]))
        origin = origin + rotation[:, :, 2] * d[i]
    return origin + rotation @ TOOL, screws


def residual(x, q, lengths):
    return np.linalg.norm(forward(x, q)[0] - CENTRE, axis=1) - lengths


def jacobian(x, q):
    ball, screws = forward(x, q)
    bar = ball - CENTRE
    u = bar / np.linalg.norm(bar, axis=1)[:, None]
    columns = []
    for (origin, axis), _ in screws[1:]:
        columns.append(np.einsum("ij,ij->i", np.cross(axis, ball - origin), u))
    for (_, axis), _ in screws[1:]:
        columns.append(np.einsum("ij,ij->i", axis, u))
    for _, axis in screws[3:]:
        columns.append(np.einsum("ij,ij->i", axis, u))
    return np.stack(columns, axis=1)


def gauss_newton(q, lengths, jac=jacobian, res=residual):
    x = np.zeros(13)
    for _ in range(20):
        step = np.linalg.lstsq(jac(x, q), -res(x, q, lengths), rcond=None)[0]
        x = x + step
        if np.linalg.norm(step) < 1e-9:
            break
    return x


def pinocchio_model(x):
    alpha, a, d = table(x)
    model, parent, offset = pin.Model(), 0, pin.SE3.Identity()
    turn = lambda axis, angle: pin.SE3(pin.AngleAxis(angle, np.array(axis, float)).toRotationMatrix(), np.zeros(3))
    shift = lambda x, y, z: pin.SE3(np.eye(3), np.array([x, y, z], float))
    for i in range(6):
        placement = offset * turn([1, 0, 0], alpha[i]) * shift(a[i], 0, 0) * turn([0, 0, 1], THETA[i])
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"j{i}")
        offset = shift(0, 0, d[i])
    ball = offset * shift(*TOOL)
    frame = model.addFrame(pin.Frame("ball", parent, 0, ball, pin.FrameType.OP_FRAME))
    return model, model.createData(), frame, ball


def pinocchio_system(x, q, lengths):
    """Residuals and rows from Pinocchio's kinematic regressor: twists of the joint placements, mapped to DH."""
    model, data, frame, ball = pinocchio_model(x)
    n = len(q)
    rows, res = np.empty((n, 13)), np.empty(n)
    signed = q * SIGN
    # A placement's twist by alpha and a is x of the frame before Rz(theta offset); d is z after the joint.
    back = [pin.AngleAxis(-THETA[i], np.array([0, 0, 1.0])).toRotationMatrix()[:, 0] for i in range(6)]
    for k in range(n):
        pin.forwardKinematics(model, data, signed[k])
        regressor = pin.computeFrameKinematicRegressor(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        position = data.oMi[6].act(ball.translation)
        bar = position - CENTRE
        distance = np.linalg.norm(bar)
        res[k] = distance - lengths[k]
        g = (bar / distance) @ regressor[:3]
        for i in range(1, 6):
            block = g[6 * i : 6 * i + 6]
            rows[k, i - 1] = block[3:] @ back[i]
            rows[k, 5 + i - 1] = block[:3] @ back[i]
        for j, i in enumerate((3, 4, 5)):
            rows[k, 10 + j] = (bar / distance) @ data.oMi[i + 1].rotation[:, 2]
    return rows, res


def pinocchio_gauss_newton(q, lengths):
    x = np.zeros(13)
    for _ in range(20):
        rows, res = pinocchio_system(x, q, lengths)
        step = np.linalg.lstsq(rows, -res, rcond=None)[0]
        x = x + step
        if np.linalg.norm(step) < 1e-9:
            break
    return x


def pybotics_fit(q, lengths):
    from pybotics.robot import Robot

    theta = SIGN * 0 + THETA

    def lengths_of(x):
        alpha, a, d = table(x)
        robot = Robot.from_parameters(np.stack([alpha, a, theta, d], axis=1).ravel())
        robot.tool.position = TOOL
        return np.array([np.linalg.norm(robot.fk(signed)[:3, 3] - CENTRE) for signed in q * SIGN])

    return least_squares(lambda x: lengths_of(x) - lengths, np.zeros(13), x_scale="jac").x


def median_ms(work, runs=5):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = work()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times), result


def regressor_per_pose(q):
    """us per pose of Pinocchio's C++ kinematic regressor (6 x 36, with the forward pass), and of a call from Python
    that does next to nothing in C++: two of these are in the first."""
    model, data, frame, _ = pinocchio_model(np.zeros(13))
    signed = list(q * SIGN)
    pin.forwardKinematics(model, data, signed[0])

    def regressors():
        for angles in signed:
            pin.forwardKinematics(model, data, angles)
            pin.computeFrameKinematicRegressor(model, data, frame, pin.LOCAL_WORLD_ALIGNED)

    def calls():
        for _ in signed:
            pin.updateFramePlacement(model, data, frame)

    return [median_ms(work, 21)[0] * 1e3 / len(signed) for work in (regressors, calls)]


# The row of `benches/identify.rs`, the peer, and how many times as long as dbbd the peer must take; a full report may take this many fits
# of 80 poses by numpy. Machines differ in what they do well: the limits are two thirds of what was measured on one (AMD EPYC, two cores).
NUMPY, PINOCCHIO, ROW = "numpy, own Gauss-Newton", "Pinocchio regressor + Gauss-Newton", "a row by Pinocchio's regressor"
LEADS = [
    ("fit 13 parameters, 80 poses", (80, NUMPY), 4),
    ("fit 13 parameters, 80 poses", (80, PINOCCHIO), 18),
    ("fit 13 parameters, 1000 poses", (1000, NUMPY), 2),
    ("fit 13 parameters, 1000 poses", (1000, PINOCCHIO), 26),
    ("1000 Jacobian rows of all columns, from axis angles", ROW, 1.5),
    ("1000 Jacobian rows of 32 columns, in the solver", ROW, 5),
]
REPORTS = [
    ("all parameters with the full report, 80 poses", 110),
    ("all parameters with the full report, 1000 poses", 350),
]


def own_times():
    """Medians of `benches/identify.rs` in ms."""
    units = {"ns": 1e-6, "\u00b5s": 1e-3, "us": 1e-3, "ms": 1.0, "s": 1e3}
    command = ["cargo", "bench", "--bench", "identify"]
    said = subprocess.run(command, cwd=pathlib.Path(__file__).parents[2], check=True, stdout=subprocess.PIPE, text=True).stdout
    found = re.findall(r"^(\S.*?)\s+time:\s+\[\S+ \S+ (\S+) (\S+) ", said, re.MULTILINE)
    return {name: float(value) * units[unit] for name, value, unit in found}


def compare(times):
    """Prints how many times as long as dbbd the others take; whether every lead is kept."""
    own, lost = own_times(), 0
    for name, peer, least in LEADS:
        lead = times[peer] / own[name]
        lost += lead < least
        print(f"{name:52} {own[name]:9.3f} ms   {lead:6.1f} times faster than {peer if peer == ROW else peer[1]}, at least {least}")
    for name, most in REPORTS:
        cost = own[name] / times[80, NUMPY]
        lost += cost > most
        print(f"{name:52} {own[name]:9.3f} ms   {cost:6.1f} fits of 80 poses by numpy, at most {most}")
    print(f"{lost} of {len(LEADS) + len(REPORTS)} limits violated")
    return lost == 0


def main():
    random, times = np.random.default_rng(1), {}
    truth = np.concatenate([random.normal(0, math.radians(0.05), 5), random.normal(0, 0.5, 8)])
    for n in (80, 1000):
        q = np.radians(random.uniform(LIMITS[:, 0], LIMITS[:, 1], (n, 6)))
        lengths = np.linalg.norm(forward(truth, q)[0] - CENTRE, axis=1) + random.normal(0, 0.01, n)
        variants = {
            "numpy, own Gauss-Newton": lambda: gauss_newton(q, lengths),
            "numpy + scipy, analytic Jacobian": lambda: least_squares(residual, np.zeros(13), jacobian_for(lengths), x_scale="jac", args=(q, lengths)).x,
            "Pinocchio regressor + Gauss-Newton": lambda: pinocchio_gauss_newton(q, lengths),
            "pybotics + scipy": lambda: pybotics_fit(q, lengths),
        }
        reference = None
        for name, work in variants.items():
            ms, x = median_ms(work, 1 if "pybotics" in name else 5)
            reference = x if reference is None else reference
            times[n, name] = ms
            print(f"{n:5} poses  {name:36} {ms:10.2f} ms   differs from the first by {np.abs(x - reference).max():.1e}")
    regressor, call = regressor_per_pose(q)
    times[ROW] = regressor - 2 * call
    print(f"one Jacobian row: Pinocchio's C++ kinematic regressor {regressor:.2f} us a pose, of which two calls of {call:.2f} us")
    if "--assert" in sys.argv and not compare(times):
        sys.exit(1)


def jacobian_for(_lengths):
    return lambda x, q, lengths: jacobian(x, q)


if __name__ == "__main__":
    main()
