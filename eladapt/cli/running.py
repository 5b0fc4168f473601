"""``eladapt run`` and ``eladapt report``: a simulated move, and the page that keeps it."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.cli.checking import find
from eladapt.cli.saying import Outcome, say, say_table, warn
from eladapt.control.composite import CompositeController
from eladapt.control.reports import carried, friction
from eladapt.errors import (
    ArgumentError,
    EladaptError,
    RunInterrupted,
    SimulationError,
    require_number,
    require_vector,
)
from eladapt.files import file_name
from eladapt.motion.motions import move
from eladapt.motion.shaped import Shaped
from eladapt.records.record import LAST, Record
from eladapt.records.recorder import LONGEST
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within, unholdable
from eladapt.safety.gated import GatedController
from eladapt.simulation.disturbances import Noise, Payload
from eladapt.simulation.plants import PinocchioPlant
from eladapt.simulation.run import simulate
from eladapt.theory.certificates import certify

INTERRUPTED = 130  # the exit code of a run that Ctrl-C ended
SHORTEST, REST = 4.0, 1.5  # [s] of a run whose duration is not given: at least, and after the planned move
FAULTY = 3  # the exit code of a run that the torque gate ended
NEAR = 0.5  # [rad] from home, where a robot has no goal of its own


def run(options: argparse.Namespace) -> Outcome:
    """Simulate, write record, plot and report, and print how it went."""
    if options.quiet and (options.live or options.view):
        raise ArgumentError("--live, --view: expected without --quiet and --json, which hide their address")
    robot = find(options)
    goal = _posture(robot, "--goal", options.goal, _own_goal(robot))
    start = _posture(robot, "--start", options.start, robot.home)
    dt = require_number("--dt", options.dt, 0)
    if not options.jump:
        require_holdable(robot, goal, "--goal")
    planned = move(robot, start, goal).duration if not options.jump else SHORTEST
    duration = max(SHORTEST, planned + REST) if options.duration is None else options.duration
    duration = require_number("--duration", duration, 0, LONGEST)
    if duration < dt:
        raise ArgumentError(f"--duration: expected at least a step of {dt:g} s, got {duration:g} s")
    plant = _plant(robot, start, options)
    _say_too_heavy(robot, plant.payload, goal)
    controller = CompositeController.for_robot(robot, dt)
    stepped = controller if options.jump else Shaped(GatedController.for_robot(controller, dt))
    title = robot.name + (f", {options.payload:g} kg" if options.payload is not None else "")

    options.out.mkdir(parents=True, exist_ok=True)  # what cannot be written is said before the run
    failure = None
    with contextlib.ExitStack() as open_views:
        live: Any = None
        if options.live:
            from eladapt.viewing.viewer import view

            live = open_views.enter_context(
                view(robot, live=True, load=lambda state: carried(controller, _inner(state)))
            )
        try:
            record = simulate(
                stepped,
                plant,
                goal,
                duration,
                dt,
                theta0=options.theta0,
                title=title,
                observer=live,
                progress=not options.quiet,
            )
        except SimulationError as reason:
            failure, record = reason, reason.record
        except RunInterrupted as reason:
            return _interrupted(reason.record, options.out)
    record = dataclasses.replace(record, final_state=_inner(record.final_state))
    if failure is None and not options.no_certificates:
        record = _certified(record, controller, dt)
    written = _write(record, options.out)
    if failure is not None:
        raise EladaptError(f"{failure}; what happened until then is in {written['record']}") from failure
    found = _say(record, controller)
    say(f"wrote {', '.join(map(str, written.values()))}")
    if options.view:
        from eladapt.viewing.viewer import view

        view(record).wait()
    return Outcome({**found, "written": written}, FAULTY if record.faults else 0)


def _interrupted(record: Record, folder: Path) -> Outcome:
    """Keeps the record alone: who pressed Ctrl-C does not want to wait for a report."""
    path = record.save(f"{_stem(record, folder)}.npz")
    warn(
        f"interrupted at {record.t[-1]:.3g} s; what happened until then is in {path} (eladapt report {path})"
    )
    return Outcome({"written": {"record": path}}, INTERRUPTED)


def report(options: argparse.Namespace) -> Outcome:
    """Write the page. Raises RecordError for a file that is no record."""
    from eladapt.display.report import report as write

    records = [Record.load(path, options.package_dir) for path in options.records]
    out = options.out or options.records[0].with_suffix(".html")
    if out.exists() and out.is_dir():
        raise ArgumentError(f"--out: expected the name of a page, got the folder {out}")
    page = write(records, out, labels=options.label, animation=not options.no_animation)
    say(f"wrote {page}")
    return Outcome({"written": {"report": page}})


def _plant(robot: Robot, start: np.ndarray, options: argparse.Namespace) -> Any:
    load = _load(options)
    spread = require_number("--noise", options.noise, 0, closed=True)
    if options.seed < 0:
        raise ArgumentError(f"--seed: expected 0 or more, got {options.seed}")
    given: dict[str, Any] = {"payload": load, "noise": Noise(spread, spread), "seed": options.seed}
    if options.plant == "mujoco":
        from eladapt.simulation.mujoco_plant import MujocoPlant

        return MujocoPlant(robot, start, **given)
    return PinocchioPlant(robot, start, **given)


def _load(options: argparse.Namespace) -> Payload | None:
    if options.payload is None:
        if options.attach is not None:
            raise ArgumentError("--attach: expected with --payload, which says how heavy the load is")
        return None
    mass = require_number("--payload", options.payload, 0)
    attach = 0.0 if options.attach is None else require_number("--attach", options.attach, 0, closed=True)
    return Payload(mass, attach=attach)


def _say_too_heavy(robot: Robot, load: Payload | None, goal: np.ndarray) -> None:
    """A load that the motors cannot hold at the goal may be what one wants to see; but not unawares."""
    if load is None:
        return
    if said := unholdable(dataclasses.replace(robot, model=load.loaded(robot)), goal):
        warn(f"--payload: {load.mass:g} kg are too heavy for this arm at its goal: {said}")


def _posture(robot: Robot, name: str, given: list[list[float]] | None, otherwise: np.ndarray) -> np.ndarray:
    """The configuration for joint coordinates within the limits."""
    x = otherwise if given is None else np.array([number for part in given for number in part])
    if len(x) != robot.nv:
        raise ArgumentError(
            f"{name}: expected {robot.nv} numbers, for {', '.join(robot.joint_names)}; got {len(x)}"
        )
    x = require_vector(name, x, robot.nv)
    q = robot.configuration(x)
    if given is not None:
        require_within(robot, q, name)
    return q


def _own_goal(robot: Robot) -> np.ndarray:
    if np.any(robot.target != robot.home):
        return robot.target
    away = np.where(robot.home + NEAR <= robot.upper, NEAR, -NEAR)
    return np.clip(robot.home + away, robot.lower, robot.upper)


def _inner(state: Any) -> Any:
    """The controller's own state, of whatever stands around it."""
    while hasattr(state, "inner"):
        state = state.inner
    return state


def _certified(record: Record, controller: CompositeController, dt: float) -> Record:
    from eladapt.display.tables import plain_certificate

    kept = {**record.configuration, "certificates": [plain_certificate(certify(controller, dt=dt))]}
    return dataclasses.replace(record, configuration=kept)


def _stem(record: Record, folder: Path) -> Path:
    """Where the files of a record go, without what their names end in."""
    return folder / file_name(record.robot_source.get("load") or record.robot_source["name"], "robot")


def _write(record: Record, folder: Path) -> dict[str, Path]:
    """Record and plot, and the report where Bokeh is installed, by what they are."""
    from eladapt.display.plots import plot

    stem = _stem(record, folder)
    written = {"record": record.save(f"{stem}.npz"), "plot": Path(f"{stem}.png")}
    plot(record, written["plot"])
    try:
        from eladapt.display.report import report as write
    except EladaptError as reason:
        warn(reason)
    else:
        written["report"] = write(record, f"{stem}.html")
    return written


def _say(record: Record, controller: CompositeController) -> dict[str, Any]:
    """How the run went, in words; returned for --json."""
    m = record.metrics()
    found: dict[str, Any] = {"robot": record.title, "metrics": m}
    if m.arrived:
        say(f"every joint below 1e-3 rad after {m.settling_time:.2f} s")
        say(f"steady error {m.steady_error:.1e} rad, torque ripple at rest {m.chatter:.1e} N m")
    else:
        say(f"not settled below 1e-3 rad after {record.t[-1]:g} s, errors of up to {m.steady_error:.1e} rad "
            f"in the last {min(LAST, record.t[-1]):.3g} s")  # fmt: skip
    for said in m.warnings:
        warn(said)
    for certificate in record.configuration.get("certificates", ()):
        failed = sum(not row["holds"] for row in certificate["rows"])
        said = f"{failed} do not hold; the report says what that means" if failed else "all hold"
        say(f"conditions of the proofs: {len(certificate['rows'])}, {said}")
        found["certificate"] = certificate
    say(f"largest speed: {m.speed_said}")
    say(f"joint range: {m.range_said}")
    say(f"fault: {m.faults_said}")
    if record.carried is not None:
        load = carried(controller, record.final_state)
        said = f"{load.mass:.4g} kg" if np.isfinite(load.mass) else "not known, this motion does not tell it"
        say(f"load, as estimated: {said}")
        found["load"] = load
    if controller.regressors.n_friction:
        found["friction"] = friction(controller, record.final_state)
        say_table(found["friction"])
    return found
