"""The process behind `LiveView`: newest posture in, MeshCat's commands out to every browser, on loopback.

Started as ``python -m eladapt.display.live_server FD`` with one line of JSON on stdin; it answers with one
line on stdout, and ends when stdin does, that is with the process that started it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
from typing import Any

import numpy as np
from meshcat import geometry as draw
from tornado import httpserver, netutil, web, websocket

from eladapt.display import loads
from eladapt.display.live import FRAMES_PER_SECOND, HEAD
from eladapt.display.page import LOOPBACK, filled
from eladapt.display.scene import TRAIL_COLOUR, Scene, camera_for, motion_of, visuals_of
from eladapt.errors import EladaptError
from eladapt.robot.model import Robot

MOST_POINTS = 2000  # of the tool's path; then every other one goes
PATH_PERIOD = 12  # frames between two drawings of the path
ROOM = 1.15  # the arm moves, so the camera stands back from the first posture
NICE = 5  # the loop that drives the arm comes first


class Stage:
    """The arm on show: where it stands, and the commands that put it there."""

    def __init__(self, robot: Robot):
        self.robot, self.zero = robot, np.zeros(1)
        visuals = visuals_of(robot)
        home, target = (robot.configuration(x)[None] for x in (robot.home, robot.target))
        self.camera = camera_for(visuals, motion_of(robot, self.zero, home, self.zero),
                                 motion_of(robot, self.zero, target, self.zero))  # fmt: skip
        self.camera["distance"] *= ROOM
        self.scene = Scene()
        self.scene.draw_surroundings(self.camera["distance"])
        self.scene.draw_robots(visuals)
        loads.draw_balls(self.scene)
        self.still, self.frame = self.scene.commands, 0
        self.path: list[np.ndarray] = []
        self.goal, self.t, self.stride, self.skipped = np.zeros(0), -np.inf, 1, 0
        self.tool = robot.model.frames[robot.model.getFrameId(robot.tool)]
        self.moving: list[bytes] = []  # the last frame, for who comes later
        start = [0.0] * HEAD + [*home[0], *home[0]]
        self.step(np.array(start))
        self.path.clear()

    def page(self, title: str, stream: str) -> str:
        """The page as of now, which goes on from ``stream``."""
        self.scene.commands = [*self.still, *self.moving, *self._path()]
        return filled(self.scene, self.camera, title, "live", ", where there is one", stream)

    def step(self, message: np.ndarray) -> list[bytes]:
        """The commands that lead to the posture of a message; none if it is not finite."""
        t, mass, centre, misfit = message[0], message[1], message[2:5], message[5]
        q, goal = np.split(message[HEAD:], 2)
        if not (np.isfinite(t) and np.isfinite(q).all() and np.isfinite(goal).all()):
            return []
        if t < self.t:
            self.path.clear()
        self.t = t
        motion = motion_of(self.robot, self.zero, q[None], self.zero)
        ghost = motion_of(self.robot, self.zero, goal[None], self.zero)
        self.scene.commands = []
        for name, placed in (("robot", motion), ("set-point", ghost)):
            for joint in range(1, placed.joints.shape[1]):
                self.scene.root[f"{name}/{joint}"].set_transform(placed.joints[0, joint])
        weight, at = loads.credible(mass, centre, misfit)
        place = motion.joints[0, self.tool.parentJoint] @ self.tool.placement.homogeneous
        loads.place(self.scene, "load", place[:3, :3] @ at + place[:3, 3], loads.radius_of(weight))
        self.moving = self.scene.commands
        self._go_on(motion.tool[0])
        self.frame += 1
        path = self._path() if self.frame % PATH_PERIOD == 0 else []
        return [*self.moving, *path]

    def _go_on(self, tool: np.ndarray) -> None:
        self.skipped += 1
        if self.skipped < self.stride and self.path:
            return
        self.skipped = 0
        self.path.append(tool)
        if len(self.path) > MOST_POINTS:
            self.path, self.stride = self.path[::2], 2 * self.stride

    def _path(self) -> list[bytes]:
        if len(self.path) < 2:
            return []
        self.scene.commands = []
        points = draw.PointsGeometry(np.array(self.path).T)
        self.scene.draw("tool path", points, draw.LineBasicMaterial(TRAIL_COLOUR), draw.Line)
        return self.scene.commands


class _Page(web.RequestHandler):
    def get(self) -> None:
        if self.request.host not in self.settings["hosts"]:  # another name: a page of somebody else
            raise web.HTTPError(404)
        self.write(self.settings["stage"].page(self.settings["title"], self.settings["stream"]))


class _Stream(websocket.WebSocketHandler):
    written: Any = None  # resolves when the browser has taken the last frame

    def check_origin(self, origin: str) -> bool:
        return origin in {f"http://{host}" for host in self.settings["hosts"]}

    def open(self, *_args: str, **_named: str) -> None:
        if self.request.host not in self.settings["hosts"]:
            self.close()
        else:
            self.settings["clients"].add(self)

    def on_message(self, message: str | bytes) -> None:
        """Nothing: a browser has no say."""

    def on_close(self) -> None:
        self.settings["clients"].discard(self)

    def frame(self, commands: list[bytes]) -> None:
        """Send a frame, or leave it out while the last one is still on its way."""
        if self.written is not None and not self.written.done():
            return
        with contextlib.suppress(websocket.WebSocketClosedError):
            for command in commands:
                self.written = self.write_message(command, binary=True)


async def serve(inbox: socket.socket, wanted: dict[str, Any]) -> None:
    """Serve until stdin ends."""
    robot = Robot.from_source(wanted["robot"])
    stage = Stage(robot)
    try:
        sockets = netutil.bind_sockets(wanted["port"], LOOPBACK)
    except (OSError, OverflowError) as reason:
        port = wanted["port"]
        raise EladaptError(f"port {port}: nothing can be served there: {reason}") from reason
    port = sockets[0].getsockname()[1]
    clients: set[_Stream] = set()
    hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}
    routes = [("/", _Page), ("/stream", _Stream)]
    application = web.Application(
        routes, stage=stage, clients=clients, hosts=hosts, title=robot.name,
        stream=f"ws://{LOOPBACK}:{port}/stream", log_function=lambda _handler: None,
    )  # fmt: skip
    httpserver.HTTPServer(application).add_sockets(sockets)
    done = asyncio.Event()
    loop = asyncio.get_running_loop()

    def left() -> None:
        if not os.read(sys.stdin.fileno(), 1024):
            done.set()

    loop.add_reader(sys.stdin.fileno(), left)
    print(json.dumps({"url": f"http://{LOOPBACK}:{port}/"}), flush=True)
    while not done.is_set():
        newest = _newest(inbox)
        if newest is not None and len(newest) == HEAD + 2 * robot.nq:
            commands = stage.step(newest)
            for client in list(clients):
                client.frame(commands)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(done.wait(), 1 / FRAMES_PER_SECOND)


def _newest(inbox: socket.socket) -> np.ndarray | None:
    newest = None
    with contextlib.suppress(BlockingIOError):
        while True:
            newest = np.frombuffer(inbox.recv(65536))
    return newest


def main() -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop; this ends when that does
    os.nice(NICE)
    inbox = socket.socket(fileno=int(sys.argv[1]))
    inbox.setblocking(False)
    line = b""
    while not line.endswith(b"\n"):
        line += os.read(0, 1)
    try:
        asyncio.run(serve(inbox, json.loads(line)))
    except EladaptError as reason:
        print(json.dumps({"error": str(reason)}), flush=True)


if __name__ == "__main__":
    main()
