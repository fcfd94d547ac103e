#!/usr/bin/env python3
"""Reads each virtual bar twice, with `dbbd acquire` and with the independent client, and compares.

    python3 tests/clients/compare.py path/to/dbbd PROGRAM.src [PROTOCOL ..]

With `--speed 0` device time goes on with the frames that are taken, and with the requests of a polled
bar: the same program, robot and seed give the same readings one by one. A polled bar measures every
2 s of device time, so that a few seconds of requests come to where the bar is within its stroke;
readings that the bar refuses are left out on both sides.
"""
import csv
import pathlib
import subprocess
import sys
import tempfile

POLLED = ["sylvac-opto", "heidenhain-nd28x", "modbus-rtu", "cdi-starrett", "mitutoyo-idh"]
KNOWN = ["dbb-cobs-1", "dbb-nmea-1", "usdigital-qsb", "microepsilon-ild1420", "riftek-rf60x"] + POLLED
AT_MM = {"microepsilon-ild1420": 25.0, "riftek-rf60x": 25.0}


def simulate(dbbd, program, protocol, world):
    rate_hz = 0.5 if protocol in POLLED else 200
    pathlib.Path(world).write_text(f"[bar]\nrate_hz = {rate_hz}\n")
    bar = subprocess.Popen([dbbd, "simulate", "--program", program, "--tool", "30,20,10", "--protocol", protocol, "--quiet",
                            "--speed", "0", "--halt", "0", "--world", world],
                           stdout=subprocess.PIPE, text=True)
    return bar, bar.stdout.readline().strip()


def main():
    dbbd, program = sys.argv[1:3]
    failed = False
    script = pathlib.Path(__file__).with_name("read_bar.py")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    for protocol in sys.argv[3:] or KNOWN:
        with tempfile.TemporaryDirectory() as directory:
            world, run, out = (f"{directory}/{name}" for name in ["world.toml", "run", "csv"])
            bar, port = simulate(dbbd, program, protocol, world)
            client = subprocess.run([sys.executable, script, protocol, port, "4"], capture_output=True, text=True)
            bar.kill()
            theirs = [float(line) for line in client.stdout.split()]
            bar, port = simulate(dbbd, program, protocol, world)
            acquire = [dbbd, "acquire", "--port", port, "--protocol", protocol, "--out", run, "--duration", "6"]
            subprocess.run(acquire, **quiet)
            bar.kill()
            subprocess.run([dbbd, "export", run, "--out", out], check=True, **quiet)
            with open(f"{out}/samples.csv") as rows:
                ours = [float(row["reading_mm"]) - AT_MM.get(protocol, 0.0) for row in csv.DictReader(rows)]
        pairs = list(zip(ours, theirs))
        worst = max((abs(a - b) for a, b in pairs), default=float("inf"))
        different = len({a for a, _ in pairs})
        print(f"{protocol:22} {len(pairs):6} readings compared, {different} different ones, largest difference {worst:.6f} mm")
        failed |= worst > 1e-6
    sys.exit(failed)


if __name__ == "__main__":
    main()
