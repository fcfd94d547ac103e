"""Parses emitted KRL with an ANTLR grammar that this project did not write.

    krl_grammars.py GENERATED START FILE..

GENERATED is the directory into which ANTLR's Python target wrote krlLexer.py and krlParser.py, START the
grammar's first rule. Exit code 1 when a file does not parse. Needs antlr4-python3-runtime of the same version as the
tool that generated the parser. The grammars are antlr/grammars-v4 (aca577d) and liukegeek/KrlParser (d48d794):

    git clone https://github.com/antlr/grammars-v4; git clone https://github.com/liukegeek/KrlParser
    npm i antlr4ng-cli@2.0.0; pip install antlr4-python3-runtime==4.13.2
    antlr="java -jar node_modules/antlr4ng-cli/antlr4-4.13.2-SNAPSHOT-complete.jar -Dlanguage=Python3"
    $antlr -o gen_up grammars-v4/kuka/krl.g4
    $antlr -o gen_ext KrlParser/krl-core/src/main/resources/krl.g4
    python tests/independent/krl_grammars.py gen_up module --spline OUT/*.src OUT/*.dat
    python tests/independent/krl_grammars.py gen_ext start OUT/*.src OUT/*.dat

--spline reads SCIRC as CIRC: the motion of KSS 8 that a grammar of 2011 does not know, in the same form.
"""

import re
import sys
from pathlib import Path

from antlr4 import CommonTokenStream, InputStream
from antlr4.error.ErrorListener import ErrorListener


class Collected(ErrorListener):
    def __init__(self):
        self.found = []

    def syntaxError(self, recognizer, symbol, line, column, message, error):
        self.found.append(f"{line}:{column + 1}: {message}")


def main():
    arguments = [a for a in sys.argv[1:] if not a.startswith("--")]
    options = set(sys.argv[1:]) - set(arguments)
    if len(arguments) < 3 or not options <= {"--spline"}:
        sys.exit(__doc__)
    generated, start, *files = arguments
    sys.path.insert(0, generated)
    from krlLexer import krlLexer
    from krlParser import krlParser

    wrong = 0
    for name in files:
        text = Path(name).read_bytes().decode("ascii")
        if options:
            text = re.sub(r"(?m)^(\s*)SCIRC\b", r"\1CIRC", text)
        errors = Collected()
        lexer = krlLexer(InputStream(text))
        parser = krlParser(CommonTokenStream(lexer))
        for part in (lexer, parser):
            part.removeErrorListeners()
            part.addErrorListener(errors)
        getattr(parser, start)()
        for error in errors.found:
            print(f"{name}:{error}")
        wrong += bool(errors.found)
    print(f"{len(files)} files, {wrong} with errors")
    sys.exit(1 if wrong else 0)


main()
