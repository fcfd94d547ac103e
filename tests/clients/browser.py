"""Chromium with axe on the pages of `dbbd serve`, for the clients beside this file. Exits with 77 where one of them is not installed."""

import pathlib
import re
import shutil
import subprocess
import sys

try:
    import axe_playwright_python
    from playwright.sync_api import expect, sync_playwright
except ImportError as missing:
    print(f"SKIPPED: {missing}")
    sys.exit(77)

CHROMIUM = shutil.which("chromium")
if CHROMIUM is None:
    print("SKIPPED: there is no chromium")
    sys.exit(77)

AXE = next(pathlib.Path(axe_playwright_python.__file__).parent.glob("**/axe.min.js")).read_text()


def serve(dbbd, cell):
    """The service of the configuration in a directory, and its address."""
    child = subprocess.Popen([dbbd, "serve", "--config", "dbbd.toml"], cwd=cell, stderr=subprocess.PIPE, text=True)
    for line in child.stderr:
        if "event=listening" in line:
            return child, re.search(r"http://[0-9.:]+/", line)[0]
    raise SystemExit("the service does not listen")
