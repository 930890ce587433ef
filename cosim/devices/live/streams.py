"""What a robot sends of itself while it moves: joints from a UR's controller, anything as lines of JSON.

A UR's controller (RTDE, port 30004) sends packages: a head of size (2 bytes) and kind (1 byte), then
the values that were asked for, all with the first byte first. Source: Universal Robots, Real-Time Data
Exchange (RTDE) Guide, protocol version 2.
"""

import json
import math
import os
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from select import select
from typing import Any, Final, final

from cosim.errors import InputError

RTDE_PORT: Final = 30004
RTDE_Hz: Final = 125.0
_CONNECT_s: Final = 5.0
_CHUNK: Final = 65536
_KINDS: Final = "rtde:HOST[:PORT], tcp:HOST:PORT, file:PATH (a serial line too), or - for standard input"


@final
@dataclass(frozen=True)
class Reading:
    """What a robot says of itself; what it leaves out is as it was.

    Args:
        time_s: on the robot's clock, to which the twin advances; None: with the next reading that has one.
        joint_position: (joints,) [rad], of sliding ones [m].
        pressure_Pa: gauge, by chamber name.
        cable_tension_N: by cable name.
        arrived_s: `time.perf_counter()` when it was read here.
    """

    time_s: float | None = None
    joint_position: Sequence[float] | None = None
    pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    cable_tension_N: Mapping[str, float] = field(default_factory=dict)
    arrived_s: float = field(default_factory=time.perf_counter)


_KEYS: Final = ("time_s", "joint_position", "pressure_Pa", "cable_tension_N")


class Stream(ABC):
    """Readings from a file descriptor.

    Args:
        name: in messages.
        number: of the descriptor.
    """

    def __init__(self, name: str, number: int) -> None:
        self.name, self._number = name, number
        self._held = b""

    def fileno(self) -> int:
        """Return the file descriptor to wait for."""
        return self._number

    def read(self) -> list[Reading] | None:
        """Return the readings that are there now, once the descriptor can be read; None at its end.

        Raises:
            InputError: what came cannot be understood, or the connection broke.
        """
        try:
            came = os.read(self._number, _CHUNK)
        except OSError as error:
            raise InputError(f"{self.name}: cannot be read: {error.strerror}") from error
        if not came:
            return None
        self._held += came
        return self._taken()

    @abstractmethod
    def _taken(self) -> list[Reading]:
        """Take whole readings out of the bytes that have come."""

    def close(self) -> None:
        """Close the descriptor, but not standard input."""
        if self._number:
            with suppress(OSError):
                os.close(self._number)


@final
class LineStream(Stream):
    """An object of JSON in every line, with some keys of `Reading`; the first line may be cut off."""

    _begun = False

    def _taken(self) -> list[Reading]:
        *lines, self._held = self._held.split(b"\n")
        return [reading for line in lines if line.strip() and (reading := self._reading(line)) is not None]

    def _reading(self, line: bytes) -> Reading | None:
        first, self._begun = not self._begun, True
        try:
            found = json.loads(line)
            if not isinstance(found, dict) or found.keys() - {*_KEYS}:
                raise ValueError("must be an object with the keys " + ", ".join(_KEYS))
            if "time_s" in found and not _is_time(found["time_s"]):
                raise ValueError(f"time_s is {found['time_s']!r}; must be a finite number")
        except ValueError as error:
            if first:
                return None
            raise InputError(f"{self.name}: line {line[:80]!r}: {error}") from error
        return Reading(**found)


def _is_time(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


_VERSION, _OUTPUTS, _START, _DATA = b"VOSU"
_FIELDS: Final = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D"}
_ROW: Final = struct.Struct(">B7d")


@final
class RtdeStream(Stream):
    """Time and joints of a UR's controller, 125 times a second; connects when it is made.

    Args:
        host: of the controller.
        port: of it.

    Raises:
        InputError: nobody answers there, or not as RTDE does.
    """

    def __init__(self, host: str, port: int = RTDE_PORT) -> None:
        self._socket = _connected(host, port)
        super().__init__(f"rtde:{host}:{port}", self._socket.fileno())
        try:
            self._begin()
        except (InputError, OSError, struct.error) as error:
            self.close()
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.name}: does not answer as RTDE does: {error}") from error
        self._socket.settimeout(None)

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def _begin(self) -> None:
        if self._asked(_VERSION, struct.pack(">H", 2)) != b"\x01":
            raise InputError(f"{self.name}: refuses protocol version 2; needs a controller of 2017 or later")
        names = ",".join(_FIELDS)
        kinds = self._asked(_OUTPUTS, struct.pack(">d", RTDE_Hz) + names.encode())[1:].decode(
            "ascii", "replace"
        )
        if kinds != ",".join(_FIELDS.values()):
            raise InputError(f"{self.name}: sends {kinds} for {names}; must be {','.join(_FIELDS.values())}")
        if self._asked(_START, b"") != b"\x01":
            raise InputError(f"{self.name}: refuses to start; is another program using all its places?")

    def _asked(self, kind: int, payload: bytes) -> bytes:
        """Return the answer to a request; what else comes meanwhile, such as texts, is passed over."""
        self._socket.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)
        while True:
            size, answered = struct.unpack(">HB", self._exactly(3))
            body = self._exactly(size - 3)
            if answered == kind:
                return body

    def _exactly(self, count: int) -> bytes:
        found = b""
        while len(found) < count:
            part = self._socket.recv(count - len(found))
            if not part:
                raise InputError(f"{self.name}: closed the connection")
            found += part
        return found

    def _taken(self) -> list[Reading]:
        found = []
        while len(self._held) >= 3:
            size, kind = struct.unpack_from(">HB", self._held)
            if size < 3:
                raise InputError(f"{self.name}: sent a package of {size} bytes; it must have 3 at least")
            if len(self._held) < size:
                break
            if kind == _DATA and size == 3 + _ROW.size:
                _, time_s, *joints = _ROW.unpack_from(self._held, 3)
                found.append(Reading(time_s, tuple(joints)))
            self._held = self._held[size:]
        return found


def _connected(host: str, port: int) -> socket.socket:
    try:
        return socket.create_connection((host, port), timeout=_CONNECT_s)
    except OSError as error:
        raise InputError(f"{host}:{port}: cannot be connected to: {error.strerror or error}") from error


def open_stream(given: str) -> Stream:
    """Return the stream that a text names.

    Args:
        given: "rtde:HOST[:PORT]"; or where lines of JSON come from: "tcp:HOST:PORT", "file:PATH", or "-".

    Raises:
        InputError: it names none, or it cannot be opened.
    """
    kind, _, place = given.partition(":")
    if given == "-":
        return LineStream("standard input", 0)
    if kind == "file":
        try:
            return LineStream(given, os.open(Path(place), os.O_RDONLY | os.O_NOCTTY))
        except OSError as error:
            raise InputError(f"{given}: cannot be opened: {error.strerror}") from error
    host, _, number = place.partition(":")
    if kind not in ("rtde", "tcp") or not host or not (number.isdecimal() or (kind == "rtde" and not number)):
        raise InputError(f"stream '{given}': give {_KINDS}")
    if kind == "rtde":
        return RtdeStream(host, int(number or RTDE_PORT))
    return LineStream(given, _connected(host, int(number)).detach())


@final
class Streams:
    """Several streams as one: their readings in the order in which they arrive."""

    def __init__(self) -> None:
        self._open: list[Stream] = []
        self._waiting: deque[Reading] = deque()

    def add(self, stream: Stream) -> None:
        """Read one more."""
        self._open.append(stream)

    @property
    def waiting(self) -> Sequence[Reading]:
        """Readings that have arrived and have not been taken."""
        return self._waiting

    def next(self, within_s: float | None = None) -> Reading | None:
        """Return the next reading; None where all streams have ended, or at the end of a time.

        Args:
            within_s: how long to wait; None: for ever.

        Raises:
            InputError: a stream sends what cannot be understood.
        """
        self._gather(0.0)
        while not self._waiting and self._open and self._gather(within_s):
            pass
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Close all."""
        for stream in self._open:
            stream.close()
        self._open = []

    def _gather(self, within_s: float | None) -> bool:
        """Take what has arrived, and return whether anything can still come in time."""
        ready = select(self._open, [], [], within_s)[0] if self._open else []
        for stream in ready:
            found = stream.read()
            if found is None:
                stream.close()
                self._open.remove(stream)
            self._waiting.extend(found or ())
        return bool(ready)
