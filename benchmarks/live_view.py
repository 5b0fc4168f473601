"""What a live view costs the loop that it watches: step times of the Panda's controller, on against off.

One loop at 1 kHz (a real clock, a simulated arm) goes from goal to goal for a minute. In blocks of half a
second the live view is told of every step, or of none; each phase of a move has as many blocks of either.
Timed is what a loop of one's own does between measurement and torque: `CompositeController.step`, and
`LiveView.show`. Somebody watches all the time: a process that takes the stream as a browser does, or
Chromium, which draws it without a graphics card and so takes a core for itself. Each is measured with the
loop as any process, and with the real-time priority that `eladapt.hardware.run_loop(priority=)` gives it.

Run it on a quiet computer: the machine's own disturbance is in both columns, and in their ratio.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import multiprocessing
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from table import write

import eladapt as ea
from eladapt.hardware.timing import undisturbed

DT = 1e-3
BLOCK, MOVE = 500, 2000  # steps
PRIORITY = 50  # of 1 to 99
ALLOWED = 1.10


class Steps(NamedTuple):
    """Times of all steps [s], by whether the live view was told of them."""

    off: np.ndarray
    on: np.ndarray
    frames: float  # sent in a second, while the view was told
    late: float  # the share of steps that, with the simulation of the arm, took more than a step


def take_stream(url: str) -> None:
    """What a browser's connection does, without the drawing."""
    from tornado.websocket import websocket_connect

    async def follow() -> None:
        stream = await websocket_connect(url.replace("http", "ws") + "stream")
        while await stream.read_message() is not None:
            pass

    asyncio.run(follow())


def draw_it(url: str) -> None:
    """Chromium with the page open."""
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--disable-quic", "--disable-background-networking", "--use-angle=swiftshader",
             "--disable-component-update", "--enable-unsafe-swiftshader"]  # fmt: skip
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
        opened.new_page(viewport={"width": 800, "height": 600}).goto(url)
        while True:
            time.sleep(1)


@contextlib.contextmanager
def watching(watch: Any, url: str) -> Iterator[None]:
    """Somebody who looks, in a process of their own."""
    watcher = multiprocessing.get_context("spawn").Process(target=watch, args=(url,), daemon=True)
    watcher.start()
    time.sleep(10)  # until it looks
    try:
        yield
    finally:
        watcher.terminate()
        watcher.join()


def loop(live: ea.LiveView, seconds: float) -> Steps:
    """The loop; the first move is not counted."""
    robot = live.robot
    controller = ea.CompositeController.for_robot(robot, DT)
    goals = [robot.configuration(x) for x in (robot.target, robot.home)]
    plant = ea.PinocchioPlant(robot, goals[1])
    measurement = plant.reset()
    state = controller.init(measurement)
    times: dict[bool, list[float]] = {False: [], True: []}
    late, told_for, steps, sent = 0, 0.0, round(seconds / DT), live.sent
    due = time.perf_counter()
    for k in range(steps):
        goal = goals[k // MOVE % 2]
        told = (k // BLOCK + k // MOVE // 2) % 2 == 1  # a pair of moves swaps who has which phase
        began = time.perf_counter()
        state, tau = controller.step(state, measurement, goal, DT)
        if told:
            live.show(measurement.t, measurement.q, goal)
        ended = time.perf_counter()
        if k >= MOVE:
            times[told].append(ended - began)
        measurement = plant.step(tau, DT)
        due += DT
        left = due - time.perf_counter()
        if left > 0:
            time.sleep(left)
        else:
            due = time.perf_counter()
            late += k >= MOVE
        told_for += told * (time.perf_counter() - began)
    frames = (live.sent - sent) / told_for
    return Steps(np.array(times[False]), np.array(times[True]), frames, late / (steps - MOVE))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=66.0, help="of each loop (default: 66)")
    parser.add_argument("--no-chromium", action="store_true", help="leave out the browser")
    options = parser.parse_args()
    watchers = {"the stream is taken": take_stream}
    if not options.no_chromium:
        watchers["Chromium draws it, no graphics card"] = draw_it
    rows = []
    for (name, watch), priority in itertools.product(watchers.items(), (None, PRIORITY)):
        with (
            ea.view(ea.Robot.load("panda"), live=True) as live,
            watching(watch, live.url),
            undisturbed(priority),
        ):
            steps = loop(live, options.seconds)
        row = [name, priority or "none"]
        for percent in (50, 99):
            off, on = (1e3 * np.percentile(times, percent) for times in (steps.off, steps.on))
            row += [f"{off:.3f}", f"{on:.3f}", f"{on / off:.3f}{'' if on / off <= ALLOWED else ' **no**'}"]
        rows.append([*row, f"{steps.frames:.0f}", f"{steps.late:.2%}"])
    head = [
        "who looks", "real-time priority", "median off [ms]", "on", "ratio", "99 % off [ms]", "on", "ratio",
        "frames/s sent", "steps late",
    ]  # fmt: skip
    notes = (
        "The Panda's controller at 1 kHz, `CompositeController.step` with `LiveView.show` (on) and without "
        f"(off), in alternating blocks of one loop. A ratio above {ALLOWED:.2f} is marked **no**. Steps "
        "late: longer than 1 ms together with the simulation of the arm, on and off alike. The priority is "
        "that of `run_loop(priority=)`."
    )
    write("live_view", "Step times with the live view on", head, rows, notes)


if __name__ == "__main__":
    main()
