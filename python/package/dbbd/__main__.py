"""The command line: ``dbbd`` or ``python -m dbbd``."""

import signal
import sys

from ._dbbd import _main


def main() -> None:
    """Runs the command line with the arguments of this process, and ends it with its exit code."""
    # Signals are those of any program: Python's handler would only note them while a command runs.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_main(["dbbd", *sys.argv[1:]], [sys.executable, "-m", "dbbd"]))


if __name__ == "__main__":
    main()
