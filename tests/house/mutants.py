#!/usr/bin/env python3
"""Changes formulas one by one and counts the changes that a test notices.

    tests/house/mutants.py --seed 1 --count 40 --at-least 34 --unit-at-least 28
    tests/house/mutants.py --only robot/ --dry

A mutant is one changed operator, sign, index, constant or function in a formula of the product. The tests of its crate run
first, the suite only if they pass. A mutant that does not compile is replaced by the next one. All of this happens in a
worktree of the last commit in `target/mutants`, or in a copy that `--tree` names. Results are kept as lines of JSON:
a run that is started again goes on, until a source or test is changed.

A survivor shows a formula without a test, or a change that makes no difference: read it before writing a test.
"""

import argparse
import difflib
import hashlib
import json
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import threading
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

OWN_TREE = Path(__file__).resolve().parents[2]
WORK = OWN_TREE / "target/mutants"

# Where formulas are: paths below a `src`.
FORMULA_FILES = re.compile(
    r"(math|robot|measurement|estimation|design|circular|conformity)/"
    r"|device/protocol/(decoder|decimal|counter|field|fram)"
    r"|plan/(risk|timing|check|clearance)\b"
    r"|recording/(device_clock|dwell|matching)\b"
)

# --- Tokens -----------------------------------------------------------------------------------------------------------

TOKEN = re.compile(
    r"""(?P<blank>\s+|//[^\n]*)
    |(?P<comment>/\*)
    |(?P<text>[bc]?r(?P<hashes>\#*)".*?"(?P=hashes)|[bc]?"(?:\\.|[^"\\])*"|b?'(?:\\[^u]|\\x..|\\u\{\w+\}|[^\\'])')
    |(?P<lifetime>'\w+)
    |(?P<word>(?:r\#)?[^\W\d]\w*)
    |(?P<number>0[xbo][\da-fA-F_]+\w*|\d[\d_]*(?:\.(?![.\w])|\.\d[\d_]*)?(?:[eE][+-]?\d[\d_]*)?(?:[fiu]\w+)?)
    |(?P<sign>::|->|=>|\.\.=|\.\.|<<=|>>=|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%^&|]=|.)""",
    re.VERBOSE | re.DOTALL,
)
# After these a sign is the sign of a number, after any other word it is an operator.
KEYWORDS = set("as break else if in let loop match move mut ref return unsafe while".split())


@dataclass(frozen=True)
class Token:
    kind: str
    text: str
    start: int
    end: int


def tokens(source):
    """The tokens of a Rust source without comments and white space."""
    found, at = [], 0
    while at < len(source):
        match = TOKEN.match(source, at)
        at = match.end()
        if match.lastgroup == "comment":
            at = comment_end(source, at)
        elif match.lastgroup != "blank":
            found.append(Token(match.lastgroup, match[0], match.start(), at))
    return found


def comment_end(source, at):
    """Block comments nest."""
    depth = 1
    while depth and at < len(source):
        step = {"/*": 1, "*/": -1}.get(source[at : at + 2], 0)
        depth += step
        at += 2 if step else 1
    return at


# --- Which tokens are formulas ----------------------------------------------------------------------------------------


class Formulas:
    """A source, and the indices of its tokens that are expressions of the product."""

    def __init__(self, source):
        self.source = source
        self.tokens = tokens(source)
        self.closing = self.pair_brackets()
        self.opening = {end: start for start, end in self.closing.items()}
        self.inside = self.bodies() - self.excluded()

    def text(self, i):
        return self.tokens[i].text if 0 <= i < len(self.tokens) else ""

    def texts(self, start, count):
        return [token.text for token in self.tokens[start : start + count]]

    def pair_brackets(self):
        closing, open_brackets = {}, []
        for i, token in enumerate(self.tokens):
            if token.text in ("(", "[", "{"):
                open_brackets.append(i)
            elif token.text in (")", "]", "}"):
                closing[open_brackets.pop()] = i
        return closing

    def find(self, wanted, start):
        """The first of some signs from a place on, outside further brackets; the end of the block if there is none."""
        i = start
        while i < len(self.tokens) and self.text(i) not in wanted and self.text(i) not in (")", "]", "}"):
            i = self.closing.get(i, i) + 1
        return i

    def bodies(self):
        """The bodies of functions and the values of constants."""
        found = set()
        for i, token in enumerate(self.tokens):
            if token.text == "fn" and self.tokens[i + 1].kind == "word":
                start = self.find(("{", ";"), i)
                found.update(range(start, self.closing.get(start, start)))
            elif token.text in ("const", "static") and self.text(i + 2) == ":" and self.text(i - 1) not in ("<", ","):
                found.update(range(self.find(("=",), i), self.find((";",), i)))
        return found

    def excluded(self):
        """Attributes, tests, macros, patterns and types inside bodies."""
        found = set()
        for i in range(len(self.tokens)):
            found.update(self.excluded_from(i))
        return found

    def excluded_from(self, i):
        text, behind = self.text(i), self.text(i + 1)
        if text == "#" and "[" in (behind, self.text(i + 2)):
            end = self.closing[i + 1 if behind == "[" else i + 2] + 1
            is_test = self.texts(i, 7) == ["#", "[", "cfg", "(", "test", ")", "]"]
            return range(i, self.item_end(end) if is_test else end)
        if behind == "!" and self.tokens[i].kind == "word" and text != "vec":
            start = i + 3 if text == "macro_rules" else i + 2
            return range(i, self.closing.get(start, start))
        if text == "let":
            return range(i, self.find(("=", ";"), i))
        if text == "for" and behind != "<":
            return range(i, self.find(("in", "{"), i))
        if text == "fn":
            return range(i, self.find(("{", ";"), i))
        if text == "->":
            return range(i, self.find(("{", ";", ","), i))
        if text == "as":
            end = i + 2
            while self.text(end) == "::":
                end += 2
            return range(i, end)
        if text == "::" and behind == "<":
            return range(i, self.generics_end(i + 1))
        if text == "|" and not self.is_operand(i - 1):
            return range(i, self.find(("|",), i + 1))
        if text == "=>":
            return self.pattern(i)
        return ()

    def item_end(self, i):
        """Behind the item that begins here."""
        end = self.find((";",) if self.text(i) == "use" else ("{", ";"), i)
        return self.closing.get(end, end) + 1

    def generics_end(self, i):
        depth = 0
        while True:
            depth += {"<": 1, ">": -1, ">>": -2}.get(self.text(i), 0)
            i += 1
            if depth <= 0 or i >= len(self.tokens):
                return i

    def pattern(self, arrow):
        """The pattern of a match arm, without the condition behind it."""
        i = arrow - 1
        while self.text(i) not in (",", "{", "(", "["):
            start = self.opening.get(i, i)
            # The block of the arm before ends in the same sign as a pattern with named fields.
            if self.text(i) == "}" and not self.text(start - 1)[:1].isupper():
                break
            i = start - 1
        return range(i, min(arrow, self.find(("if", "=>"), i + 1)))

    def is_operand(self, i):
        if i < 0:
            return False
        token = self.tokens[i]
        if token.kind == "word":
            return token.text not in KEYWORDS
        return token.kind in ("number", "text") or token.text in (")", "]", "?")

    def is_spaced(self, i):
        """Formatted code has blanks around an operator and none around the brackets of generics."""
        token = self.tokens[i]
        return self.source[token.start - 1].isspace() and self.source[token.end].isspace()

    def is_binary(self, i):
        return self.is_operand(i - 1) and self.is_spaced(i)


# --- Mutants ----------------------------------------------------------------------------------------------------------

ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*="}
COMPARISONS = {"<": ("<=", ">"), "<=": ("<", ">="), ">": (">=", "<"), ">=": (">", "<=")}
COORDINATES = {"x": "y", "y": "z", "z": "x", "0": "1", "1": "0"}
FUNCTIONS = {"sin": "cos", "cos": "sin", "asin": "acos", "acos": "asin"}
EXTREMES = {"min": "max", "max": "min", "min_by": "max_by", "max_by": "min_by"}


@dataclass(frozen=True)
class Mutant:
    path: str
    kind: str
    source: str
    start: int
    end: int
    new: str

    @property
    def line(self):
        return self.source.count("\n", 0, self.start) + 1

    @property
    def changed(self):
        return self.source[: self.start] + self.new + self.source[self.end :]

    @property
    def name(self):
        column = self.start - self.source.rfind("\n", 0, self.start)
        return f"{self.path}:{self.line}:{column} {self.source[self.start : self.end]!r} to {self.new!r}"

    def excerpts(self):
        """What stands around the change in its line, before and after it."""
        before = self.source[: self.start].rpartition("\n")[2][-24:].lstrip()
        after = self.source[self.end :].partition("\n")[0][:24].rstrip()
        return before + self.source[self.start : self.end] + after, before + self.new + after

    def diff(self):
        old, new = self.source.splitlines(True), self.changed.splitlines(True)
        return "".join(difflib.unified_diff(old, new, self.path, self.path, n=1))


def mutants_of(path, source):
    """All mutants of a source."""
    formulas = Formulas(source)
    for i in sorted(formulas.inside):
        token = formulas.tokens[i]
        for kind, new in changes(formulas, i):
            yield Mutant(path, kind, source, token.start, token.end, new)


def changes(formulas, i):
    """Kind and new text of each change of a token."""
    token, before, behind = formulas.tokens[i], formulas.text(i - 1), formulas.text(i + 1)
    text = token.text
    if text in ARITHMETIC and formulas.is_binary(i):
        yield "arithmetic", ARITHMETIC[text]
    if text in COMPARISONS and formulas.is_binary(i):
        for new in COMPARISONS[text]:
            yield "comparison", new
    if text == "-" and not formulas.is_operand(i - 1):
        yield "sign", ""
    if begins_product(formulas, i):
        yield "sign", "-" + text
    if before == "[" and behind == "]" and formulas.is_operand(i - 2):
        # `^ 1` is the neighbour that is more often in range: a panic alone would be noticed by any test.
        if token.kind == "word":
            yield "index", text + " ^ 1"
        elif text.isdigit():
            yield "index", str(abs(int(text) - 1))
    elif before == "." and text in COORDINATES and behind != "(":
        yield "index", COORDINATES[text]
    elif token.kind == "number" and before != "." and (new := doubled(text)):
        yield "constant", new
    if text in FUNCTIONS and behind != ":":
        yield "function", FUNCTIONS[text]
    if text in EXTREMES and before in (".", "::"):
        yield "extreme", EXTREMES[text]


def begins_product(formulas, i):
    """Whether a value is the first factor of an expression: that is a number, and may have a sign."""
    is_value = formulas.tokens[i].kind in ("word", "number") and formulas.is_operand(i)
    if not is_value or formulas.text(i - 1) not in ("=", "(", ",", "return", "+=", "-="):
        return False
    i += 1
    while formulas.text(i) in (".", "::", "(", "["):
        i = formulas.closing[i] + 1 if i in formulas.closing else i + 2
    return formulas.text(i) in ("*", "/") and formulas.is_binary(i)


def doubled(text):
    """A literal times two; `None` for zero."""
    number = r"(0x[\da-f]+|0[bo]\d+|[\d.]+(?:e[+-]?\d+)?)(.*)"
    digits, suffix = re.fullmatch(number, text.replace("_", "").lower()).groups()
    value = 2 * (float(digits) if re.search(r"\.|^\d+e", digits) else int(digits, 0))
    return f"{value!r}{suffix}" if value else None


def drawn(tree, only, seed):
    """All mutants in random order, every kind as often as the others."""
    chance = random.Random(seed)
    by_kind = {}
    for path in sorted(sources(tree)):
        place = path.partition("src/")[2]
        if FORMULA_FILES.match(place) and re.search(only, path) and not is_test(place):
            for mutant in mutants_of(path, (tree / path).read_bytes().decode()):
                by_kind.setdefault(mutant.kind, []).append(mutant)
    for of_kind in by_kind.values():
        chance.shuffle(of_kind)
    while by_kind:
        kind = chance.choice(sorted(by_kind))
        yield by_kind[kind].pop()
        if not by_kind[kind]:
            del by_kind[kind]


def sources(tree):
    """The paths of all Rust sources of the crates."""
    for top in [tree / "src", *tree.glob("crates/*/src")]:
        yield from (path.relative_to(tree).as_posix() for path in top.rglob("*.rs"))


def is_test(place):
    return any(part in ("tests", "tests.rs", "test_support") for part in place.split("/"))


# --- Runs -------------------------------------------------------------------------------------------------------------

FAILED_TEST = re.compile(r"test (.+?)(?: - should panic)? \.\.\. FAILED")


@dataclass(frozen=True)
class Outcome:
    passed: bool
    # The last lines, or that the time was over.
    reason: str = ""
    failed_test: str = ""


def run(command, tree, limit_s):
    """Runs a command until it ends, a test fails or its time is over."""
    process = subprocess.Popen(
        command,
        cwd=tree,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        # What the tests start ends with them.
        start_new_session=True,
    )
    is_over = threading.Event()

    def stop():
        is_over.set()
        os.killpg(process.pid, signal.SIGKILL)

    timer = threading.Timer(limit_s, stop)
    timer.start()
    last_lines = []
    try:
        for line in process.stdout:
            last_lines = [*last_lines[-20:], line]
            if failed := FAILED_TEST.match(line):
                return Outcome(False, failed_test=failed[1])
        process.wait()
    finally:
        timer.cancel()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if is_over.is_set():
        return Outcome(False, "time is over")
    return Outcome(process.returncode == 0, "".join(last_lines) if process.returncode else "")


class Bench:
    """A copy of the tree in which mutants are built and tested."""

    def __init__(self, tree, options):
        self.tree = tree
        self.options = options
        self.results = Results(options.results, tree_digest(tree))

    def judge(self, mutant):
        """The recorded or new result of a mutant."""
        if known := self.results.get(mutant.name):
            return known
        unit = shlex.split(self.options.unit.format(crate=crate_of(self.tree, mutant.path)))
        suite = shlex.split(self.options.suite)
        self.check_unchanged(unit, self.options.unit_limit)
        result = self.with_change(mutant, lambda: self.test("unit", unit, self.options.unit_limit))
        if result["result"] == "survived":
            self.check_unchanged(suite, self.options.suite_limit)
            result = self.with_change(mutant, lambda: self.test("suite", suite, self.options.suite_limit))
        return self.results.add(mutant.name, result)

    def with_change(self, mutant, test):
        path = self.tree / mutant.path
        path.write_bytes(mutant.changed.encode())
        try:
            return test()
        finally:
            path.write_bytes(mutant.source.encode())

    def test(self, stage, command, limit_s):
        if not run(building(command), self.tree, self.options.build_limit).passed:
            return {"result": "not compiling"}
        outcome = run(command, self.tree, limit_s)
        # A test that another program disturbed has not noticed the change.
        if outcome.failed_test and run(only(command, outcome.failed_test), self.tree, limit_s).passed:
            outcome = run(command, self.tree, limit_s)
        if outcome.passed:
            return {"result": "survived"}
        noticed_by = outcome.failed_test or outcome.reason.strip().rpartition("\n")[2]
        return {"result": f"killed by {stage}", "test": noticed_by}

    def check_unchanged(self, command, limit_s):
        """Tests that fail without a change would kill every mutant."""
        name = "unchanged: " + shlex.join(command)
        if self.results.get(name):
            return
        outcome = run(building(command), self.tree, self.options.build_limit)
        if outcome.passed:
            outcome = run(command, self.tree, limit_s)
        if not outcome.passed:
            sys.exit(f"without a change, {shlex.join(command)} fails: {outcome.failed_test or outcome.reason}")
        self.results.add(name, {"result": "passed"})


class Results:
    """Results by name, kept in a file; those of another state of the tree do not count."""

    def __init__(self, path, state):
        self.path, self.state, self.known = path, state, {}
        if path.exists():
            for line in path.read_text().splitlines():
                entry = json.loads(line)
                if entry["state"] == state:
                    self.known[entry["name"]] = entry

    def get(self, name):
        return self.known.get(name)

    def add(self, name, result):
        self.known[name] = {"name": name, "state": self.state, **result}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as out:
            out.write(json.dumps(self.known[name]) + "\n")
        return self.known[name]


def building(command):
    """The command that builds what another runs."""
    end = command.index("--") if "--" in command else len(command)
    return [*command[:end], "--no-run", *command[end:]]


def only(command, test):
    """The command that runs a single test of another."""
    return [*command, *([] if "--" in command else ["--"]), "--exact", test]


def crate_of(tree, path):
    directory = next(above for above in (tree / path).parents if (above / "Cargo.toml").exists())
    return tomllib.loads((directory / "Cargo.toml").read_text())["package"]["name"]


def tree_digest(tree):
    """Of all sources, tests and manifests."""
    digest = hashlib.sha256()
    for top, directories, files in os.walk(tree):
        directories[:] = sorted(name for name in directories if name != "target" and not name.startswith("."))
        for path in sorted(Path(top, name) for name in files if name.endswith((".rs", ".toml"))):
            digest.update(path.relative_to(tree).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def own_worktree():
    """A worktree of the last commit, without the changes of an earlier run."""
    tree = WORK / "tree"
    git = ["git", "-C", str(OWN_TREE)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    if tree.exists():
        subprocess.run(["git", "-C", str(tree), "checkout", "--quiet", "--force", "--detach", commit], check=True)
    else:
        subprocess.run([*git, "worktree", "add", "--quiet", "--force", "--detach", str(tree), commit], check=True)
    return tree


# --- The program ------------------------------------------------------------------------------------------------------


def parse_options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40, help="mutants that compile")
    parser.add_argument("--only", default="", metavar="PATTERN", help="only sources whose path has this pattern")
    parser.add_argument("--tree", type=Path, help="a copy of the tree that may be changed")
    parser.add_argument("--dry", action="store_true", help="print the mutants and run nothing")
    parser.add_argument("--at-least", type=int, default=0, help="mutants that must be killed")
    parser.add_argument("--unit-at-least", type=int, default=0, help="mutants that tests of the crate must kill")
    parser.add_argument("--unit", default="cargo test -p {crate} --lib", help="tests of a crate")
    parser.add_argument("--suite", default="cargo test --test suite", help="tests for what these let live")
    parser.add_argument("--unit-limit", type=float, default=120, metavar="S", help="a test that takes longer hangs")
    parser.add_argument("--suite-limit", type=float, default=1800, metavar="S")
    parser.add_argument("--build-limit", type=float, default=1800, metavar="S")
    parser.add_argument("--results", type=Path, default=WORK / "results.jsonl")
    return parser.parse_args()


def print_table(judged):
    print("| mutant | kind | before | after | result | noticed by |\n|---|---|---|---|---|---|")
    for mutant, result in judged:
        before, after = (f"`{excerpt.replace('|', chr(92) + '|')}`" for excerpt in mutant.excerpts())
        place = f"{mutant.path}:{mutant.line}"
        print(f"| {place} | {mutant.kind} | {before} | {after} | {result['result']} | {result.get('test', '')} |")


def main():
    options = parse_options()
    # An end from outside restores the source too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))
    if options.dry:
        mutants = drawn(options.tree or OWN_TREE, options.only, options.seed)
        for _, mutant in zip(range(options.count), mutants):
            print(f"{mutant.kind}:\n{mutant.diff()}")
        return 0
    if options.tree and options.tree.resolve() == OWN_TREE:
        sys.exit("--tree must be a copy: its sources are changed")
    tree = options.tree or own_worktree()
    bench = Bench(tree, options)
    judged, not_compiling = [], 0
    for mutant in drawn(tree, options.only, options.seed):
        if len(judged) == options.count:
            break
        result = bench.judge(mutant)
        print(f"{mutant.name}: {result['result']}", file=sys.stderr)
        if result["result"] == "not compiling":
            not_compiling += 1
        else:
            judged.append((mutant, result))
    print_table(judged)
    counts = Counter(result["result"] for _, result in judged)
    by_unit, by_suite = counts["killed by unit"], counts["killed by suite"]
    killed = by_unit + by_suite
    print(
        f"\n{len(judged)} mutants: {by_unit} killed by tests of their crate, {by_suite} by the suite, "
        f"{counts['survived']} survived; {not_compiling} more did not compile."
    )
    return int(killed < options.at_least or by_unit < options.unit_at_least)


if __name__ == "__main__":
    sys.exit(main())
