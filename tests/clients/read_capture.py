"""Reads a capture as docs/reference/capture.md describes it, and nothing else, and compares it with the CSV export.

    dbbd export RUN --out DIR
    python3 read_capture.py RUN DIR
"""

import csv
import struct
import sys
from pathlib import Path

TABLE = []
for n in range(256):
    for _ in range(8):
        n = n >> 1 ^ (0x82F63B78 if n & 1 else 0)
    TABLE.append(n)


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


assert crc32c(b"123456789") == 0xE3069283


class Bytes:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        self.at += count
        assert self.at <= len(self.data)
        return self.data[self.at - count : self.at]

    def double(self):
        return struct.unpack("<d", self.take(8))[0]

    def leb(self):
        value = shift = 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def step(self, before):
        zigzag = self.leb()
        return (before + (zigzag >> 1 ^ -(zigzag & 1))) % 2**64


def samples(payload):
    data, sequence, ticks, offset, temperature, status = Bytes(payload), 0, 0, 0, None, 0
    while data.at < len(payload):
        flags = data.take(1)[0]
        reading = data.double()
        if flags & 2:
            sequence = data.step(sequence)
        if flags & 4:
            ticks = data.step(ticks)
        if flags & 64:
            temperature = data.double()
        if flags & 128:
            status = data.leb()
        offset = data.step(offset)
        yield {
            "reading_mm": reading,
            "sequence": sequence if flags & 2 else None,
            "ticks": ticks if flags & 4 else None,
            "trigger": (flags >> 4 & 1) if flags & 8 else None,
            "temperature_c": temperature if flags & 32 else None,
            "valid": flags & 1,
            "status": status,
            "offset": offset,
        }


def number(text):
    return None if text == "" else float(text)


run, directory = sys.argv[1], Path(sys.argv[2])
file = Bytes(Path(run).read_bytes())
header = file.take(16)
version, check = struct.unpack("<II", header[8:])
assert header[:8] == b"DBBDCAP\n" and version in (2, 3, 4) and check == crc32c(header[:12])
tables = {
    name: csv.DictReader(open(directory / f"{name}.csv", newline="")) for name in ["samples", "raw", "events", "faults"]
}
counts = {}
number_of_record = 0
while file.at < len(file.data):
    head = file.take(17)
    magic, kind, length, host_ns = struct.unpack("<4sBIQ", head)
    assert magic == b"\xdb\xbd\x5a\xa5"
    payload = file.take(length)
    assert struct.unpack("<I", file.take(4))[0] == crc32c(head[4:] + payload)
    if version >= 3:
        assert kind >= 128 and struct.unpack("<I", payload[:4])[0] == number_of_record % 2**32
        number_of_record += 1
        kind, payload = kind - 128, payload[4:]
    counts[kind] = counts.get(kind, 0) + 1
    if kind == 2:
        assert next(tables["raw"]) == {"host_ns": str(host_ns), "bytes_hex": payload.hex()}
    elif kind == 6:
        for sample in samples(payload):
            row = next(tables["samples"])
            assert int(row["host_ns"]) == host_ns
            for name, value in sample.items():
                assert number(row[name]) == value, (name, row, sample)
            counts["samples"] = counts.get("samples", 0) + 1
    elif kind in (4, 5):
        assert int(next(tables["faults" if kind == 4 else "events"])["host_ns"]) == host_ns
for name, rows in tables.items():
    assert next(rows, None) is None, f"{name}.csv has more rows"
print("records by kind:", counts)
