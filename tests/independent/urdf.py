#!/usr/bin/env python3
"""The URDF of an identification, read by Pinocchio, against the modified-DH table of robot-identified.toml built
joint by joint in Pinocchio (golden.py): the largest difference of flange and ball over 1000 random axis vectors.

    venv/bin/python tests/independent/urdf.py RESULT [RESULT..]      # directories that `dbbd identify --out` wrote

    venv/bin/python tests/independent/urdf.py --patched PATCHED.urdf LINK ROBOT.toml   # that `dbbd export --urdf-in` wrote

The second form compares LINK, which is fixed to link 6, in a user's patched URDF with the flange; where its root link and LINK
are in the robot is taken from the first pose (the root by a quarter turn), and the other poses must agree.

It fails above 1e-9 mm, patched above 1e-6 mm. Beta, masses and both senses of the axes are covered where the result has them.
"""
import sys
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

import golden


def table(robot):
    joints = robot["joint"]
    radians = lambda key: [np.radians(joint.get(key, 0.0)) for joint in joints]
    return dict(
        alpha=radians("alpha_deg"), a=[j["a_mm"] for j in joints], theta=radians("theta_offset_deg"),
        d=[j["d_mm"] for j in joints], beta=radians("beta_deg"), tool=robot.get("tool", {}).get("ball_mm", [0.0, 0.0, 0.0]),
    )


def patched(urdf, link, toml):
    robot = tomllib.loads(Path(toml).read_text())
    ours = golden.build(table(robot))
    model = pin.buildModelFromUrdf(urdf)
    theirs = (model, model.createData())
    signs = np.array([joint["sign"] for joint in robot["joint"]])
    limits = np.radians([joint["limits_deg"] for joint in robot["joint"]])
    random = np.random.default_rng(1)
    poses = random.uniform(limits[:, 0], limits[:, 1], (1000, 6))
    flange = [golden.frame(ours, "flange", signs * axes).copy() for axes in poses]
    links = [golden.frame(theirs, link, axes).copy() for axes in poses]
    worst = np.inf
    for quarter in range(4):
        root = pin.SE3(pin.rpy.rpyToMatrix(0, 0, quarter * np.pi / 2), np.zeros(3))
        tip = None
        apart = []
        for expected, found in zip(flange, links):
            expected = pin.SE3(expected.rotation, expected.translation * 1e-3)
            tip = tip or expected.inverse() * root * found
            apart.append(np.linalg.norm((expected * tip).translation - (root * found).translation) * 1e3)
        worst = min(worst, max(apart))
    print(f"{urdf}: largest difference of {link} {worst:.1e} mm over {len(poses)} poses")
    if worst > 1e-6:
        sys.exit("the URDF is another robot")


def main(folders):
    for folder in map(Path, folders):
        robot = tomllib.loads((folder / "robot-identified.toml").read_text())
        ours = golden.build(table(robot))
        model = pin.buildModelFromUrdf(str(folder / "robot-identified.urdf"))
        theirs = (model, model.createData())
        signs = np.array([joint["sign"] for joint in robot["joint"]])
        limits = np.radians([joint["limits_deg"] for joint in robot["joint"]])
        random = np.random.default_rng(1)
        worst = 0.0
        for _ in range(1000):
            axes = random.uniform(limits[:, 0], limits[:, 1])
            for name in ("flange", "ball"):
                expected = golden.frame(ours, name, signs * axes).translation
                found = golden.frame(theirs, name, axes).translation * 1e3
                worst = max(worst, float(np.linalg.norm(found - expected)))
        masses = sum(inertia.mass for inertia in model.inertias)
        betas = [round(float(np.degrees(beta)), 4) for beta in table(robot)["beta"]]
        print(f"{folder}: largest difference {worst:.1e} mm; beta {betas} deg, {masses} kg")
        if worst > 1e-9:
            sys.exit("the URDF is another robot")


if __name__ == "__main__":
    patched(*sys.argv[2:]) if sys.argv[1] == "--patched" else main(sys.argv[1:])
