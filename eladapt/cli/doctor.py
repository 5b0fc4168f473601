"""``eladapt doctor``: whether this computer has what eladapt needs, line by line."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import os
import platform
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eladapt.cli.saying import Outcome, say
from eladapt.errors import EladaptError, installing

NEEDED = (
    "numpy",
    "scipy",
    "pin",
    "example-robot-data",
    "numba",
    "ruckig",
    "matplotlib",
    "meshcat",
    "tornado",
    "defusedxml",
    "tqdm",
)
WANTED = {
    "mujoco": "mujoco",
    "bokeh": "report",
    "clarabel": "identify",
    "pin-pink": "motion",
}  # package: eladapt's extra
WARM = 20  # steps that load or compile what they need
STEPS, RATE = 400, 1e-3  # of the Panda's loop, and the step it has to keep [s]


class Finding(NamedTuple):
    """``ok``, ``note`` (works, but) or ``FAIL``, and what it is about."""

    grade: str
    text: str


def doctor(_options: argparse.Namespace) -> Outcome:
    """Print the findings; 1 if something that is needed is missing."""
    findings = []
    for part in (_python, _packages, _pinocchio, _robots, _loopback, _speed, _realtime):
        for finding in _safely(part):
            say(f"{finding.grade:4}  {finding.text}", flush=True)
            findings.append(finding)
    return Outcome(findings, 1 if any(finding.grade == "FAIL" for finding in findings) else 0)


def _safely(part: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """A check that itself fails is a finding, not the end."""
    try:
        yield from part()
    except (EladaptError, ImportError, OSError, AttributeError) as reason:
        yield Finding("FAIL", f"{part.__name__.strip('_')}: {' '.join(str(reason).split())}")


def _python() -> Iterator[Finding]:
    version = platform.python_version()
    yield Finding(
        "ok" if sys.version_info >= (3, 11) else "FAIL", f"Python {version} on {platform.platform()}"
    )


def _packages() -> Iterator[Finding]:
    for name in NEEDED:
        version = _version(name)
        yield (
            Finding("ok", f"{name} {version}") if version else Finding("FAIL", f"{name}: pip install {name}")
        )
    for name, extra in WANTED.items():
        version = _version(name)
        missing = f"{name} is not installed: {installing(extra)}"
        yield Finding("ok", f"{name} {version}") if version else Finding("note", missing)


def _pinocchio() -> Iterator[Finding]:
    module = importlib.import_module("pinocchio")
    if not hasattr(module, "computeJointTorqueRegressor"):
        yield Finding(
            "FAIL", f"the module pinocchio at {module.__file__} is another project's: pip uninstall pinocchio"
        )
        return
    imported, installed = str(module.__version__), _version("pin") or ""
    text = f"pinocchio {imported} from {os.path.dirname(str(module.__file__))}"
    other = f"{text}, but pin {installed} is installed: PYTHONPATH (as of ROS) hides it"
    yield Finding("ok", text) if installed.startswith(imported) else Finding("FAIL", other)


def _robots() -> Iterator[Finding]:
    from eladapt.robot import library
    from eladapt.robot.model import Robot

    for name in library.robots():
        Robot.load(name)
    yield Finding(
        "ok", f"{len(library.robots())} robots of the library are read: {', '.join(library.robots())}"
    )


def _loopback() -> Iterator[Finding]:
    with contextlib.closing(socket.socket()) as opened:
        opened.bind(("127.0.0.1", 0))
    yield Finding("ok", "a page can be served on the loopback interface")


def _speed() -> Iterator[Finding]:
    middle, late = _step_times()
    text = f"a step of the Panda's controller takes {middle:.2f} ms, 99 % at most {late:.2f} ms"
    fast = late < 1e3 * RATE
    yield Finding("ok" if fast else "note", text + (": 1 kHz" if fast else ": too slow for 1 kHz"))
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        yield Finding("note", "the matrices are small: OPENBLAS_NUM_THREADS=1 is faster, and steadier")


def _realtime() -> Iterator[Finding]:
    """What `run_loop` can ask this system for, so that nothing comes between a measurement and its torque."""
    if not hasattr(os, "sched_setaffinity"):
        yield Finding("note", "this system has no real-time scheduling for priority= and cpus= of run_loop")
        return
    cpus = sorted(os.sched_getaffinity(0))
    apart = _read("/sys/devices/system/cpu/isolated")
    if apart:
        yield Finding("ok", f"processors {apart} are kept free: run_loop(..., cpus=) of these")
    elif len(cpus) > 1:
        last = cpus[-1]
        text = f"no processor is kept free (isolcpus={last} would): run_loop(..., cpus=[{last}]) keeps to one"
        yield Finding("note", text)
    else:
        yield Finding("note", "one processor for all: a loop waits for whatever else runs")
    import resource

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    most = 99 if os.geteuid() == 0 or limit == resource.RLIM_INFINITY else min(limit, 99)
    if most:
        yield Finding("ok", f"run_loop(..., priority=) takes 1 to {most}")
    else:
        text = "run_loop(..., priority=) is refused: add '@realtime - rtprio 80' to /etc/security/limits.conf"
        yield Finding("note", text)
    if _read("/sys/kernel/realtime") != "1":
        yield Finding("note", "the kernel is not a real-time one (PREEMPT_RT): some ticks will be late")


def _read(path: str) -> str:
    """What a file of the system says, "" where there is none."""
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def _step_times() -> tuple[float, float]:
    """[ms] the median step and its 99th percentile, in closed loop."""
    from eladapt.control.composite import CompositeController
    from eladapt.robot.model import Robot
    from eladapt.simulation.plants import PinocchioPlant

    robot = Robot.load("panda")
    controller = CompositeController.for_robot(robot)
    plant = PinocchioPlant(robot, robot.configuration(robot.home))
    goal, measurement = robot.configuration(robot.target), plant.reset()
    state, times = controller.init(measurement), []
    for _ in range(STEPS):
        began = time.perf_counter()
        state, tau = controller.step(state, measurement, goal, RATE)
        times.append(time.perf_counter() - began)
        measurement = plant.step(tau, RATE)
    middle, late = 1e3 * np.percentile(times[WARM:], [50, 99])
    return float(middle), float(late)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
