"""`identify` gives what the command gives, to the last bit."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

import dbbd
from conftest import ROOT, numbers

#: What the paper identifies.
ASKED = "alpha1-5,a1-5,d4-6"


PAPER = ROOT / "examples" / "paper"

#: What the flange of a robot file carries.
CARRIED = """
[tool]
ball_mm = [30.0, 20.0, 10.0]

[[payload]]
name = "bar"
kg = 2.0
centre_mm = [0.0, 0.0, 60.0]

[[payload]]
name = "gripper"
kg = 50.0
centre_mm = [0.0, 0.0, 150.0]
"""


def command(folder, *options, table=PAPER / "observations.csv", robot="kr60ha"):
    run = subprocess.run(
        [sys.executable, "-m", "dbbd", "identify", table, "--robot", robot, "--tool", "30,20,10", "--centres",
         PAPER / "centres.csv", "--out", folder, "--quiet", *options],
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
    found = dbbd.identify(**paper, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), **keywords)
    assert same_result(found, expected)
    names = found.names
    covariance = np.genfromtxt(tmp_path / "covariance.csv", delimiter=",", skip_header=1)[..., 1:]
    assert np.array_equal(found.covariance, covariance.reshape(len(names), len(names)))


def same_result(found, expected):
    """JSON writes a number as the shortest text that reads back to its bits; a result in memory was made from no file."""
    of_file = {key: value for key, value in expected.items() if key not in ("provenance", "sha256")}
    return json.dumps(found.to_dict(), sort_keys=True) == json.dumps(of_file, sort_keys=True)


def test_payload_force_and_time_count_as_in_a_table(tmp_path, paper):
    robot, table = tmp_path / "robot.toml", tmp_path / "observations.csv"
    robot.write_text((ROOT / "robots" / "kr60ha.toml").read_text() + CARRIED)
    header, *rows = (PAPER / "observations.csv").read_text().splitlines()
    count = len(rows)
    further = {
        "payload": [["bar", "gripper", ""][at % 3] for at in range(count)],
        "force_n": [20.0 if at % 2 else np.nan for at in range(count)],
        "t_s": [10.5 * at for at in range(count)],
    }
    cells = zip(rows, further["payload"], further["force_n"], further["t_s"])
    lines = [f"{row},{name},{'' if np.isnan(force) else force},{time}" for row, name, force, time in cells]
    table.write_text("\n".join([f"{header},payload,force_n,t_s", *lines]) + "\n")
    expected = command(tmp_path / "result", "--prior", "datasheet", table=table, robot=robot)
    robot = dbbd.Robot.load(robot)
    assert same_result(dbbd.identify(**paper, **further, robot=robot, prior="datasheet"), expected)
    # One value is that of all lengths, and it matters.
    all_alike = dbbd.identify(**paper, payload="gripper", force_n=20.0, robot=robot, prior="datasheet")
    each_alike = {"payload": ["gripper"] * count, "force_n": [20.0] * count}
    assert all_alike.to_json() == dbbd.identify(**paper, **each_alike, robot=robot, prior="datasheet").to_json()
    assert all_alike.to_json() != dbbd.identify(**paper, robot=robot, prior="datasheet").to_json()
    for wrong in ({"payload": "spindle"}, {"force_n": 5000.0}):
        with pytest.raises(dbbd.DbbdError):
            dbbd.identify(**paper, **wrong, robot=robot)
    for wrong in ({"payload": ["bar"]}, {"force_n": [1.0, 2.0]}, {"t_s": np.inf}):
        with pytest.raises(ValueError):
            dbbd.identify(**paper, **wrong, robot=robot)


def test_day_and_temperature_are_those_of_an_identity(tmp_path, paper):
    (tmp_path / "identity.toml").write_text('measured = "2024-01-05"\n[[temperature]]\nof = "robot"\ncelsius = 23.0\n')
    expected = command(tmp_path / "result", "--prior", "datasheet", "--identity", tmp_path / "identity.toml")
    day = {"measured": "2024-01-05", "temperature_c": 23.0}
    found = dbbd.identify(**paper, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), prior="datasheet", **day)
    assert same_result(found, expected)
    found.robot.save(tmp_path / "robot.toml")
    for path in (tmp_path / "robot.toml", tmp_path / "result" / "robot-identified.toml"):
        keys = re.findall("(?m)^(date|temperature_c) = .*$", path.read_text())
        assert keys[:2] == ["date", "temperature_c"], path
    for wrong in ({"measured": "05.01.2024"}, {"temperature_c": 296.0}):
        with pytest.raises(dbbd.DbbdError):
            dbbd.identify(**paper, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), **wrong)


def test_what_is_known_of_a_robot_fades_until_the_lengths_are_measured(tmp_path):
    nominal, random = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), np.random.default_rng(3)
    q = np.array([0, -90, 90, 0, 60, 0]) + random.uniform(-1, 1, (120, 6)) * np.array([60, 30, 30, 90, 50, 120])
    given = {"balls_mm": [[1300.0, -300.0, 600.0]], "sigma_mm": 0.002}
    lengths = dbbd.simulate(q, 1, robot=nominal.drawn(seed=7), balls_mm=given["balls_mm"], bar_mm=300.0)
    first, later = (q[:80], lengths[:80], 1), (q[80:], lengths[80:], 1)
    options = {"prior": "datasheet", "model": "geometric", **given}
    robot = dbbd.identify(*first, robot=nominal, measured="2020-01-01", **options).robot

    def checked(robot, **day):
        found = dbbd.check(*later, robot=robot, **given, **day).to_dict()
        return found["predicted_position_uncertainty_mm"]["calibrated"]["mean"]

    def identified(**day):
        return dbbd.identify(*later, robot=robot, **{**options, "prior": "posterior"}, **day).predict_deg(q)[1].mean()

    same_day, today = {"measured": "2020-01-01"}, {}
    later_day = {"measured": "2022-01-01T08:00:00Z"}
    assert checked(robot, **same_day) < checked(robot, **later_day) < checked(robot, **today)
    assert identified(**same_day) < identified(**later_day)
    # The day stays with the file; a robot without one does not fade.
    robot.save(tmp_path / "robot.toml")
    assert "2020-01-01" in (tmp_path / "robot.toml").read_text()
    undated = dbbd.identify(*first, robot=nominal, **options).robot
    assert checked(undated, **same_day) == checked(undated, **today)


def test_prediction_is_that_of_the_command(tmp_path, paper):
    robot = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])
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
    covariance = found.covariance_deg(q)
    assert covariance.shape == (20, 3, 3) and found.covariance_deg(q[0]).shape == (3, 3)
    assert np.allclose(np.trace(covariance, axis1=1, axis2=2), sd**2, rtol=1e-9)
    for at, name in enumerate(["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]):
        row, column = np.triu_indices(3)
        assert np.allclose(covariance[:, row[at], column[at]], expected[name], rtol=1e-6, atol=1e-9), name


def test_a_check_finds_the_changed_joint(paper):
    given = {"balls_mm": paper["balls_mm"], "sigma_mm": 0.005}
    robot = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10])
    robot = dbbd.identify(**{**paper, **given}, robot=robot, prior="datasheet", model="geometric").robot
    q = paper["axes_deg"][::4]

    def read(offset_deg):
        moved = q + np.array([0, 0, offset_deg, 0, 0, 0])
        return dbbd.simulate(moved, 1, robot=robot, balls_mm=paper["balls_mm"], bar_mm=300.0)

    assert dbbd.check(q, read(0.0), 1, robot=robot, **given).decision == "unchanged"
    changed = dbbd.check(q, read(0.3), 1, robot=robot, **given)
    assert changed.decision == "changed" and changed.changes[0]["parameters"]


def test_errors_have_the_code_and_the_text_of_the_command(paper):
    run = subprocess.run([sys.executable, "-m", "dbbd", "robots", "show", "kr61"], capture_output=True, text=True)
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.Robot.load("kr61")
    assert run.returncode == 1
    assert run.stderr.strip() == f"error[{raised.value.code}]: {raised.value}"
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.identify(**{**paper, "ball": 2}, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]))
    assert raised.value.code.startswith("E")
    with pytest.raises(ValueError):
        dbbd.identify(**{**paper, "lengths_mm": [1.0, 2.0]}, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]))


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
    result = dbbd.identify(**arguments, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), prior="datasheet", model="geometric")
    assert len(result.names) > 20


def with_keys(capture, *keys):
    """The capture with further keys in the job of its plan, of which a file of this version has no hash."""
    head = 4 + 1 + 4 + 8  # magic, kind, length, time; the length of the name comes before the name
    start = capture.index(b"plan.json") - head - 2
    end = start + head + int.from_bytes(capture[start + 5:start + 9], "little")
    record = capture[start:end]
    for before, key in keys:
        record = record.replace(before, before + key, 1)
    record = record[:5] + (len(record) - head).to_bytes(4, "little") + record[9:]
    crc = 0xFFFFFFFF
    for byte in record[4:]:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x82F63B78 * (crc & 1)
    return capture[:start] + record + (crc ^ 0xFFFFFFFF).to_bytes(4, "little") + capture[end + 4:]


def test_lengths_of_a_run_carry_what_identify_uses(tmp_path):
    run, table = ROOT / "fixtures" / "captures" / "run.dbbd", tmp_path / "observations.csv"
    program = [sys.executable, "-m", "dbbd", "sync"]
    subprocess.run([*program, run, "--out", table], capture_output=True)
    written = numbers(table, ["index", "t_s"])
    arguments, _ = dbbd.Capture.open(run).lengths()
    assert np.array_equal(arguments["index"], written[:, 0])
    assert np.allclose(arguments["t_s"], written[:, 1], rtol=0, atol=1e-4)
    identity = json.loads((tmp_path / "observations.provenance.json").read_text())["provenance"]["identity"]
    assert arguments["measured"] == identity["measured"]
    assert arguments["force_n"] is None and arguments["payload"] is None
    # The same run with a bar that pulls, and with another payload than the usual.
    pulled = tmp_path / "pulled.dbbd"
    further = (b'"length_mm": 300.0,', b' "force_n": 20.0,'), (b'"robot": "kr60ha",', b' "payload": "gripper",')
    pulled.write_bytes(with_keys(run.read_bytes(), *further))
    arguments, _ = dbbd.Capture.open(pulled).lengths()
    count = len(arguments["lengths_mm"])
    assert arguments["force_n"].tolist() == [20.0] * count and arguments["payload"] == ["gripper"] * count
    robot = tmp_path / "robot.toml"
    robot.write_text((ROOT / "robots" / "kr60ha.toml").read_text() + CARRIED)
    options = {"prior": "datasheet", "model": "geometric"}
    assert dbbd.identify(**arguments, robot=dbbd.Robot.load(robot), **options).names
    # A robot without this payload is refused, as by the command.
    refused = dbbd.request({"request": "identify", "input": str(pulled), "out": str(tmp_path / "out")})["refusal"]
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.identify(**arguments, robot=dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), **options)
    assert raised.value.code == refused["code"]


def test_positions_identify_alone_and_beside_lengths() -> None:
    nominal, random = dbbd.Robot.load("kr60ha", tool_mm=[30, 20, 10]), np.random.default_rng(4)
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
