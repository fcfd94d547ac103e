"""One bar at 1 kHz for hours, read by `dbbd acquire`, with the memory and the descriptors of the process every ten seconds.

    python tests/clients/soak.py target/release/dbbd [SECONDS]

Prints one line each ten minutes and a summary at the end: the samples in the capture against those that the bar's own clock
counts, gaps, the median memory and descriptors of the first and of the last tenth. Ends with an error when a sample is missing
or a figure of the last tenth is above the first's by more than a tenth.
"""

import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

DBBD = pathlib.Path(sys.argv[1]).resolve()
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 3600.0
JOB = pathlib.Path(__file__).parents[2] / "examples" / "circles.toml"
WORLD = "[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nrate_hz = 1000.0\n"


def status(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])


def main():
    home = pathlib.Path(tempfile.mkdtemp(prefix="dbbd-soak-"))
    (home / "world.toml").write_text(WORLD)
    run = lambda *words: subprocess.run([DBBD, *words], cwd=home, check=True, capture_output=True)
    run("plan", str(JOB), "--out", "plan")
    run("krl", "plan/plan.csv", "--out", "krl")
    program = next(p for p in sorted((home / "krl").glob("*.src")) if "HALT" in p.read_text())
    bar = subprocess.Popen(
        [DBBD, "simulate", "--program", program, "--tool", "30,20,10", "--world", "world.toml", "--link", "bar", "--halt", str(SECONDS + 600)],
        cwd=home, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (home / "bar").exists():
        time.sleep(0.1)
    reader = subprocess.Popen(
        [DBBD, "acquire", "--port", "bar", "--out", "run.dbbd", "--duration", str(SECONDS), "--json"],
        cwd=home, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    seen, begun, told = [], time.time(), 0
    time.sleep(5)
    while reader.poll() is None:
        try:
            descriptors = len(list(pathlib.Path(f"/proc/{reader.pid}/fd").iterdir()))
            seen.append((status(reader.pid), descriptors))
        except (FileNotFoundError, TypeError):
            break
        if time.time() - begun >= told:
            print(f"{time.time() - begun:7.0f} s  {seen[-1][0]} kB  {seen[-1][1]} descriptors", flush=True)
            told += 600
        time.sleep(10)
    answer = json.loads(reader.communicate()[0])
    bar.kill()
    tenth = max(1, len(seen) // 10)
    first, last = seen[:tenth], seen[-tenth:]
    figures = [[statistics.median(column) for column in zip(*part)] for part in (first, last)]
    size = (home / "run.dbbd").stat().st_size
    print(json.dumps(answer))
    print(f"memory {figures[0][0]:.0f} kB at first, {figures[1][0]:.0f} kB at the end, {max(m for m, _ in seen)} kB at most;"
          f" descriptors {figures[0][1]:.0f}, {figures[1][1]:.0f}; capture {size / 1e6:.0f} MB")
    if any(b > 1.1 * a for a, b in zip(*figures)):
        raise SystemExit("memory or descriptors grew")
    info = subprocess.run([DBBD, "info", "run.dbbd", "--json"], cwd=home, capture_output=True, text=True)
    print(info.stdout)


main()
