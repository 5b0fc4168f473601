"""A robot at the other end of a UDP socket, as fast interfaces of vendors are: both of its ends.

Every period the robot sends its state, and the controller answers with a torque. A packet is a header, a
number that counts up, and float64 in little-endian order. Old packets are dropped, the newest counts.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eladapt.errors import HardwareError, require_number
from eladapt.gains.extremes import effort, extremes
from eladapt.hardware.timing import Pacer, Timing, undisturbed
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Plant
from eladapt.signals import Measurement

HEADER = struct.Struct("<4s4sQ")  # magic, kind, number
MAGIC = b"ELA1"
START, STATE, TORQUE, STOP = b"strt", b"stat", b"torq", b"stop"
LOOPBACK = "127.0.0.1"
MOST_PACKETS = 64  # in a period: 0.3 ms to read; a controller sends one


class Packet(NamedTuple):
    """One datagram."""

    kind: bytes
    number: int
    values: np.ndarray

    def pack(self) -> bytes:
        """The bytes that are sent."""
        body = np.ascontiguousarray(self.values, dtype="<f8").tobytes()
        return HEADER.pack(MAGIC, self.kind, self.number) + body

    @classmethod
    def unpack(cls, data: bytes, sizes: dict[bytes, int]) -> Packet | None:
        """The packet in ``data``, None where it is none or of another size than its kind's."""
        if len(data) < HEADER.size:
            return None
        magic, kind, number = HEADER.unpack_from(data)
        if magic != MAGIC or len(data) - HEADER.size != 8 * sizes.get(kind, -1):
            return None
        return cls(kind, number, np.frombuffer(data, "<f8", offset=HEADER.size).astype(float))


class UdpRobot:
    """The controller's end: a `RobotInterface` on a robot that `serve` serves.

    read waits for up to ``patience`` [s] for something new, two periods by default, and then returns the last
    measurement again, whose age the gate counts. Raises HardwareError where nobody answers `start`.
    """

    def __init__(
        self,
        robot: Robot,
        port: int,
        host: str = LOOPBACK,
        *,
        dt: float = 1e-3,
        patience: float | None = None,
    ):
        self.robot, self.address = robot, (host, port)
        self.patience = 2 * dt if patience is None else require_number("patience", patience, 0)
        self._sizes = {STATE: 1 + robot.nq + 2 * robot.nv}
        self._socket: socket.socket | None = None
        self._sent = self._received = 0
        self._last: Measurement | None = None

    def start(self, timeout: float = 5.0) -> None:
        """Ask for states until the first one comes."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(self.address)
        self._socket.setblocking(False)
        until = time.monotonic() + timeout
        while self._last is None:
            if time.monotonic() > until:
                host, port = self.address
                raise HardwareError(f"no robot answers at {host}:{port} within {timeout:g} s; is it running?")
            self._send(START, np.zeros(0))
            self._wait(0.05)
            self._drain()

    def read(self) -> Measurement:
        """The newest measurement."""
        if self._last is None or self._socket is None:
            raise HardwareError("read: start the robot first")
        until = time.monotonic() + self.patience
        while not self._drain() and (left := until - time.monotonic()) > 0:
            self._wait(left)
        return self._last.copy()

    def write(self, tau: np.ndarray) -> None:
        """Send a torque (nv,)."""
        self._send(TORQUE, tau)

    def stop(self) -> None:
        """Tell the robot to stop, three times since packets get lost, and hang up."""
        if self._socket is None:
            return
        for _ in range(3):
            self._send(STOP, np.zeros(0))
        self._socket.close()
        self._socket = None

    def _send(self, kind: bytes, values: np.ndarray) -> None:
        self._sent += 1
        if self._socket is None:
            raise HardwareError("write: start the robot first")
        # a robot that is gone shows by its measurements, which the gate watches
        with contextlib.suppress(ConnectionError, BlockingIOError):
            self._socket.send(Packet(kind, self._sent, values).pack())

    def _wait(self, timeout: float) -> None:
        if self._socket is not None:
            select.select([self._socket], [], [], timeout)

    def _drain(self) -> bool:
        """Take all that has come; whether something newer was there."""
        newer = False
        while self._socket is not None:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # nobody listens yet, or any more
            packet = Packet.unpack(data, self._sizes)
            if packet is None or packet.number <= self._received:
                continue
            self._received, newer = packet.number, True
            t, q, v, tau = np.split(packet.values, np.cumsum([1, self.robot.nq, self.robot.nv]))
            self._last = Measurement(float(t[0]), q, v, tau)
        return newer


class Served(NamedTuple):
    """How a robot's day was."""

    commands: int  # torques that were taken
    without: int  # periods in which none came: the one before was held
    refused: int  # packets that were none, torques that were not finite, and others' before the start
    clipped: int  # torques that were beyond the joints' effort limits, and were held to them
    timing: Timing
    ended: str  # "stop", "silence" or "nobody came"


def serve(
    plant: Plant,
    dt: float = 1e-3,
    ready: Callable[[int], object] = print,
    *,
    patience: float = 60.0,
    silence: float = 0.5,
    priority: int | None = None,
) -> Served:
    """The robot's end: a plant that runs in real time on a port of loopback that the system chooses.

    ready: called with that port. The brakes hold until the first torque comes. Ends when it is told to stop,
    when nothing is heard for ``silence`` [s], or when nobody comes for ``patience`` [s]. Who starts it first
    has it. A torque is held to the effort limits, the URDF's or what a `TorqueGate` takes where it sets none.
    No more than `MOST_PACKETS` are looked at in a period, so that the robot's clock goes on whatever comes.
    """
    nv, most = plant.robot.nv, effort(plant.robot, extremes(plant.robot))
    sizes = {START: 0, TORQUE: nv, STOP: 0}
    measurement = plant.reset()
    tau, number, newest, commands, without, refused, clipped = np.zeros(nv), 0, 0, 0, 0, 0, 0
    client, ended, heard = None, "nobody came", time.monotonic() + patience - silence
    pacer = Pacer(dt, 1_000_000)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server, undisturbed(priority):
        server.bind((LOOPBACK, 0))
        server.setblocking(False)
        ready(server.getsockname()[1])
        pacer.restart()
        while time.monotonic() - heard < silence:
            pacer.began(0.0)
            fresh = False
            for _ in range(MOST_PACKETS):
                try:
                    data, sender = server.recvfrom(65536)
                except BlockingIOError:
                    break
                except ConnectionError:
                    continue
                packet = Packet.unpack(data, sizes)
                if packet is None or not np.isfinite(packet.values).all() or client not in (None, sender):
                    refused += 1
                    continue
                if client is None and packet.kind == START:
                    client, newest, ended = sender, 0, "silence"
                    server.connect(client)  # the system drops what others send
                if client is None or packet.number <= newest:
                    continue
                newest, heard = packet.number, time.monotonic()
                if packet.kind == TORQUE:
                    tau, fresh = np.clip(packet.values, -most, most), True
                    commands += 1
                    clipped += bool((tau != packet.values).any())
                elif packet.kind == STOP:
                    ended, heard = "stop", -math.inf
            if commands and ended != "stop":
                without += not fresh
                measurement = plant.step(tau, dt)
            if client is not None:
                number += 1
                t, q, v, applied = measurement
                state = Packet(STATE, number, np.concatenate([[t], q, v, applied]))
                with contextlib.suppress(ConnectionError, BlockingIOError):
                    server.send(state.pack())
            pacer.wait()
    return Served(commands, without, refused, clipped, pacer.timing(), ended)
