#!/usr/bin/env python3
"""Flange poses of the robots that are built in, from published descriptions of joint places and axes.

    python3 tests/independent/robots.py

writes fixtures/golden/robots.csv with numpy alone. Each robot is written down as its description has it: for
every joint its place and turn (roll, pitch, yaw) in the frame before and the axis that it turns about, then
the flange; no DH parameter occurs here. Sources: the ROS-Industrial descriptions of the KUKA, ABB, Yaskawa and
Staubli robots, kroshu's ROS 2 descriptions of the newer KUKA robots, and the makers' ROS 2 descriptions of the Universal Robots and FANUC arms.
A FANUC's description turns joint 3 by what its controller shows as J3 + J2.
"""
import math
from pathlib import Path

import numpy as np

OUT = Path(__file__).resolve().parents[2] / "fixtures/golden/robots.csv"
QUARTER = math.pi / 2
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
DOWN, BACK = (0, 0, -1), (-1, 0, 0)
STRAIGHT = (0, 0, 0)


def arm(axes, *places, flange=(0, QUARTER, 0)):
    """Joints that are not turned against each other: their axes and places, mm."""
    return [(place, STRAIGHT, axis) for axis, place in zip(axes, places)], flange


KUKA = (DOWN, Y, Y, BACK, Y, BACK)
ABB = (Z, Y, Y, X, Y, X)
YASKAWA = (Z, Y, (0, -1, 0), BACK, (0, -1, 0), BACK)
FANUC = YASKAWA
STAUBLI = (Z, Y, Y, Z, Y, Z)
TURNED = (math.pi, -QUARTER, 0)


def universal(d1, a2, a3, d4, d5, d6):
    joints = [
        ((0, 0, d1), STRAIGHT, Z),
        ((0, 0, 0), (QUARTER, 0, 0), Z),
        ((a2, 0, 0), STRAIGHT, Z),
        ((a3, 0, d4), STRAIGHT, Z),
        ((0, -d5, 0), (QUARTER, 0, 0), Z),
        ((0, d6, 0), (QUARTER, math.pi, math.pi), Z),
    ]
    return joints, STRAIGHT


ROBOTS = {
    "kr60ha": arm(KUKA, (0, 0, 0), (350, 0, 815), (850, 0, 0), (465, 0, 145), (355, 0, 0), (170, 0, 0)),
    "kr16-2": arm(KUKA, (0, 0, 675), (260, 0, 0), (680, 0, 0), (670, 0, -35), (0, 0, 0), (158, 0, 0)),
    "kr120r2500pro": arm(KUKA, (0, 0, 675), (350, 0, 0), (1150, 0, 0), (1000, 0, -41), (0, 0, 0), (215, 0, 0)),
    "kr210r2700extra": arm(KUKA, (0, 0, 675), (350, 0, 0), (1150, 0, 0), (0, 0, -41), (1200, 0, 0), (215, 0, 0)),
    "kr6r900sixx": arm(KUKA, (0, 0, 400), (25, 0, 0), (455, 0, 0), (0, 0, 35), (420, 0, 0), (80, 0, 0)),
    "irb120": arm(ABB, (0, 0, 0), (0, 0, 290), (0, 0, 270), (0, 0, 70), (302, 0, 0), (72, 0, 0)),
    "irb1600-10-145": arm(ABB, (0, 0, 0), (150, 0, 486.5), (0, 0, 700), (300, 0, 0), (300, 0, 0), (65, 0, 0)),
    "ur5": universal(89.159, -425, -392.25, 109.15, 94.65, 82.3),
    "ur10": universal(127.3, -612, -572.3, 163.941, 115.7, 92.2),
    # The controller's world frame lies 478 mm above the mounting face, where the first two axes meet in height.
    "tx2-90l": arm(
        (Z, Y, Y, Z, Y, Z), (0, 0, 0), (50, 0, 0), (0, 50, 500), (0, 0, 0), (0, 0, 550), (0, 0, 100), flange=STRAIGHT
    ),
    "ur3e": universal(151.85, -243.55, -213.2, 131.05, 85.35, 92.1),
    "ur5e": universal(162.5, -425, -392.2, 133.3, 99.7, 99.6),
    "ur10e": universal(180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur16e": universal(180.7, -478.4, -360, 174.15, 119.85, 116.55),
    "ur20": universal(236.3, -862, -728.7, 201, 159.3, 154.3),
    "kr10r1100-2": arm(KUKA, (0, 0, 400), (25, 0, 0), (560, 0, 0), (196, 0, 25), (319, 0, 0), (90, 0, 0)),
    "kr16r2010-2": arm(KUKA, (0, 0, 0), (160, 0, 520), (980, 0, 0), (0, 0, 150), (860, 0, 0), (153, 0, 0)),
    "kr20r1810-2": arm(KUKA, (0, 0, 312.7), (160, 0, 207.3), (780, 0, 0), (427, 0, 150), (433, 0, 0), (153, 0, 0)),
    "kr210r2700-2": arm(KUKA, (0, 0, 0), (330, 0, 645), (1150, 0, 0), (0, 0, 115), (1220, 0, 0), (215, 0, 0)),
    "irb2600-12-165": arm(ABB, (0, 0, 445), (150, 0, 0), (0, 0, 700), (0, 0, 115), (795, 0, 0), (85, 0, 0)),
    "irb4600-60-205": arm(ABB, (0, 0, 495), (175, 0, 0), (0, 0, 900), (0, 0, 175), (960, 0, 0), (135, 0, 0)),
    "irb6700-200-260": arm(ABB, (0, 0, 780), (320, 0, 0), (0, 0, 1125), (0, 0, 200), (1142.5, 0, 0), (200, 0, 0)),
    # The controllers' frames lie in height of axis 2.
    "gp12": arm(YASKAWA, (0, 0, 0), (155, 0, 0), (0, 0, 614), (640, 0, 200), (0, 0, 0), (100, 0, 0), flange=TURNED),
    "gp25": arm(YASKAWA, (0, 0, 0), (150, 0, 0), (0, 0, 760), (0, 0, 200), (795, 0, 0), (100, 0, 0), flange=TURNED),
    "tx2-60": arm(STAUBLI, (0, 0, 0), (0, 0, 0), (0, 20, 290), (0, 0, 0), (0, 0, 310), (0, 0, 70), flange=STRAIGHT),
    "tx2-90": arm(STAUBLI, (0, 0, 0), (50, 0, 0), (0, 50, 425), (0, 0, 0), (0, 0, 425), (0, 0, 100), flange=STRAIGHT),
    # The controllers' world frames lie in height of axis 2.
    "m10id12": arm(FANUC, (0, 0, 0), (75, 0, 0), (0, 0, 640), (0, 0, 195), (700, 0, 0), (75, 0, 0), flange=TURNED),
    "m20id25": arm(FANUC, (0, 0, 0), (75, 0, 0), (0, 0, 840), (0, 0, 215), (890, 0, 0), (90, 0, 0), flange=TURNED),
    "crx10ia": arm(FANUC, (0, 0, 0), (0, 0, 0), (0, 0, 540), (0, 0, 0), (540, 0, 0), (160, -150, 0), flange=TURNED),
}
# Arms whose controller shows axis 3 against the horizontal.
COUPLED = {"m10id12", "m20id25", "crx10ia"}


def about(axis, angle):
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], float)
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def turned(roll, pitch, yaw):
    return about(Z, yaw) @ about(Y, pitch) @ about(X, roll)


def flange(robot, axes):
    joints, last = robot
    rotation, position = np.eye(3), np.zeros(3)
    for (place, turn, axis), angle in zip(joints, axes):
        position = position + rotation @ np.array(place, float)
        rotation = rotation @ turned(*turn) @ about(axis, angle)
    return position, rotation @ turned(*last)


def main():
    random = np.random.default_rng(1)
    lines = ["robot,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,x_mm,y_mm,z_mm," + ",".join(f"r{i}{j}" for i in range(3) for j in range(3))]
    for name, robot in ROBOTS.items():
        for degrees in [np.zeros(6), *random.uniform(-170, 170, (6, 6)).round(3)]:
            shown = np.radians(degrees)
            joints = shown + (0, 0, shown[1], 0, 0, 0) if name in COUPLED else shown
            position, rotation = flange(robot, joints)
            numbers = [*degrees, *position, *rotation.ravel()]
            lines.append(name + "," + ",".join(f"{number + 0.0:.12g}" for number in numbers))
    OUT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
