"""The process behind `LiveView`: newest posture in, MeshCat's commands out to every browser, on loopback.

Started as ``python -m eladapt.viewing.live_server FD`` with one line of JSON on stdin; it answers with one
line on stdout, and ends when stdin does, or when the process that started it has: a process forked from that
one may hold stdin open for longer.
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
import pinocchio as pin
from meshcat import geometry as draw
from tornado import httpserver, netutil, web, websocket

from eladapt.errors import EladaptError
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index
from eladapt.viewing import loads
from eladapt.viewing.live import FRAMES_PER_SECOND, HEAD
from eladapt.viewing.page import LOOPBACK, filled
from eladapt.viewing.scene import TRAIL_COLOUR, Scene, camera_for, motion_of, tip_of, visuals_of

MOST_POINTS = 2000  # of the tool's path; then every other one goes
PATH_PERIOD = 12  # frames between two drawings of the path
ROOM = 1.15  # the arm moves, so the camera stands back from the first posture
NICE = 5  # the loop that drives the arm comes first


class Stage:
    """The arm on show: where it stands, and the commands that put it there."""

    def __init__(self, robot: Robot):
        self.robot, self.data, zero = robot, robot.model.createData(), np.zeros(1)
        visuals = visuals_of(robot)
        home, target = (robot.configuration(x) for x in (robot.home, robot.target))
        still, moved = (motion_of(robot, zero, q[None], zero) for q in (home, target))
        self.camera = camera_for(visuals, still, moved)
        self.camera["distance"] *= ROOM
        self.scene = Scene()
        self.scene.draw_surroundings(self.camera["distance"])
        self.scene.draw_robots(visuals)
        loads.draw_balls(self.scene)
        self.still, self.frame = self.scene.commands, 0
        self.path: list[np.ndarray] = []
        self.goal, self.t, self.stride, self.skipped = np.zeros(0), -np.inf, 1, 0
        self.tool = robot.model.frames[frame_index(robot.model, robot.tool)]
        self.tip = tip_of(robot, self.tool.parentJoint) if self.tool.parentJoint else np.zeros(3)
        self.moving: list[bytes] = []  # the last frame, for who comes later
        self.ghost: list[bytes] = []
        self.step(np.array([0.0] * HEAD + [*home, *home]))
        self.path.clear()

    def page(self, title: str, stream: str) -> str:
        """The page as of now, which goes on from ``stream``."""
        self.scene.commands = [*self.still, *self.whole()]
        return filled(self.scene, self.camera, title, "live", ", where there is one", stream)

    def whole(self) -> list[bytes]:
        """The commands that bring up to date who missed some."""
        return [*self.ghost, *self.moving, *self._path()]

    def step(self, message: np.ndarray) -> list[bytes]:
        """The commands that lead to the posture of a message; none if it is not finite."""
        t, mass, centre, misfit = message[0], message[1], message[2:5], message[5]
        q, goal = np.split(message[HEAD:], 2)
        if not (np.isfinite(t) and np.isfinite(q).all() and np.isfinite(goal).all()):
            return []
        if t < self.t:
            self.path.clear()
        self.t = t
        stays = np.array_equal(goal, self.goal)
        if not stays:
            self.goal = goal.copy()
            self.ghost = self._pose("set-point", goal)
        self.moving = self._pose("robot", q)
        weight, at = loads.credible(mass, centre, misfit)
        place = self.data.oMi[self.tool.parentJoint] * self.tool.placement
        self.scene.commands = self.moving
        loads.place(self.scene, "load", place.act(at), loads.radius_of(weight))
        self._go_on(self.data.oMi[self.tool.parentJoint].act(self.tip))
        self.frame += 1
        path = self._path() if self.frame % PATH_PERIOD == 0 else []
        return [*self.moving, *([] if stays else self.ghost), *path]

    def _pose(self, name: str, q: np.ndarray) -> list[bytes]:
        self.scene.commands = []
        pin.forwardKinematics(self.robot.model, self.data, q)
        for joint in range(1, self.robot.model.njoints):
            self.scene.root[f"{name}/{joint}"].set_transform(self.data.oMi[joint].homogeneous)
        return self.scene.commands

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
    behind = False  # a frame was left out, and none was sent since

    def check_origin(self, origin: str) -> bool:
        return origin in {f"http://{host}" for host in self.settings["hosts"]}

    def open(self, *_args: str, **_named: str) -> None:
        if self.request.host not in self.settings["hosts"]:
            self.close()
        else:
            self.behind = True  # of what moved since its page was made
            self.settings["clients"].add(self)

    def on_message(self, message: str | bytes) -> None:
        """Nothing: a browser has no say."""

    def on_close(self) -> None:
        self.settings["clients"].discard(self)

    def frame(self, commands: list[bytes]) -> None:
        """Send a frame, or leave it out while the last one is still on its way."""
        self.behind = self.written is not None and not self.written.done()
        if self.behind:
            return
        with contextlib.suppress(websocket.WebSocketClosedError):
            for command in commands:
                self.written = asyncio.ensure_future(self.write_message(command, binary=True))
                self.written.add_done_callback(lambda sent: sent.cancelled() or sent.exception())


async def serve(inbox: socket.socket, wanted: dict[str, Any]) -> None:
    """Serve until stdin ends, or the process ``wanted["parent"]`` has."""
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
    while not done.is_set() and os.getppid() == wanted["parent"]:
        newest = _newest(inbox)
        if newest is not None and len(newest) == HEAD + 2 * robot.nq:
            commands = stage.step(newest)
            for client in list(clients):
                client.frame(stage.whole() if client.behind else commands)
        else:
            for client in [client for client in clients if client.behind]:
                client.frame(stage.whole())
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
