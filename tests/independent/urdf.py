#!/usr/bin/env python3
"""The URDF that `dbbd export --for` writes, in the programs that read it: MuJoCo, Drake, Pinocchio and yourdfpy load it, and have the
ball where `dbbd predict --model geometric` has it, at 200 random axis vectors. Drake has six actuators.

    python3 tests/independent/urdf.py DBBD [--ur-description DIR] ROBOT..     # directories of results, robot files, built-in names
    python3 tests/independent/urdf.py --patched PATCHED.urdf LINK ROBOT.toml  # that `dbbd export --urdf-in` wrote

With the package ur_description (a directory), xacro makes the arm of robot_calibration.yaml, whose tool0 is compared with the flange:
of ur10e with lengths and angles that are changed.

The last form compares LINK, which is fixed to link 6, in a user's patched URDF with the flange; where its root link and LINK
are in the robot is taken from the first pose (the root by a quarter turn), and the other poses must agree.

It fails above 1e-6 mm, and ends with 77 where a package is missing: pip install mujoco drake pin yourdfpy xacro.
"""
import csv
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

try:
    import mujoco
    import numpy as np
    import pinocchio as pin
    import yourdfpy
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
except ImportError as missing:
    print(f"SKIPPED: the readers of URDF: {missing}")
    sys.exit(77)

import golden

LIMIT_MM = 1e-6
AXES = [f"a{axis}_deg" for axis in range(1, 7)]
TOOL = [30.0, 20.0, 10.0]  # the ball of a built-in robot, which states none
REPOSITORY = Path(__file__).resolve().parents[2]


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
    if worst > LIMIT_MM:
        sys.exit("the URDF is another robot")


def in_mujoco(urdf):
    model = mujoco.MjModel.from_xml_path(urdf)
    data = mujoco.MjData(model)

    def ball(joints):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        return data.body("ball").xpos.copy()
    return ball


def in_drake(urdf):
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(urdf)
    plant.Finalize()
    assert plant.num_actuators() == 6, plant.num_actuators()
    context = plant.CreateDefaultContext()

    def ball(joints):
        plant.SetPositions(context, joints)
        return plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("ball")).translation()
    return ball


def in_pinocchio(urdf):
    model = pin.buildModelFromUrdf(urdf)
    data = model.createData()

    def ball(joints):
        pin.framesForwardKinematics(model, data, joints)
        return data.oMf[model.getFrameId("ball")].translation.copy()
    return ball


def in_yourdfpy(urdf):
    model = yourdfpy.URDF.load(urdf, load_meshes=False, load_collision_meshes=False)

    def ball(joints):
        model.update_cfg(joints)
        return model.get_transform("ball", "world")[:3, 3]
    return ball


READERS = [in_mujoco, in_drake, in_pinocchio, in_yourdfpy]


def run(dbbd, *arguments):
    done = subprocess.run([dbbd, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode in (0, 3), f"{arguments}: {done.stderr}"


def predicted(dbbd, folder, robot, file, *tool):
    """Axis vectors within the limits in degrees, and what `dbbd predict` says of each, mm."""
    random = np.random.default_rng(1)
    limits = np.array([joint["limits_deg"] for joint in robot["joint"]])
    axes = random.uniform(limits[:, 0], limits[:, 1], (200, 6))
    with open(folder / "axes.csv", "w", newline="") as poses:
        csv.writer(poses).writerows([AXES, *([repr(float(deg)) for deg in row] for row in axes)])
    run(dbbd, "predict", folder / "axes.csv", "--robot", file, "--model", "geometric", *tool, "--out", folder / "p.csv")
    with open(folder / "p.csv", newline="") as rows:
        return axes, np.array([[float(row[key]) for key in ("x_mm", "y_mm", "z_mm")] for row in csv.DictReader(rows)])


def definition(name, folder):
    """The robot of a result, of a file or of a built-in name, which gets a tool ball, and its file."""
    file = Path(name) / "robot-identified.toml" if Path(name).is_dir() else Path(name)
    if not file.is_file():
        file = folder / f"{name}.toml"
        file.write_text((REPOSITORY / "robots" / file.name).read_text() + f"\n[tool]\nball_mm = {TOOL}\n")
    return tomllib.loads(file.read_text()), file


def joints_of(robot, axes_deg):
    """The variables of the URDF: of a coupled joint the sum."""
    joints = np.radians(axes_deg)
    for at, joint in enumerate(robot["joint"]):
        if "coupling" in joint:
            joints[:, at] += joint["coupling"]["factor"] * np.radians(axes_deg[:, joint["coupling"]["axis"] - 1])
    return joints


def read_by_all(dbbd, name, folder):
    robot, file = definition(name, folder)
    run(dbbd, "export", file, "--for", "urdf", "--replace", "--out", folder)
    axes, expected = predicted(dbbd, folder, robot, file)
    for reader in READERS:
        ball = reader(str(folder / "robot-identified.urdf"))
        found = np.array([ball(joints) for joints in joints_of(robot, axes)]) * 1e3
        worst = np.linalg.norm(found - expected, axis=1).max()
        print(f"{name}: {reader.__name__}: largest difference {worst:.1e} mm over {len(axes)} poses")
        if worst > LIMIT_MM:
            sys.exit("the URDF is another robot")


def ur_description(dbbd, description, folder):
    """tool0 in `base` of the arm that xacro makes of the exported YAML, against the flange of dbbd."""
    text = (REPOSITORY / "robots/ur10e.toml").read_text()
    for key, by in (("a_mm", 0.7), ("d_mm", -0.4), ("alpha_deg", 0.03), ("theta_offset_deg", -0.02)):
        lines = [f"{key} = {float(line.split('=')[1]) + by}" if line.startswith(f"{key} =") else line for line in text.splitlines()]
        text = "\n".join(lines)
    (folder / "ur.toml").write_text(text + "\n")
    run(dbbd, "export", folder / "ur.toml", "--for", "ros", "--replace", "--out", folder)
    # The package is found by its index; this one is not installed.
    index = folder / "ament_index_python"
    index.mkdir(exist_ok=True)
    (index / "__init__.py").write_text("")
    (index / "packages.py").write_text(
        f"class PackageNotFoundError(KeyError):\n    pass\n\n\ndef get_package_share_directory(name):\n    return {str(description)!r}\n")
    arm = subprocess.run(
        ["xacro", f"{description}/urdf/ur.urdf.xacro", "name:=ur", "ur_type:=ur10e", f"kinematics_params:={folder}/robot_calibration.yaml"],
        env={**os.environ, "PYTHONPATH": str(folder)}, capture_output=True, text=True)
    assert arm.returncode == 0, arm.stderr
    model = pin.buildModelFromXML(arm.stdout)
    data = model.createData()
    axes, expected = predicted(dbbd, folder, tomllib.loads(text), folder / "ur.toml", "--tool", "0,0,0")
    worst = 0.0
    for joints, place in zip(np.radians(axes), expected):
        pin.framesForwardKinematics(model, data, joints)
        base, tool = (data.oMf[model.getFrameId(frame)] for frame in ("base", "tool0"))
        worst = max(worst, float(np.linalg.norm(base.actInv(tool).translation * 1e3 - place)))
    print(f"ur_description: largest difference of tool0 {worst:.1e} mm over {len(axes)} poses")
    if worst > LIMIT_MM:
        sys.exit("the YAML is another robot")


def main(dbbd, *robots):
    with tempfile.TemporaryDirectory() as folder:
        if robots[0] == "--ur-description":
            ur_description(dbbd, Path(robots[1]).resolve(), Path(folder))
            robots = robots[2:]
        for name in robots:
            read_by_all(dbbd, name, Path(folder))


if __name__ == "__main__":
    patched(*sys.argv[2:]) if sys.argv[1] == "--patched" else main(*sys.argv[1:])
