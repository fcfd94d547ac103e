"""Wrong inputs as users make them, each one mistake in sound files, and whether dbbd helps to find it.

    python3 tests/independent/wrong_inputs.py DBBD [--only PATTERN] [--json FILE]     (standard library only)

The sound files are made once by DBBD itself, and must raise none of the codes about mistakes (else: false alarm). Then each case copies
what it needs into a directory of its own, makes its mistake and runs the commands. The verdicts:

    helped     a code of the case came: it names this mistake
    unhelpful  another code came, which does not lead to the mistake
    silent     exit code 0, and no code that the sound files have not
    harmless   exit code 0, and the result is that of the sound files, for the reason that the case gives
    panic      the program ended by a panic or a signal, or did not end within 30 s

Not among the cases are mistakes that no program can notice, such as a constant error of a bar whose offset is estimated.
Exit code 0 if no case is silent, unhelpful or panic and no sound file raised a false alarm.
"""
import argparse
import concurrent.futures
import csv
import hashlib
import json
import math
import os
import pathlib
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
LIMIT_S = 30
CODE = re.compile(r"^(?:\S+: )?(?:error|warning|note)\[([EWI]\d{4})\]: (.*)", re.M)
AXES = [f"a{i}_deg" for i in range(1, 7)]
# What the sound files raise: notes that are normal.
USUAL = {"I0210", "I0240", "I0510", "I0714", "I0715", "I0716", "I1317", "I1320", "I1321", "I1326", "I1340", "I1412", "I1416", "I1413", "I1924",
         "I1850", "I1906", "I2003", "I2004", "I0711", "I0712", "I1111", "I1342", "I1343", "I1722"}
# Lengths, poses, balls and robot do not belong together: these say what to compare, not which column or axis is wrong.
OTHER = ("W1311", "W1312", "W1282", "W1322", "W1381", "W1281")


class Stop(Exception):
    """A step failed: the user goes no further."""


class Bench:
    """A directory with copies of sound files, and what the program said there."""

    def __init__(self, dbbd, sound, where):
        self.dbbd, self.sound, self.dir = dbbd, sound, pathlib.Path(where)
        self.texts, self.exits, self.output, self.cells = [], [], "", []
        self.panic, self.compare = False, None

    def take(self, *names):
        for name in names:
            source, target = self.sound / name, self.dir / pathlib.Path(name).name
            if source.is_dir():
                shutil.copytree(source, target, dirs_exist_ok=True)
            else:
                shutil.copy(source, target)
        return self

    def run(self, *commands):
        for command in commands:
            try:
                done = subprocess.run([self.dbbd] + shlex.split(command), cwd=self.dir, capture_output=True, text=True, errors="replace", timeout=LIMIT_S,
                                      stdin=subprocess.DEVNULL, env={**os.environ, "NO_COLOR": "1"})
                self.heard(command, done.returncode, done.stdout + "\n" + done.stderr)
            except subprocess.TimeoutExpired as late:
                self.heard(command, -1, str(late))
            if self.exits[-1] in (1, 2) or self.panic:
                raise Stop
        return self

    def heard(self, command, code, said):
        self.output += f"$ dbbd {command}\n{said}\nexit code {code}\n"
        self.exits.append(code)
        self.texts += [f"{c} {text}" for c, text in CODE.findall(said)]
        self.texts += ["usage " + said] if code == 2 else ["exit4 the robot has changed"] if code == 4 else []
        self.panic |= code < 0 or code == 101 or "panicked at" in said or "[E0009]" in said

    @property
    def codes(self):
        return sorted({text.split(" ", 1)[0] for text in self.texts})

    def cell(self, options, pace="0"):
        """Starts a simulated cell; the address of its bar."""
        with open(self.dir / "cell.log", "w") as log:
            cell = subprocess.Popen([self.dbbd] + shlex.split(f"simulate --speed {pace} --listen tcp://127.0.0.1:0 {TOOL} {options}"), cwd=self.dir, text=True,
                                    stdout=subprocess.PIPE, stderr=log)
        self.cells.append(cell)
        return (cell.stdout.readline().split() or [""])[-1]

    def simulated(self, options):
        """Runs `simulate` with a reader; what the simulator says counts."""
        port = self.cell(options)
        if port:
            subprocess.run([self.dbbd] + f"acquire --port {port} --out r.dbbd --gone 1 --duration 3".split(), cwd=self.dir, capture_output=True, timeout=LIMIT_S)
        self.heard(options, self.cells[-1].wait(LIMIT_S), (self.dir / "cell.log").read_text())

    def measure(self, plan, program, out, options=""):
        """Records a run of a program on the simulated cell."""
        port = self.cell(f"--program {program} {options}")
        return self.run(f"acquire --port {port} --plan {plan} --out {out} --gone 1")

    def close(self):
        for cell in self.cells:
            cell.kill()
            cell.wait()
            cell.stdout.close()

    # ---- changes of files

    def text(self, name, *changes):
        """Replaces texts (old, new), each of which must be there; a pattern where `old` is compiled."""
        path = self.dir / name
        text = path.read_text()
        for old, new in changes:
            after = old.sub(new, text) if isinstance(old, re.Pattern) else text.replace(old, new)
            assert after != text, f"{name} has no {old}"
            text = after
        path.write_text(text)
        return self

    def bytes(self, name, change):
        path = self.dir / name
        path.write_bytes(change(path.read_bytes()))
        return self

    def rows(self, name, change, delimiter=",", fields=None):
        """Changes the rows (dictionaries) of a table; `change` alters them or returns others."""
        path = self.dir / name
        with open(path, newline="") as file:
            read = csv.DictReader(file)
            rows, columns = list(read), read.fieldnames
        rows = change(rows) or rows
        with open(path, "w", newline="") as file:
            write = csv.DictWriter(file, fields or list(rows[0]) or columns, delimiter=delimiter, extrasaction="ignore")
            write.writeheader()
            write.writerows(rows)
        return self

    def write(self, name, text):
        (self.dir / name).write_text(text)
        return self


# ---- changes of tables

def each(change, *columns):
    """A change of the numbers of some columns in all rows."""
    def rows(table):
        for row in table:
            for column in columns:
                row[column] = repr(change(float(row[column])))
    return rows


def some(which, change):
    def rows(table):
        for at, row in enumerate(table):
            if which(at, len(table)):
                change(row)
    return rows


def put(**cells):
    return lambda row: row.update(cells)


def moved(column, by):
    """Adds to a number of a row."""
    return lambda row: row.update({column: repr(float(row[column]) + by)})


def swapped(one, other):
    def rows(table):
        for row in table:
            row[one], row[other] = row[other], row[one]
    return rows


def column(change, *names):
    """Changes a column (or several alike) as a list: sorted, shifted, reversed."""
    def rows(table):
        for name in names:
            for row, cell in zip(table, change([row[name] for row in table])):
                row[name] = cell
    return rows


every = lambda at, n: True
half = lambda at, n: at >= n // 2
one = lambda at, n: at == n // 2
fifth = lambda at, n: at % 5 == 0


# ---- commands on the sound files

def does(take, *commands, change=None, cell=None, same=None):
    """Takes sound files (names in one text), changes them and runs the commands; `cell` are options of a simulated cell, whose bar is {port}."""
    def case(b):
        b.take(*take.split())
        if change:
            change(b)
        b.compare = same
        port = b.cell(cell) if cell else ""
        b.run(*(c.replace("{port}", port) for c in commands))
    return case


def both(*changes):
    return lambda b: [change(b) for change in changes]


def text(name, *changes):
    return lambda b: b.text(name, *changes)


def rows(name, change, **more):
    return lambda b: b.rows(name, change, **more)


def cut(name, share=0.5):
    return lambda b: b.bytes(name, lambda v: v[:int(len(v) * share)])


def write(name, content):
    return lambda b: b.write(name, content)


def copied(source, target):
    return lambda b: shutil.copy(b.dir / source, b.dir / target)


def without(name):
    return lambda b: (b.dir / name).unlink()


def job(*changes, options=""):
    return does("job.toml", f"plan job.toml --out plan {options}", change=text("job.toml", *changes))


def robot_file(*changes):
    """A robot file that is wrong, which states the tool ball in place of the job."""
    return does("job.toml kr60.toml", "plan job.toml --robot kr60.toml --out plan", change=both(text("job.toml", NO_TOOL), text("kr60.toml", *changes)))


# A robot of the catalogue states no tool ball.
TOOL = "--tool 30,20,10"
OWN = f"identify own.csv --robot kr60ha {TOOL} --centres centres.csv --bar-u 0.001 --out out"


def own(change=None, options="--prior datasheet", balls=None, same=False, replace=("", ""), take="", **more):
    """Identification from an own table of lengths: another table, table of balls or command."""
    return does("own.csv centres.csv " + take, f"{OWN} {options}".replace(*replace), same=("out/result.json", "own/result.json") if same else None, change=both(
        *[rows("own.csv", change, **more)] * bool(change), *[rows("centres.csv", balls)] * bool(balls)))


def raw(change, same=False):
    """Identification from an own table whose bytes were changed."""
    return does("own.csv centres.csv", f"{OWN} --prior datasheet", change=lambda b: b.bytes("own.csv", change), same=("out/result.json", "own/result.json") if same else None)


def tracked(change, options="--prior datasheet", robot="kr60ha"):
    return does("positions.csv", f"identify positions.csv --robot {robot} {TOOL} --out out {options}", change=rows("positions.csv", change))


CHECK = "check check.dbbd --robot result/robot-identified.toml --out out "


def check_own(change=lambda rows: None, options="", balls=lambda rows: None):
    return does("check.csv centres.csv own", f"check check.csv --robot own/robot-identified.toml --centres centres.csv --bar-u 0.001 --out out {options}",
                change=both(rows("check.csv", change), rows("centres.csv", balls)))


def circle(change=lambda rows: None, options="", same=None, radius=300, **more):
    return does("circle.csv", f"circle circle.csv --radius {radius} --out out {options}", change=rows("circle.csv", change, **more), same=same)


GLUE = "result GLUE01.src GLUE01.dat config.dat"


def compensate(change=None, options="", config="--config config.dat", take=GLUE, program="GLUE01.src", robot="result"):
    return does(take, f"compensate {program} --robot {robot}/robot-identified.toml {config} --limit 8 --out out {options}", change=change)


def certify(options="", change=None, take="result checked"):
    return does(take, f"certificate result --specimen --out out {options}", change=change)


def identity(toml):
    return certify("--identity i.toml", write("i.toml", toml))


def predicted(change):
    return does("result poses.csv", "predict poses.csv --robot result/robot-identified.toml --out p.csv", change=rows("poses.csv", change))


def imported(change=lambda rows: None, mapping=None, plan="plan", same=None, **more):
    return does(f"trace.csv mapping.toml {plan}", f"import trace.csv --mapping mapping.toml --plan {plan}/plan.csv --out run.dbbd", "sync run.dbbd --out obs.csv",
                "identify run.dbbd --prior datasheet --out out", change=both(rows("trace.csv", change, **more), *[text("mapping.toml", mapping)] * bool(mapping)), same=same)


def driven(options="", program="krl/DBB_MAIN.src", plan="plan", take="", change=None, then=("sync r.dbbd --out o.csv", "identify r.dbbd --prior datasheet --out out")):
    """A run of a program on the simulated cell, with options or a changed world."""
    return does(f"{plan} krl world.toml {take}", f"acquire --port {{port}} --plan {plan}/plan.csv --out r.dbbd --gone 1", *then, change=change,
                cell=f"--program {program} --world world.toml {options}")


def fault(name):
    return driven(f"--fault {name}", then=())


def simulated(options, take="krl", change=None):
    def case(b):
        b.take(*take.split())
        if change:
            change(b)
        b.simulated(options)
    return case


LISTING = "fanuc-program/DBB_C001.ls"


def listing(*changes, options="", change=None):
    """A listing with changed texts, corrected."""
    return does("fanuc-result fanuc-program", f"compensate {LISTING} --robot fanuc-result/robot-identified.toml --limit 20 --out out {options}",
                change=change or text(LISTING, *changes))


def handed_back(options, take="result", change=None):
    return does(take, f"export {options} --out out", change=change)


def imported_and_planned(b):
    """A robot from machine data, which have no tool ball, with that of the job."""
    b.run("robots import machine.dat --out imported.toml", "plan job.toml --robot imported.toml --out imported-plan")


def machine(*changes, change=None):
    def case(b):
        (change or text("machine.dat", *changes))(b.take("machine.dat", "job.toml"))
        imported_and_planned(b)
    return case


def renewed(options="--renew --robot result/robot-identified.toml", take="result", change=None):
    return does(f"job.toml {take}", f"plan job.toml {options} --out out", change=change)


def predicted_as(options):
    return does("result poses.csv", f"{PREDICT} {options}")


def datum(of, take="poses.csv", change=None):
    return compensate(change, options=f"--datum {of}", take=f"{GLUE} {take}")


def excluded(rows, options=""):
    return own(options=f"--prior datasheet --exclude {rows} {options}")


def joined(inputs, options="", change=None):
    return does(inputs, f"identify {inputs} --prior datasheet --out out {options}", change=change)


def loaded(*changes, table=lambda rows: None, options=""):
    """Lengths half of which were measured with a gripper, whose mass is in the robot file."""
    return does("loads.toml loaded.csv centres.csv", f"{LOADED} {options}", change=both(rows("loaded.csv", table), *[text("loads.toml", *changes)] * bool(changes)))


def users(*changes):
    return served(SERVICE, text("dbbd.toml", *changes))


def served(config, change=None):
    return does("", "serve --config dbbd.toml --check", change=both(lambda b: (b.dir / "plans").mkdir(), write("dbbd.toml", config), *[change] * bool(change)))


# ---- the sound files

TODAY = time.strftime("%Y-%m-%d")
# The values of a KR 60 HA as its controller keeps them.
MACHINE = """&ACCESS RVO
DEFDAT $MACHINE PUBLIC
$TRAFONAME[]="#KR60HA C4 FLR"
DECL KINCLASS $KINCLASS=#STANDARD
DECL MAIN_AXIS $MAIN_AXIS=#NR
DECL WRIST_AXIS $WRIST_AXIS=#ZEH
""" + "".join(f"$AXIS_DIR[{i}]={d}\n$SOFTN_END[{i}]={low}\n$SOFTP_END[{i}]={high}\n" for i, d, low, high in (
    (1, -1, -185.0, 185.0), (2, 1, -135.0, 35.0), (3, 1, -120.0, 158.0), (4, -1, -350.0, 350.0), (5, -1, -119.0, 119.0), (6, -1, -350.0, 350.0))) + """\
FRAME $TIRORO={x 0.0,y 0.0,z 815.0,a 0.0,b 0.0,c 0.0}
FRAME $TFLWP={x 0.0,y 0.0,z 170.0,a 0.0,b 0.0,c 0.0}
FRAME $TX3P3={x 820.0,y 0.0,z 145.0,a 0.0,b 90.0,c 0.0}
REAL $LENGTH_A=350.0
REAL $LENGTH_B=850.0
DECL DHART $DH_4={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA 90.0}
DECL DHART $DH_5={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA -90.0}
ENDDAT
"""
SERVICE = f"""address = "0.0.0.0:8230"
plans = "plans"
[[user]]
name = "anna"
role = "plan"
token_hash = "{hashlib.sha256(b"a token of anna").hexdigest()}"
[[user]]
name = "ben"
role = "look"
token_hash = "{hashlib.sha256(b"a token of ben").hexdigest()}"
"""
LOADS = """
[[payload]]
name = "bar"
kg = 2.0
centre_mm = [0.0, 0.0, 60.0]

[[payload]]
name = "gripper"
kg = 50.0
centre_mm = [0.0, 0.0, 150.0]
u_kg = 0.5
u_mm = 5.0
"""
LOADED = "identify loaded.csv --robot loads.toml --centres centres.csv --bar-u 0.001 --out loaded --prior datasheet"
PREDICT = "predict poses.csv --robot result/robot-identified.toml --out p.csv"


def make_sound(b, report):
    """Makes the sound files in the directory of a bench; every command is a control."""
    b.dir.mkdir(parents=True, exist_ok=True)
    try:
        make_files(b)
    except Stop:
        sys.exit(f"the sound files cannot be made:\n{b.output[-2000:]}")
    report(b)


def make_files(b):
    for source in ("fixtures/two-balls/job.toml", "examples/first/check.toml", "fixtures/two-balls/world.toml", "fixtures/krl/GLUE01.src", "fixtures/krl/GLUE01.dat",
                   "fixtures/krl/config.dat", "examples/paper/observations.csv", "examples/paper/centres.csv"):
        shutil.copy(ROOT / source, b.dir / (("paper-" if "paper" in source else "") + pathlib.Path(source).name))
    b.text("GLUE01.src", ("LIN_REL {Z 50.0}\n", ""))
    for name, robot, ball in (("ur", "ur10e", "[600.0, 300.0, 300.0]"), ("irb", "irb1600-10-145", "[850.0, 0.0, 700.0]"), ("kr16", "kr16-2", "[1000.0, 0.0, 800.0]"),
                              ("fanuc", "m10id12", "[900.0, 0.0, 300.0]")):
        b.write(f"{name}.toml", f'robot = "{robot}"\n[bar]\nlength_mm = 300.0\nlength_u_mm = 0.002\nstroke_mm = [-8.0, 8.0]\nmargin_mm = 0.5\n'
                f'[tool]\nball_mm = [0.0, 0.0, 0.0]\n[[centre]]\nid = 1\nxyz_mm = {ball}\n[optimise]\npoints = 40\ncandidates = 600\n[motion]\nsettle_s = 0.4\ndwell_s = 0.5\n')
    b.write("kr60.toml", (ROOT / "robots/kr60ha.toml").read_text() + "\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n")
    b.run("plan job.toml --out plan", "krl plan/plan.csv --out krl", "acquire --port sim --plan plan/plan.csv --out run.dbbd", "info run.dbbd",
          "sync run.dbbd --out observations.csv", "identify run.dbbd --prior datasheet --out result", "info result/robot-identified.toml",
          "plan --check job.toml --robot result/robot-identified.toml --out check-plan", "krl check-plan/plan.csv --out check-krl",
          "acquire --port sim --plan check-plan/plan.csv --out check.dbbd", "sync check.dbbd --out check-observations.csv",
          "check check.dbbd --robot result/robot-identified.toml --tolerance 2.5 --out checked",
          "check check.dbbd --robot result/robot-identified.toml --balls-kept --out kept",
          "plan check.toml --out circ", "krl circ/plan.csv --out circ-krl", "acquire --port sim --plan circ/plan.csv --out circ.dbbd",
          "circle circ.dbbd --out circle", "compensate circ-krl/DBB_C001.src --robot result/robot-identified.toml --out corrected",
          "compensate GLUE01.src --config config.dat --robot result/robot-identified.toml --limit 8 --out glue",
          "certificate result --check checked --specimen --out certificate", "export run.dbbd --out exported",
          "predict observations.csv --robot result/robot-identified.toml --out predicted.csv")
    # another robot of the same type, in another cell
    shutil.copytree(b.dir / "krl", b.dir / "krl-b")
    b.measure("plan/plan.csv", "krl-b/DBB_MAIN.src", "run-b.dbbd", "--seed 7 --world world.toml").close()
    b.run("sync run-b.dbbd --out observations-b.csv", "identify run-b.dbbd --prior datasheet --out result-b", "compare result result-b --out compared")
    for name in ("kr16", "ur", "irb", "fanuc"):
        b.run(f"plan {name}.toml --out {name}-plan", f"program {name}-plan/plan.csv --out {name}-program",
              f"acquire --port sim --plan {name}-plan/plan.csv --out {name}.dbbd")
    b.run("identify kr16.dbbd --prior datasheet --out kr16-result", "identify irb.dbbd --prior datasheet --out irb-result",
          "compensate irb-program/DBB_C001.mod --robot irb-result/robot-identified.toml --limit 20 --out irb-corrected")
    b.run("identify fanuc.dbbd --prior datasheet --out fanuc-result",
          "compensate fanuc-program/DBB_C001.ls --robot fanuc-result/robot-identified.toml --limit 20 --out fanuc-corrected")
    b.run("identify ur.dbbd --prior datasheet --out ur-result",
          "compensate ur-program/DBB_MAIN.script --robot ur-result/robot-identified.toml --controller-model nominal --limit 20 --out ur-corrected")
    # tables as a user writes them: without the record of their origin
    lean = ["index", "centre"] + AXES + ["length_mm", "sigma_mm"]
    for name, source in (("own.csv", "observations.csv"), ("check.csv", "check-observations.csv"), ("own-b.csv", "observations-b.csv")):
        shutil.copy(b.dir / source, b.dir / name)
        b.rows(name, lambda rows: None, fields=lean)
    shutil.copy(b.dir / "plan/centres.csv", b.dir / "centres.csv")
    shutil.copy(b.dir / "own.csv", b.dir / "poses.csv")
    b.rows("poses.csv", lambda rows: None, fields=AXES)
    b.run(f"{OWN.replace('--out out', '--out own')} --prior datasheet", OWN.replace("--out out", "--out own-default"), "info own/result.json",
          "check check.csv --robot own/robot-identified.toml --centres centres.csv --bar-u 0.001 --out checked-own",
          "predict poses.csv --robot result/robot-identified.toml --out p.csv")
    # positions of a tracker: of robot b, in a frame turned by 30 degrees about Z
    b.run("predict own.csv --robot result-b/robot-identified.toml --out positions.csv")
    noise, cos, sin = random.Random(1), math.cos(math.pi / 6), math.sin(math.pi / 6)

    def tracker(rows):
        for row in rows:
            x, y, z = (float(row[k]) + noise.gauss(0, 0.02) for k in ("x_mm", "y_mm", "z_mm"))
            row.update(x_mm=repr(cos * x - sin * y - 2500), y_mm=repr(sin * x + cos * y + 300), z_mm=repr(z - 900))
    b.rows("positions.csv", tracker, fields=AXES + ["x_mm", "y_mm", "z_mm"])
    b.run(f"identify positions.csv --robot kr60ha {TOOL} --prior datasheet --out tracked",
          f"identify own-b.csv --centres centres.csv --positions positions.csv --robot kr60ha {TOOL} --prior datasheet --bar-u 0.001 --out both")
    # a circular test of other software, and a trace of another instrument
    noise = random.Random(2)

    def radius(angle):
        t = math.radians(angle)
        return 300.02 + 0.03 * math.cos(t) + 0.05 * math.sin(t) + 0.04 * math.cos(2 * t + 0.3) + noise.gauss(0, 0.002)
    rows = [("1", "ccw", angle, radius(angle) + 0.004) for angle in range(0, 360, 5)] + [("1", "cw", angle, radius(angle) - 0.004) for angle in range(355, -1, -5)]
    b.write("circle.csv", "run,direction,angle_deg,length_mm,t_s,temp_c\n" + "".join(f"{r},{w},{a},{l:.5f},{t * 0.5:.1f},21.3\n" for t, (r, w, a, l) in enumerate(rows)))
    b.run("circle circle.csv --radius 300 --out circle-own")
    with open(b.dir / "exported/samples.csv", newline="") as file:
        samples = list(csv.DictReader(file))[::5]
    b.write("trace.csv", "t_s,length_mm,strobe,valid\n" + "".join(
        f"{float(s['ticks']) * 1e-6:.3f},{300 + float(s['reading_mm']):.4f},{s['trigger']},{s['valid']}\n" for s in samples))
    b.write("mapping.toml", '[time]\nunit = "s"\n\n[length]\nunit = "mm"\nkind = "distance"\n\n[strobe]\ncolumn = "strobe"\n\n[valid]\ncolumn = "valid"\n')
    b.run("import trace.csv --mapping mapping.toml --plan plan/plan.csv --out traced.dbbd", "sync traced.dbbd --out traced.csv",
          "identify traced.dbbd --prior datasheet --out traced", "export result --for urdf --out result",
          "export kr16-result --for urdf --out kr16-result", "export result/robot-identified.toml --urdf-in result/robot-identified.urdf --out urdf")
    b.run("plan job.toml --renew --robot result/robot-identified.toml --out renewal", "export result --for kuka --out handed-back",
          "export fanuc-result --for fanuc --out fanuc-handed-back", f"{OWN} --exclude 9,13:slammed".replace("--out out", "--out excluded"),
          f"{PREDICT} --temperature 24 --tool 0,0,150 --date {TODAY}",
          "compensate GLUE01.src --config config.dat --robot result/robot-identified.toml --limit 8 --datum poses.csv --out glue-datum",
          "identify run.dbbd check.dbbd --prior datasheet --out joined")
    b.write("machine.dat", MACHINE)
    imported_and_planned(b)
    (b.dir / "plans").mkdir()
    b.write("dbbd.toml", SERVICE).run("serve --config dbbd.toml --check")
    b.write("loads.toml", (b.dir / "kr60.toml").read_text() + LOADS)
    shutil.copy(b.dir / "own.csv", b.dir / "loaded.csv")
    b.rows("loaded.csv", some(half, put(payload="gripper")), fields=lean + ["payload"])
    b.run(LOADED)
    b.write("identity.toml", 'laboratory = "Laboratory"\noperator = "A. Example"\n').run("certificate result --identity identity.toml --specimen --out certificate-2")


# ---- the cases: (name, verb, what is done, codes that name the mistake[, why the result is the same])
# A code may be followed by a word that its sentence must have. `usage` stands for exit code 2, `exit4` for a robot that has changed.

UNIT = ("E0130", "E0602")
TAUGHT = [-2.8178, -61.2356, 116.7537, 13.6265, 57.4349, -206.6011]
NO_TOOL = (re.compile(r"\[tool\]\nball_mm = .*\n"), "")
BALL_2, MOTION, BOX = "xyz_mm = [950.0, 700.0, 1100.0]", "[motion]\nfeed", '\n[[obstacle]]\nshape = "box"\n'
ROBOT_EDITED = text("result/robot-identified.toml", (re.compile(r"d_mm = 8(\d\d)"), r"d_mm = 9\1"))
RESULT_EDITED = text("result/result.json", ('"converged": true', '"converged": false'))
URDF = "export result/robot-identified.toml --urdf-in"
KRL, ACQUIRE = "krl plan/plan.csv --out k", "acquire --port sim --plan plan/plan.csv --out r.dbbd"
NUMBER = r"(-?\d+\.\d+)"


def scaled(pattern, factor):
    """A change of a text: every number in the groups of a pattern times a factor."""
    return re.compile(pattern), lambda m: re.sub(r"-?\d+\.?\d*", lambda n: f"{float(n[0]) * factor:.6f}", m[0])


def taught(change):
    return job((str(TAUGHT), str([round(v, 4) for v in change(TAUGHT)])))


def bar(line):
    return job(("margin_mm = 0.5 ", line + "\nmargin_mm = 0.5 "))


def german(table):
    for row in table:
        row.update({k: v.replace(".", ",") for k, v in row.items()})


def lengthened(by):
    """Changes the lengths by a function of place (0 to 1) and row."""
    def change(table):
        for at, row in enumerate(table):
            row["length_mm"] = repr(float(row["length_mm"]) + by(at / len(table), row))
    return change


CASES = [
    # ---- plan
    ("bar length in metres", "plan", job(("length_mm = 300.0", "length_mm = 0.3")), UNIT),
    ("uncertainty of the bar in um", "plan", job(("length_u_mm = 0.002", "length_u_mm = 2.0")), UNIT),
    ("stroke exchanged", "plan", job(("[-5.0, 5.0]", "[5.0, -5.0]")), UNIT),
    ("stroke in um", "plan", job(("[-5.0, 5.0]", "[-5000.0, 5000.0]")), UNIT),
    ("sigma of the bar in mm", "plan", bar("sigma_um = 0.002"), UNIT),
    ("base ball in metres", "plan", job(("[1300.0, 0.0, 800.0]", "[1.3, 0.0, 0.8]")), ("E0130", "E0607")),
    ("sign of Y of a base ball", "plan", job((BALL_2, "xyz_mm = [950.0, -700.0, 1100.0]")), ("E0607",)),
    ("X and Y of a base ball exchanged", "plan", job((BALL_2, "xyz_mm = [700.0, 950.0, 1100.0]")), ("E0607",)),
    ("base ball mistyped by 10 mm", "plan", job((BALL_2, "xyz_mm = [960.0, 700.0, 1100.0]")), ("E0607",)),
    ("taught_deg in radians", "plan", taught(lambda q: [math.radians(v) for v in q]), ("E0607",)),
    ("taught_deg reversed", "plan", taught(lambda q: q[::-1]), ("E0607", "E0703")),
    ("taught with the tool of the gripper", "plan", job(("[30.0, 20.0, 10.0]", "[0.0, 0.0, 180.0]")), ("E0607",)),
    ("no tool ball", "plan", job(NO_TOOL), ("E0507",)),
    ("tool ball in metres", "plan", job(("[30.0, 20.0, 10.0]", "[0.03, 0.02, 0.01]")), UNIT),
    ("another robot type", "plan", job(('"kr60ha"', '"kr16-2"')), ("E0607",)),
    ("name of the robot mistyped", "plan", job(('"kr60ha"', '"kr60hs"')), ("E0503",)),
    ("key mistyped", "plan", job(("stroke_mm", "strok_mm")), ("E0120",)),
    ("radius of another bar", "plan", job(('plane = "XZ"', 'plane = "XZ"\nradius_mm = 250.0')), ("E0705",)),
    ("arc in radians", "plan", job(("arc_deg = 216.0", "arc_deg = 3.77")), ("E0130", "E0605", "I0713")),
    ("tilt in radians", "plan", job(("tilt_deg = 30.0", "tilt_deg = 0.5236")), ("I0713", "E0130")),
    ("feed in m/s", "plan", job(("feed_mm_s = 40.0", "feed_mm_s = 0.04")), UNIT),
    ("dwell in ms", "plan", job(("dwell_s = 0.5", "dwell_s = 500.0")), UNIT),
    ("dwell too short for the bar", "plan", job(("dwell_s = 0.5", "dwell_s = 0.01")), UNIT),
    ("box inside the robot", "plan", job((MOTION, f"{BOX}low_mm = [-300.0, -300.0, 0.0]\nhigh_mm = [300.0, 300.0, 2500.0]\n{MOTION}")), ("E0708",)),
    ("obstacle in metres", "plan", job((MOTION, f"{BOX}low_mm = [0.4, 0.9, 0.0]\nhigh_mm = [0.9, 1.5, 1.0]\n{MOTION}")), UNIT),
    ("cup points down", "plan", job(("cup_axis = [0.0, 0.0, 1.0]", "cup_axis = [0.0, 0.0, -1.0]")), ("E0707",)),
    ("circle about a ball that is not there", "plan", job(('centre = 2\nplane = "YZ"', 'centre = 3\nplane = "YZ"')), ("E0604",)),
    ("a ball without a circle", "plan", job(("centre = 2\nplane", "centre = 1\nplane")), ("I0681",)),
    ("certificate dated in the future", "plan", bar('certified_on = "2062-03-01"'), ("E0680",)),
    ("expansion in um/m/K", "plan", bar("expansion_per_k = 11.5"), UNIT),
    ("temperature of the certificate in kelvin", "plan", bar("temperature_c = 293.15"), UNIT),
    ("risk in per cent", "plan", job((MOTION, f"[limits]\nmax_stroke_risk = 5.0\n\n{MOTION}")), UNIT),
    ("base frame in radians", "plan", job(("settle_s", "base = [1000.0, 0.0, 500.0, 1.5708, 0.0, 0.0]\nsettle_s")), UNIT),
    ("strobe among the index outputs", "plan", job(("settle_s", "outputs = { strobe = 9, index = [9, 16] }\nsettle_s")), ("E0606",)),
    ("serial number of another robot", "plan", does("job.toml kr60.toml", "plan job.toml --out plan", change=both(
        text("job.toml", ('robot = "kr60ha"', 'robot = "kr60.toml"\nserial = "4711"')), text("kr60.toml", ("\nconvention", '\nserial = "4712"\nconvention')))), ("E1802",)),
    ("lengths in place of the job", "plan", does("own.csv", "plan own.csv --out plan"), ("E0120", "E0603")),
    ("lengths measured with another bar", "plan", does("own.csv job.toml", "plan job.toml --measured own.csv --out again",
        change=rows("own.csv", lengthened(lambda at, row: 200))), ("E0721", "W1282")),
    ("the plan as measured lengths", "plan", does("plan job.toml", "plan job.toml --measured plan/plan.csv --out again"), ("E1204",)),
    ("check of a robot that is not identified", "plan", does("job.toml", "plan --check job.toml --robot kr60ha --out check"), ("E0740", "E1910")),
    ("check with the robot of another type", "plan", does("job.toml kr16-result", "plan --check job.toml --robot kr16-result/robot-identified.toml --out c"), ("E0607", "E1802")),
    ("check with a risk in per cent", "plan", does("job.toml result", "plan --check job.toml --robot result/robot-identified.toml --tolerance 2 --risk 5 --out c"),
     ("usage risk",)),
    ("identified robot without lengths.csv", "plan", does("job.toml result", "plan job.toml --robot result/robot-identified.toml --out again",
        change=without("result/lengths.csv")), ("W0720",)),
    ("lengths.csv of another result", "plan", does("job.toml result result-b", "plan job.toml --robot result/robot-identified.toml --out again",
        change=copied("result-b/lengths.csv", "result/lengths.csv")), ("E1806",)),
    ("identified robot edited", "plan", does("job.toml result", "plan job.toml --robot result/robot-identified.toml --out again", change=ROBOT_EDITED), ("W1840",)),
    # ---- robot files
    ("angles in radians", "robots", robot_file(("KUKA KR 60 HA", "Cell robot"), (re.compile(r"alpha_deg = (-?)90.0"), r"alpha_deg = \g<1>1.5707963")), ("E0130",)),
    ("angles in gon", "robots", robot_file(("KUKA KR 60 HA", "Cell robot"), (re.compile(r"alpha_deg = (-?)90.0"), r"alpha_deg = \g<1>100.0")), ("E0130", "E0505", "E0607")),
    ("lengths in metres", "robots", robot_file(("KUKA KR 60 HA", "Cell robot"), scaled(r"\b[ad]_mm = .*", 1e-3)), ("E0505", "E0607", "E0130")),
    ("limits in radians", "robots", robot_file(scaled(r"limits_deg = .*", math.pi / 180)), ("E0505", "E0130")),
    ("sign of an axis", "robots", robot_file(("sign = 1", "sign = -1")), ("W0581", "E0607")),
    ("zero of an axis by 90 degrees", "robots", robot_file(("theta_offset_deg = -90.0", "theta_offset_deg = 0.0")), ("W0581", "E0607")),
    ("a joint left out", "robots", robot_file((re.compile(r"\[\[joint\]\]\nalpha_deg = 90.0.*?\n\n", re.S), "")), ("E0504",)),
    ("tolerance in um", "robots", robot_file(("length_mm = 0.5", "length_mm = 500.0")), ("E0505", "E0130",)),
    ("speed in rad/s", "robots", robot_file(scaled(r"max_speed_deg_s = .*", math.pi / 180)), ("E0505", "E0704", "E0130")),
    ("tool ball in metres", "robots", robot_file(("[30.0, 20.0, 10.0]", "[0.03, 0.02, 0.01]")), ("E0505", "E0607", "E0130")),
    ("mass in grams", "robots", robot_file(("[tolerance]", "[[mass]]\njoint = 3\nkg = 150000.0\ncentre_mm = [400.0, 0.0, 0.0]\n\n[tolerance]")), ("E0505", "E0130",)),
    # ---- krl and program
    ("a row of the plan deleted", "krl", does("plan", KRL, change=rows("plan/plan.csv", lambda table: table[:20] + table[21:])), ("E0730", "E0731")),
    ("plan.csv of another plan", "krl", does("plan circ", KRL, change=copied("circ/plan.csv", "plan/plan.csv")), ("E0730",)),
    ("plan.csv without plan.json", "krl", does("plan", KRL, change=without("plan/plan.json")), ("E0730",)),
    ("plan.csv saved by a spreadsheet", "krl", does("plan", KRL, change=lambda b: b.bytes("plan/plan.csv", lambda v: v.replace(b",", b";").replace(b".", b","))),
     ("E0730", "E0731")),
    ("KRL for another make", "krl", does("ur-plan", "krl ur-plan/plan.csv --out k"), ("E0824",)),
    ("RAPID for a KUKA", "program", does("plan", "program plan/plan.csv --language rapid --out k"), ("E0824",)),
    ("EthernetKRL without a server", "krl", does("plan", KRL + " --sync ekrl"), ("E0823", "E0880", "usage server")),
    ("the server is the controller itself", "krl", does("plan", KRL + " --sync ekrl --server 127.0.0.1:54600"), ("I0881", "E0880")),
    ("EthernetKRL on a KR C2", "krl", does("plan", KRL + " --sync ekrl --server 172.31.1.10:54600 --controller krc2"), ("E0823", "E0883")),
    ("programs of another plan in the directory", "krl", does("circ krl", "krl circ/plan.csv --out krl"), ("W0882", "E0182")),
    # ---- acquire
    ("port that is not there", "acquire", does("", "acquire --port /dev/ttyUSB9 --out r.dbbd"), ("E0201",)),
    ("port of another system", "acquire", does("", "acquire --port COM3 --out r.dbbd"), ("E0201",)),
    ("serial server that is not there", "acquire", does("", "acquire --port tcp://127.0.0.1:9 --out r.dbbd --gone 1"), ("E0231",)),
    ("capture that exists", "acquire", does("plan run.dbbd", "acquire --port sim --plan plan/plan.csv --out run.dbbd"), ("E0401",)),
    ("another protocol than the bar's", "acquire", does("krl world.toml", "acquire --port {port} --protocol dbb-csv-1 --duration 2 --out r.dbbd --gone 1",
        cell="--program krl/DBB_MAIN.src --world world.toml"), ("W0221",)),
    ("zero with a bar that has no command for it", "acquire", does("plan", ACQUIRE + " --protocol dbb-nmea-1 --zero"), ("E1520", "E0301 zero")),
    ("identity with a bar of another length", "acquire", does("plan", ACQUIRE + " --identity i.toml", change=write("i.toml", "[bar]\nlength_mm = 150.0\n")), ("W1844",)),
    ("identity of a ball that is not there", "acquire", does("plan", ACQUIRE + " --identity i.toml", change=write("i.toml", 'balls = { 3 = "S-3" }\n')), ("W1844",)),
    ("bar not seated", "acquire", fault("unseated_um=80"), ("W0280",)),
    ("ball creeps", "acquire", fault("creep_um=300"), ("W0281",)),
    ("magnet slips", "acquire", fault("slip_um=200"), ("W0282", "W0284")),
    ("cable pulls", "acquire", fault("cable_um=80"), ("W0283",)),
    ("bits flipped", "acquire", fault("flip=0.001"), ("W0223",)),
    ("bar beyond its stroke", "acquire", fault("over_mm=20"), ("W0222",)),
    ("EthernetKRL with a program that was not written for it", "acquire", does("plan krl world.toml", "acquire --port {port} --plan plan/plan.csv --ekrl 127.0.0.1:0 --out r.dbbd --gone 1",
        cell="--program krl/DBB_MAIN.src --world world.toml"), ("W0224",)),
    ("axes with another scheme", "acquire", does("plan", ACQUIRE + " --axes tcp://127.0.0.1:30004"), ("E2201", "usage axes")),
    ("controller of the axes that is away", "acquire", does("plan", ACQUIRE + " --axes rtde://127.0.0.1:9"), ("E2203",)),
    ("axes that do not come", "acquire", does("plan krl world.toml", "acquire --port {port} --plan plan/plan.csv --axes rsi://127.0.0.1:49871 --out r.dbbd --gone 1",
        cell="--program krl/DBB_MAIN.src --world world.toml"), ("W2210",)),
    # ---- another program, robot, ball or bar than planned
    ("module of another plan driven", "sync", driven(program="circ-krl/DBB_MAIN.src", take="circ-krl"), ("E1084",)),
    ("program of the calibration, plan of the check", "sync", driven(plan="check-plan"), ("E1084",)),
    ("program driven on another robot type", "identify", driven("--robot kr120r2500pro"), ("W1003", "E1001")),
    ("controller in absolute-accuracy mode", "identify", driven("--robot result/robot-identified.toml --accuracy result/robot-identified.toml", take="result"), ("W1327",)),
    ("bar of 320 mm on circles of 300 mm", "acquire", driven(change=text("world.toml", ("noise_um = 2.0", "noise_um = 2.0\nlength_mm = 320.0")), then=()), ("W0222",)),
    ("balls exchanged on their posts", "acquire", driven(change=write("world.toml", "[[centre]]\nid = 2\nxyz_mm = [1300.0, 0.0, 800.0]\n[[centre]]\nid = 1\nxyz_mm = [950.0, 700.0, 1100.0]\n"), then=()),
     ("W0222",)),
    ("ball 30 mm lower than taught", "identify", driven(change=text("world.toml",
     ("id = 2\ntaught_deg = [-39.3926, -80.8698, 118.5950, 9.0813, 68.0267, -235.7499]", "id = 2\nxyz_mm = [950.0, 700.0, 1070.0]"))),
     ("W0222", "W1007", "W1003", "W1312")),
    ("worn gears, geometry only", "identify", driven(change=text("world.toml",
     ("repeatability_um = 14.0", "repeatability_um = 14.0\nbacklash_deg = [0.05, 0.05, 0.05, 0.05, 0.05, 0.05]")),
        then=("identify r.dbbd --prior datasheet --model geometric --out out",)), ("I1326", "W1316", "W1381")),
    # ---- sync
    ("plan of another run", "sync", does("run.dbbd circ", "sync run.dbbd --plan circ/plan.csv --out o.csv"), ("W0412", "E1001")),
    ("capture cut off", "sync", does("run.dbbd", "sync run.dbbd --out o.csv", change=cut("run.dbbd", 0.6)), ("W0410", "W0411")),
    ("capture with a damaged sector", "sync", does("run.dbbd", "sync run.dbbd --out o.csv", change=lambda b: b.bytes("run.dbbd", lambda v: v[:900000] + bytes(512) + v[900512:])),
     ("W0410",)),
    (".dat of another plan", "sync", does("run.dbbd circ-krl", "sync run.dbbd --axes circ-krl/DBB_C001.dat --out o.csv"), ("E0408",)),
    (".dat that was not fetched from the controller", "sync", does("run.dbbd krl", "sync run.dbbd --axes krl/DBB_C001.dat --out o.csv"), ("W0480",)),
    # ---- identify: robot, balls, tool, options
    ("no base balls", "identify", own(replace=("--centres centres.csv ", "")), ("E1302",)),
    ("another robot type", "identify", own(replace=("kr60ha", "kr16-2")), ("W1282 robot", "W1281")),
    ("tool ball forgotten", "identify", own(replace=(TOOL, "--tool 0,0,0")), OTHER),
    ("no tool ball", "identify", own(replace=(f"{TOOL} ", "")), ("E0507",)),
    ("tool ball in metres", "identify", own(replace=(TOOL, "--tool 0.03,0.02,0.01")), ("E1305 metres", "usage metres")),
    ("tool ball in another order", "identify", own(replace=(TOOL, "--tool 10,20,30")), OTHER),
    ("sigma in um", "identify", own(options="--prior datasheet --sigma 14"), ("W1335", "W1280", "E0003", "E0130", "W0131")),
    ("uncertainty of the bar in um", "identify", own(replace=("--bar-u 0.001", "--bar-u 1")), ("E0003", "E0130",)),
    ("another length of the bar", "identify", own(lengthened(lambda at, row: 0.5)), ("W1312 bar",)),
    ("centres in metres", "identify", own(balls=each(lambda v: v / 1000, "x_mm", "y_mm", "z_mm")), OTHER + ("E1204",)),
    ("centres exchanged", "identify", own(balls=column(lambda c: c[::-1], "x_mm", "y_mm", "z_mm")), ("W1282 exchanged",)),
    ("centres: X and Y exchanged", "identify", own(balls=swapped("x_mm", "y_mm")), OTHER),
    ("centres in the frame of a rail", "identify", own(balls=each(lambda v: v + 1500, "x_mm")), OTHER),
    ("a centre mistyped by 100 mm", "identify", own(balls=some(lambda at, n: at == 1, moved("z_mm", 100)), same=True), ("W1312", "W1282"), "the centres are estimated"),
    ("one base ball of two", "identify", own(balls=lambda table: table[:1]), ("E1203",)),
    ("the plan as lengths", "identify", does("plan centres.csv", OWN.replace("own.csv", "plan/plan.csv", 1)), ("E1204",)),
    ("capture with another robot type", "identify", does("run.dbbd", "identify run.dbbd --robot kr16-2 --out out"), ("W1328", "E1802")),
    ("capture with the balls of another job", "identify", does("run.dbbd paper-centres.csv", "identify run.dbbd --centres paper-centres.csv --out out"), ("E1203", "W1282")),
    ("the lengths of the result again", "identify", does("run.dbbd result", "identify run.dbbd --robot result/robot-identified.toml --out out"), ("W1334", "W1805")),
    ("identified robot of another cell", "identify", own(options="", replace=(f"kr60ha {TOOL}", "result-b/robot-identified.toml"), take="result-b"), OTHER + ("I1323",)),
    ("identified robot edited", "identify", does("own-b.csv centres.csv result", OWN.replace("own.csv", "own-b.csv").replace(f"kr60ha {TOOL}", "result/robot-identified.toml"), change=ROBOT_EDITED),
     ("W1840",)),
    ("parameters.csv of these lengths as the prior", "identify", own(options="--prior result/parameters.csv", take="result"), ("E1304", "W1805", "W1334")),
    ("validation with the lengths themselves", "identify", own(options="--prior datasheet --validate own.csv"), ("W1805", "W1334")),
    ("validation with another robot", "identify", own(options="--prior datasheet --validate own-b.csv", take="own-b.csv"), ("W1382",)),
    ("ten lengths", "identify", own(lambda table: table[::15]), ("W1315", "W1319", "E1301")),
    ("one circle only", "identify", own(lambda table: table[:38], options="--prior none", balls=lambda table: table[:1]), ("W1319", "I1321")),
    ("result over its input", "identify", does("result centres.csv", f"identify result/lengths.csv --robot kr60ha {TOOL} --centres centres.csv --out result"), ("E0180",)),
    ("table of sync edited", "identify", does("observations.csv observations.provenance.json centres.csv", OWN.replace("own.csv", "observations.csv"),
        change=rows("observations.csv", some(one, moved("length_mm", 0.002)))), ("W1809",)),
    # ---- identify: lengths
    ("lengths in metres", "identify", own(each(lambda v: v / 1000, "length_mm")), ("E1204",)),
    ("lengths in inches", "identify", own(each(lambda v: v / 25.4, "length_mm")), ("E1204",)),
    ("lengths in cm", "identify", own(each(lambda v: v / 10, "length_mm")), ("E1204",)),
    ("readings in place of distances", "identify", own(lengthened(lambda at, row: -300)), ("E1204", "E0111", "W1282", "W1312 bar")),
    ("deviations in um taken as mm", "identify", own(each(lambda v: 300 + (v - 300) / 1000, "length_mm")), ("W1327", "W1283")),
    ("half of the lengths by another bar", "identify", own(lengthened(lambda at, row: 0.15 * (at > 0.5))), ("W1333", "I1336 bar's")),
    ("every other length by another bar", "identify", own(some(lambda at, n: at % 2, moved("length_mm", 0.3))), ("W1381",)),
    ("lengths sorted", "identify", own(column(lambda c: sorted(c, key=float), "length_mm")), ("W1381", "W1330", "W1333")),
    ("lengths reversed", "identify", own(column(lambda c: c[::-1], "length_mm")), ("W1381", "W1330")),
    ("lengths shifted by one row", "identify", own(column(lambda c: c[1:] + c[:1], "length_mm")), ("W1330",)),
    ("lengths shifted from the middle on", "identify", own(column(lambda c: c[:80] + c[81:] + c[-1:], "length_mm")), ("W1330", "W1381")),
    ("lengths of the other ball", "identify", own(column(lambda c: c[74:] + c[:74], "length_mm")), ("W1330", "W1381")),
    ("lengths of ball 1 of another robot", "identify", does("own.csv own-b.csv centres.csv", OWN + " --prior datasheet", change=lambda b: b.rows("own.csv", column(
        lambda c: [line.split(",")[8] for line in (b.dir / "own-b.csv").read_text().splitlines()[1:75]] + c[74:], "length_mm"))), OTHER + ("W1330", "W1331", "W1333")),
    ("rows pasted twice", "identify", own(lambda table: table + table[:40]), ("W1209",)),
    ("rows pasted twice, numbered on", "identify", own(lambda table: table + [{**r, "index": str(500 + i)} for i, r in enumerate(table)]), ("W1209",)),
    ("two runs with the same indices", "identify", does("own.csv own-b.csv centres.csv", OWN, change=lambda b: b.bytes("own.csv",
        lambda v: v + (b.dir / "own-b.csv").read_bytes().split(b"\n", 1)[1])), ("E1208",)),
    ("file cut in a row", "identify", raw(lambda v: v[:len(v) * 2 // 3]), ("E0112", "E0111")),
    ("digits of a length exchanged", "identify", own(some(one, lambda r: r.update(length_mm=r["length_mm"].replace("299.", "992.").replace("300.", "030.")))), ("W1282",)),
    ("a length mistyped by 1 mm", "identify", own(some(one, moved("length_mm", 1))), ("I1314", "W1282")),
    ("a fifth of the lengths mistyped", "identify", own(some(fifth, moved("length_mm", 1))), ("W1313", "W1282", "W1381")),
    ("bar frozen for 20 poses", "identify", own(some(lambda at, n: 60 <= at < 80, put(length_mm="299.9123"))), ("W1283",)),
    ("lengths rounded to 0.1 mm", "identify", own(each(lambda v: round(v, 1), "length_mm")), ("I1284",)),
    ("ball moved in its cup by 0.25 mm", "identify", own(lengthened(lambda at, r: 0.25 * (at > 0.75) * math.cos(2 * math.pi * 4 * at))), ("W1331", "W1381", "W1333")),
    ("bar warms by 0.2 mm", "identify", own(lengthened(lambda at, r: 0.2 * at)), ("W1333",)),
    ("decimal commas between commas", "identify", raw(lambda v: v.replace(b".", b",")), ("E0112",)),
    ("German table", "identify", raw(lambda v: v.replace(b",", b";").replace(b".", b","), same=True), (), "delimiter and decimal are seen in the file"),
    ("UTF-16 table", "identify", raw(lambda v: v.decode().encode("utf-16"), same=True), (), "the encoding is seen in the file"),
    ("rows in another order", "identify", own(lambda table: random.Random(3).sample(table, len(table)), same=True), ("W1330", "W1333"), "every row has its own pose and length"),
    ("columns in another order", "identify", own(lambda table: None, fields=["sigma_mm", "length_mm"] + AXES[::-1] + ["centre", "index"], same=True), (), "columns are found by their names"),
    # ---- identify: axis angles
    ("angles in radians", "identify", own(each(math.radians, *AXES)), ("W1281 radians", "E1204")),
    ("angles in gon", "identify", own(each(lambda v: v / 0.9, *AXES)), ("E1204",)),
    ("half of the angles in radians", "identify", own(some(half, lambda r: r.update({a: repr(math.radians(float(r[a]))) for a in AXES}))), ("E1204 radians",)),
    ("angles rounded to 0.01 degrees", "identify", own(each(lambda v: round(v, 2), *AXES)), ("I1284",)),
    ("angles rounded to 0.1 degrees", "identify", own(each(lambda v: round(v, 1), *AXES)), ("I1284",)),
    ("angles rounded to degrees", "identify", own(each(lambda v: float(round(v)), *AXES)), ("I1284",)),
    ("angles shifted by one row", "identify", own(column(lambda c: c[1:] + c[:1], *AXES)), ("W1330", "W1282")),
    ("angles reversed", "identify", own(column(lambda c: c[::-1], *AXES)), OTHER),
    ("one axis sorted", "identify", own(column(lambda c: sorted(c, key=float), "a5_deg")), OTHER),
    ("one axis shifted by a row", "identify", own(column(lambda c: c[1:] + c[:1], "a4_deg")), OTHER),
    ("sign of one angle", "identify", own(some(one, lambda r: r.update(a5_deg=repr(-float(r["a5_deg"]))))), ("W1282",)),
    ("one angle mistyped by 10 degrees", "identify", own(some(one, moved("a2_deg", 10))), ("W1282", "I1314")),
    ("axis 3 against the horizontal", "identify", own(some(every, lambda r: r.update(a3_deg=repr(float(r["a3_deg"]) + float(r["a2_deg"]))))), OTHER),
    ("external axis in front of axis 1", "identify", own(some(every, lambda r: r.update(zip(AXES, ["0.0"] + [r[x] for x in AXES[:5]])))), OTHER),
    ("mastering of axis 3 changed halfway by 0.1 degrees", "identify", own(some(half, moved("a3_deg", 0.1))), OTHER + ("W1331", "W1333")),
    ("all rows of ball 1", "identify", own(each(lambda v: 1, "centre")), ("W1282", "E1202", "E1203", "W1311")),
    ("numbers of the balls exchanged", "identify", own(some(every, lambda r: r.update(centre=str(3 - int(r["centre"]))))), ("W1282 exchanged",)),
    ("number of the ball of one row", "identify", own(some(one, lambda r: r.update(centre=str(3 - int(r["centre"]))))), ("W1282",)),
    ("numbers of the balls from 0", "identify", own(some(every, lambda r: r.update(centre=str(int(r["centre"]) - 1)))), ("E1203", "E1202", "E0111")),
    # ---- identify: other columns
    ("sigma in um in the table", "identify", own(each(lambda v: v * 1000, "sigma_mm")), ("I1317", "W1280", "W0131")),
    ("sigma empty in some rows", "identify", own(some(fifth, put(sigma_mm=""))), ("W1280",)),
    ("sigma of one row in um", "identify", own(some(one, put(sigma_mm="2.0"))), ("W1280",)),
    ("sigma zero", "identify", own(each(lambda v: 0.0, "sigma_mm")), ("E0111", "W1280", "E1301")),
    ("temperatures in Fahrenheit", "identify", own(some(every, put(temp_c="70.2"))), ("W0131",)),
    ("temperatures without a sensor", "identify", own(some(every, put(temp_c="-999.0"))), ("W0131",)),
    ("header without units", "identify", raw(lambda v: v.replace(b"_deg", b"").replace(b"_mm", b"")), ("E0110",)),
    ("no header", "identify", raw(lambda v: v.split(b"\n", 1)[1]), ("E0110",)),
    ("spreadsheet file", "identify", raw(lambda v: b"PK\x03\x04" + bytes(200)), ("E0103",)),
    # ---- identify: positions
    ("positions in metres", "identify", tracked(each(lambda v: v / 1000, "x_mm", "y_mm", "z_mm")), ("E1360", "E1204")),
    ("positions in a left-handed frame", "identify", tracked(each(lambda v: -v, "z_mm")), ("E1360 mirror",)),
    ("X and Y of positions exchanged", "identify", tracked(swapped("x_mm", "y_mm")), ("E1360 mirror",)),
    ("positions in another order", "identify", tracked(column(lambda c: c[::-1], "x_mm", "y_mm", "z_mm")), ("E1360",)),
    ("positions with radians", "identify", tracked(each(math.radians, *AXES)), ("E1360", "W1281", "E1204")),
    ("positions of another robot type", "identify", tracked(lambda table: None, robot="kr16-2"), ("E1360",) + OTHER),
    ("tracker moved halfway", "identify", tracked(some(half, moved("x_mm", 0.5))), ("W1333",)),
    ("one position mistyped", "identify", tracked(some(one, moved("y_mm", 10))), ("W1282", "I1314")),
    ("positions and lengths of two robots", "identify", own(options="--positions positions.csv", take="positions.csv"), ("W1362",)),
    # ---- check
    ("positions", "check", does("positions.csv result centres.csv", "check positions.csv --robot result/robot-identified.toml --centres centres.csv --out out"),
     ("E1361", "E0110")),
    ("nominal robot", "check", does("check.dbbd", "check check.dbbd --robot kr60ha --out out"), ("E1910",)),
    ("calibration of another robot type", "check", does("check.dbbd kr16-result", CHECK.replace("result", "kr16-result")), ("E1910", "E1802")),
    ("calibration of another cell", "check", does("check.dbbd result-b", CHECK.replace("result", "result-b")), ("exit4", "W1916")),
    ("calibration of simulated readings", "check", does("check.csv centres.csv result", "check check.csv --robot result/robot-identified.toml --centres centres.csv --out out"),
     ("W1851",)),
    ("lengths of the calibration", "check", does("run.dbbd result", CHECK.replace("check.dbbd", "run.dbbd")), ("W1918", "W1805")),
    ("tolerance below zero", "check", does("check.dbbd result", CHECK + "--tolerance -1"), ("usage plausible",)),
    ("tolerance of zero", "check", does("check.dbbd result", CHECK + "--tolerance 0"), ("usage plausible",)),
    ("tolerance with its unit", "check", does("check.dbbd result", CHECK + "--tolerance '0.5 mm'"), ("usage unit",)),
    ("tolerance beyond every number", "check", does("check.dbbd result", CHECK + "--tolerance 1e400"), ("usage plausible",)),
    ("sigma in um", "check", does("check.dbbd result", CHECK + "--sigma 14"), ("W1921", "E0003", "E0130")),
    ("repeatability of the tool in um", "check", does("check.dbbd result", CHECK + "--tool-repeat 10"), ("E0003", "E0130", "usage")),
    ("ball elsewhere, said to be kept", "check", check_own(options="--balls-kept", balls=each(lambda v: v + 80, "x_mm")), ("E1923",)),
    ("angles in radians", "check", check_own(each(math.radians, *AXES)), ("W1281", "E1204")),
    ("angles in gon", "check", check_own(each(lambda v: v / 0.9, *AXES)), ("W1281", "E1204")),
    ("axes 4 and 6 exchanged", "check", check_own(swapped("a4_deg", "a6_deg")), ("W1282", "W1916", "W1281")),
    ("lengths shifted by one row", "check", check_own(column(lambda c: c[1:] + c[:1], "length_mm")), ("W1330", "W1916", "exit4")),
    ("bar 0.5 mm longer", "check", check_own(lengthened(lambda at, row: 0.5)), ("exit4", "W1916", "W1312")),
    ("centres exchanged", "check", check_own(balls=column(lambda c: c[::-1], "x_mm", "y_mm", "z_mm")), ("W1282",)),
    ("four lengths", "check", check_own(lambda table: table[:4]), ("E1911",)),
    ("every row twice", "check", check_own(lambda table: table + table), ("W1209",)),
    ("result of another calibration beside the robot", "check", does("check.dbbd result result-b", CHECK, change=copied("result-b/result.json", "result/result.json")), ("W1922",)),
    ("result beside the robot edited", "check", does("check.dbbd result", CHECK, change=RESULT_EDITED), ("E1808",)),
    # ---- circle
    ("radius wrong by 1 mm", "circle", circle(radius=301), ("W1480",)),
    ("radius not that of the plan", "circle", does("circ.dbbd", "circle circ.dbbd --radius 299 --out out"), ("W1480",)),
    ("lengths in metres", "circle", circle(each(lambda v: v / 1000, "length_mm")), ("E1402", "E0130")),
    ("deviations in um in place of lengths", "circle", circle(each(lambda v: (v - 300) * 1000, "length_mm")), ("E1402", "E1404", "E0130")),
    ("deviations in um added to the radius", "circle", circle(each(lambda v: 300 + (v - 300) * 1000, "length_mm")), ("E1402", "W1480")),
    ("directions exchanged", "circle", circle(some(every, lambda r: r.update(direction={"cw": "ccw", "ccw": "cw"}[r["direction"]]))), ("I1411",)),
    ("angles in radians", "circle", circle(each(math.radians, "angle_deg")), ("W1482", "E1403")),
    ("angles in gon", "circle", circle(each(lambda v: v / 0.9, "angle_deg")), ("W1482",)),
    ("numbers of points in place of angles", "circle", circle(lambda table: [r.update(angle_deg=str(at % 72)) for at, r in enumerate(table)] and None), ("W1482",)),
    ("angles counted clockwise", "circle", circle(each(lambda v: -v, "angle_deg")), ("I1411",)),
    ("angle and length exchanged", "circle", circle(swapped("angle_deg", "length_mm")), ("E1402", "E1404", "E0130")),
    ("lengths sorted", "circle", circle(column(lambda c: sorted(c, key=float), "length_mm")), ("W1480",)),
    ("lengths of one direction reversed", "circle", circle(column(lambda c: c[:72] + c[72:][::-1], "length_mm")), ("W1480",)),
    ("file pasted twice", "circle", circle(lambda table: table + table), ("W1482",)),
    ("both directions under one name", "circle", circle(some(every, put(direction="cw"))), ("W1482", "I1411")),
    ("one length mistyped", "circle", circle(some(lambda at, n: at == 30, moved("length_mm", 0.5))), ("W1480",)),
    ("zero changed between the directions", "circle", circle(some(half, moved("length_mm", 0.2))), ("W1480",)),
    ("bar frozen", "circle", circle(some(lambda at, n: 20 <= at < 40, put(length_mm="300.0123"))), ("W1480",)),
    ("one direction cut off", "circle", circle(lambda table: table[:100]), ("W1482",)),
    ("temperatures in Fahrenheit", "circle", circle(some(every, put(temp_c="70.3"))), ("W1482", "W0131",)),
    ("times in ms", "circle", circle(each(lambda v: v * 1000, "t_s")), ("W1482",)),
    ("sigma in um", "circle", circle(options="--sigma 2"), ("W1482", "E0003", "E0130", "W0131")),
    ("expansion in um/m/K", "circle", circle(options="--expansion 11.5"), ("E0003", "E0130", "usage")),
    ("the same run twice", "circle", does("circ.dbbd", "circle circ.dbbd circ.dbbd --out out"), ("W1805", "E1903")),
    ("run without circles", "circle", does("kr16.dbbd", "circle kr16.dbbd --out out"), ("E1401", "E1001 circle")),
    ("plan of another run", "circle", does("circ.dbbd plan", "circle circ.dbbd --plan plan/plan.csv --out out"), ("W0412", "E1001", "W1415")),
    ("German table", "circle", circle(german, delimiter=";", same=("out/circle.json", "circle-own/circle.json")), (), "delimiter and decimal are seen in the file"),
    # ---- compensate
    ("nominal robot", "compensate", does(GLUE, "compensate GLUE01.src --robot kr60ha --config config.dat --out out"), ("E0909",)),
    ("robot of another type", "compensate", does("kr16-result circ-krl", "compensate circ-krl/DBB_C001.src --robot kr16-result/robot-identified.toml --out out"), ("E1802",)),
    ("robot of another type, program of a person", "compensate", compensate(take=GLUE.replace("result", "kr16-result"), robot="kr16-result"), ("E0906", "E0908", "E0907")),
    ("corrected twice", "compensate", compensate(config="", take="corrected result", program="corrected/DBB_C001.src"), ("E1801",)),
    ("program of a plan on the identified robot", "compensate", compensate(config="", take="check-krl result", program="check-krl/DBB_C001.src"), ("E1801",)),
    ("points in metres", "compensate", compensate(text("GLUE01.dat", scaled(rf"\b[XYZ] {NUMBER}", 1e-3))), ("E0915", "E0906")),
    ("tools in metres", "compensate", compensate(text("config.dat", ("{X 52.5,Y -3.25,Z 210.0", "{X 0.0525,Y -0.00325,Z 0.21"))), ("E0915",)),
    ("bases in metres", "compensate", compensate(text("config.dat", ("{X 900.0,Y -400.0,Z 450.0", "{X 0.9,Y -0.4,Z 0.45"))), ("E0915",)),
    ("no $config.dat", "compensate", compensate(config=""), ("E0901",)),
    ("another file as $config.dat", "compensate", compensate(config="--config GLUE01.dat"), ("W1841", "E0901")),
    ("$config.dat as the program", "compensate", compensate(program="config.dat", config=""), ("E0910", "E0913")),
    ("no .dat", "compensate", compensate(without("GLUE01.dat")), ("E0101", "E0806", "E0903", "E0811", "W0905")),
    (".dat of another plan", "compensate", compensate(copied("circ-krl/DBB_C001.dat", "krl/DBB_C001.dat"), config="", take="result krl circ-krl", program="krl/DBB_C001.src"),
     ("E0806",)),
    ("program cut off", "compensate", compensate(cut("GLUE01.src")), ("E0980", "E0802")),
    ("out over the program", "compensate", does("result circ-krl", "compensate circ-krl/DBB_C001.src --robot result/robot-identified.toml --out circ-krl"), ("E0910", "E0180")),
    ("limit in um", "compensate", does(GLUE, "compensate GLUE01.src --robot result/robot-identified.toml --config config.dat --limit 5000 --out out"), ("E0910", "E0003", "E0130", "usage")),
    ("tool in radians", "compensate", compensate(config="--tool 52.5,-3.25,210,1.5708,0,3.1416 --base 900,-400,450,15,0,0"), ("E0910 radians", "usage radians")),
    ("RAPID points in metres", "compensate", compensate(text("irb-program/DBB_C001.mod", scaled(r"(?<=:=\[)\[[^],]*,[^],]*,[^],]*\](?=,\[)", 1e-3)), config="", take="irb-result irb-program",
        program="irb-program/DBB_C001.mod", robot="irb-result"), ("E0915", "E0906")),
    ("RAPID quaternion not of unit length", "compensate", compensate(text("irb-program/DBB_C001.mod", (re.compile(r"(robtarget XP1:=\[\[[^]]*\],)\[[-\d.]+,"), r"\g<1>[2.5,")), config="",
        take="irb-result irb-program", program="irb-program/DBB_C001.mod", robot="irb-result"), ("E0903", "E0808")),
    ("URScript points in millimetres", "compensate", compensate(text("ur-program/DBB_MAIN.script", (re.compile(rf"movel\(p\[{NUMBER},{NUMBER},{NUMBER}"),
        lambda m: "movel(p[" + ",".join(f"{float(v) * 1000:.4f}" for v in m.groups()))), config="", take="ur-result ur-program", program="ur-program/DBB_MAIN.script", robot="ur-result"), ("E0915", "E0906")),
    ("URScript joints in degrees", "compensate", compensate(text("ur-program/DBB_MAIN.script", scaled(r"movej\(\[[^]]*\]", 180 / math.pi)), config="", take="ur-result ur-program",
        program="ur-program/DBB_MAIN.script", robot="ur-result"), ("E0915", "E0906", "E0903")),
    ("RAPID program for a KUKA", "compensate", compensate(config="", take="result irb-program", program="irb-program/DBB_C001.mod"), ("E1802", "E0824")),
    # ---- compare
    ("the same result twice", "compare", does("result", "compare result result --out out"), ("E1903",)),
    ("another robot type", "compare", does("result kr16-result", "compare result kr16-result --out out"), ("E1902",)),
    ("a circle and a calibration", "compare", does("result circle", "compare result circle --out out"), ("E1902",)),
    ("dates exchanged", "compare", does("result result-b", "compare result result-b --dates 2026-06-01,2026-01-01 --out out"), ("E1904",)),
    ("dates of other days", "compare", does("result result-b", "compare result result-b --dates 2024-01-01,2024-06-01 --out out"), ("W1907",)),
    ("results in the wrong order", "compare", does("own.csv own-b.csv centres.csv", f"{OWN} --identity i.toml", f"{OWN} --identity j.toml".replace("own.csv", "own-b.csv").replace("--out out", "--out old"),
        "compare out old --out c", change=both(write("i.toml", 'measured = "2026-03-01"\n'), write("j.toml", 'measured = "2026-01-01"\n'))), ("W1907",)),
    ("result edited", "compare", does("result result-b", "compare result result-b --out out", change=RESULT_EDITED), ("E1808",)),
    ("tolerance in um", "compare", does("result result-b", "compare result result-b --tolerance 500 --out out"), ("E0003", "E0130", "usage")),
    ("circles of other radii", "compare", does("circle.csv circle-own", "circle circle.csv --radius 150 --out small", "compare circle-own small --out out",
        change=rows("circle.csv", lengthened(lambda at, row: -150))), ("E1902", "W1908")),
    # ---- certificate
    ("a circle", "certificate", does("circle", "certificate circle --out out"), ("E2001", "E0101 result.json")),
    ("result edited", "certificate", certify(change=RESULT_EDITED), ("E1808",)),
    ("simulated readings", "certificate", does("result", "certificate result --out out"), ("E2008",)),
    ("simulated readings of the check", "certificate", does("own check.dbbd", "check check.dbbd --robot own/robot-identified.toml --out c", "certificate own --check c --out out"),
     ("E2008",)),
    ("check of another robot", "certificate", does("kr16-result checked", "certificate kr16-result --check checked --specimen --out out"), ("E2002",)),
    ("check of another calibration", "certificate", does("result-b checked", "certificate result-b --check checked --specimen --out out"), ("E2002",)),
    ("identity dated in the future", "certificate", identity('measured = "2062-01-01"\n'), ("E0680",)),
    ("identity of another day", "certificate", identity('measured = "2024-01-01"\n'), ("W2007",)),
    ("bar of another length", "certificate", identity("[bar]\nlength_mm = 150.0\n"), ("W2007",)),
    ("uncertainty of the bar in um", "certificate", identity("[bar]\nlength_u_mm = 2.0\n"), ("W2007", "E0130")),
    ("temperature in Fahrenheit", "certificate", identity('[[temperature]]\nof = "air"\ncelsius = 68.0\nu_k = 0.4\n'), ("W2007", "E0130", "E0680")),
    ("another temperature of the bar", "certificate", identity('[[temperature]]\nof = "bar"\ncelsius = 31.0\nu_k = 0.4\n'), ("W2007",)),
    ("old certificate of the bar", "certificate", identity('[bar]\ncertified_on = "2015-03-01"\n'), ("I1846", "W2007")),
    ("certificate of the bar after the measurement", "certificate", identity('measured = "2026-01-05"\n[bar]\ncertified_on = "2026-03-01"\n'), ("E0680", "W2007")),
    ("result with warnings", "certificate", does("own.csv centres.csv", OWN + " --prior datasheet", "certificate out --out c",
        change=rows("own.csv", lengthened(lambda at, row: 1.0))), ("W2005",)),
    # ---- predict
    ("angles in radians", "predict", predicted(each(math.radians, *AXES)), ("W1281",)),
    ("axes in the opposite order", "predict", predicted(some(every, lambda r: r.update(zip(AXES, [r[a] for a in AXES[::-1]])))), ("W1281",)),
    ("lengths of another robot type", "predict", does("kr16-result observations.csv observations.provenance.json", "predict observations.csv --robot kr16-result/robot-identified.toml --out p.csv"),
     ("E1802", "W1281", "W1328")),
    ("robot file edited", "predict", does("result poses.csv", PREDICT, change=ROBOT_EDITED), ("W1840",)),
    ("one angle beyond its limit", "predict", predicted(some(one, put(a2_deg="80.0"))), ("W1281",)),
    # ---- export, info, recover
    ("URDF of another robot", "export", does("result kr16-result", URDF + " kr16-result/robot-identified.urdf --out out"), ("E1721",)),
    ("URDF in millimetres", "export", does("result", URDF + " result/robot-identified.urdf --out out", change=text("result/robot-identified.urdf", scaled(r'xyz="[^"]*" rpy', 1000))),
     ("E1721",)),
    ("URDF over itself", "export", does("result", URDF + " result/robot-identified.urdf --out result"), ("E0180", "E0102 another directory")),
    ("capture cut off", "info", does("run.dbbd", "info run.dbbd", change=cut("run.dbbd")), ("W0410", "W0411")),
    ("result edited", "info", does("result", "info result/result.json", change=RESULT_EDITED), ("E1808",)),
    ("plan.csv edited", "info", does("plan", "info plan/plan.csv", change=rows("plan/plan.csv", some(one, put(length_mm="301.0")))), ("E0730",)),
    ("recovery over the capture", "recover", does("run.dbbd", "recover run.dbbd --out run.dbbd"), ("E0180", "E0401")),
    # ---- import
    ("lengths in metres", "import", imported(each(lambda v: v / 1000, "length_mm")), ("E1105", "W1181", "E1180")),
    ("lengths in inches", "import", imported(each(lambda v: v / 25.4, "length_mm")), ("E1105", "W1181", "E1180")),
    ("readings in place of distances", "import", imported(lengthened(lambda at, row: -300)), ("E1105", "E1180")),
    ("readings in um in place of mm", "import", imported(each(lambda v: (v - 300) * 1000, "length_mm"), ('"distance"', '"reading"')), ("E1105", "W1181", "E1180")),
    ("times in ms", "import", imported(each(lambda v: v * 1000, "t_s")), ("W1110", "I1113")),
    ("times of a clock that runs slow", "import", imported(each(lambda v: v * 0.9, "t_s")), ("W1110",)),
    ("trace cut off", "import", imported(lambda table: table[:len(table) // 2]), ("W1110",)),
    ("trace in another order", "import", imported(lambda table: table[::-1]), ("E1104",)),
    ("plan of another run", "import", imported(plan="circ"), ("W1110", "I1113", "W1004")),
    ("strobe and valid exchanged", "import", imported(swapped("strobe", "valid")), ("E1001", "W1003", "W1004", "E1180")),
    ("strobe inverted", "import", imported(some(every, lambda r: r.update(strobe=str(1 - int(r["strobe"]))))), ("W1003", "W1004", "E1001")),
    ("lengths that never change", "import", imported(each(lambda v: 300.0, "length_mm")), ("W1181", "E1001")),
    ("a reading a second", "import", imported(lambda table: table[::40]), ("W1181",)),
    ("lengths a second behind the strobe", "import", imported(column(lambda c: c[:1] * 40 + c[:-40], "length_mm")), ("W1083",)),
    ("German trace", "import", imported(german, delimiter=";", same=("obs.csv", "traced.csv")), (), "delimiter and decimal are seen in the file"),
    ("capture in place of the trace", "import", does("run.dbbd plan", "import run.dbbd --plan plan/plan.csv --out r.dbbd"), ("E0103", "E0110", "E0112")),
    # ---- simulate
    ("program for another robot", "simulate", simulated("--program krl/DBB_MAIN.src --nominal kr16-2"), ("E1802",)),
    (".dat is missing", "simulate", simulated("--program krl/DBB_MAIN.src", change=without("krl/DBB_C001.dat")), ("E0101", "E0806", "E0811")),
    (".dat of another plan", "simulate", simulated("--program krl/DBB_MAIN.src", "krl circ-krl", copied("circ-krl/DBB_C001.dat", "krl/DBB_C001.dat")), ("E0806",)),
    ("stroke of the world exchanged", "simulate", simulated("--program krl/DBB_MAIN.src --world world.toml", "krl world.toml", text("world.toml", ("noise_um = 2.0", "stroke_mm = [5.0, -5.0]"))),
     ("E1603", "E0130",)),
    # ---- bar and serve
    ("port that is not there", "bar", does("", "bar check --port /dev/ttyUSB9 --out bar"), ("E0201",)),
    ("key mistyped", "serve", served('adress = "127.0.0.1:8230"\nplans = "plans"\n'), ("E0120",)),
    ("open address without a token", "serve", served('address = "0.0.0.0:8230"\nplans = "plans"\n'), ("E1501",)),
    ("token that all may read", "serve", served('token_file = "token"\nplans = "plans"\n', write("token", "0123456789abcdef0123\n")), ("E1501",)),
    ("stroke as distances", "serve", served('plans = "plans"\n[alarm]\nstroke_mm = [295.0, 305.0]\n'), ("E1501",)),
    ("share in per cent", "serve", served('plans = "plans"\n[alarm]\nshare = 90\n'), ("E1501",)),
    # ---- listings of a FANUC
    ("FANUC points in metres", "compensate", listing(scaled(rf"[XYZ] = +{NUMBER}  mm", 1e-3)), ("E0915", "E0906")),
    ("FANUC listing cut off", "compensate", listing(change=cut(LISTING)), ("E0980", "E0913")),
    ("FANUC program in binary form", "compensate", does("fanuc-result fanuc-program", "compensate P.tp --robot fanuc-result/robot-identified.toml --out out",
        change=copied(LISTING, "P.tp")), ("E0913 extension",)),
    ("FANUC binary form named .ls", "compensate", listing(change=lambda b: b.bytes(LISTING, lambda v: bytes(range(256)) * 20)), ("E0913",)),
    ("KRL named .ls", "compensate", listing(change=lambda b: (b.take("GLUE01.src"), shutil.copy(b.dir / "GLUE01.src", b.dir / LISTING))), ("E0913",)),
    ("FANUC position deleted", "compensate", listing((re.compile(r"P\[7\]\{.*?\};\n", re.S), "")), ("W0905", "E0903")),
    ("FANUC position of another tool", "compensate", listing((re.compile(r"(P\[7\]\{.*?)UT : 10", re.S), r"\1UT : 3")), ("E0901", "E0902")),
    ("FANUC frames of another controller", "compensate", listing(("UTOOL_NUM=10", "UTOOL_NUM=4")), ("E0901", "E0902")),
    ("FANUC frames from a $config.dat", "compensate", does("fanuc-result fanuc-program config.dat",
        f"compensate {LISTING} --robot fanuc-result/robot-identified.toml --config config.dat --limit 20 --out out", change=text(LISTING, ("UTOOL[10]=PR[100]", "UTOOL[8]=PR[100]"))),
     ("W1841", "E0901")),
    ("FANUC listing for a KUKA", "compensate", does("result fanuc-program", f"compensate {LISTING} --robot result/robot-identified.toml --out out"), ("E1802", "E0824")),
    ("FANUC decimal commas", "compensate", listing((re.compile(r"(\d)\.(\d{3})  mm"), r"\1,\2  mm")), ("E0903", "W0905", "E0802")),
    # ---- what is handed back
    ("a capture", "export", handed_back("run.dbbd --for kuka", "run.dbbd"), ("E1724",)),
    ("a robot that is not identified", "export", handed_back("kr60ha --for kuka", ""), ("E0909", "E1725")),
    ("the robot of another make", "export", handed_back("result --for fanuc"), ("E1725",)),
    ("Universal Robots for KUKA", "export", handed_back("ur-result --for kuka", "ur-result"), ("E1725",)),
    ("target mistyped", "export", handed_back("result --for kukka"), ("usage kukka",)),
    ("a circle", "export", handed_back("circle --for kuka", "circle"), ("E0101",)),
    ("identified robot edited, handed back", "export", handed_back("result --for kuka", change=ROBOT_EDITED), ("W1840",)),
    ("result edited, handed back", "export", handed_back("result --for kuka", change=RESULT_EDITED), ("E1808",)),
    ("result of another calibration beside the robot", "export", handed_back("result --for kuka", "result result-b", copied("result-b/result.json", "result/result.json")), ("W1922", "E1725")),
    # ---- machine data of a KUKA
    ("machine data: lengths in metres", "robots", machine(("$LENGTH_A=350.0", "$LENGTH_A=0.35"), ("$LENGTH_B=850.0", "$LENGTH_B=0.85")), ("E0505", "E0130", "E0607")),
    ("machine data: one length mistyped", "robots", machine(("$LENGTH_B=850.0", "$LENGTH_B=580.0")), ("E0607",)),
    ("machine data: sense of an axis", "robots", machine(("$AXIS_DIR[2]=1", "$AXIS_DIR[2]=-1")), ("E0607", "W0581")),
    ("machine data: decimal comma", "robots", machine(("$LENGTH_A=350.0", "$LENGTH_A=350,0")), ("E0590",)),
    ("machine data cut off", "robots", machine(change=cut("machine.dat", 0.8)), ("E0590",)),
    ("machine data: limits exchanged", "robots", machine(("$SOFTN_END[2]=-135.0", "$SOFTN_END[2]=35.0"), ("$SOFTP_END[2]=35.0", "$SOFTP_END[2]=-135.0")),
     ("E0590",)),
    ("machine data: limits in radians", "robots", machine(scaled(r"(?<=END\[\d\]=).*", math.pi / 180)), ("E0505", "E0130")),
    ("machine data of a SCARA", "robots", machine(("#NR", "#CC")), ("E0590",)),
    ("$config.dat in place of $machine.dat", "robots", does("config.dat", "robots import config.dat --out i.toml"), ("E0590",)),
    # ---- a calibration renewed
    ("renewal of a robot that is not identified", "plan", renewed("--renew --robot kr60ha", ""), ("E0740", "E1910")),
    ("renewal without a robot", "plan", renewed("--renew", ""), ("usage --robot",)),
    ("renewal with the robot of another type", "plan", renewed("--renew --robot kr16-result/robot-identified.toml", "kr16-result"), ("E0607", "E1802")),
    ("renewal with five lengths", "plan", renewed("--renew=5 --robot result/robot-identified.toml"), ("usage 5",)),
    ("renewal with an edited robot", "plan", renewed(change=ROBOT_EDITED), ("W1840",)),
    ("renewal for another bar", "plan", renewed(change=text("job.toml", ("length_mm = 300.0", "length_mm = 0.3"))), UNIT),
    # ---- prediction for another day, load and tool
    ("temperature in kelvin", "predict", predicted_as("--temperature 293.15"), ("E0003", "E0130")),
    ("temperature in Fahrenheit", "predict", predicted_as("--temperature 70"), ("E0003", "E0130", "W0131")),
    ("day before the calibration", "predict", predicted_as("--date 2020-01-31"), ("W0584",)),
    ("day in the German order", "predict", predicted_as("--date 31.01.2027"), ("usage 31", "E0680", "E0003")),
    ("day in another century", "predict", predicted_as("--date 2226-01-31"), ("W0584",)),
    ("payload in grams", "predict", predicted_as("--payload 20000,0,0,100"), ("E0130", "E0505")),
    ("payload in metres", "predict", predicted_as("--payload 20,0,0,0.1"), ("E0130", "W0131")),
    ("payload that the robot file does not name", "predict", predicted_as("--payload gripper"), ("E0582",)),
    ("payload without its centre", "predict", predicted_as("--payload 20"), ("E0582", "usage")),
    ("tool in metres", "predict", predicted_as("--tool 0,0,0.3"), ("E0130", "E1305")),
    ("tool with a turn in radians", "predict", predicted_as("--tool 0,0,300,0,3.14159"), ("usage", "E1305", "E0003")),
    # ---- datum of a correction
    ("datum mistyped", "compensate", datum("programm"), ("E0101",)),
    ("datum in radians", "compensate", datum("poses.csv", change=rows("poses.csv", each(math.radians, *AXES))), ("W1281",)),
    ("datum of one pose", "compensate", datum("poses.csv", change=rows("poses.csv", lambda table: table[:1])), ("E1301 workspace",)),
    ("datum of another robot type", "compensate", datum("kr16-result/lengths.csv", "kr16-result"), ("E1802", "W1281")),
    ("datum without angles", "compensate", datum("centres.csv", "centres.csv"), ("E0110",)),
    # ---- rows left out
    ("a row that is not there", "identify", excluded("999"), ("E1307",)),
    ("a range in the wrong order", "identify", excluded("9-7"), ("usage 9-7",)),
    ("all rows", "identify", excluded("1-400"), ("E1301", "E1307")),
    ("rows by names", "identify", excluded("outliers"), ("usage outliers",)),
    # ---- several captures
    ("a capture twice", "identify", joined("run.dbbd run.dbbd"), ("E1306 twice",)),
    ("captures of two robot types", "identify", joined("run.dbbd kr16.dbbd"), ("E1802", "W1328", "E1203")),
    ("captures of two robots", "identify", joined("run.dbbd run-b.dbbd"), ("W1381", "W1333", "W1331", "W1382", "W1803")),
    ("a capture and a circle", "identify", joined("run.dbbd circle.csv"), ("E0110",)),
    ("one set-up with another base ball", "identify", does("own.csv check.csv centres.csv", f"{OWN.replace('own.csv', 'own.csv check.csv')} --prior datasheet --same-setup",
        change=rows("check.csv", lengthened(lambda at, row: 0.4 * math.cos(math.radians(float(row["a1_deg"])) * 3)))), ("W1381", "W1331", "W1333", "W1312")),
    # ---- what the flange carries
    ("payload in grams, in the robot file", "robots", loaded(("kg = 50.0", "kg = 50000.0")), ("E0505", "E0130")),
    ("payload in metres, in the robot file", "robots", loaded(("150.0]", "0.15]")), ("E0505", "E0130", "W0131")),
    ("uncertainty of a payload in grams", "robots", loaded(("u_kg = 0.5", "u_kg = 500.0")), ("E0505", "E0130", "W0131")),
    ("payload mistyped in the table", "robots", loaded(table=some(half, put(payload="griper"))), ("E0582",)),
    ("payload without a name", "robots", loaded(('name = "gripper"\n', "")), ("E0582", "E0505", "E0120")),
    ("two payloads of one name", "robots", loaded(('name = "gripper"', 'name = "bar"')), ("E0505", "E0582")),
    ("payload with a key mistyped", "robots", loaded(("centre_mm = [0.0, 0.0, 150.0]", "center_mm = [0.0, 0.0, 150.0]")), ("E0120",)),
    # ---- users of the service
    ("role mistyped", "serve", users(('role = "look"', 'role = "looks"')), ("E0120", "E0121", "E1501")),
    ("token in place of its hash", "serve", users((re.compile(r'token_hash = "\w+"', re.S), 'token_hash = "a token of anna"')), ("E1501",)),
    ("hash of another kind", "serve", users((re.compile(r'token_hash = "(\w{32})\w+"'), r'token_hash = "\1"')), ("E1501",)),
    ("two users of one name", "serve", users(('"ben"', '"anna"')), ("E1501",)),
    ("two users of one token", "serve", users((hashlib.sha256(b"a token of ben").hexdigest(), hashlib.sha256(b"a token of anna").hexdigest())), ("E1501",)),
    ("user without a name", "serve", users(('name = "ben"', 'name = ""')), ("E1501",)),
    ("[user] in place of [[user]]", "serve", users((re.compile(r'\[\[user\]\]\nname = "ben".*', re.S), ""), ("[[user]]", "[user]")), ("E0120", "E0121")),
]
CASES += [(f"sign of axis {i}", "identify", own(each(lambda v: -v, f"a{i}_deg")), OTHER) for i in range(1, 7)]
CASES += [(f"zero of axis {i} by 90 degrees", "identify", own(each(lambda v: v + 90, f"a{i}_deg")), OTHER) for i in range(2, 7)]
CASES += [(f"axes {i} and {j} exchanged", "identify", own(swapped(f"a{i}_deg", f"a{j}_deg")), OTHER) for i, j in ((1, 6), (2, 3), (4, 6), (5, 6))]
CASES += [(f"mastering of axis {i} lost by 1.5 degrees{how}", "identify", own(each(lambda v: v + 1.5, f"a{i}_deg"), options), ("W1312", "W1322", "I1323"))
          for i in range(2, 6) for how, options in (("", "--prior datasheet"), (", no prior", ""))]


# ---- verdicts

def alike(b):
    """Whether the result is that of the sound files, to a twentieth of its standard uncertainty."""
    mine, theirs = b.dir / b.compare[0], b.sound / b.compare[1]
    if not mine.exists():
        return False
    if mine.suffix == ".csv":
        lengths = [{r["index"]: float(r["length_mm"]) for r in csv.DictReader(path.open())} for path in (mine, theirs)]
        return lengths[0].keys() == lengths[1].keys() and all(abs(v - lengths[1][k]) < 1e-6 for k, v in lengths[0].items())
    mine, theirs = json.loads(mine.read_text()), json.loads(theirs.read_text())
    if "parameters" not in mine:
        return all(mine[key] == theirs[key] for key in ("tests", "circles") if key in theirs)
    values = [{p["name"]: (p["identified"], p["sd"] or 0) for p in r["parameters"]} for r in (mine, theirs)]
    return all(abs(v - values[1][k][0]) <= 0.05 * sd + 1e-9 for k, (v, sd) in values[0].items())


def judged(b, codes, why):
    if b.panic:
        return "panic"
    if any(text.startswith(code.split(" ")[0]) and all(word in text for word in code.split(" ")[1:]) for code in codes for text in b.texts):
        return "helped"
    if any(b.exits):
        return "unhelpful"
    if why and b.compare and alike(b):
        return "harmless"
    return "unhelpful" if set(b.codes) - USUAL - {"I0113", "I1112"} else "silent"


def tried(case, dbbd, sound):
    name, verb, mutate, codes, *why = case
    with tempfile.TemporaryDirectory() as where:
        b = Bench(dbbd, sound, where)
        try:
            mutate(b)
        except Stop:
            pass
        finally:
            b.close()
        return {"name": name, "verb": verb, "verdict": judged(b, codes, why), "exit": max(b.exits, default=0), "codes": b.codes, "expected": list(codes),
                "texts": b.texts, "output": b.output}


def main():
    parse = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parse.add_argument("dbbd", help="the program")
    parse.add_argument("--only", metavar="PATTERN", default="", help="only cases whose `verb: name` has this pattern")
    parse.add_argument("--sound", metavar="DIR", help="keep the sound files there, and take those that are there")
    parse.add_argument("--json", metavar="FILE", help="everything as JSON")
    args = parse.parse_args()
    dbbd = str(pathlib.Path(args.dbbd).resolve())
    cases = [c for c in CASES if re.search(args.only, f"{c[1]}: {c[0]}")]
    false_alarms = []

    def control(b):
        false_alarms.extend(t for t in b.texts if t[:5] not in USUAL)

    with tempfile.TemporaryDirectory() as where:
        where = pathlib.Path(args.sound or where).resolve() / "sound"
        sound = Bench(dbbd, where, where)
        if not (where / "made").exists():
            make_sound(sound, control)
            sound.write("made", "")
        for text in false_alarms:
            print(f"false alarm  {text}")
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            found = list(pool.map(lambda case: tried(case, dbbd, sound.dir), cases))
    for f in found:
        if f["verdict"] != "helped":
            print(f"{f['verdict']:9}  {f['verb']}: {f['name']}  (exit code {f['exit']}; {' '.join(c for c in f['codes'] if c not in USUAL) or 'no code'}; expected {' '.join(f['expected']) or 'the same result'})")
    verdicts = ("helped", "unhelpful", "silent", "harmless", "panic")
    verbs = list(dict.fromkeys(f["verb"] for f in found))
    print("\n" + f"{'':12}" + "".join(f"{v:>11}" for v in verdicts))
    for verb in verbs + ["all"]:
        print(f"{verb:12}" + "".join(f"{sum(f['verdict'] == v and verb in (f['verb'], 'all') for f in found):11}" for v in verdicts))
    print(f"{len(found)} cases, {len(false_alarms)} false alarms")
    if args.json:
        pathlib.Path(args.json).write_text(json.dumps({"false_alarms": false_alarms, "cases": found}, indent=1))
    sys.exit(bool(false_alarms) or any(f["verdict"] in ("unhelpful", "silent", "panic") for f in found))


if __name__ == "__main__":
    main()
