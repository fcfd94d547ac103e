"""Golden values of crates/dbbd-model/src/test_support/circular_cases.rs, from scipy alone.

    python3 -m venv v && v/bin/pip install numpy scipy && v/bin/python tests/independent/circular.py

Least squares: scipy.optimize.least_squares on the exact distances. Minimum zone: scipy.optimize.linprog
(HiGHS), repeated about the centre found until that rests. The lengths are computed by the same formula
in the test; nothing else is shared with the program.
"""

import numpy as np
import scipy
from scipy.optimize import least_squares, linprog


def lengths(theta, sense, radius, centre, offset, e_a, e_b, phi, backlash):
    """Exact lengths of a machine with scale errors, squareness and reversal steps. sense: 1 ccw, -1 cw."""
    x, y = radius * np.cos(theta), radius * np.sin(theta)
    going_x = np.where(-np.sin(theta) * sense >= 0, 1.0, -1.0)
    going_y = np.where(np.cos(theta) * sense >= 0, 1.0, -1.0)
    px = (1 + e_a) * x + phi * y + 0.5 * backlash[0] * going_x
    py = (1 + e_b) * y + 0.5 * backlash[1] * going_y
    form = 0.002 * np.sin(7 * theta + 0.3) + 0.0015 * np.cos(11 * theta)
    return np.hypot(px - centre[0], py - centre[1]) + offset + form


def fit(theta, length, radius):
    def residual(p):
        return length - np.hypot(radius * np.cos(theta) - p[0], radius * np.sin(theta) - p[1]) - p[2]

    p = np.zeros(3)
    for _ in range(4):
        p = least_squares(residual, p, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    # Newton's last digits, by plain linear least squares.
    for _ in range(3):
        dx, dy = radius * np.cos(theta) - p[0], radius * np.sin(theta) - p[1]
        reach = np.hypot(dx, dy)
        jacobian = np.column_stack([-dx / reach, -dy / reach, np.ones_like(theta)])
        p = p + np.linalg.lstsq(jacobian, residual(p), rcond=None)[0]
    return p, residual(p)


def minimum_zone(theta, length, radius, centre):
    c = np.array(centre, float)
    unit = 1e6  # HiGHS keeps 1e-7 of the unit: nanometres make that 1e-13 mm
    for _ in range(12):
        dx, dy = radius * np.cos(theta) - c[0], radius * np.sin(theta) - c[1]
        reach = np.hypot(dx, dy)
        deviation = (length - reach) * unit
        ux, uy = dx / reach, dy / reach
        one = np.ones_like(theta)
        # l <= deviation + u . d <= h, least h - l
        a = np.vstack([np.column_stack([ux, uy, -one, 0 * one]), np.column_stack([-ux, -uy, 0 * one, one])])
        b = np.concatenate([-deviation, deviation])
        found = linprog([0, 0, 1, -1], A_ub=a, b_ub=b, bounds=[(None, None)] * 4, method="highs",
                        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10})
        assert found.status == 0, found.message
        step = found.x[:2] / unit
        c = c + step
        if np.hypot(*step) < 1e-12:
            break
    d = length - np.hypot(radius * np.cos(theta) - c[0], radius * np.sin(theta) - c[1])
    return d.max() - d.min()


CASES = {
    # name: radius, points, first and span in degrees, centre, offset, e_a, e_b, phi, backlash, senses
    "full": (150.0, 72, 0.0, 360.0, (0.31, -0.17), 0.023, 40e-6, -25e-6, 60e-6, (0.004, 0.007), (1, -1)),
    "arc": (300.0, 90, 20.0, 220.0, (0.5, 0.2), -0.011, 10e-6, 30e-6, -45e-6, (0.0, 0.003), (1,)),
    "dense": (100.0, 2000, 3.0, 360.0, (-1.0, 0.6), 0.005, 0.0, 80e-6, 120e-6, (0.01, 0.002), (1, -1)),
}

print("scipy", scipy.__version__, "numpy", np.__version__)
for name, (radius, points, first, span, centre, offset, e_a, e_b, phi, backlash, senses) in CASES.items():
    gaps = points if span == 360.0 else points - 1
    theta = np.deg2rad(first + span * np.arange(points) / gaps)
    runs = [(theta, lengths(theta, s, radius, centre, offset, e_a, e_b, phi, backlash)) for s in senses]
    both = np.concatenate([t for t, _ in runs]), np.concatenate([l for _, l in runs])
    p, joint = fit(*both, radius)
    g_lsc, g_mzc = [], []
    for t, l in runs:
        own, rest = fit(t, l, radius)
        g_lsc.append(np.ptp(rest))
        g_mzc.append(minimum_zone(t, l, radius, own[:2]))
    full = span == 360.0
    radial = joint + p[2] if full else both[1] - radius
    values = {"G_lsc": max(g_lsc), "G_mzc": max(g_mzc), "D": p[2], "F_max": radial.max(), "F_min": radial.min(),
              "x": p[0], "y": p[1]}
    if len(senses) == 2:
        values["Gb"] = np.ptp(joint)
        values["H"] = np.abs(joint[:points] - joint[points:]).max()
    for key, value in values.items():
        print(f'        ("{name}", "{key}", {value:.13}),')
    if full:
        # second harmonics about the joint centre, by sense
        for s, rest in zip(senses, joint.reshape(len(senses), points)):
            h = np.column_stack([np.ones(points), np.cos(theta), np.sin(theta), np.cos(2 * theta), np.sin(2 * theta)])
            c = np.linalg.lstsq(h, rest + p[2], rcond=None)[0]
            print(f'        ("{name}", "c2 {"ccw" if s > 0 else "cw"}", {c[3]:.13}),')
            print(f'        ("{name}", "s2 {"ccw" if s > 0 else "cw"}", {c[4]:.13}),')
