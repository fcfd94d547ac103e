"""`identify` gives what the command gives, to the last bit."""

import json
import subprocess
import sys

import numpy as np
import pytest

import dbbd
from conftest import ROOT

#: What the paper identifies.
ASKED = "alpha1-5,a1-5,d4-6"


def command(folder, *options):
    paper = ROOT / "examples" / "paper"
    run = subprocess.run(
        [sys.executable, "-m", "dbbd", "identify", paper / "observations.csv", "--robot", "kr60ha", "--centres",
         paper / "centres.csv", "--out", folder, "--quiet", *options],
        capture_output=True, text=True)
    assert run.returncode in (0, 3), run.stderr
    return json.loads((folder / "result.json").read_text())


@pytest.mark.parametrize("options, keywords", [
    (["--estimate", ASKED], {"estimate": ASKED}),
    (["--prior", "datasheet"], {"prior": "datasheet"}),
    (["--estimate", "alpha1-5,a1-5,d2-6", "--sigma", "0.002", "--bar-u", "0.01"],
     {"estimate": "alpha1-5,a1-5,d2-6", "sigma_mm": 0.002, "bar_u_mm": 0.01}),
])
def test_result_is_that_of_the_command(tmp_path, paper, options, keywords):
    expected = command(tmp_path, *options)
    # A result in memory was made from no file, and is none.
    del expected["provenance"], expected["sha256"]
    found = dbbd.identify(**paper, robot=dbbd.Robot.load("kr60ha"), **keywords)
    # JSON writes a number as the shortest text that reads back to its bits.
    assert json.dumps(found.to_dict(), sort_keys=True) == json.dumps(expected, sort_keys=True)
    names = found.names
    covariance = np.genfromtxt(tmp_path / "covariance.csv", delimiter=",", skip_header=1)[..., 1:]
    assert np.array_equal(found.covariance, covariance.reshape(len(names), len(names)))


def test_prediction_is_that_of_the_command(tmp_path, paper):
    robot = dbbd.Robot.load("kr60ha")
    command(tmp_path, "--prior", "datasheet")
    found = dbbd.identify(**paper, robot=robot, prior="datasheet")
    table = tmp_path / "axes.csv"
    q = paper["axes_deg"][:20]
    names = [f"a{axis}_deg" for axis in range(1, 7)]
    table.write_text(",".join(names) + "\n" + "".join(",".join(map(repr, row.tolist())) + "\n" for row in q))
    run = subprocess.run([sys.executable, "-m", "dbbd", "predict", table, "--robot", tmp_path / "robot-identified.toml",
                          "--out", tmp_path / "p.csv"], capture_output=True, text=True)
    # The paper's circle does not determine the robot, and its file says so.
    assert run.returncode == 3 and "W1319" in run.stderr, run.stderr
    expected = np.genfromtxt(tmp_path / "p.csv", delimiter=",", names=True)
    places, sd = found.predict_deg(q)
    # The robot's file has its angles in degrees.
    assert np.allclose(places, np.stack([expected["x_mm"], expected["y_mm"], expected["z_mm"]], 1), atol=1e-9, rtol=0)
    assert np.allclose(sd, expected["sd_mm"], rtol=1e-6)


def test_a_check_finds_the_changed_joint(paper):
    given = {"balls_mm": paper["balls_mm"], "sigma_mm": 0.005}
    robot = dbbd.Robot.load("kr60ha")
    robot = dbbd.identify(**{**paper, **given}, robot=robot, prior="datasheet", model="geometric").robot
    q = paper["axes_deg"][::4]

    def read(offset_deg):
        moved = q + np.array([0, 0, offset_deg, 0, 0, 0])
        return dbbd.simulate(moved, 1, robot=robot, balls_mm=paper["balls_mm"], bar_mm=300.0)

    assert dbbd.check(q, read(0.0), 1, robot=robot, **given).decision == "pass"
    changed = dbbd.check(q, read(0.3), 1, robot=robot, **given)
    assert changed.decision == "fail" and changed.changes[0]["parameters"]


def test_errors_have_the_code_and_the_text_of_the_command(paper):
    run = subprocess.run([sys.executable, "-m", "dbbd", "robots", "show", "kr61"], capture_output=True, text=True)
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.Robot.load("kr61")
    assert run.returncode == 1
    assert run.stderr.strip() == f"error[{raised.value.code}]: {raised.value}"
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.identify(**{**paper, "ball": 2}, robot=dbbd.Robot.load("kr60ha"))
    assert raised.value.code.startswith("E")
    with pytest.raises(ValueError):
        dbbd.identify(**{**paper, "lengths_mm": [1.0, 2.0]}, robot=dbbd.Robot.load("kr60ha"))


def test_a_plan_reads_back(tmp_path):
    plan = dbbd.plan(ROOT / "examples" / "first" / "job.toml")
    plan.write(tmp_path)
    again = dbbd.Plan.read(tmp_path / "plan.csv")
    assert np.array_equal(plan.axes_deg, again.axes_deg) and len(plan.axes_deg) > 20
    assert plan.header()["hash"] == again.header()["hash"]


def test_a_capture_has_the_numbers_of_its_export(tmp_path):
    # The demo starts the simulator and every command as a child of this program.
    run = subprocess.run([sys.executable, "-m", "dbbd", "demo", "--out", tmp_path], capture_output=True, text=True)
    assert run.returncode in (0, 3), run.stderr
    path = next(tmp_path.rglob("*.dbbd"))
    subprocess.run([sys.executable, "-m", "dbbd", "export", path, "--out", tmp_path / "csv"], capture_output=True)
    exported = np.genfromtxt(tmp_path / "csv" / "samples.csv", delimiter=",", names=True)
    capture = dbbd.Capture.open(path)
    assert np.array_equal(capture.samples()["reading_mm"], exported["reading_mm"])
    assert capture.events()[0]["event"] == "started"
    arguments, _ = capture.lengths()
    assert len(capture.plan.axes_deg) >= len(arguments["lengths_mm"]) == len(arguments["axes_deg"]) > 50
    result = dbbd.identify(**arguments, robot=dbbd.Robot.load("kr60ha"), prior="datasheet", model="geometric")
    assert len(result.names) > 20


def test_positions_identify_alone_and_beside_lengths() -> None:
    nominal, random = dbbd.Robot.load("kr60ha"), np.random.default_rng(4)
    home, turns = np.array([0, -90, 90, 0, 60, 0]), np.array([60, 30, 30, 90, 50, 120])
    q = home + random.uniform(-1, 1, (60, 6)) * turns
    truth = nominal.drawn(seed=7)
    # A frame turned by a quarter about z and shifted.
    places = truth.fk_deg(q)[:, :3, 3] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) + [3000, -500, 200]
    balls = [[1300.0, -300.0, 600.0]]
    lengths = dbbd.simulate(q, 1, robot=truth, balls_mm=balls, bar_mm=300.0, noise_um=1.0, seed=1)
    tracked = {"positions_deg": q, "positions_mm": places, "positions_sigma_mm": 0.001, "model": "geometric"}
    alone = dbbd.identify(robot=nominal, **tracked)
    both = dbbd.identify(q, lengths, 1, robot=nominal, balls_mm=balls, sigma_mm=np.full(60, 0.001), **tracked)
    assert alone.to_dict()["made_from"] == {"lengths": 0, "positions": 60, "targets": 1}
    assert both.to_dict()["made_from"] == {"lengths": 60, "positions": 60, "targets": 1}
    others = home + random.uniform(-1, 1, (50, 6)) * turns
    distances = lambda at: np.linalg.norm(np.diff(at, axis=0), axis=1)  # noqa: E731
    true = distances(truth.fk_deg(others)[:, :3, 3])
    for result in (alone, both):
        assert np.abs(distances(result.predict_deg(others)[0]) - true).max() < 0.02
    with pytest.raises(ValueError):
        dbbd.identify(robot=nominal, positions_mm=places)
