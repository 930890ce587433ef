"""Reads the measured motion of a robot as a stream: joints from a UR's controller, or lines of JSON from a
socket, a file or standard input. A UR's controller (RTDE, port 30004) sends packages: a head with size (2
bytes) and kind (1 byte), then the requested values, all in big-endian order. Source: Universal Robots,
Real-Time Data Exchange (RTDE) Guide, protocol version 2.
"""

import json
import math
import os
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from select import select
from typing import Any, Final, final

from cosim.devices.command_checks import shown
from cosim.errors import InputError

RTDE_PORT: Final = 30004
RTDE_Hz: Final = 125.0
_CONNECT_s: Final = 5.0
_CHUNK: Final = 65536
_LONGEST_LINE: Final = 1_000_000
_SHOWN: Final = 80
_KINDS: Final = "rtde:HOST[:PORT], tcp:HOST:PORT, file:PATH (a serial line too), or - for standard input"
_KEYS: Final = ("time_s", "joint_position", "pressure_Pa", "cable_tension_N")
_VERSION, _OUTPUTS, _START, _DATA = b"VOSU"
_FIELDS: Final = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D"}
_ROW: Final = struct.Struct(">B7d")
_SENT: Final = b"VvMUOISP"
"""Kinds of packages that a controller sends."""


@final
@dataclass(frozen=True)
class Reading:
    """Measured values that a robot sends; omitted values are unchanged.

    Args:
        time_s: on the robot's clock, to which the twin advances; None: the values apply with the next reading
            that has a time.
        joint_position: (joints,) [rad], of sliding joints [m].
        pressure_Pa: gauge, by chamber name.
        cable_tension_N: by cable name.
        arrived_s: `time.perf_counter()` when it was read here.
    """

    time_s: float | None = None
    joint_position: Sequence[float] | None = None
    pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    cable_tension_N: Mapping[str, float] = field(default_factory=dict)
    arrived_s: float = field(default_factory=time.perf_counter)


class Stream(ABC):
    """Readings from a file descriptor.

    Args:
        name: in messages.
        number: of the descriptor.
    """

    def __init__(self, name: str, number: int) -> None:
        self.name, self._number = name, number
        self._held = b""
        self.left_out: Counter[str] = Counter()
        """Messages on data that could not be read, each with its count."""

    def fileno(self) -> int:
        """Return the file descriptor to wait for."""
        return self._number

    def read(self) -> list[Reading] | None:
        """Return the readings that have arrived; None at the end of the stream. Blocks until there is data.

        Raises:
            InputError: the data cannot be parsed, or the connection broke.
        """
        try:
            data = os.read(self._number, _CHUNK)
        except OSError as error:
            raise InputError(f"{self.name}: cannot be read: {error.strerror}") from error
        if not data:
            rest, self._held = self._held, b""
            return (self._last(rest) or None) if rest.strip() else None
        self._held += data
        return self._parsed()

    @abstractmethod
    def _parsed(self) -> list[Reading]:
        """Return the complete readings in the received bytes, and remove them there."""

    def _last(self, rest: bytes) -> list[Reading]:
        """Return the readings in the bytes that remain at the end of the stream."""
        self._leave_out(f"the last {len(rest)} bytes are no whole reading")
        return []

    def _leave_out(self, text: str) -> None:
        self.left_out[f"{self.name}: {text}"] += 1

    def close(self) -> None:
        """Close the descriptor, but not standard input."""
        if self._number:
            with suppress(OSError):
                os.close(self._number)


@final
class LineStream(Stream):
    """A JSON object per line, with some keys of `Reading`; a key with the value null counts as omitted.

    The first line may be cut off, and the last one may have no line break.
    """

    _begun = False

    def _parsed(self) -> list[Reading]:
        *lines, self._held = self._held.split(b"\n")
        if len(self._held) > _LONGEST_LINE:
            raise InputError(
                f"{self.name}: a line is longer than {_LONGEST_LINE} bytes; end every reading with a line "
                "break"
            )
        return self._parsed_lines(lines)

    def _parsed_lines(self, lines: list[bytes]) -> list[Reading]:
        return [reading for line in lines if line.strip() and (reading := self._reading(line)) is not None]

    def _last(self, rest: bytes) -> list[Reading]:
        try:
            json.loads(rest)
        except (ValueError, RecursionError):
            return super()._last(rest)
        return self._parsed_lines([rest])

    def _reading(self, line: bytes) -> Reading | None:
        first, self._begun = not self._begun, True
        try:
            found = json.loads(line)
        except (ValueError, RecursionError) as error:
            if first:
                self._leave_out(f"the first line is not JSON: {line[:_SHOWN]!r}")
                return None
            raise InputError(f"{self.name}: line {line[:_SHOWN]!r}: {error}") from error
        try:
            return Reading(**_values(found))
        except ValueError as error:
            raise InputError(f"{self.name}: line {line[:_SHOWN]!r}: {error}") from error


def _values(found: Any) -> dict[str, Any]:
    """Return the values of a line by key; the time may be infinite or NaN.

    Raises:
        ValueError: a key or value is not allowed.
    """
    if not isinstance(found, dict) or found.keys() - {*_KEYS}:
        raise ValueError("must be an object with the keys " + ", ".join(_KEYS))
    given = {key: value for key, value in found.items() if value is not None}
    for key in given.keys() & {"pressure_Pa", "cable_tension_N"}:
        if not isinstance(given[key], dict):
            raise ValueError(
                f"{key} is {shown(given[key])}; must be numbers by name, such as {{'name': 1.0}}"
            )
    if "time_s" in given:
        if type(given["time_s"]) not in (int, float):
            raise ValueError(f"time_s is {shown(given['time_s'])}; must be a number")
        try:
            given["time_s"] = float(given["time_s"])
        except OverflowError:
            raise ValueError("time_s is beyond the largest number, 1.8e308") from None
    return given


@final
class RtdeStream(Stream):
    """Time and joints of a UR's controller, 125 times a second; the constructor connects.

    Args:
        host: of the controller.
        port: of it.

    Raises:
        InputError: no connection is possible, or the answer is not one of RTDE.
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
        """Return the answer to a request; packages of other kinds, such as texts, are skipped."""
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

    def _parsed(self) -> list[Reading]:
        found = []
        while len(self._held) >= 3:
            size, kind = struct.unpack_from(">HB", self._held)
            wrong_data = kind == _DATA and size != 3 + _ROW.size
            if size < 3 or kind not in _SENT or wrong_data:
                raise InputError(
                    f"{self.name}: sent a package of {size} bytes and kind {bytes([kind])!r}; must have 3 at "
                    f"least, {3 + _ROW.size} with data, and a kind of RTDE: connect again"
                )
            if len(self._held) < size:
                break
            if kind == _DATA:
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
    """Return the stream of an address.

    Args:
        given: "rtde:HOST[:PORT]"; or a source of JSON lines: "tcp:HOST:PORT", "file:PATH", or "-".

    Raises:
        InputError: it is no such address, or it cannot be opened.
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
    """Several streams as one: their readings in the order in which they arrive.

    Args:
        late_s: waiting readings that are out of order by less than this are sorted by their times.
    """

    def __init__(self, late_s: float = 0.0) -> None:
        self._late_s = late_s
        self._all: list[Stream] = []
        self._open: list[Stream] = []
        self._waiting: deque[Reading] = deque()

    def add(self, stream: Stream) -> None:
        """Add a stream."""
        self._all.append(stream)
        self._open.append(stream)

    @property
    def waiting(self) -> Sequence[Reading]:
        """Readings that have arrived, and that `next` has not returned yet."""
        return self._waiting

    @property
    def left_out(self) -> Counter[str]:
        """Messages of all streams on data that could not be read, each with its count."""
        return sum((stream.left_out for stream in self._all), Counter())

    def next(self, within_s: float | None = None) -> Reading | None:
        """Return the next reading; None if all streams have ended, or none arrives in time.

        Args:
            within_s: longest time to wait; None: unlimited.

        Raises:
            InputError: a stream sends data that cannot be parsed.
        """
        self._gather(0.0)
        while not self._waiting and self._open and self._gather(within_s):
            pass
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Close all streams."""
        for stream in self._open:
            stream.close()
        self._open = []

    def _gather(self, within_s: float | None) -> bool:
        """Read the streams that have data; return whether any had data or ended within a time."""
        ready = select(self._open, [], [], within_s)[0] if self._open else []
        for stream in ready:
            found = stream.read()
            if found is None:
                stream.close()
                self._open.remove(stream)
            for reading in found or ():
                self._put(reading)
        return bool(ready)

    def _put(self, reading: Reading) -> None:
        """Add a reading behind all waiting ones, but before those that are later by less than `late_s`."""
        place = len(self._waiting)
        while place and 0.0 < _behind_s(self._waiting[place - 1], reading) < self._late_s:
            place -= 1
        self._waiting.insert(place, reading)


def _behind_s(newer: Reading, older: Reading) -> float:
    """Return the time from an older to a newer reading; NaN if either has no time."""
    if newer.time_s is None or older.time_s is None:
        return math.nan
    return newer.time_s - older.time_s
