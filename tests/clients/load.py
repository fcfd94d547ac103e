"""A hundred clients of the live stream, of which twenty read nothing, on a bar of 1 kHz.

    python tests/clients/load.py target/release/dbbd [SECONDS] [CLIENTS] [DEAF]

Says the delay from the byte to the page (the host's stamp of the read against the arrival in this process, on the same clock):
of the newest sample of each picture, and of the oldest, which has waited for the picture; the memory of the service; and
whether the capture lost anything. Ends with an error when it did.
"""

import asyncio
import json
import pathlib
import statistics
import subprocess
import sys
import time

from cell import served

DBBD = pathlib.Path(sys.argv[1]).resolve()
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
CLIENTS = int(sys.argv[3]) if len(sys.argv) > 3 else 100
DEAF = int(sys.argv[4]) if len(sys.argv) > 4 else 20
PORT = 8232


def memory_kb(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])


def cpu_s(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


async def ask(method, path, body=None):
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
    content = b"" if body is None else json.dumps(body).encode()
    head = f"{method} /api/v1{path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n"
    writer.write(head.encode() + f"Content-Length: {len(content)}\r\n\r\n".encode() + content)
    answer = await reader.read()
    writer.close()
    text = answer.split(b"\r\n\r\n", 1)[1]
    return json.loads(text) if text else None


async def listen(newest, oldest, lost, end):
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    event = None
    while time.time() < end:
        line = await reader.readline()
        now = 1000 * time.time()
        if not line:
            raise SystemExit("a reading client was cut off")
        if line.startswith(b"event: "):
            event = line[7:].strip()
        elif line.startswith(b"data: ") and event == b"frame":
            frame = json.loads(line[6:])
            newest.append(now - frame["unix_ms"])
            oldest.append(now - frame["unix_ms"] + frame["span_ms"])
        elif line.startswith(b"data: ") and event == b"lost":
            lost.append(json.loads(line[6:])["messages"])
    writer.close()


async def deaf(end):
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT, limit=1)
    writer.transport.pause_reading()
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    await asyncio.sleep(max(0.0, end - time.time()))
    writer.close()


async def main(cell, service):
    await ask("POST", "/run", {"name": "load"})
    await asyncio.sleep(1)
    end = time.time() + SECONDS
    newest, oldest, lost, sizes = [], [], [], []
    first, began = memory_kb(service.pid), cpu_s(service.pid)

    async def watch():
        while time.time() < end:
            sizes.append(memory_kb(service.pid))
            await asyncio.sleep(1)

    async def later(number, client):
        # A network has 64 places for connections that have not asked yet.
        await asyncio.sleep(0.005 * number)
        await client

    clients = [listen(newest, oldest, lost, end) for _ in range(CLIENTS - DEAF)]
    clients += [deaf(end) for _ in range(DEAF)]
    await asyncio.gather(watch(), *(later(number, client) for number, client in enumerate(clients)))
    cpu = (cpu_s(service.pid) - began) / SECONDS
    await ask("POST", "/run/stop")
    status = await ask("GET", "/status")
    while status["run"]:
        await asyncio.sleep(0.1)
        status = await ask("GET", "/status")
    for name, delays in (("newest", newest), ("oldest", oldest)):
        parts = statistics.quantiles(delays, n=100)
        print(f"{name} sample of {len(delays)} pictures: median {parts[49]:.2f} ms, 99 % {parts[98]:.2f} ms, most {max(delays):.2f} ms")
    print(f"memory: {first} kB before, {max(sizes)} kB at most, {sizes[-1]} kB at the end; processor {100 * cpu:.1f} % of a core")
    print(f"messages lost by readers: {sum(lost)}")
    info = subprocess.run([DBBD, "info", "--json", cell / "dbbd-runs/load/run.dbbd"], capture_output=True, text=True)
    info = json.loads(info.stdout)
    print({key: info[key] for key in ("samples", "rate_hz", "gaps", "missing", "lost", "faults", "ended")})
    assert info["missing"] == 0 and info["lost"] == 0 and info["gaps"] == 0 and not info["faults"]


with served(DBBD, PORT) as (cell, service):
    asyncio.run(main(cell, service))
