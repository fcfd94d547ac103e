"""Chromium with axe on the pages of `dbbd serve`, for the clients beside this file. Fails where one of them is not installed."""

import pathlib
import re
import shutil
import subprocess
import sys

import axe_playwright_python
from playwright.sync_api import expect, sync_playwright

CHROMIUM = shutil.which("chromium") or sys.exit("there is no chromium")

AXE = next(pathlib.Path(axe_playwright_python.__file__).parent.glob("**/axe.min.js")).read_text()


def serve(dbbd, cell):
    """The service of the configuration in a directory, and its address."""
    child = subprocess.Popen([dbbd, "serve", "--config", "dbbd.toml"], cwd=cell, stderr=subprocess.PIPE, text=True)
    for line in child.stderr:
        if "event=listening" in line:
            return child, re.search(r"http://[0-9.:]+/", line)[0]
    raise SystemExit("the service does not listen")
