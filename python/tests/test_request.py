"""One request has one answer, whoever asks: the command, `dbbd request`, Python."""

import json
import shutil
import subprocess
import sys

import pytest

import dbbd
from conftest import ROOT, numbers

IDENTIFIED = "identify/robot-identified.toml"

#: A program with three points that the identified robot reaches.
PROGRAM = """DEF P( )
$BASE = {X 0, Y 0, Z 0, A 0, B 0, C 0}
$TOOL = {X 0, Y 0, Z 100, A 0, B 0, C 0}
PTP {A1 0, A2 -90, A3 90, A4 0, A5 30, A6 0}
LIN {X 1300, Y 0, Z 900, A 0, B 90, C 0}
LIN {X 1300, Y 100, Z 900, A 0, B 90, C 0}
END
"""

#: A request of each kind and its command line. A later one uses results of an earlier one.
REQUESTS = [
    ({"request": "plan", "job": "job.toml", "out": "plan"}, ["plan", "job.toml", "--out", "plan"]),
    (
        {"request": "identify", "input": "run.dbbd", "prior": "datasheet", "out": "identify"},
        ["identify", "run.dbbd", "--prior", "datasheet", "--out", "identify"],
    ),
    (
        {"request": "circle", "inputs": ["run.dbbd"], "out": "circle"},
        ["circle", "run.dbbd", "--out", "circle"],
    ),
    (
        {"request": "check", "input": "run.dbbd", "robot": IDENTIFIED, "tolerance_mm": 1.0,
         "rule": {"guard_band": {"risk": 0.05}}, "tool_repeat_mm": 0.01, "out": "check"},
        ["check", "run.dbbd", "--robot", IDENTIFIED, "--tolerance", "1", "--out", "check"],
    ),
    (
        {"request": "compensate", "program": "P.src", "robot": IDENTIFIED, "limit_mm": 20.0, "out": "corrected"},
        ["compensate", "P.src", "--robot", IDENTIFIED, "--limit", "20", "--out", "corrected"],
    ),
    (
        {"request": "certificate", "result": "identify", "check": "check", "out": "certificate"},
        ["certificate", "identify", "--check", "check", "--out", "certificate"],
    ),
]


def filled(folder):
    folder.mkdir()
    shutil.copy(ROOT / "fixtures" / "captures" / "run.dbbd", folder)
    job = (ROOT / "examples" / "circles.toml").read_text().replace("points = 80", "points = 12")
    (folder / "job.toml").write_text(job)
    (folder / "P.src").write_text(PROGRAM)
    return folder


def program(folder, *arguments, stdin=None):
    return subprocess.run([sys.executable, "-m", "dbbd", *arguments], cwd=folder, input=stdin, capture_output=True)


def written(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_request_of_each_kind_has_the_answer_of_its_command(tmp_path, monkeypatch):
    by_command, by_request, by_python = (filled(tmp_path / name) for name in ("command", "request", "python"))
    monkeypatch.chdir(by_python)
    for asked, command in REQUESTS:
        printed = program(by_command, *command, "--json")
        answered = program(by_request, "request", stdin=json.dumps(asked).encode() + b"\n")
        answer = dbbd.request_json(asked)
        assert printed.returncode in (0, 3) and printed.returncode == answered.returncode, printed.stderr
        # To the byte, but for the end of the last line.
        assert answered.stdout.decode() == answer + "\n", asked
        files = [written(folder / asked["out"]) for folder in (by_command, by_request, by_python)]
        assert files[0] == files[1] == files[2], asked
        result, document = json.loads(answer)["result"], json.loads(printed.stdout)
        assert sorted(result["files"]) == sorted(files[2])
        # `--json` prints the document with the findings that were reported before it.
        for each in (result["document"], document):
            each.pop("findings", None)
        assert result["document"] == document, asked


def test_a_request_is_a_dictionary_or_json(tmp_path, monkeypatch):
    monkeypatch.chdir(filled(tmp_path / "python"))
    asked = {"request": "circle", "inputs": ["run.dbbd"], "out": "circle"}
    answer = dbbd.request(asked)
    assert answer == dbbd.request(json.dumps(asked)) == json.loads(dbbd.request_json(asked))
    refused = dbbd.request({**asked, "inputs": ["another.dbbd"]})
    assert refused["refusal"]["code"].startswith("E") and "result" not in refused
    for wrong in ({}, {**asked, "holt": 1}, "{"):
        with pytest.raises(dbbd.DbbdError) as raised:
            dbbd.request(wrong)
        assert raised.value.code == "E0004"


def test_arrays_have_the_answer_of_the_request(tmp_path, monkeypatch):
    """A plan and a check of arrays are those of the request; test_identify.py has the identification."""
    monkeypatch.chdir(filled(tmp_path / "python"))
    for asked, _ in REQUESTS[:2]:
        assert "result" in dbbd.request(asked)
    plan = dbbd.plan("job.toml")
    plan.write("again")
    assert written(tmp_path / "python" / "again") == written(tmp_path / "python" / "plan")
    with pytest.warns(dbbd.DbbdWarning):
        identified = dbbd.Robot.load(IDENTIFIED)
    # The lengths beside the identified robot put the ball elsewhere, where the poses of the job are not safe.
    second = dbbd.request({"request": "plan", "job": "job.toml", "robot": IDENTIFIED, "out": "second"})
    with pytest.raises(dbbd.DbbdError) as raised:
        dbbd.plan("job.toml", robot=identified)
    assert raised.value.code == second["refusal"]["code"]
    answer = dbbd.request({**REQUESTS[3][0], "input": "identify/lengths.csv", "centres": "plan/centres.csv"})
    # The table has the temperature of the bar, 20 degrees.
    lengths = lengths_of(tmp_path / "python")
    check = dbbd.check(**lengths, robot=identified, tolerance_mm=1.0, temperature_c=20.0)
    expected = answer["result"]["document"]
    # Those of the files are with the answer.
    del expected["provenance"], expected["findings"]
    assert json.dumps(check.to_dict(), sort_keys=True) == json.dumps(expected, sort_keys=True)
    found = {finding["code"] for finding in check.findings}
    assert found <= {finding["code"] for finding in answer["findings"]}
    # The lengths identified this robot.
    assert "W1918" in found and check.decision != "pass"
    answer = dbbd.request({"request": "identify", "input": "identify/lengths.csv", "robot": IDENTIFIED,
                           "centres": "plan/centres.csv", "out": "twice"})
    result = dbbd.identify(**lengths_of(tmp_path / "python"), robot=identified)
    for findings in (answer["findings"], result.findings):
        assert "W1334" in {finding["code"] for finding in findings}


def lengths_of(folder):
    axes = [f"a{axis}_deg" for axis in range(1, 7)]
    senses = [f"approach{axis}" for axis in range(1, 7)]
    names = ["index", "centre", *axes, "length_mm", "sigma_mm", "t_s", *senses]
    table = numbers(folder / "identify" / "lengths.csv", names)
    return {
        "index": table[:, 0].astype(int),
        "ball": table[:, 1].astype(int),
        "axes_deg": table[:, 2:8],
        "lengths_mm": table[:, 8],
        "sigma_mm": table[:, 9],
        "t_s": table[:, 10],
        "approach": table[:, 11:].astype(int),
        "balls_mm": numbers(folder / "plan" / "centres.csv", ["x_mm", "y_mm", "z_mm"]),
    }
