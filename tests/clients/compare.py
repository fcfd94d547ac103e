#!/usr/bin/env python3
"""Reads each virtual bar twice, with `dbbd acquire` and with the independent client, and compares.

    python3 tests/clients/compare.py path/to/dbbd PROGRAM.src [PROTOCOL ..]

The same program, robot and seed give the same lengths on the same device clock. A streaming bar is
compared reading by reading from the first; a polled one by the set of readings at the still start.
"""
import csv
import pathlib
import subprocess
import sys
import tempfile

KNOWN = ["dbb-cobs-1", "dbb-nmea-1", "sylvac-opto", "heidenhain-nd28x", "usdigital-qsb", "microepsilon-ild1420", "modbus-rtu"]
AT_MM = {"microepsilon-ild1420": 25.0}


def simulate(dbbd, program, protocol):
    bar = subprocess.Popen([dbbd, "simulate", "--program", program, "--protocol", protocol, "--quiet"],
                           stdout=subprocess.PIPE, text=True)
    return bar, bar.stdout.readline().strip()


def main():
    dbbd, program = sys.argv[1:3]
    failed = False
    for protocol in sys.argv[3:] or KNOWN:
        bar, port = simulate(dbbd, program, protocol)
        script = pathlib.Path(__file__).with_name("read_bar.py")
        client = subprocess.run([sys.executable, script, protocol, port, "3"], capture_output=True, text=True)
        bar.kill()
        theirs = [float(line) for line in client.stdout.split()]
        with tempfile.TemporaryDirectory() as directory:
            bar, port = simulate(dbbd, program, protocol)
            run, out = f"{directory}/run", f"{directory}/csv"
            subprocess.run([dbbd, "acquire", "--port", port, "--protocol", protocol, "--out", run, "--duration", "5", "--quiet"])
            bar.kill()
            subprocess.run([dbbd, "export", run, "--out", out, "--quiet"], check=True)
            with open(f"{out}/samples.csv") as rows:
                ours = [float(row["reading_mm"]) - AT_MM.get(protocol, 0.0) for row in csv.DictReader(rows)]
        count = min(len(ours), len(theirs))
        worst = max((abs(a - b) for a, b in zip(ours, theirs)), default=float("inf"))
        print(f"{protocol:22} {count:6} readings compared, largest difference {worst:.6f} mm")
        failed |= worst > 1e-6
    sys.exit(failed)


if __name__ == "__main__":
    main()
