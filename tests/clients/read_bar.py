#!/usr/bin/env python3
"""An independent reader of virtual bars: pyserial, and decoders written from the makers' formats
(see the sources in protocols/*.toml), sharing nothing with dbbd.

    python3 tests/clients/read_bar.py PROTOCOL PORT [SECONDS]

prints one reading in mm a line. `compare.py` beside it runs it against `dbbd simulate`.
Run by hand; `cargo test` does not need it. Needs pyserial.
"""
import sys
import time

import serial

# What a virtual bar sends before its first frame.
MARK = b"dbbd simulate: not a real bar\r\n"


class Port(serial.Serial):
    """A port without the mark that its first bytes may be."""
    first, is_begun = b"", False

    def read(self, size=1):
        while not self.is_begun:
            got = super().read(len(MARK) - len(self.first))
            if not got:
                return b""
            self.first += got
            if self.first == MARK:
                self.first = b""
            self.is_begun = not self.first or not MARK.startswith(self.first)
        given, self.first = self.first[:size], self.first[size:]
        return given or super().read(size)


def lines(port, end, deadline):
    pending = b""
    while time.monotonic() < deadline:
        pending += port.read(256)
        while end in pending:
            line, pending = pending.split(end, 1)
            yield line


def reply(port, end, deadline):
    """One whole reply; a slow one is waited for, in pieces."""
    line = b""
    while not line.endswith(end) and time.monotonic() < deadline:
        line += port.read_until(end)
    return line


def crc16_ibm_3740(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def crc16_modbus(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def dbb_cobs_1(port, deadline):
    port.write(b"\x02\x53\x00")
    for stuffed in lines(port, b"\0", deadline):
        body, at = bytearray(), 0
        while at < len(stuffed):
            code = stuffed[at]
            body += stuffed[at + 1:at + code]
            at += code
            if code < 255 and at < len(stuffed):
                body.append(0)
        if len(body) == 16 and crc16_ibm_3740(body[:14]) == int.from_bytes(body[14:], "little"):
            yield int.from_bytes(body[7:11], "little", signed=True) / 1e5
    port.write(b"\x02\x58\x00")


def dbb_nmea_1(port, deadline):
    port.write(b"S\n")
    for line in lines(port, b"\r\n", deadline):
        if line[:1] == b"$" and b"*" in line:
            body, sent = line[1:].split(b"*")
            xor = 0
            for byte in body:
                xor ^= byte
            if xor == int(sent, 16):
                yield float(body.split(b",")[3])
    port.write(b"X\n")


def sylvac_opto(port, deadline):
    while time.monotonic() < deadline:
        port.write(b"?\r")
        line = reply(port, b"\r", deadline)
        if line[:1] in b"+- " and line.endswith(b"\r"):
            yield float(line[:-1].replace(b" ", b""))


def heidenhain_nd28x(port, deadline):
    while time.monotonic() < deadline:
        port.write(b"\x02")
        line = reply(port, b"\r\n", deadline)
        if len(line) == 17 and line.endswith(b"\r\n"):
            yield float(line[:11].replace(b" ", b"")) * (25.4 if line[12:13] == b'"' else 1.0)


def usdigital_qsb(port, deadline):
    port.write(b"W155\n")
    port.write(b"S0E\n")
    for line in lines(port, b"\n", deadline):
        line = line.strip()
        if line[:3].upper() == b"S0E" and line.endswith(b"!") and len(line) == 20:
            count = int(line[3:11], 16)
            yield (count - (1 << 32) if count >> 31 else count) / 1000.0
    port.write(b"R0E\n")


def microepsilon_ild1420(port, deadline):
    port.write(b"OUTPUT RS422\n")
    value, place = 0, 0
    while time.monotonic() < deadline:
        for byte in port.read(256):
            tag = byte >> 6
            if tag == 0:
                value, place = byte & 63, 1
            elif tag == place and place in (1, 2):
                value |= (byte & 63) << 6 * place
                place += 1
                if place == 3:
                    if value <= 65520:
                        yield (value * 102 / (100 * 65520) - 0.01) * 50.0 - 25.0
                    place = 0
            else:
                place = 0
    port.write(b"OUTPUT NONE\n")


def riftek_rf60x(port, deadline):
    port.write(b"\x01\x87")
    record = []
    while time.monotonic() < deadline:
        for byte in port.read(256):
            if not byte & 0x80 or (record and (byte ^ record[0]) & 0x30):
                record = []
            if byte & 0x80:
                record.append(byte)
            if len(record) == 4:
                counts = sum((byte & 15) << 4 * place for place, byte in enumerate(record))
                yield counts * 50.0 / 16384 - 25.0
                record = []
    port.write(b"\x01\x88")


def cdi_starrett(port, deadline):
    while time.monotonic() < deadline:
        port.write(b"R\r")
        line = reply(port, b"\r\n", deadline)
        number, _, unit = line.strip().partition(b",")
        if unit.strip() in (b"MM", b"IN"):
            yield float(number.replace(b" ", b"")) * (25.4 if unit.strip() == b"IN" else 1.0)


def mitutoyo_idh(port, deadline):
    while time.monotonic() < deadline:
        port.write(b"GA00\r\n")
        line = reply(port, b"\r\n", deadline)
        if line.startswith(b"GN00,") and len(line) == 17:
            yield float(line[5:15])


def modbus_rtu(port, deadline):
    request = bytes([1, 4, 0, 0, 0, 2])
    request += crc16_modbus(request).to_bytes(2, "little")
    assert request.hex() == "01040000000271cb"
    while time.monotonic() < deadline:
        port.write(request)
        frame = port.read(9)
        if len(frame) == 9 and crc16_modbus(frame[:7]) == int.from_bytes(frame[7:], "little"):
            yield int.from_bytes(frame[3:7], "big", signed=True) / 1000.0


def main():
    name, path = sys.argv[1], sys.argv[2]
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 5.0
    with Port(path, timeout=0.2) as port:
        for reading in globals()[name.replace("-", "_")](port, time.monotonic() + seconds):
            print(f"{reading:.6f}", flush=True)


if __name__ == "__main__":
    main()
