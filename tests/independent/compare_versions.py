"""Compares what two builds of dbbd compute from the same inputs. Python 3.11, standard library only, Unix.

    python tests/independent/compare_versions.py OLD_BINARY NEW_BINARY [--shared DIR] [--only NAME] [--jobs N]
    python tests/independent/compare_versions.py --renames | --self-test

Captures are made once, with the old binary, and read by both; only the items `chain` measure with each binary. The checkout's
examples, fixtures and robots are the inputs; DIR holds data of real robots that are not part of the project (data/kr60,
data/irb120_drawwire). --only takes the items whose name contains NAME, --keep DIR leaves every output there, --sentences prints
the sentences that differ.

First run it with one binary twice: it must find no difference, and tells how many numbers it compared. Then run it with two
binaries and `--at-least` that number. How many samples a capture has depends on the host's time (1 in 1000); with the same
--inputs DIR both runs read the same captures, and the numbers are exactly as many.

What counts:
- Exit codes, missing files, numbers and words of JSON, CSV, TOML, URDF and KRL files, and of JSON on stdout. These fail.
- A number of the old version that the new one does not have fails, and so does an entry of a list that only one has. What has
  another name, place, word or code in the new version stands in the tables below. Numbers that only the new one has are listed.
- Numbers are equal to 1e-9 of the larger one, or to 1e-12. A covariance is compared in units of its two standard deviations.
  Programs (.src, .dat, .xml) must be equal in every character but for comments, MCAP files in every byte.
- Counted, but no failure: sentences for people (keys `text`, `reason`, .., strings of three words or more, comments, stdout
  that is not JSON, stderr); words that only one version has; what must differ between versions (hashes, version numbers, the
  number of a schema) or between two measurements (times of day), which is replaced before the comparison.
Pages and pictures (.html, .svg) are not compared. Some numbers are noise by nature: what follows from the residuals of exact
lengths, smallest singular values, conditions above 1e7. A person reads what differs; there is no list of what is allowed.
"""
import argparse
import collections
import concurrent.futures
import csv
import filecmp
import io
import json
import math
import os
import pty
import random
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import tty
from pathlib import Path

# --- what has another name in the new version -------------------------------------------------------------------------
# The rules change what the old version wrote before it is compared; with the same binary twice they do nothing. They work one
# after the other, from the top. IN: names of files with blanks between them, `*` for all; JSON on stdout is `COMMAND.stdout`.
# PATH: `parameters[].sd` in JSON and TOML; in CSV a column, and `column.key` where its cells are JSON. It takes along all that
# is below it. `[]` is any entry of a list, `[a1]` that of this name or code, `*` any one key; what `[]` and `*` of the old path
# stand for goes to those of the new path, in their order.

FILES = []          # (old name, new name), without the directory; `*` stands for what has no dot
RESULT = "result.json identify.stdout"
PATHS = [           # (IN, old PATH, new PATH)
    (RESULT, "observations", "measurements"),
    (RESULT, "sigma_mm", "noise_mm.length"),
    (RESULT, "sigma_freedom", "noise_mm.degrees_of_freedom"),
    (RESULT, "joint_errors.pose_sigma_mm", "noise_mm.pose"),
    (RESULT, "joint_errors.length_sigma_mm", "noise_mm.instrument"),
    (RESULT, "prior.scale", "prior_scale"),
    (RESULT, "prior.source", "prior"),
    (RESULT, "predicted_position_error_mm", "predicted_position_uncertainty_mm"),
    (RESULT, "dependent[].combination", "combinations[].members"),
    (RESULT, "dependent", "combinations"),
    (RESULT, "advice[].tells", "recommendations[].identifies"),
    (RESULT, "advice", "recommendations"),
    (RESULT, "outliers[].centre", "outliers[].ball"),
    (RESULT, "warnings[].kind", "findings[].severity"),
    (RESULT, "warnings", "findings"),
]
WORDS = [           # (IN, key or column in the old version, old value, new value): whole values, also null (None)
    (RESULT, "prior", None, "none"),
    (RESULT, "kind", "note", "info"),
    (RESULT, "kind", "doubt", "warning"),
    *((RESULT + " parameters.csv mastering.csv", "status", *words) for words in (
        ("prior", "supported_by_prior"), ("held", "fixed"), ("too_weak", "poorly_observable"))),
]
CODES = []          # (old code, new code): of findings and errors, in every file

ROOT = Path(__file__).resolve().parents[2]
RELATIVE, ABSOLUTE = 1e-9, 1e-12
TIMEOUT_S = 600
csv.field_size_limit(2**30)


class Renames:
    """The tables above, ready for use."""

    def __init__(self, files=(), paths=(), words=(), codes=()):
        self.files, self.paths = ([(entry, *self.rule(*entry[-2:])) for entry in table] for table in (files, paths))
        self.words, self.codes = words, dict(codes)
        self.unused = [*files, *paths, *words, *codes]

    @staticmethod
    def rule(old, new):
        wild = re.compile(r"\\\[\\\]|\\\*")
        pattern = wild.sub(lambda one: r"([^.\[\]/]*)" if one[0] == r"\*" else r"(\[[^]]*\])", re.escape(old))
        if len(wild.findall(re.escape(new))) > len(wild.findall(re.escape(old))):
            raise ValueError(f"{old} -> {new}: the new path has more wildcards")
        return re.compile(pattern + r"(?=[.\[]|$)"), new

    def used(self, entry):
        if entry in self.unused:
            self.unused = [one for one in self.unused if one != entry]

    def move(self, rules, text):
        for entry, pattern, new in rules:
            if found := pattern.match(text):
                self.used(entry)
                parts = iter(found.groups())
                text = re.sub(r"\[\]|\*", lambda _: next(parts), new) + text[found.end():]
        return text

    def file(self, name):
        return str(Path(name).parent / self.move(self.files, Path(name).name))

    def of(self, file):
        """How the paths and the words of a file are renamed: two functions."""
        here = lambda entry: any(Path(file).match(pattern) for pattern in entry[0].split())
        rules = [rule for rule in self.paths if here(rule[0])]
        words = {entry[1:3]: entry for entry in self.words if here(entry)}

        def word(value, key=""):
            if isinstance(value, dict):
                return {one: word(below, one) for one, below in value.items()}
            if isinstance(value, list):
                return [word(one, key) for one in value]
            entry = words.get((key, value))
            self.used(entry)
            return entry[3] if entry else value

        return (lambda path: self.move(rules, path)) if rules else str, word if words else lambda value, key="": value

    def in_text(self, text):
        def code(found):
            new = self.codes.get(found[0], found[0])
            self.used((found[0], new))
            return new

        return re.sub(r"\b[EWI]\d{4}\b", code, text) if self.codes else text


def markdown():
    words = [(files, f"{key}: {old}", f"{key}: {new}") for files, key, old, new in WORDS]
    rows = [("files", *one) for one in FILES] + PATHS + words + [("codes", *one) for one in CODES]
    return "| in | old | new |\n|---|---|---|\n" + "".join(f"| {files} | `{old}` | `{new}` |\n" for files, old, new in rows)


# --- comparison -------------------------------------------------------------------------------------------------------

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
HASH = re.compile(r"(?<![\w.])(?=[0-9]*[a-f])[0-9a-f]{16}(?![\w.])|\b[0-9a-f]{64}\b")
VERSION = re.compile(r'(\bdbbd[ /-]v?|version[\\"]*\s*[:=]\s*[\\"]*)\d+\.\d+\.\d+[-+.\w]*')
TIME = re.compile(r"\b\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d")
VERSION_KEYS = {"dbbd", "version", "dbbd_version", "hash", "schema"}
TEXT_KEYS = {"text", "reason", "remark", "cause", "cure", "message"}
EXACT = {".src", ".dat", ".xml", ".mcap"}
SKIPPED = {".html", ".svg", ".dbbd"}            # and run-krl, in which a free port stands


class Difference:
    """What differs in one item. With `clock`, its two versions measured at different times of day."""

    def __init__(self, renames=Renames(), clock=False):
        self.renames, self.clock = renames, clock
        self.numbers = 0                        # compared
        self.failures = []                      # (relative difference, where, what)
        self.lost, self.new, self.removed, self.added = (collections.Counter() for _ in range(4))  # numbers, words, by place
        self.texts, self.known = 0, 0           # sentences; hashes, versions and times
        self.sentences = []                     # examples of sentences

    def fail(self, where, what, size=math.inf):
        self.failures.append((size, where, what))

    def number(self, where, old, new, scale=None):
        self.numbers += 1
        if old == new or (math.isnan(old) and math.isnan(new)):
            return
        off = abs(old - new)
        largest = scale if scale else max(abs(old), abs(new))
        if not (off <= RELATIVE * largest or (not scale and off <= ABSOLUTE)):
            size = off / largest if math.isfinite(off) and largest else math.inf
            self.fail(where, f"{old!r} -> {new!r}", size)

    def sentence(self, where, old, new):
        if old != new:
            self.texts += 1
            self.sentences.append((where, str(old), str(new)))

    def neutral(self, old, new):
        """Both without what must differ between versions."""
        plain = [VERSION.sub(r"\1<version>", HASH.sub("<hash>", text)) for text in (old, new)]
        if self.clock:
            plain = [TIME.sub("<time>", text) for text in plain]
        if old != new and plain[0] == plain[1]:
            self.known += 1
        return plain


def as_number(text):
    return float(text) if NUMBER.fullmatch(text) or text in ("nan", "inf", "-inf", "NaN") else None


def as_json(text):
    try:
        return json.loads(text)
    except ValueError:
        return None


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def is_sentence(value):
    return isinstance(value, str) and value.count(" ") >= 2 and "\n" not in value


def is_parent(value):
    """Has a dictionary or a list values of its own? A list of sentences is one text."""
    return isinstance(value, dict) or (isinstance(value, list) and not (value and all(map(is_sentence, value))))


def generic(path):
    return re.sub(r"\[[^]]*\]", "[]", path)


def labels(values):
    """What tells the entries of a list apart: their names, or their codes with a number; else nothing."""
    for key in ("name", "code"):
        found = [one.get(key) if isinstance(one, dict) else None for one in values]
        if key == "code":
            found = [code and f"{code}#{found[:at].count(code) + 1}".removesuffix("#1") for at, code in enumerate(found)]
        if values and all(isinstance(one, str) for one in found) and len(set(found)) == len(found):
            return [re.sub(r"[\[\]]", "_", one) for one in found]
    return None


def flat(value, path, plain=()):
    """Every value below a path with its own path. Lists whose generic path is in `plain` are numbered."""
    yield path, value
    if isinstance(value, dict):
        for key, one in value.items():
            yield from flat(one, f"{path}.{key}" if path else key, plain)
    elif is_parent(value):
        names = None if generic(path) in plain else labels(value)
        for name, one in zip(names or range(len(value)), value):
            yield from flat(one, f"{path}[{name}]", plain)


def compare_json(d, file, old, new, where=None, at=("", "")):
    """Two documents, value by value; `at` is where they stand in a line of a table."""
    moved, word = d.renames.of(file)
    old, where = word(old, at[0]), where or file
    lists = [[(generic(path), value) for path, value in flat(side, at[i]) if isinstance(value, list) and value]
             for i, side in enumerate((old, new))]
    plain = {path for path, value in [(moved(path), value) for path, value in lists[0]] + lists[1] if not labels(value)}
    theirs = dict(flat(new, at[1], plain))
    ours = {}
    for path, value in flat(old, at[0], {path for path, _ in lists[0] if moved(path) in plain}):
        path = moved(path)
        if path not in ours or is_parent(ours[path]):
            ours[path] = value
        elif not is_parent(value) and value != ours[path]:
            d.fail(f"{where}: {path}", f"two values of the old version come here: {ours[path]!r:.80} and {value!r:.80}")
    for path, value in ours.items():
        if path in theirs:
            compare_values(d, f"{where}: {path}", value, theirs[path], re.sub(r"\[[^]]*\]", "", path).rpartition(".")[2])
        elif is_number(value):
            d.lost[f"{file}: {generic(path)}"] += 1
        elif path.endswith("]"):
            d.fail(f"{where}: {path}", "only in the old version")
        elif not is_parent(value):
            d.removed[f"{Path(file).name}: {generic(path)}"] += 1
    for path, value in theirs.items():
        if path in ours:
            continue
        if path.endswith("]") and path[:path.rindex("[")] in ours:
            d.fail(f"{where}: {path}", "only in the new version")
        if is_number(value):
            d.new[f"{Path(file).name}: {generic(path)}"] += 1
        elif not is_parent(value):
            d.added[f"{Path(file).name}: {generic(path)}"] += 1


def compare_values(d, where, old, new, key):
    if key in VERSION_KEYS and not is_parent(old):
        d.known += old != new
    elif is_number(old) and is_number(new):
        d.number(where, float(old), float(new))
    elif is_parent(old) and is_parent(new):
        return                                  # what is below them is compared
    elif key in TEXT_KEYS or any(is_sentence(one) or (isinstance(one, list) and not is_parent(one)) for one in (old, new)):
        d.sentence(where, old, new)
    elif isinstance(old, str) and isinstance(new, str):
        if "\n" in old:
            return compare_text(d, where, old, new)
        old, new = d.neutral(old, new)
        if old != new:
            d.fail(where, f"{old!r:.80} -> {new!r:.80}")
    elif old != new:
        d.fail(where, f"{old!r:.80} -> {new!r:.80}")


def is_comment(line):
    return re.match(r"\s*(#|;(?!\s*(END)?FOLD))", line)


def compare_text(d, where, old, new, exact=False):
    """Line by line; numbers as numbers unless exact. Comments of TOML and KRL are sentences."""
    if exact and ("\r\n" in old) != ("\r\n" in new):
        d.fail(where, "the line ends differ")
    sides = [[line for line in text.splitlines() if line.strip()] for text in d.neutral(old, new)]
    d.sentence(where, *("\n".join(filter(is_comment, side)) for side in sides))
    old, new = ([line for line in side if not is_comment(line)] for side in sides)
    if len(old) != len(new):
        d.fail(where, f"{len(old)} -> {len(new)} lines")
    for at, (one, other) in enumerate(zip(old, new), 1):
        if one != other and (exact or NUMBER.sub("0", one) != NUMBER.sub("0", other)):
            d.fail(f"{where}:{at}", f"{one!r:.90} -> {other!r:.90}")
        else:
            for a, b in zip(NUMBER.findall(one), NUMBER.findall(other)):
                d.number(f"{where}:{at}", float(a), float(b))


def compare_csv(d, file, old, new):
    moved, word = d.renames.of(file)
    (ours, *old), (theirs, *new) = (list(csv.reader(io.StringIO(text))) or [[]] for text in (old, new))
    names = [moved(column) for column in ours]
    if len(old) != len(new):
        d.fail(file, f"{len(old)} -> {len(new)} rows")
    variances = {}
    if file.endswith("covariance.csv"):
        variances = {row[0]: abs(float(row[ours.index(row[0])])) for row in old}
    for rows, columns, others, place, numbers, words in ((old, names, theirs, file, d.lost, d.removed),
                                                         (new, theirs, names, Path(file).name, d.new, d.added)):
        for at, column in enumerate(columns):
            if column not in others:
                cells = [json.loads(row[at] or "null") if column.endswith("_json") else as_number(row[at]) for row in rows]
                count = sum(is_number(value) for _, value in flat(cells, ""))
                (numbers if count else words)[f"{place}: {column}"] += count or 1
    both = [(at, theirs.index(name), column, name) for at, (column, name) in enumerate(zip(ours, names)) if name in theirs]
    for line, (one, other) in enumerate(zip(old, new), 1):
        for i, j, column, name in both:
            a, b = word(one[i], column), other[j]
            values = as_number(a), as_number(b)
            if None not in values:
                scale = variances.get(one[0]), variances.get(column)
                d.number(f"{file}[{line}]: {name}", *values, math.sqrt(scale[0] * scale[1]) if all(scale) else None)
            elif column.endswith("_json"):
                compare_json(d, file, json.loads(a or "null"), json.loads(b or "null"), f"{file}[{line}]", (column, name))
            elif a != b:
                compare_values(d, f"{file}[{line}]: {name}", a, b, name)


def compare_file(d, file, old, new):
    """The contents of two files; `file` is the name in the new version."""
    kind = Path(file).suffix
    if kind == ".mcap":
        return old == new or d.fail(file, f"{len(old)} -> {len(new)} bytes, not equal")
    old, new = d.renames.in_text(old.decode("utf-8", "replace")), new.decode("utf-8", "replace")
    if kind == ".json":
        compare_json(d, file, json.loads(old), json.loads(new))
    elif kind == ".toml":
        compare_json(d, file, tomllib.loads(old), tomllib.loads(new))
        d.sentence(file, *d.neutral(*("\n".join(filter(is_comment, side.splitlines())) for side in (old, new))))
    elif kind == ".csv":
        compare_csv(d, file, old, new)
    else:
        compare_text(d, file, old, new, kind in EXACT)


def numbers_in(file, content):
    alone = Difference()
    compare_file(alone, file, content, content)
    return alone.numbers


def compare_calls(d, where, old, new):
    if old.code == new.code == 2:
        d.fail(where, f"wrong usage: {new.err.strip()}")
    if old.code != new.code:
        said = (new.err or new.out).strip().splitlines()[:1]
        d.fail(where, f"exit code {old.code} -> {new.code}: {' '.join(said)}")
    d.sentence(f"{where} stderr", old.err, new.err)
    ours, theirs = as_json(d.renames.in_text(old.out)), as_json(new.out)
    if ours is None:
        d.sentence(f"{where} stdout", old.out, new.out)
    elif theirs is None:
        d.fail(f"{where} stdout", "no JSON in the new version")
    else:
        compare_json(d, f"{old.args[0]}.stdout", ours, theirs, f"{where} stdout")


def compare_runs(d, old, new):
    """Two runs of an item: exit codes, stdout, stderr, and the files they left."""
    for at, calls in enumerate(zip(old.calls, new.calls), 1):
        compare_calls(d, f"call {at} ({calls[0].args[0]})", *calls)
    ours, theirs = [{str(path.relative_to(run.dir)): path.read_bytes() for path in sorted(run.dir.rglob("*"))
                     if path.is_file() and path.suffix not in SKIPPED and "run-krl" not in path.parts} for run in (old, new)]
    ours = {d.renames.file(name): (name, content) for name, content in ours.items()}
    for file, (name, content) in ours.items():
        if file in theirs:
            compare_file(d, file, content, theirs[file])
        else:
            d.fail(file, f"the new version does not write it ({name}, {numbers_in(name, content)} numbers)")
    for file in theirs.keys() - ours.keys():
        count = numbers_in(file, theirs[file])
        (d.new if count else d.added)[f"file {Path(file).name}"] += count or 1
    for where, count in d.lost.items():
        d.fail(where, f"{count} numbers that the new version has not")


# --- captures ---------------------------------------------------------------------------------------------------------

Call = collections.namedtuple("Call", "args code out err")
Run = collections.namedtuple("Run", "dir calls")


def call(binary, args, directory):
    done = subprocess.run([binary, *args], cwd=directory, capture_output=True, timeout=TIMEOUT_S,
                          env={**os.environ, "NO_COLOR": "1"})
    out, err = (side.decode("utf-8", "replace") for side in (done.stdout, done.stderr))
    return Call(args, done.returncode, out, err)


def must(binary, args, directory):
    done = call(binary, args, directory)
    if done.code not in (0, 3):
        raise RuntimeError(f"dbbd {' '.join(args)}: {done.err}")


def reading_over(acquire, run, quiet_s):
    """Waits for the end of `acquire`; interrupts it where nothing more comes."""
    size, since = 0, time.monotonic()
    while acquire.poll() is None:
        time.sleep(0.05)
        now = run.stat().st_size if run.exists() else 0
        if now != size:
            size, since = now, time.monotonic()
        elif time.monotonic() - since > quiet_s:
            acquire.send_signal(signal.SIGINT)
            since = time.monotonic() + 20


def measure(binary, directory, job, name="run.dbbd", plan=(), sync="output", speed="0", simulate=(), acquire=(), quiet_s=3.0):
    """A capture of a job: plan, programs, and a simulated cell that is read. Files named beside `name` are of the cell."""
    stem = Path(name).stem
    must(binary, ["plan", str(job), "--out", f"{stem}-plan", *plan, "--quiet"], directory)
    port = []
    if sync == "ekrl":
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = ["--ekrl", f"127.0.0.1:{free.getsockname()[1]}"]
    server = ["--server", port[1]] if port else []
    must(binary, ["krl", f"{stem}-plan/plan.csv", "--out", f"{stem}-krl", "--sync", sync, *server, "--quiet"], directory)
    link = directory / f"{stem}-bar"
    quiet = dict(cwd=directory, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    cell = subprocess.Popen([binary, "simulate", "--program", f"{stem}-krl/DBB_MAIN.src", "--speed", speed, "--halt", "1",
                             "--link", str(link), *port, *simulate], **quiet)
    try:
        begun = time.monotonic()
        while not link.is_symlink() and time.monotonic() - begun < 20 and cell.poll() is None:
            time.sleep(0.02)
        reader = subprocess.Popen([binary, "acquire", "--port", str(link), "--plan", f"{stem}-plan/plan.csv", "--out", name,
                                   *port, *acquire], **quiet)
        reading_over(reader, directory / name, quiet_s)
        if not (directory / name).exists():
            raise RuntimeError(f"no capture {name}")
    finally:
        try:
            cell.wait(1.0)
        except subprocess.TimeoutExpired:
            cell.terminate()
            cell.wait()


def recorded_bytes(text):
    if text.startswith('"'):
        return text[1:-1].replace("\\r", "\r").replace("\\n", "\n").encode()
    return bytes.fromhex(text)


def replay(binary, directory, recording):
    """A capture of a recorded line: fixtures/README.md tells the form. Says whether there is one."""
    lines = [line.split(" ", 2) for line in recording.read_text().splitlines() if not line.startswith(("#", "stream"))]
    if any(line[1] == "x" for line in lines):
        return False                            # unplugged: tests/suite/replay plays that
    run = directory / f"{recording.stem}.dbbd"
    bar, host = pty.openpty()
    tty.setraw(host)
    reader = subprocess.Popen([binary, "acquire", "--port", os.ttyname(host), "--protocol", recording.stem.split("+")[0],
                               "--out", run.name], cwd=directory, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    reads = threading.Event()

    def listen():
        for line in reader.stderr:
            if line.startswith(b"reading "):
                reads.set()

    threading.Thread(target=listen, daemon=True).start()
    heard, spoken_to = b"", False

    def hear(seconds):
        nonlocal heard
        if select.select([bar], [], [], seconds)[0]:
            heard += os.read(bar, 4096)

    for _, side, text in lines:
        said = recorded_bytes(text.strip())
        if side == ">":
            begun = time.monotonic()
            while not heard.startswith(said) and time.monotonic() - begun < 10:
                hear(0.05)
            heard, spoken_to = heard[len(said):], True
        else:
            if not spoken_to:
                spoken_to = reads.wait(10)
            os.write(bar, said)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        hear(0.05)
    reader.send_signal(signal.SIGINT)
    while reader.poll() is None:
        hear(0.05)
    os.close(bar)
    os.close(host)
    return run.exists()


# --- inputs -----------------------------------------------------------------------------------------------------------

LOADED = """
[[mass]]
joint = 2
kg = 160.0
centre_mm = [400.0, 0.0, 60.0]
[[mass]]
joint = 3
kg = 120.0
centre_mm = [120.0, 0.0, 180.0]
[payload]
kg = 60.0
centre_mm = [0.0, 40.0, 180.0]
"""
IRB120 = [(0, 0, 0, 290, 165), (-90, 0, -90, 0, 110), (0, 270, 0, 0, 110), (-90, 70, 0, 302, 160), (90, 0, 0, 0, 120),
          (-90, 0, 180, 72, 400)]
# The layout of dbbd's own export, for `import`.
OWN = """[time]
column = "ticks"
unit = "us"
[length]
column = "reading_mm"
kind = "reading"
[strobe]
column = "trigger"
[valid]
column = "valid"
[temperature]
column = "temperature_c"
"""
# Moved off by up to 50 mm from where a user would tape them.
THREE_BALLS = "centre,x_mm,y_mm,z_mm\n1,300,-1530,500\n2,720,-1600,1080\n3,390,-960,1190\n"


def circle_csv(points, first, span, radius, both, warm=False, noise=0.0):
    """A circular test: scale errors, squareness, reversal steps, a form of order 7 and 11."""
    dice, text, t = random.Random(7), "run,direction,angle_deg,length_mm" + (",t_s,temp_c\n" if warm else "\n"), 0.0
    for sense, turn in [("ccw", 1), ("cw", -1)][:2 if both else 1]:
        angles = [first + span * i / (points if span == 360.0 else points - 1) for i in range(points)]
        for angle in angles[::turn]:
            a = math.radians(angle)
            going = lambda v: 0.5 if v * turn >= 0 else -0.5
            x = (1 + 40e-6) * radius * math.cos(a) + 60e-6 * radius * math.sin(a) + 0.004 * going(-math.sin(a)) - 0.31
            y = (1 - 25e-6) * radius * math.sin(a) + 0.007 * going(math.cos(a)) + 0.17
            length = math.hypot(x, y) + 0.023 + 0.002 * math.sin(7 * a + 0.3) + 0.0015 * math.cos(11 * a)
            t += 0.5
            tail = f",{t},{22 + t / 500}" if warm else ""
            text += f"1,{sense},{angle!r},{length + noise * dice.gauss(0, 1)!r}{tail}\n"
    return text


def write_inputs(at):
    joints = "".join(f"  {{ alpha_deg = {alpha}, a_mm = {a}, theta_offset_deg = {theta}, d_mm = {d}, sign = 1, "
                     f"limits_deg = [-{limit}, {70 if row == 2 else limit}], max_speed_deg_s = 250 }},\n"
                     for row, (alpha, a, theta, d, limit) in enumerate(IRB120))
    few = (ROOT / "fixtures/golden/unmodelled.csv").read_text().splitlines()[:13]
    demo = (ROOT / "examples/demo.toml").read_text()
    check = (ROOT / "examples/first/check.toml").read_text()
    kr60 = (ROOT / "robots/kr60ha.toml").read_text()
    files = {
        "irb120.toml": 'name = "ABB IRB 120"\nconvention = "modified-dh"\njoint = [\n' + joints + "]\n[tool]\n"
                       "ball_mm = [7, -2, 48]\n[tolerance]\nlength_mm = 1.0\nangle_deg = 0.1\n",
        "one.csv": "centre,x_mm,y_mm,z_mm\n1,270,-1490,530\n", "three.csv": THREE_BALLS,
        "wire.csv": "centre,x_mm,y_mm,z_mm\n1,220,-470,-40\n", "few.csv": "\n".join(few) + "\n",
        "loaded.toml": kr60 + LOADED, "short.toml": demo.replace("points = 80", "points = 12"),
        "both.toml": check.replace('plane = "XY"', 'plane = "XY"\ndirection = "both"'), "own.toml": OWN,
        "upright.toml": (ROOT / "examples/first/job.toml").read_text().replace("tilt_deg", "tilt_deg = 0.0 #"),
        "full.csv": circle_csv(72, 0.0, 360.0, 150.0, True, noise=0.001), "exact.csv": circle_csv(72, 0.0, 360.0, 150.0, True),
        "arc.csv": circle_csv(90, 20.0, 220.0, 300.0, False),
        "warm.csv": circle_csv(400, 3.0, 360.0, 100.0, True, True, 0.001),
        "trace.csv": "t_s,length_mm\n" + "".join(f"{i / 128},{300 + i % 9 / 4096}\n" for i in range(1000)),
        "trace-de.csv": "Messung 7\r\n\r\nZeit;Weg\r\n# seen\r\n" + "".join(
            f"{i * 7},5;{i % 9},25\r\n" for i in range(1000)),
    }
    for name, text in files.items():
        (at / name).write_text(text)


E, W = ROOT / "examples", ROOT / "examples/first/world.toml"
CSV_BAR = ("--protocol", "dbb-csv-1")
# Captures: what `measure` is told. A noisy, sluggish line; a bar that only streams; a controller that logs its axes.
CAPTURES = {
    "dwells": dict(job="{in}/short.toml"),
    "demo": dict(job=E / "demo.toml", simulate=("--seed", "3")),
    "balls": dict(job=E / "first/job.toml", simulate=("--world", str(W))),
    "check": dict(job=E / "first/check.toml", simulate=("--world", str(W), "--seed", "2")),
    "both": dict(job="{in}/both.toml", simulate=("--override", "80")),
    "continuous": dict(job=E / "continuous.toml", simulate=("--world", str(W))),
    "continuous-marker": dict(job=E / "continuous.toml", sync="marker", simulate=("--world", str(W))),
    "marker": dict(job="{in}/short.toml", sync="marker"),
    "ekrl": dict(job="{in}/short.toml", sync="ekrl"),
    "csv": dict(job="{in}/short.toml", sync="marker", speed="100", simulate=CSV_BAR, acquire=CSV_BAR),
    "faults": dict(job="{in}/short.toml", simulate=tuple("--fault drop=0.0003 --fault flip=0.0003 --fault skip=0.002".split())),
    "logged": dict(job="{in}/short.toml", simulate=("--save", "logged-axes", "--seed", "4")),
    "paper": dict(job=E / "seed-experiment.toml", simulate=("--seed", "5")),
    "optimal": dict(job=E / "optimal.toml", simulate=("--seed", "6")),
    "stage": dict(job=E / "stages.toml", simulate=("--world", str(E / "stages/world.toml"))),
}


class Inputs:
    """A directory with all inputs; what takes a binary is made when it is asked for first."""

    def __init__(self, binary, at, wanted):
        self.binary, self.at = binary, at
        write_inputs(at)
        for name in dict.fromkeys(need for item in wanted for need in item.needs):
            made = at / f"{name}.made"
            if not made.exists():
                print(f"making {name}", file=sys.stderr)
                self.make(name)
                made.touch()

    def make(self, name):
        if name.startswith("rec "):
            replay(self.binary, self.at, ROOT / "fixtures/captures" / f"{name[4:]}.rec")
        elif name == "robot":                   # an identified robot, for `compensate` and `plan --robot`
            must(self.binary, ["identify", "balls.dbbd", "--prior", "datasheet", "--out", "robot"], self.at)
        elif name == "stage result":
            must(self.binary, ["identify", "stage.dbbd", "--prior", "datasheet", "--out", "stage-result"], self.at)
        elif name == "samples":
            must(self.binary, ["export", "dwells.dbbd", "--out", "samples"], self.at)
        else:
            told = dict(CAPTURES[name])
            told["job"] = str(told["job"]).replace("{in}", str(self.at))
            measure(self.binary, self.at, name=f"{name}.dbbd", **told)


# --- items ------------------------------------------------------------------------------------------------------------

class Item:
    """Calls of both binaries; `{in}` is the inputs, `{root}` the checkout, `{shared}` the shared data."""

    def __init__(self, name, *calls, needs=(), optional=False, cell=None):
        self.name, self.calls, self.needs, self.optional, self.cell = name, calls, needs, optional, cell

    def run(self, binary, directory, places):
        directory.mkdir(parents=True)
        if self.cell:
            told = {**CAPTURES[self.cell], "job": str(CAPTURES[self.cell]["job"]).format(**places)}
            measure(binary, directory, **told)
        fill = lambda word: word.format(**places)
        return Run(directory, [call(binary, [fill(word) for word in line.split()], directory) for line in self.calls])


def items(shared):
    root, every = "{root}/", []
    add = lambda *args, **more: every.append(Item(*args, **more))
    # identify: tables
    paper = f"identify {root}examples/paper/observations.csv --robot kr60ha --centres {root}examples/paper/centres.csv --json --out o"
    thirteen = "--estimate alpha1-5,a1-5,d4-6"
    for name, more in {
        "thirteen": thirteen, "fifteen": "--estimate alpha1-5,a1-5,d2-6", "default": "", "datasheet": "--prior datasheet",
        "monte-carlo": thirteen + " --monte-carlo 100 --sigma 0.002", "folds": "--folds 4 --sigma 0.005", "all": "--estimate all",
        "hold": "--hold centres,tool,bar", "bar": "--bar-u 0.001",
        "workspace": "--workspace {root}/examples/paper/observations.csv",
    }.items():
        add(f"identify paper {name}", f"{paper} {more}")
    golden = f"--centres {root}examples/paper/centres.csv --json --out o"
    planes, unmodelled = (f"identify {root}fixtures/golden/{name}.csv" for name in ("three_planes", "unmodelled"))
    for name, line in {
        "planes": f"{planes} --robot kr60ha --hold bar_offset", "planes folds 0": f"{planes} --robot kr60ha --folds 0 --hold bar_offset",
        "planes default": f"{planes} --robot kr60ha", "planes prior": f"{planes} --robot kr60ha --prior datasheet",
        "planes validate": f"{planes} --robot kr60ha --sigma 0.002 --validate {root}examples/paper/observations.csv",
        "unmodelled": f"{unmodelled} --robot kr60ha --sigma 0.005 --folds 0", "unmodelled default": f"{unmodelled} --robot kr60ha",
        "unmodelled prior": f"{unmodelled} --robot kr60ha --prior datasheet",
        "unmodelled loaded": f"{unmodelled} --robot {{in}}/loaded.toml --sigma 0.005",
        "unmodelled groups": f"{unmodelled} --robot {{in}}/loaded.toml --sigma 0.005 --estimate all,compliance,gear --prior datasheet",
        "unmodelled no groups": f"{unmodelled} --robot {{in}}/loaded.toml --sigma 0.005 --hold compliance,gear",
        "unmodelled monte-carlo": f"{unmodelled} --robot kr60ha --sigma 0.02 --monte-carlo 100",
        "few": "identify {in}/few.csv --robot kr60ha --hold centres,tool,bar --folds 0",
    }.items():
        add(f"identify golden {name}", f"{line} {golden}")
    # identify: real robots
    kr60 = "--robot kr60ha --tool 30,-40,134 --json --out o --centres {in}/"
    wire = "identify {shared}/data/irb120_drawwire/lengths.csv --robot {in}/irb120.toml --centres {in}/wire.csv --json --out o"
    for balls in ("one", "three"):
        for order in ("", "_approach"):
            line = f"identify {{shared}}/data/kr60/{balls}_ball{'s' if balls == 'three' else ''}{order}.csv {kr60}{balls}.csv"
            add(f"identify real {balls}{order}", line)
            add(f"identify real {balls}{order} prior", f"{line} --prior datasheet")
    add("identify real wire", wire)
    add("identify real wire prior", f"{wire} --prior datasheet --folds 5")
    # plans and programs
    for job in ("demo", "continuous", "stages", "optimal", "seed-experiment", "first/job", "first/check"):
        kinds = [f"krl p/plan.csv --sync {sync} --controller {controller} --server 127.0.0.1:8231 --out {sync}-{controller}"
                 for sync in ("output", "marker", "ekrl") for controller in ("krc2", "krc4", "krc5")]
        add(f"plan {job}", f"plan {root}examples/{job}.toml --out p --json", *kinds)
    add("plan with --stage", f"plan {root}examples/demo.toml --stage 12 --out p --json", "krl p/plan.csv --out k")
    add("plan both ways", "plan {in}/both.toml --out p --json", "krl p/plan.csv --out k")
    add("plan refused", "plan {in}/upright.toml --out p --json")
    add("plan on an identified robot", f"plan {root}examples/first/job.toml --robot {{in}}/robot/robot-identified.toml --out p --json",
        needs=["balls", "robot"])
    add("plan second stage", f"plan {root}examples/stages.toml --robot {{in}}/stage-result/robot-identified.toml --out p --json",
        "krl p/plan.csv --out k", needs=["stage", "stage result"])
    add("plan measured", f"plan {root}examples/stages.toml --measured {{in}}/stage-result/lengths.csv --out p --json",
        needs=["stage", "stage result"])
    # captures
    for name in CAPTURES:
        run = f"{{in}}/{name}.dbbd"
        add(f"capture {name}", f"sync {run} --out obs.csv --json", f"info {run} --json", f"export {run} --out csv --json",
            f"identify {run} --out o --json", f"identify {run} --prior datasheet --out prior --json",
            f"circle {run} --out c --json", needs=[name])
    add("capture mcap", "export {in}/check.dbbd --mcap --out m", needs=["check"])
    add("capture trend", "circle {in}/check.dbbd {in}/balls.dbbd --out c --monte-carlo 200 --json", needs=["check", "balls"])
    axes = " ".join(f"--axes {{in}}/logged-axes/DBB_C00{module}.dat" for module in (1, 2, 3))
    add("capture logged axes", f"sync {{in}}/logged.dbbd {axes} --out obs.csv --json", f"circle {{in}}/logged.dbbd {axes} --out c --json",
        "identify obs.csv --robot kr60ha --centres {in}/logged-plan/centres.csv --out o --json", needs=["logged"])
    old = f"{root}fixtures/captures/run.dbbd"
    add("capture stored", f"info {old} --json", f"sync {old} --out obs.csv --json", f"export {old} --out csv",
        f"identify {old} --out o --json", optional=True)
    for path in sorted((ROOT / "fixtures/captures").glob("*.rec")):
        if "+unplug" not in path.stem:
            run = f"{{in}}/{path.stem}.dbbd"
            add(f"rec {path.stem}", f"info {run} --json", f"export {run} --out csv", needs=[f"rec {path.stem}"])
    for name in ("dwells", "continuous", "marker"):        # what EthernetKRL does depends on the host's time
        add(f"chain {name}", "sync run.dbbd --out obs.csv --json", "identify run.dbbd --prior datasheet --out o --json", cell=name)
    # circular tests, compensation, import
    add("circle full", "circle {in}/full.csv --radius 150 --out c --json")
    add("circle full exact", "circle {in}/full.csv --monte-carlo 0 --sigma 0.001 --bar-u 0.0005 --out c --json")
    add("circle arc", "circle {in}/arc.csv --out c --json")
    add("circle warm", "circle {in}/warm.csv --radius 100 --expansion 12e-6 --machine-expansion 11e-6 --certified 21 --out c --json")
    add("circle trend", "circle {in}/full.csv {in}/exact.csv --radius 150 --out c --json")
    robot = "--robot {in}/robot/robot-identified.toml --json"
    glue = f"{root}fixtures/krl/GLUE01.src"
    add("compensate", f"compensate {glue} --config {root}fixtures/krl/config.dat {robot} --limit 100 --out k",
        f"compensate {glue} {robot} --tool 30,20,10,0,0,0 --base 0,0,0,0,0,0 --limit 100 --out t", f"compensate {glue} {robot} --out u",
        f"compensate {{in}}/dwells-krl/DBB_C001.src {robot} --limit 100 --out a",
        f"compensate {{in}}/dwells-krl/DBB_C002.src {robot} --limit 100 --out b",
        f"compensate {{in}}/continuous-krl/DBB_C001.src {robot} --limit 100 --out c", needs=["balls", "robot", "dwells", "continuous"])
    again = "sync again.dbbd --out obs.csv --json", "identify again.dbbd --out o --json", "export again.dbbd --out csv"
    plan = "--plan {in}/dwells-plan/plan.csv"
    add("import own export", f"import {{in}}/samples/samples.csv {plan} --mapping {{in}}/own.toml --out again.dbbd --json",
        *again, needs=["dwells", "samples"])
    add("import plain", f"import {{in}}/trace.csv {plan} --out t.dbbd --json", "export t.dbbd --out csv", needs=["dwells"])
    add("import mapping", f"import {{in}}/trace-de.csv {plan} --mapping {root}examples/mapping.toml --out t.dbbd --json",
        "export t.dbbd --out csv", needs=["dwells"])
    if shared and (shared / "data").is_dir():
        return every
    print("skipped: the items `identify real`: no data of real robots (--shared DIR)")
    return [item for item in every if not item.name.startswith("identify real")]


# --- the run ----------------------------------------------------------------------------------------------------------

def compare_item(item, binaries, work, places, renames):
    difference = Difference(renames, clock=bool(item.cell))
    directory = work / item.name.replace("/", "-").replace(" ", "_")
    try:
        runs = [item.run(binary, directory / side, places) for side, binary in zip(("old", "new"), binaries)]
        compare_runs(difference, *runs)
    except Exception as error:                  # a broken output is a difference, not the end
        difference.fail(item.name, f"{type(error).__name__}: {error}")
    return difference


def report(item, d):
    notes = [f"{count} {what}" for count, what in (
        (d.new.total(), "new numbers"), (d.texts, "sentences"), (d.known, "hashes, versions or times"),
        (d.added.total(), "words added"), (d.removed.total(), "words removed")) if count]
    tail = f"{d.numbers} numbers" + (f"   ({', '.join(notes)})" if notes else "")
    if not d.failures:
        print(f"ok    {item.name}: {tail}", flush=True)
        return
    numeric = [size for size, *_ in d.failures if size != math.inf]
    largest = f", largest relative {max(numeric):.1e}" if numeric else ""
    word = "note" if item.optional else "DIFF"
    print(f"{word}  {item.name}: {len(d.failures)} differences ({len(numeric)} of numbers{largest}) in {tail}")
    for size, where, what in sorted(d.failures, key=lambda one: -one[0] if one[0] != math.inf else -1e300)[:6]:
        print(f"        {where}: {what}" + ("" if size == math.inf else f"  ({size:.1e})"))
    if len(d.failures) > 6:
        print(f"        and {len(d.failures) - 6} more")
    sys.stdout.flush()


def self_test():
    """The tables at work, on two small directories."""
    old = {"o/a.old.csv": "length,sd,about_json\n300.5,1,\"{\"\"a\"\":1}\"\n", "o/result.json": json.dumps({
        "schema": 1, "sigma_mm": 0.1, "prior": {"source": "datasheet", "scale": 2}, "folds": None, "few": [3], "drift": None,
        "joints": [{"axis": 1}, {"axis": 2}], "advice": [{"poses": 7}],
        "warnings": [{"code": "W0001", "values": {"x": 1}}, {"code": "W0002", "values": {"x": 2}}],
        "parameters": [{"name": "a1", "status": "held", "sd": 5}, {"name": "a2", "status": "free", "sd": 6}]})}
    new = {"o/a.csv": "sd,length_mm,about_json\n1,300.5,\"{\"\"b\"\":1}\"\n", "o/result.json": json.dumps({
        "schema": 2, "noise_mm": {"pose": 0.1}, "prior": "datasheet", "scale": 2, "folds": "none", "rank": 8,
        "findings": [{"code": "W0001", "values": {"x": 1}}, {"code": "W0001", "values": {"x": 2}}], "few": [3], "drift": {},
        "recommendations": [{"code": "I0001", "values": {"poses": 7}}], "joints": {"axis": [1, 2]},
        "parameters": [{"name": "a2", "status": "free", "deviation": {"sd": 6}},
                       {"name": "a1", "status": "fixed", "deviation": {"sd": 5}}]})}
    result = "result.json identify.stdout"
    renames = Renames([("*.old.csv", "*.csv")], [
        (result, "sigma_mm", "noise_mm.pose"), (result, "prior.scale", "scale"), (result, "prior.source", "prior"),
        (result, "warnings", "findings"), (result, "advice[].*", "advice[].values.*"), (result, "advice", "recommendations"),
        (result, "parameters[].sd", "parameters[].deviation.sd"), (result, "joints[].axis", "joints.axis[]"),
        (result, "joints[]", "joints.axis[]"), ("a.csv", "length", "length_mm"), ("*.csv", "about_json.a", "about_json.b"),
    ], [(result, "status", "held", "fixed"), (result, "folds", None, "none"), (result, "drift", None, {})], [("W0002", "W0001")])

    def compared(new, renames=renames):
        with tempfile.TemporaryDirectory() as work:
            runs = []
            for side, files in (("old", old), ("new", new)):
                runs.append(Run(Path(work) / side, [Call(["identify"], 0, files["o/result.json"], "")]))
                (runs[-1].dir / "o").mkdir(parents=True)
                for name, text in files.items():
                    (runs[-1].dir / name).write_text(text)
            d = Difference(renames)
            compare_runs(d, *runs)
            return d

    d = compared(new)
    assert not d.failures and not renames.unused, (d.failures, renames.unused)
    assert d.numbers == 2 * 10 + 3 and d.new == {"result.json: rank": 1, "identify.stdout: rank": 1}, (d.numbers, d.new)
    assert compared(old, Renames()).numbers == d.numbers
    for text, other, says in (
        ('"pose"', '"poses"', "result.json: noise_mm.pose"), ("[3]", "[]", "result.json: few[]"),
        ("[3]", "[3, 4]", "result.json: few[1]"), ('"sd": 6', '"sd": 6.00001', "result.json: parameters[a2].deviation.sd"),
        ("fixed", "free", "result.json: parameters[a1].status"), ("length_mm", "length_m", "a.csv: length_mm"),
        ('{""b""', '{""c""', "a.csv: about_json.b"),
    ):
        failures = compared({name: content.replace(text, other) for name, content in new.items()}).failures
        assert f"o/{says}" in [where for _, where, _ in failures], (text, failures)
    print("the tables work")


def main():
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("--self-test", action="store_true", help="only try the tables of renames, without a binary")
    parser.add_argument("--renames", action="version", version=markdown(), help="only print these tables, as Markdown")
    parser.add_argument("--at-least", type=int, default=0, metavar="N", help="fail if fewer numbers are compared")
    parser.add_argument("--shared", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--inputs", type=Path, metavar="DIR", help="make the captures there, or use those of an earlier run")
    parser.add_argument("--keep", type=Path, help="a directory that does not exist yet")
    parser.add_argument("--sentences", action="store_true", help="print the sentences that differ")
    given = parser.parse_args()
    binaries = [str(Path(path).resolve(strict=True)) for path in (given.old, given.new)]
    same = filecmp.cmp(*binaries, shallow=False)
    renames = Renames() if same else Renames(FILES, PATHS, WORDS, CODES)
    wanted = [item for item in items(given.shared) if given.only in item.name]
    if not wanted:
        sys.exit(f"no item contains {given.only!r}")
    work = given.keep.resolve() if given.keep else Path(tempfile.mkdtemp(prefix="compare-versions-"))
    work.mkdir(exist_ok=not given.keep, parents=True)
    inputs = given.inputs.resolve() if given.inputs else work / "in"
    inputs.mkdir(exist_ok=True, parents=True)
    try:
        Inputs(binaries[0], inputs, wanted)
        places = {"in": str(inputs), "root": str(ROOT), "shared": str((given.shared or ROOT).resolve())}
        with concurrent.futures.ThreadPoolExecutor(given.jobs) as pool:
            one = lambda item: compare_item(item, binaries, work, places, renames)
            results = []
            for item, d in zip(wanted, pool.map(one, wanted)):
                results.append((item, d))
                report(item, d)
                for where, old, new in d.sentences if given.sentences else ():
                    print(f"        {where}:\n          - {old.strip()!r:.400}\n          + {new.strip()!r:.400}")
    finally:
        if not given.keep:
            shutil.rmtree(work)
    for title, word in (("numbers not in the new version", "lost"), ("numbers only in the new version", "new"),
                        ("words removed", "removed"), ("words added", "added")):
        count = sum((getattr(d, word) for _, d in results), collections.Counter())
        for place, many in sorted(count.items()):
            print(f"{title}: {place}   {many} in {sum(place in getattr(d, word) for _, d in results)} items")
    for entry in sorted(renames.unused, key=str) if not given.only else ():
        print(f"renamed, but not seen: {entry}")
    failed = [item.name for item, d in results if d.failures and not item.optional]
    sums = {what: sum(getattr(d, what) for _, d in results) for what in ("texts", "known")}
    differ = sum(size != math.inf for _, d in results for size, *_ in d.failures)
    print(f"{len(results)} items: {len(results) - len(failed)} equal, {len(failed)} with differences ({differ} of numbers); "
          f"besides {sums['texts']} sentences, {sums['known']} hashes, versions or times")
    compared = sum(d.numbers for item, d in results if not item.optional)
    print(f"{compared} numbers compared" + (f", {given.at_least} needed" if given.at_least else ""))
    failed = failed or compared < given.at_least
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
