"""A run seen while it goes on. The loop that drives the arm never waits for whoever looks.

The web server is a process of its own (`live_server`). `LiveView.show` puts a posture into a socket that
never blocks, at most 60 times a second; what does not fit is dropped, and the server draws the newest.
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, EladaptError
from eladapt.robot.model import Robot

FRAMES_PER_SECOND = 60
LOADS_PER_SECOND = 5  # an estimate of the load takes 0.5 ms on the panda, so it is made seldom
STARTUP = 60.0  # [s] for the server to read the robot's meshes
HEAD = 6  # t, mass, centre (3) and misfit of the load, before q and the goal in a message
SERVER = "eladapt.viewing.live_server"


class LiveView:
    """The arm in a browser, as `show` says it stands; made by ``view(robot, live=True)``.

    load: from the controller's state to what the arm carries, as `CompositeController.carried`; used
    where the view is the ``observer`` of `simulate`. ``url`` is for the browser, ``sent`` and ``dropped``
    count frames. The server ends with `close`, with the block of a ``with``, or with the process.
    Raises ArgumentError for a port that cannot be had or a robot that cannot be drawn.
    """

    def __init__(self, robot: Robot, *, port: int = 0, load: Callable[[Any], Any] | None = None):
        self.robot, self.sent, self.dropped = robot, 0, 0
        self._load, self._load_next, self._carried = load, 0.0, np.array([0.0, 0, 0, 0, 1.0])
        self._next, self._message = 0.0, np.zeros(HEAD + 2 * robot.nq)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, "-m", SERVER, str(theirs.fileno())], pass_fds=[theirs.fileno()],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
            )  # fmt: skip
        try:
            self.url = self._started({"robot": robot.source, "port": port, "parent": os.getpid()})
        except BaseException:
            self.close()
            raise
        print(f"The arm can be seen at {self.url}", flush=True)

    def show(
        self, t: float, q: np.ndarray, goal: np.ndarray | None = None, *, mass: float = 0.0,
        centre: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Draw the arm at q (nq,), its set-point at goal (nq,), and a load of ``mass`` [kg] at the tool.

        t [s]: of the run; the path of the tool starts again where it falls back. Returns at once, always:
        in microseconds, and without an effect where the last frame is less than 1/60 s old.
        Raises ArgumentError for a posture of another shape, where it would be drawn.
        """
        now = time.perf_counter()
        if now >= self._next:
            self._send(now, t, q, goal, (mass, *centre, 0.0))

    def __call__(self, t: float, q: np.ndarray, goal: np.ndarray, state: Any = None) -> None:
        """`show` as an observer of `simulate`, with the load that the state tells."""
        now = time.perf_counter()
        if now < self._next:
            return
        if self._load is not None and now >= self._load_next:
            self._load_next = now + 1 / LOADS_PER_SECOND
            found = self._load(state)
            self._carried = np.array([found.mass, *found.com, found.misfit])
        self._send(now, t, q, goal, self._carried)

    def close(self) -> None:
        """End the server. `show` has no effect from then on."""
        self._next = np.inf
        self._socket.close()
        for pipe in (self._server.stdin, self._server.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._server.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(
        self,
        now: float,
        t: float,
        q: np.ndarray,
        goal: np.ndarray | None,
        carried: np.ndarray | tuple[float, ...],
    ) -> None:
        self._next = now + 1 / FRAMES_PER_SECOND
        goal = q if goal is None else goal
        message, size = self._message, self.robot.nq
        if np.shape(q) != (size,) or np.shape(goal) != (size,):
            raise ArgumentError(
                f"q, goal: expected shape ({size},) each, got {np.shape(q)} and {np.shape(goal)}"
            )
        message[0], message[1:HEAD], message[HEAD : HEAD + size], message[HEAD + size :] = t, carried, q, goal
        try:
            self._socket.send(message.data)
            self.sent += 1
        except BlockingIOError:
            self.dropped += 1
        except OSError:  # the server is gone; the arm still has to be driven
            self._next = np.inf

    def _started(self, wanted: dict[str, Any]) -> str:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps(wanted).encode() + b"\n")
        self._server.stdin.flush()
        ready, _, _ = select.select([self._server.stdout], [], [], STARTUP)
        line = self._server.stdout.readline() if ready else b""
        if not line:
            raise EladaptError(f"the live view's server did not start within {STARTUP:g} s; see stderr above")
        answer = json.loads(line)
        if "error" in answer:
            raise ArgumentError(answer["error"])
        return str(answer["url"])
