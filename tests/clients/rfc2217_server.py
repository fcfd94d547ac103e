"""Serves one serial device over RFC 2217 with pyserial's PortManager; prints the TCP port. Usage: rfc2217_server.py DEVICE"""

import socket
import sys
import threading

import serial
import serial.rfc2217

# A pseudo-terminal has no modem wires to watch.
serial.rfc2217.PortManager.check_modem_lines = lambda self, force_notification=False: None


class Connection:
    """What PortManager writes to."""

    def __init__(self, sock):
        self.sock, self.lock = sock, threading.Lock()

    def write(self, data):
        with self.lock:
            self.sock.sendall(data)


def upwards(device, manager, connection, closed):
    try:
        while not closed.is_set():
            data = device.read(device.in_waiting or 1)
            if data:
                connection.write(b"".join(manager.escape(data)))
    except OSError:
        pass


def serve(device, sock):
    connection, closed = Connection(sock), threading.Event()
    manager = serial.rfc2217.PortManager(device, connection)
    reader = threading.Thread(target=upwards, args=(device, manager, connection, closed), daemon=True)
    reader.start()
    try:
        while data := sock.recv(1024):
            device.write(b"".join(manager.filter(data)))
    except OSError:
        pass
    closed.set()
    reader.join()


listener = socket.create_server(("127.0.0.1", 0))
print(listener.getsockname()[1], flush=True)
while True:
    client, _ = listener.accept()
    with client, serial.Serial(sys.argv[1], timeout=0.05) as port:
        serve(port, client)
