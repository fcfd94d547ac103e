"""A simulated cell with a bar of 1 kHz behind `dbbd serve`, for the clients beside this file."""

import contextlib
import pathlib
import shutil
import subprocess
import tempfile
import time

JOB = pathlib.Path(__file__).parents[2] / "examples" / "circles.toml"
WORLD = "[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nrate_hz = 1000.0\n"


@contextlib.contextmanager
def served(dbbd, port, token=None):
    """Its directory and the process of the service at 127.0.0.1:port, which asks for the token if one is given."""
    with tempfile.TemporaryDirectory() as folder:
        cell = pathlib.Path(folder)
        shutil.copy(JOB, cell / "job.toml")
        (cell / "world.toml").write_text(WORLD)
        asked = ""
        if token:
            (cell / "token").write_text(token)
            (cell / "token").chmod(0o600)
            asked = 'token_file = "token"\n'
        (cell / "dbbd.toml").write_text(f'address = "127.0.0.1:{port}"\n{asked}[device]\nport = "bar"\n')
        for step in (["plan", "job.toml", "--out", "plan"], ["krl", "plan/plan.csv", "--out", "krl"]):
            subprocess.run([dbbd, "--quiet", *step], cwd=cell, check=True, stdout=subprocess.DEVNULL)
        robot = subprocess.Popen(
            [dbbd, "simulate", "--program", "krl/DBB_MAIN.src", "--tool", "30,20,10", "--link", "bar", "--world", "world.toml"],
            cwd=cell, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        service = subprocess.Popen([dbbd, "serve", "--config", "dbbd.toml"], cwd=cell, stderr=subprocess.DEVNULL)
        try:
            time.sleep(1.5)
            yield cell, service
        finally:
            robot.kill()
            service.terminate()
            service.wait()
            robot.wait()
