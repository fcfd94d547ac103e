"""Checks the calls of a URScript program against lists of the language's functions that another project keeps.

usage: urscript_functions.py DIR PROGRAM.script..

DIR holds the files *Functions.json of ahernguo/urscript-extension (MIT), in its directory src. Every call must be of a
function in the lists or of a routine of the program; it has no more arguments than the function has, no keyword that it
does not have, and each argument without a default. Nested def and end are counted. Prints what is wrong; exit code 1 then.
"""

import ast
import json
import re
import sys
from pathlib import Path


def functions(directory):
    known = {}
    for path in sorted(Path(directory).glob("*Functions.json")):
        for entry in json.loads(path.read_text(encoding="utf-8-sig")):
            known.setdefault(entry["Name"], []).append([(p["Label"], p["Default"]) for p in entry["Parameters"]])
    return known


def fits(call, parameters):
    labels = [label for label, _ in parameters]
    given = labels[: len(call.args)] + [keyword.arg for keyword in call.keywords]
    enough = all(label in given for label, default in parameters if default == "")
    return len(call.args) <= len(labels) and enough and all(label in labels for label in given)


def check(path, known):
    wrong, open_blocks = [], []
    lines = [line.split("#")[0].strip() for line in path.read_text(encoding="ascii").splitlines()]
    own = {m[1]: m[2].count(",") + bool(m[2]) for m in (re.match(r"def (\w+)\((.*)\):", line) for line in lines) if m}
    for number, line in enumerate(lines, 1):
        if re.match(r"(def|if|while|thread)\b.*:$", line):
            open_blocks.append(number)
            line = re.sub(r"^(def .*|while|if|thread \w+)", "", line).rstrip(":").strip()
        elif line == "end":
            if not open_blocks:
                wrong.append(f"{path}:{number}: end without a block")
            else:
                open_blocks.pop()
            continue
        line = re.sub(r"^(local|global) ", "", line)
        line = re.sub(r"\bp\[", "[", line)
        if not line:
            continue
        try:
            tree = ast.parse(line)
        except SyntaxError as error:
            wrong.append(f"{path}:{number}: {error.msg}: {line}")
            continue
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            name = call.func.id
            if name in own:
                good = own[name] == len(call.args) and not call.keywords
            else:
                good = any(fits(call, parameters) for parameters in known.get(name, []))
            if not good:
                wrong.append(f"{path}:{number}: {name} is not called so: {line}")
    wrong += [f"{path}:{number}: not ended" for number in open_blocks]
    return wrong


def main():
    known = functions(sys.argv[1])
    programs = [Path(name) for name in sys.argv[2:]]
    wrong = [line for program in programs for line in check(program, known)]
    print("\n".join(wrong + [f"{len(known)} functions, {len(programs)} programs, {len(wrong)} wrong"]))
    return 1 if wrong or not known else 0


sys.exit(main())
