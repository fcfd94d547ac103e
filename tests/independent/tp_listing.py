"""Reads listings of TP programs by the facts of their format alone, and says what a controller would not load or find.

usage: tp_listing.py PROGRAM.ls..

Sections and their order, the numbers of the lines, the length of remarks and messages, labels and programs that are jumped to or called, positions
that are moved to, their layout (tabs, three decimals), their frames and configuration. The facts are from the exports of controllers and the probes on
ROBOGUIDE that LeroyDu56/CrossArm publishes. Prints what is wrong; exit code 1 then.
"""

import re
import sys
from pathlib import Path

NUMBER = r" *-?\d*\.\d{3}"
JOINTS = re.compile("\tJ1={0} deg,\tJ2={0} deg,\tJ3={0} deg,\n\tJ4={0} deg,\tJ5={0} deg,\tJ6={0} deg\n".format(NUMBER))
POSE = re.compile("\tX ={0}  mm,\tY ={0}  mm,\tZ ={0}  mm,\n\tW ={0} deg,\tP ={0} deg,\tR ={0} deg\n".format(NUMBER))
FRAMES = re.compile(r"   GP1:\n\tUF : (\d|F), UT : (\d+|F),\t(?:\tCONFIG : '([NF] [UD] [TB](?:, -?[01]){3})',)?\n")
MOTION = re.compile(r"([JLC]) (P\[\d+\])(?: +(P\[\d+\]))? (\d+%|\d+msec|\d+\.\dsec|\d+mm/sec) (?:FINE|CNT0)")


def statements(body):
    """The text of each statement with the number of its line."""
    number, text = None, ""
    for line in body.splitlines():
        head = re.match(r"( {0,3}\d+| {4}):(.*)", line)
        if not head:
            yield None, f"not a line of a program: {line}"
            continue
        if head[1].strip():
            number, text = int(head[1]), ""
        text += head[2]
        if text.rstrip().endswith(";"):
            yield number, text.strip().removesuffix(";").strip()


def check(path, programs):
    data = path.read_bytes()
    wrong = [] if data.isascii() else ["not ASCII"]
    if data.count(b"\n") != data.count(b"\r\n"):
        wrong.append("lines that do not end with CR LF")
    text = data.decode("ascii", "replace").replace("\r\n", "\n")
    sections = re.fullmatch(r"/PROG  (\w+)\n/ATTR\n(.*?)/MN\n(.*?)/POS\n(.*)/END\n", text, re.DOTALL)
    if not sections:
        return wrong + ["not the sections /PROG, /ATTR, /MN, /POS, /END"]
    name, _, body, tail = sections.groups()
    if name != path.stem.upper() or len(name) > 8:
        wrong.append(f"the program is named {name}")
    positions = dict(re.findall(r"P\[(\d+)\]\{\n(.*?)\};\n", tail, re.DOTALL))
    if re.sub(r"P\[\d+\]\{\n.*?\};\n", "", tail, flags=re.DOTALL):
        wrong.append("text between the positions")
    for number, position in positions.items():
        frames = FRAMES.match(position)
        numbers = position[frames.end():] if frames else ""
        if not frames or not (POSE if frames[3] else JOINTS).fullmatch(numbers):
            wrong.append(f"P[{number}]: {position!r}")
    labels, used = set(), set()
    for expected, (number, statement) in enumerate(statements(body), 1):
        if number != expected:
            wrong.append(f"line {number} in place of {expected}: {statement}")
        used.update(re.findall(r"\bP\[(\d+)\]", statement))
        labels.update(re.findall(r"^LBL\[(\d+)\]", statement))
        message = re.match(r"MESSAGE\[(.*)\]", statement)
        motion = re.match(r"[JLC] ", statement)
        call = re.match(r"CALL (\w+)", statement)
        if statement.startswith("!") and len(statement) > 33:
            wrong.append(f"{number}: a remark of {len(statement) - 1} characters")
        if message and len(message[1]) > 24:
            wrong.append(f"{number}: a message of {len(message[1])} characters")
        if motion and not MOTION.fullmatch(statement):
            wrong.append(f"{number}: {statement}")
        if call and call[1] not in programs:
            wrong.append(f"{number}: no program {call[1]}")
        pulse = re.match(r"DO\[\d+\]=PULSE,(.*)", statement)
        if pulse and not re.fullmatch(r"\d+\.\dsec", pulse[1]):
            wrong.append(f"{number}: {statement}")
    for missing in sorted(used - positions.keys()):
        wrong.append(f"no position P[{missing}]")
    return wrong


def main():
    paths = [Path(name) for name in sys.argv[1:]]
    programs = {path.stem.upper() for path in paths}
    found = [f"{path}: {wrong}" for path in paths for wrong in check(path, programs)]
    print("\n".join(found) or f"{len(paths)} listings read")
    sys.exit(bool(found))


main()
