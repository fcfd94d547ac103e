#!/usr/bin/env python3
"""Independent peers of the axes of a controller, sharing nothing with dbbd.

    python3 tests/clients/axes.py rtde HOST PORT SECONDS        reads `dbbd simulate --axes rtde://..` with the maker's client
    python3 tests/clients/axes.py ur-rtde HOST SECONDS          the same with ur-rtde (SDU; PyPI), which knows port 30004 only
    python3 tests/clients/axes.py rsi-listen PORT SECONDS       reads `dbbd simulate --axes rsi://..`
    python3 tests/clients/axes.py rsi-send HOST PORT SECONDS    is a controller for `dbbd acquire --axes rsi://..`

prints what came, as JSON. `.ci/night` runs `ur-rtde`. The others are run by hand; `rtde` needs UniversalRobots/RTDE_Python_Client_Library on PYTHONPATH.
"""
import json
import math
import socket
import sys
import time
import xml.etree.ElementTree as ET


def steps(times):
    found = {}
    for before, now in zip(times, times[1:]):
        step = round(1e3 * (now - before), 3)
        found[step] = found.get(step, 0) + 1
    return found


def rtde(host, port, seconds):
    from rtde import rtde as maker

    client = maker.RTDE(host, int(port))
    client.connect()
    version = client.get_controller_version()
    names = ["timestamp", "actual_q", "target_q"]
    assert client.send_output_setup(names, ["DOUBLE", "VECTOR6D", "VECTOR6D"], frequency=250)
    assert client.send_start()
    times, apart, until = [], 0.0, time.monotonic() + float(seconds)
    while time.monotonic() < until:
        state = client.receive_buffered()
        if state is None:
            time.sleep(0.001)
            continue
        times.append(state.timestamp)
        apart = max([apart] + [abs(a - b) for a, b in zip(state.actual_q, state.target_q)])
    client.send_pause()
    client.disconnect()
    return {"version": version, "packages": len(times), "steps_ms": steps(times), "apart_deg": math.degrees(apart)}


def ur_rtde(host, seconds):
    from rtde_receive import RTDEReceiveInterface  # of ur-rtde

    robot = RTDEReceiveInterface(host, 250.0, ["timestamp", "actual_q", "target_q"])
    times, until = [robot.getTimestamp()], time.monotonic() + float(seconds)
    while time.monotonic() < until:
        now = robot.getTimestamp()
        if now != times[-1]:
            times.append(now)
        time.sleep(0.0005)
    degrees = lambda axes: [math.degrees(axis) for axis in axes]
    found = {"times": len(times), "steps_ms": steps(times)}
    found |= {"measured_deg": degrees(robot.getActualQ()), "commanded_deg": degrees(robot.getTargetQ())}
    robot.disconnect()
    return found


def rsi_listen(port, seconds):
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", int(port)))
    line.settimeout(0.5)
    times, apart, until = [], 0.0, time.monotonic() + float(seconds)
    while time.monotonic() < until:
        try:
            root = ET.fromstring(line.recv(4096).decode())
        except TimeoutError:
            continue
        assert root.tag == "Rob" and root.attrib["Type"] == "KUKA"
        axes = lambda name: [float(root.find(name).attrib[f"A{axis}"]) for axis in range(1, 7)]
        apart = max([apart] + [abs(a - b) for a, b in zip(axes("AIPos"), axes("ASPos"))])
        times.append(1e-3 * int(root.find("IPOC").text))
    return {"packets": len(times), "steps_ms": steps(times), "apart_deg": apart}


def rsi_send(host, port, seconds):
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.settimeout(0.003)
    ipoc, first, sent, echoed, wrong, begin = 4208163634, 4208163634, 0, 0, 0, time.monotonic()
    while time.monotonic() < begin + float(seconds):
        angle = 10 * math.sin(sent * 0.004)
        axes = " ".join(f'A{axis}="{angle + axis:.4f}"' for axis in range(1, 7))
        text = (
            f'<Rob Type="KUKA"><RIst X="1620.0" Y="0.0" Z="1910.0" A="0.0" B="90.0" C="0.0" /><AIPos {axes} />'
            f'<ASPos {axes} /><Delay D="0" /><IPOC>{ipoc}</IPOC></Rob>'
        )
        line.sendto(text.encode(), (host, int(port)))
        sent += 1
        try:
            answer = ET.fromstring(line.recv(1024).decode())
            zero = all(float(value) == 0.0 for value in answer.find("AK").attrib.values())
            good = answer.tag == "Sen" and zero and int(answer.find("IPOC").text) in range(first, ipoc + 1, 4)
            echoed, wrong = echoed + good, wrong + (not good)
        except (TimeoutError, ConnectionRefusedError):
            pass
        ipoc += 4
        time.sleep(max(0.0, begin + 0.004 * sent - time.monotonic()))
    return {"sent": sent, "answers": echoed, "wrong_answers": wrong}


WAYS = {"rtde": rtde, "ur-rtde": ur_rtde, "rsi-listen": rsi_listen, "rsi-send": rsi_send}
print(json.dumps(WAYS[sys.argv[1]](*sys.argv[2:])))
