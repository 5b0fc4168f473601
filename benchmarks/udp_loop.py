"""The loop at 1 kHz against a robot in another process: overruns, jitter, latency, and where the arm ends up.

MuJoCo simulates the arm in real time behind UDP on loopback. The set-point changes between the target of the
library and home every ten seconds. Nothing else should run on the machine.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
from multiprocessing.connection import Connection

import numpy as np
from table import markdown, write

import eladapt as ea
from eladapt.hardware.timing import EDGES, Timing
from eladapt.hardware.udp import Served, serve

DT, LEG = 1e-3, 10.0  # [s]


def arm(name: str, pipe: Connection, priority: int | None) -> None:
    robot = ea.Robot.load(name)
    plant = ea.MujocoPlant(robot, robot.configuration(robot.home))
    pipe.send(serve(plant, DT, ready=pipe.send, priority=priority))


def run(name: str, duration: float, priority: int | None) -> tuple[ea.LoopResult, Served]:
    robot = ea.Robot.load(name)
    inner = ea.CompositeController.for_robot(robot, DT, delay=2 * DT)
    controller = ea.GatedController.for_robot(inner, DT)
    places = robot.configuration(robot.target), robot.configuration(robot.home)
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=arm, args=(name, there, priority))
    process.start()
    there.close()
    interface = ea.UdpRobot(robot, here.recv(), dt=DT)
    result = ea.run_loop(
        controller, interface, lambda t: places[int(t / LEG) % 2], duration, DT, priority=priority
    )
    served = here.recv()
    process.join()
    return result, served


def leg_errors(record: ea.Record) -> np.ndarray:
    """[rad] the largest error in the last second of every leg."""
    t, error = record.t, np.abs(record.error).max(axis=1)
    ends = np.flatnonzero(np.any(np.diff(record.goal, axis=0) != 0, axis=1)).tolist()
    if not ends or t[-1] - t[ends[-1]] > 0.5 * LEG:  # else the last leg has only begun
        ends.append(len(t) - 1)
    return np.array([error[(t > t[end] - 1) & (np.arange(len(t)) <= end)].max() for end in ends])


def histogram(timings: dict[str, Timing]) -> str:
    """Shares of the ticks, as a table."""
    ends = [0, *EDGES, np.inf]
    bars = [f"{low:g} to {high:g}" for low, high in itertools.pairwise(ends)]
    columns = [
        [f"{count / timing.ticks:.2%}" for count in counts]
        for timing in timings.values()
        for counts in (timing.late_counts, timing.work_counts)
    ]
    head = ["[us]", *(f"{name}: {what}" for name in timings for what in ("late", "state to command"))]
    return markdown(head, list(zip(bars, *columns, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["two_link", "panda"])
    parser.add_argument("--duration", type=float, default=60.0, help="[s] of each (default: 60)")
    parser.add_argument("--priority", type=int, help="real-time priority of both processes, 1 to 99")
    parser.add_argument("--dry", action="store_true", help="print, but leave the table of results as it is")
    options = parser.parse_args()
    rows: list[list[object]] = []
    timings: dict[str, Timing] = {}
    for name in options.robots:
        result, served = run(name, options.duration, options.priority)
        timing = timings[name] = result.timing
        print(f"{name}: {timing}; {served}; {result.ended}, fault: {result.fault}", flush=True)
        work, late = (", ".join(f"{1e6 * x:.0f}" for x in times) for times in (timing.work, timing.late))
        rows.append(
            [
                name, timing.ticks, f"{timing.overruns} ({timing.overrun_share:.2%})", timing.missed, work,
                late, served.without, f"{leg_errors(result.record).max():.1e}", result.fault or "none",
            ]
        )  # fmt: skip
    if options.dry:
        return
    head = [
        "robot", "ticks", "overruns", "ticks missed", "measurement to command [us]", "late by [us]",
        "periods without a torque", "largest error at rest [rad]", "fault",
    ]  # fmt: skip
    priority = "no" if options.priority is None else f"{options.priority} as"
    notes = (
        f"{options.duration:g} s at {1 / DT:g} Hz, the controller, told of 2 ms of delay, behind its gate, "
        f"{priority} real-time priority. Times: 50 %, 99 %, 99.9 %, largest. An overrun is a tick whose "
        "command was not out when the next one was due (asked: under 1 %). Error at rest: in the last second "
        f"of each leg of {LEG:g} s (asked: 2e-3 rad). Periods without a torque: by the robot, which then "
        "holds the one before.\n\n## Jitter and latency\n\n"
        f"{histogram(timings)}\nShares of all ticks. Late: from when a tick was due until its state was "
        "there. State to command: from there until the torque was out."
    )
    write("udp_loop", "1 kHz over UDP against a robot in another process", head, rows, notes)


if __name__ == "__main__":
    main()
