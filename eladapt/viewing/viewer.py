"""The motion of a record in three dimensions: the arm, its set-point as a ghost, the tool's path, the load.

One self-contained page holds everything, MeshCat's viewer included. It is written to a file, or
served from memory on the loopback interface; it makes no request of its own, and its content
security policy has the browser refuse any. A run that is still going on is shown by `live`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np
from meshcat import geometry as draw
from meshcat.animation import Animation

from eladapt.errors import ArgumentError, require_number
from eladapt.files import atomic_write
from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.viewing import loads
from eladapt.viewing.live import LiveView
from eladapt.viewing.page import LOOPBACK, PageServer, filled
from eladapt.viewing.scene import TRAIL_COLOUR, Scene, camera_for, motion_of, visuals_of

FRAMES_PER_SECOND = 30
MOST_FRAMES = 3000  # of one animation; a longer motion gets fewer frames a second


@dataclass(frozen=True)
class View:
    """Where a motion can be seen: ``url`` for a browser, and ``path`` if it is a file."""

    url: str
    path: Path | None = None
    server: PageServer | None = field(default=None, repr=False)

    def _repr_html_(self) -> str:
        """The page itself, in a notebook: it outlives the server, and needs no way to it."""
        from eladapt.display.inline import frame

        if self.path is not None:
            return frame(self.path.read_text(encoding="utf-8"), self.url)
        assert self.server is not None, "without a file there is a server"
        return frame(self.server.page.decode("utf-8"), self.url)

    def wait(self) -> None:
        """Keep serving until Ctrl-C, then close. Returns at once for a file."""
        try:
            if self.server is not None:
                self.server.thread.join()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving. A file stays."""
        if self.server is not None:
            self.server.shutdown()
            self.server.server_close()


@overload
def view(
    shown: Record, html: str | Path | None = None, *, speed: float = 1.0, loop: bool = True, port: int = 0,
    live: Literal[False] = False,
) -> View: ...  # fmt: skip
@overload
def view(
    shown: Robot, *, live: Literal[True], port: int = 0, load: Callable[[Any], Any] | None = None
) -> LiveView: ...
def view(
    shown: Record | Robot, html: str | Path | None = None, *, speed: float = 1.0, loop: bool = True,
    port: int = 0, live: bool = False, load: Callable[[Any], Any] | None = None,
) -> View | LiveView:  # fmt: skip
    """Show the motion in a browser, or write it to a self-contained file when ``html`` is a path. A notebook
    shows it where a cell ends with the view.

    speed: 1 is real time, 0.5 is half of it. loop: start again at the end; the page's "Open Controls >
    Animations" has start, stop, time and speed as well. port: of the loopback server, 0 for one that is
    free; the server ends with `View.close`, or with the process.

    live: show a run while it goes on. ``shown`` is then the robot, and the `LiveView` that is
    returned takes its postures, from `simulate` or from a loop of one's own:

        live = ea.view(robot, live=True, load=controller.carried)
        record = ea.simulate(controller, plant, goal, observer=live)

    Meshes are read from the URDF's own folder and from the robot's ``package_dirs``, which for a record that
    was loaded are those given to `Record.load`. The view goes on without one that is refused, with a
    MeshWarning that names it. Raises ArgumentError for a record without motion, a file name that does not end
    in .html, and a port that cannot be had; UrdfError for the URDF of an older record, which does not hold
    it, that is not there any more, and for a broken one.
    """
    if live:
        if not isinstance(shown, Robot) or html is not None:
            raise ArgumentError(
                "live: expected view(robot, live=True), without html; a record is in the past"
            )
        return LiveView(shown, port=port, load=load)
    if not isinstance(shown, Record):
        raise ArgumentError(f"shown: expected a Record, or a Robot with live=True, got {shown!r}")
    speed = require_number("speed", speed, 0.0)
    if html is None:
        server = PageServer(page_of(shown, speed, loop), port)
        url = f"http://{LOOPBACK}:{server.server_address[1]}/"
        print(f"The motion can be seen at {url}", flush=True)
        return View(url, server=server)
    path = Path(html)
    if path.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"html: expected a file name that ends in .html, got {str(html)!r}")
    page = page_of(shown, speed, loop)
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return View(path.resolve().as_uri(), path)


def page_of(record: Record, speed: float = 1.0, loop: bool = True) -> str:
    """The self-contained page. Raises ArgumentError as `view` does."""
    robot = Robot.from_source(record.robot_source)
    visuals = visuals_of(robot)
    finite = np.isfinite(record.q).all(axis=1)
    n = len(finite) if finite.all() else int(np.argmin(finite))
    if n == 0:
        raise ArgumentError(f"record {record.title!r}: expected a finite configuration, got none")
    t, goal = record.t[:n] - record.t[0], record.goal[:n]
    seconds = t[-1] / speed
    fps = min(FRAMES_PER_SECOND, MOST_FRAMES / max(seconds, 1.0))
    times = speed / fps * np.arange(math.floor(seconds * fps) + 1)
    motion = motion_of(robot, t, record.q[:n], times)
    ghost = motion_of(robot, t, goal, times if np.any(goal != goal[0]) else times[:1])

    camera = camera_for(visuals, motion, ghost)
    scene = Scene()
    scene.draw_surroundings(camera["distance"])
    scene.draw_robots(visuals)
    path = draw.PointsGeometry(motion.tool.T)
    scene.draw("tool path", path, draw.LineBasicMaterial(TRAIL_COLOUR), draw.Line)
    animation = Animation(default_framerate=fps)
    scene.move("robot", motion, animation)
    scene.move("set-point", ghost, animation)
    carried = loads.loads_of(record, robot, motion, times)
    if carried is not None:
        loads.animate(scene, carried, animation)
    scene.root.set_animation(animation, repetitions=math.inf if loop else 1)
    known = carried is not None and carried.true_centre is not None
    load = "" if carried is None else ", true load in wires" if known else " "
    duration = f"{t[-1]:.3g} s" + ("" if speed == 1 else f" at {speed:g} times real time")
    return filled(scene, camera, record.title or robot.name, duration, load)
