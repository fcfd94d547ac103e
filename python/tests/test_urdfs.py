"""Public URDFs with the joints of an identified robot, loaded by Pinocchio.

`DBBD_URDFS` names a directory with files that have the names of built-in robots (`kr6r900sixx.urdf`); those of UR come with
`pip install example-robot-data`.
"""

import os
import pathlib
import sysconfig

import numpy as np
import pinocchio as pin
import pytest

import dbbd


def public():
    folders = [pathlib.Path(os.environ["DBBD_URDFS"])] if "DBBD_URDFS" in os.environ else []
    beside = pathlib.Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data"
    folders.append(beside / "robots" / "ur_description" / "urdf")
    for name in dbbd.Robot.built_in():
        found = [path for folder in folders for path in (folder / f"{name}.urdf", folder / f"{name}_robot.urdf")]
        yield from [(name, path) for path in found if path.is_file()][:1]


URDFS = list(public())
assert URDFS, "no public URDFs: DBBD_URDFS and example-robot-data are absent"


@pytest.mark.parametrize("name, path", URDFS, ids=[name for name, _ in URDFS])
def test_the_last_link_moves_as_the_identified_flange(tmp_path, name, path):
    # As an identification leaves it: an identified robot has its nominal one inside.
    nominal = dbbd.Robot.load(name, tool_mm=[0, 0, 0])
    identified = identify(nominal)
    text, joints = identified.patch_urdf(path)
    (tmp_path / "patched.urdf").write_text(text)
    model = pin.buildModelFromUrdf(str(tmp_path / "patched.urdf"))
    data = model.createData()
    arm = [model.getJointId(joint["name"]) for joint in joints]
    low, high = nominal.limits_deg.T
    poses = np.random.default_rng(1).uniform(low, high, (1000, 6))
    flange, places = identified.fk_deg(poses, frame="flange"), []
    for axes in poses:
        q = pin.neutral(model)
        for joint, angle in zip(arm, np.radians(axes)):
            at, width = model.joints[joint].idx_q, model.joints[joint].nq
            q[at:at + width] = [angle] if width == 1 else [np.cos(angle), np.sin(angle)]
        pin.forwardKinematics(model, data, q)
        place = data.oMi[arm[-1]].homogeneous.copy()
        place[:3, 3] *= 1e3
        places.append(place)
    places = np.array(places)
    worst = min(apart(places, flange, quarter) for quarter in range(4))
    print(f"{name}: {worst:.1e} mm over 1000 poses; joints moved by up to {max(j['moved_mm'] for j in joints):.2f} mm")
    assert max(joint["moved_mm"] for joint in joints) > 0.01
    assert worst < 1e-6


def apart(places, flange, quarter):
    """The largest difference, mm; the root by a quarter turn, and where link and flange are to each other, by the first pose."""
    root = np.eye(4)
    root[:2, :2] = np.round([[np.cos(a := quarter * np.pi / 2), -np.sin(a)], [np.sin(a), np.cos(a)]])
    found = root @ places
    tip = np.linalg.inv(flange[0]) @ found[0]
    return np.linalg.norm((flange @ tip - found)[:, :3, 3], axis=1).max()


def identify(nominal):
    """Identified from lengths of a drawn true robot."""
    random = np.random.default_rng(2)
    low, high = nominal.limits_deg.T
    q = random.uniform(low, high, (150, 6))
    balls = np.array([[800.0, 0.0, 500.0], [0.0, 900.0, 700.0], [-600.0, -500.0, 900.0]])
    ball = np.arange(150) % 3 + 1
    truth = nominal.drawn(seed=4)
    lengths = dbbd.simulate(q, ball, robot=truth, balls_mm=balls, bar_mm=300.0)
    return dbbd.identify(q, lengths, ball, robot=nominal, balls_mm=balls, prior="datasheet", model="geometric").robot
