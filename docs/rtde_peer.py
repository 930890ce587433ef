"""Plays a motion of `cosim export-path` as the controller of a UR arm does: try a twin without a robot.

    python rtde_peer.py way.csv [PORT]
    cosim twin light_hexagon_arm rtde:127.0.0.1:PORT

Answers one program after another with RTDE, protocol version 2: time and joints, 125 times a second.
"""

import csv
import socket
import struct
import sys
import time

RATE_Hz = 125.0
SENT = "timestamp,actual_q"
ANSWERS = {ord("V"): b"\x01", ord("O"): b"\x01DOUBLE,VECTOR6D", ord("S"): b"\x01"}


def rows_of(path: str) -> list[list[float]]:
    """Return the six joints of every row of a table."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name.endswith(".position_rad")]
    return [[float(row[name]) for name in names] for row in rows]


def package(kind: int, payload: bytes) -> bytes:
    """Return a package: size, kind, payload."""
    return struct.pack(">HB", 3 + len(payload), kind) + payload


def answer(connection: socket.socket) -> None:
    """Answer what a program asks for, until it asks to start."""
    with connection.makefile("rb") as asked:
        kind = 0
        while kind != ord("S"):
            size, kind = struct.unpack(">HB", asked.read(3))
            body = asked.read(size - 3)
            known = kind in ANSWERS and (kind != ord("O") or body[8:].decode() == SENT)
            connection.sendall(package(kind, ANSWERS[kind] if known else b"\x00NOT_FOUND"))


def play(connection: socket.socket, rows: list[list[float]], paced: bool = True) -> None:
    """Send all rows, each at its time unless not `paced`."""
    began = time.monotonic()
    for k, joints in enumerate(rows):
        if paced:
            time.sleep(max(began + k / RATE_Hz - time.monotonic(), 0.0))
        connection.sendall(package(ord("U"), struct.pack(">B7d", 1, k / RATE_Hz, *joints)))


def main(path: str, port: str = "30004") -> None:
    """Wait for programs and play to each of them."""
    with socket.create_server(("127.0.0.1", int(port))) as server:
        while True:
            connection, _ = server.accept()
            with connection:
                try:
                    answer(connection)
                    play(connection, rows_of(path))
                except OSError as error:
                    print(f"the program has gone: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
