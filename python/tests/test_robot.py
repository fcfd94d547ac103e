"""Positions, derivatives and axis angles against Pinocchio, an independent library."""

import gc
import os
import resource
import threading
import time

import numpy as np
import pinocchio as pin
import pytest

import dbbd
from conftest import ROOT

ROBOTS = dbbd.Robot.built_in()
# A FANUC shows axis 3 against the horizontal: its joint 3, which a URDF has, turns by A3 + A2.
COUPLED = {"crx10ia", "m10id12", "m20id25"}


def poses(robot, count):
    low, high = dbbd.Robot.load(robot).limits_deg.T
    return np.random.default_rng(1).uniform(low, high, (count, 6))


@pytest.mark.parametrize("name", ROBOTS)
def test_poses_and_derivatives_are_pinocchios(name, tmp_path):
    robot = dbbd.Robot.load(name, tool_mm=[30, 20, 10]).drawn(7)
    robot.to_urdf(tmp_path / "robot.urdf")
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    data, flange, ball = model.createData(), model.getFrameId("flange"), model.getFrameId("ball")
    q = np.radians(poses(name, 200))
    flanges, balls, jacobians = robot.fk_rad(q, frame="flange"), robot.fk_rad(q), robot.jacobian_rad(q)
    joints_by_axes = np.eye(6)
    joints_by_axes[2, 1] = name in COUPLED
    for at, axes in enumerate(q):
        pin.computeJointJacobians(model, data, joints_by_axes @ axes)
        pin.updateFramePlacements(model, data)
        assert np.allclose(1e3 * data.oMf[flange].translation, flanges[at, :3, 3], atol=1e-9, rtol=0)
        assert np.allclose(data.oMf[flange].rotation, flanges[at, :3, :3], atol=1e-12, rtol=0)
        assert np.allclose(1e3 * data.oMf[ball].translation, balls[at, :3, 3], atol=1e-9, rtol=0)
        jacobian = pin.getFrameJacobian(model, data, ball, pin.LOCAL_WORLD_ALIGNED) @ joints_by_axes
        assert np.allclose(1e3 * jacobian[:3], jacobians[at, :3], atol=1e-9, rtol=0)
        assert np.allclose(jacobian[3:], jacobians[at, 3:], atol=1e-12, rtol=0)


def offset_wrist(folder):
    """A KR 60 HA whose axes 4 and 6 pass each other at 150 mm."""
    joints = (ROOT / "robots" / "kr60ha.toml").read_text().split("[[joint]]")
    joints[5] = joints[5].replace("d_mm = 0.0", "d_mm = 150.0", 1)
    path = folder / "offset.toml"
    path.write_text("[[joint]]".join(joints))
    return dbbd.Robot.load(path, tool_mm=[30, 20, 10])


def numeric_ik(pin, model, frame, wanted, q):
    """Axis angles by Newton steps with Pinocchio's logarithm and Jacobian; None where they do not converge."""
    data = model.createData()
    for _ in range(60):
        pin.framesForwardKinematics(model, data, q)
        off = data.oMf[frame].actInv(wanted)
        error = pin.log6(off).vector
        if np.linalg.norm(error) < 1e-12:
            return q
        jacobian = pin.Jlog6(off.inverse()) @ pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        step = np.linalg.lstsq(jacobian, error, rcond=1e-9)[0]
        q = q + step * min(1.0, 0.5 / np.abs(step).max())
    return None


@pytest.mark.parametrize("kind", ["kr60ha", "ur10e", "offset wrist"])
@pytest.mark.parametrize("drawn", [False, True])
def test_axis_angles_are_pinocchios(kind, drawn, tmp_path):
    """What Pinocchio finds from any start is one of the branches, for the nominal and for an identified robot."""
    nominal = offset_wrist(tmp_path) if kind == "offset wrist" else dbbd.Robot.load(kind, tool_mm=[30, 20, 10])
    robot = nominal.drawn(7) if drawn else nominal
    robot.to_urdf(tmp_path / "robot.urdf")
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    frame, random = model.getFrameId("ball"), np.random.default_rng(5)
    low, high = np.radians(nominal.limits_deg.T)
    compared = 0
    for _ in range(40):
        q = random.uniform(low, high)
        # Near a singularity the angles of one pose differ.
        scaled = robot.jacobian_rad(q) * np.array([[1e-3]] * 3 + [[1.0]] * 3)
        if np.linalg.svd(scaled, compute_uv=False)[-1] < 0.03:
            continue
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        wanted = data.oMf[frame].copy()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = wanted.rotation, 1e3 * wanted.translation
        branches = robot.ik_rad(pose)
        for start in [q + random.uniform(-0.3, 0.3, 6), random.uniform(low, high)]:
            found = numeric_ik(pin, model, frame, wanted, start)
            if found is None:
                continue
            apart = np.abs((branches - found + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
            assert apart.min() < 1e-6, (q, found, branches)
            compared += 1
    assert compared >= 30


def test_axis_angles_lead_back_to_their_pose():
    robot = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]).drawn(3)
    q = poses("kr60ha", 300)
    pose = robot.fk_deg(q)
    found = robot.ik_deg(pose, near=q)
    assert np.isfinite(found).all(axis=1).mean() > 0.98
    assert np.nanmax(np.abs(robot.fk_deg(found) - pose)) < 1e-6
    branches = robot.ik_rad(pose[0])
    assert branches.shape[1] == 6 and np.abs(robot.fk_rad(branches) - pose[0]).max() < 1e-6
    far = pose[0].copy()
    far[0, 3] = 1e5
    with pytest.raises(dbbd.DbbdError):
        robot.ik_rad(far)
    assert np.isnan(robot.ik_deg(np.stack([far, pose[0]]), near=q[0])[0]).all()


def test_units_agree():
    robot, q = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), poses("kr60ha", 5)
    assert np.allclose(robot.fk_deg(q), robot.fk_rad(np.radians(q)), rtol=0, atol=1e-12 * 3000)
    per = np.array([np.pi / 180] * 3 + [1.0] * 3)[:, None]
    assert np.allclose(robot.jacobian_deg(q), per * robot.jacobian_rad(np.radians(q)), rtol=1e-12, atol=1e-12)
    assert robot.fk_deg(q[0]).shape == (4, 4) and robot.fk_deg(q.astype(int).tolist()).shape == (5, 4, 4)
    with pytest.raises(ValueError):
        robot.fk_deg(q[:, :5])


def test_a_batch_takes_at_most_twice_the_time_of_rust():
    rust = os.environ["DBBD_RUST_FK_S"]  # python/test.sh measures it
    robot = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])
    q = np.sin(0.37 * np.arange(100_000)[:, None] + np.arange(6))

    def one():
        started = time.perf_counter()
        robot.fk_rad(q)
        return time.perf_counter() - started

    least = min(one() for _ in range(10))
    print(f"100 000 poses: {least:.4f} s, Rust {float(rust):.4f} s")
    assert least <= 2 * float(rust)


def test_calls_leave_no_memory_behind():
    robot, q = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), poses("kr60ha", 1000)
    pose = robot.fk_deg(q[0])

    def calls(count):
        for _ in range(count):
            robot.fk_deg(q)
            robot.ik_deg(pose)
            robot.jacobian_deg(q[0])
            with pytest.raises(dbbd.DbbdError):
                dbbd.Robot.load("kr61")
            dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])
        gc.collect()

    def resident():
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize()

    calls(500)
    before = resident()
    calls(10_000)
    grown = resident() - before
    print(f"10 000 calls: {grown} bytes more")
    # The poses of a call are 128 kB: one lost in a hundred would be 13 MB.
    assert grown < 4e6


def test_other_threads_run_during_a_computation(paper):
    robot, counted, stop = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), [0], threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1

    thread = threading.Thread(target=count)
    thread.start()
    before, started = counted[0], time.perf_counter()
    dbbd.identify(**paper, robot=robot, prior="datasheet", monte_carlo=100)
    seconds, during = time.perf_counter() - started, counted[0] - before
    stop.set()
    thread.join()
    # With the lock held the thread would count only while Python itself runs.
    assert during > 10_000 * seconds


def test_warnings_of_a_robot_are_python_warnings(tmp_path):
    text = (ROOT / "robots" / "kr60ha.toml").read_text()
    warned = tmp_path / "warned.toml"
    warned.write_text('warnings = ["W1333"]\n' + text)
    with pytest.warns(dbbd.DbbdWarning, match="W1333") as said:
        dbbd.Robot.load(warned)
    assert said[0].message.code == "W1843"
    other = tmp_path / "other.toml"
    other.write_text(text.replace("sign = -1", "sign = 1", 1))
    with pytest.warns(dbbd.DbbdWarning) as said:
        dbbd.Robot.load(other)
    assert said[0].message.code == "W0581"
