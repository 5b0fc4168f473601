"""One trial: a world, a controller for it, and a row of numbers that says how it went."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from eladapt.control.composite import CompositeController
from eladapt.control.reports import payload
from eladapt.errors import ArgumentError, SimulationError, require_number
from eladapt.gains.sensing import Hardware
from eladapt.motion.shaped import Shaped
from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Around, BareController
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION
from eladapt.safety.gated import GatedController
from eladapt.simulation.run import simulate
from eladapt.worlds.criteria import Criteria
from eladapt.worlds.distributions import Distributions, facts
from eladapt.worlds.rows import row_of
from eladapt.worlds.world import World

ControllerFor = Callable[[Robot, Hardware, float], BareController]
STEADY = 0.5  # [s] at the end
OVERSHOOT_EVERY = 5  # samples
FULL = 0.99  # of the effort limit


def careful(robot: Robot, told: Hardware, dt: float) -> Shaped:
    """What a careful user runs: told what commissioning measured, behind a gate, asked for shaped motions."""
    controller = CompositeController.for_robot(robot, dt, **vars(told))
    return Shaped(GatedController.for_robot(controller, dt))


@dataclass(frozen=True, eq=False)
class Trials:
    """What all trials of a test have in common.

    controller: one for all worlds, or a function of robot, what is told of the world's hardware, and dt [s]
    that makes one for each. theta0: where its parameters start, as `simulate` takes it. Raises ArgumentError
    for what is no controller, no robot or no time.
    """

    robot: Robot
    controller: BareController | ControllerFor = careful
    distributions: Distributions = field(default_factory=Distributions)
    criteria: Criteria = field(default_factory=Criteria)
    dt: float = 1e-3
    theta0: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.robot, Robot):
            raise ArgumentError(f"robot: expected a Robot, as Robot.load(name) is, got {self.robot!r}")
        for name, kind in (("distributions", Distributions), ("criteria", Criteria)):
            if not isinstance(getattr(self, name), kind):
                raise ArgumentError(f"{name}: expected {kind.__name__}, got {getattr(self, name)!r}")
        made: Any = self.controller
        if not hasattr(made, "step") and not (callable(made) and hasattr(made, "__qualname__")):
            raise ArgumentError(
                "controller: expected one with init and step, or a function of robot, told hardware and dt "
                f"that makes one, at the top of a module, got {made!r}"
            )
        object.__setattr__(self, "dt", require_number("dt", self.dt, 0))

    def world(self, seed: int) -> World:
        """The world of this seed."""
        return self.distributions.world(self.robot, seed)

    def record(self, seed: int) -> Record:
        """All that happens in it. Raises SimulationError, with the record so far, where it ends early."""
        return self._simulated(self.world(seed))[0]

    def row(self, seed: int) -> np.ndarray:
        """How it went, as a row of `ROW`: also where controller, plant or world raised."""
        found: dict[str, Any] = {"seed": seed}
        try:
            world = self.world(seed)
            found |= factors(self.robot, world)
            record, controller = self._simulated(world)
            measured, largest = self._measured(record, world, controller)
            found |= measured
        except Exception as reason:
            found |= {"cause": self._raised(reason), "said": f"{type(reason).__name__}: {reason}"}
            return row_of(found)
        return row_of(found | self.criteria.judged(found, largest, self.robot.joint_names))

    def _simulated(self, world: World) -> tuple[Record, BareController]:
        robot, dt = self.robot, self.dt
        made: Any = self.controller
        controller = made if hasattr(made, "step") else made(robot, world.told, dt)
        motion, title = world.motion(robot), f"{robot.name}, world {world.seed}"
        record = simulate(
            controller, world.plant(robot, dt), motion, motion.duration + world.rest, dt, theta0=self.theta0,
            progress=False, title=title,
        )  # fmt: skip
        return record, controller

    @staticmethod
    def _raised(reason: Exception) -> str:
        """The name of a failure that left no whole record."""
        if isinstance(reason, SimulationError) and "diverged" in str(reason):
            return "diverged"
        cause = reason.__cause__ if isinstance(reason, SimulationError) and reason.__cause__ else reason
        return f"raised {type(cause).__name__}"

    def _measured(
        self, record: Record, world: World, controller: BareController
    ) -> tuple[dict[str, Any], dict[str, int]]:
        """The criteria's columns, and by column the joint that has the most of it."""
        robot, motion = self.robot, world.motion(self.robot)
        error, moving = np.abs(record.error), record.t <= motion.duration
        last = record.t > record.t[-1] - STEADY
        metrics = record.metrics(self.criteria.settled)
        way = robot.difference(motion.q0, motion.end)
        past = np.array([robot.difference(motion.end, q) for q in record.q[::OVERSHOOT_EVERY]]) * np.sign(way)
        limited = np.isfinite(record.effort_limit)
        share = np.abs(record.tau[:, limited]) / record.effort_limit[limited]
        changes = [t for t in (world.attach, world.release) if world.load and np.isfinite(t)]
        fault = record.faults[0] if record.faults else None
        measured = {
            "settling": max(0.0, metrics.settling_time - max(motion.duration, *changes, 0.0)),
            "steady": error[last].max(),
            "tracking": error[moving].max(), "overshoot": max(0.0, past.max()),
            "speed": metrics.speed.value, "torque": share.max() if limited.any() else math.nan,
            "chatter": metrics.chatter,
            "saturated": self.dt * np.count_nonzero((share >= FULL).any(axis=1)),
            "beyond": metrics.beyond.value if metrics.beyond else math.nan,
            "gravity_error": self._gravity_error(record, world, controller),
            "weighed": weighed(controller, record.final_state),
            "fault": fault.name if fault else "", "fault_at": fault.t if fault else math.nan,
            "said": str(fault) if fault else "",
        }  # fmt: skip
        outside = np.flatnonzero((error > self.criteria.settled).any(axis=1))
        course = {"settling": error[outside[-1:]], "tracking": error[moving], "overshoot": past}
        largest = {name: int(np.argmax(of.max(axis=0, initial=0.0))) for name, of in course.items()}
        for name, extreme in (("speed", metrics.speed), ("beyond", metrics.beyond)):
            if extreme and extreme.joint:
                largest[name] = robot.joint_names.index(extreme.joint)
        return measured, largest

    def _gravity_error(self, record: Record, world: World, controller: BareController) -> float:
        """The largest error of the learned gravity torque where the arm ends, as a part of an effort."""
        regressors = getattr(controller, "regressors", None)
        if regressors is None or not record.n_potential:
            return math.nan
        q, arm, load = record.q[-1], world.arm(self.robot), world.payload
        model = load.loaded(arm) if load is not None and load.held(record.t[-1]) else arm.model
        true = pin.computeGeneralizedGravity(model, model.createData(), q)
        learned = regressors.gravity(q) @ record.theta[-1]
        return float(np.max(np.abs(learned - true) / facts(self.robot).effort))


def weighed(controller: Any, state: Any) -> float:
    """[kg] of the load that the controller noticed last, negative where one went; nan where it noticed
    none."""
    while isinstance(controller, Around):
        controller = controller.controller
    while hasattr(state, "inner"):
        state = state.inner
    change = getattr(state, "change", None)
    if change is None or not change.noticed or not isinstance(controller, CompositeController):
        return math.nan
    return float(payload(controller, state).mass)


def factors(robot: Robot, world: World) -> dict[str, float]:
    """The world in the numbers among which an explanation of failures is looked for, see `FACTORS`."""
    limit, top, _ = facts(robot)
    way = robot.difference(robot.configuration(world.start), robot.configuration(world.goal))
    told = world.told
    assumed = np.array(world.rotors) / limit * ASSUMED_ROTOR_ACCELERATION
    found = {
        "distance": np.abs(way).max(), "pace": world.pace, "load": world.load,
        "load_offset": np.linalg.norm(world.load_centre),
        "attach": world.attach if world.load else math.nan,
        "release": world.release if world.load and np.isfinite(world.release) else math.nan,
        "mass_error": np.mean(world.masses) - 1, "centre_error": np.linalg.norm(world.centres, axis=1).max(),
        "rotor": assumed.max(), "coulomb": (np.array(world.coulomb) / limit).max(),
        "viscous": (np.array(world.viscous) * top / limit).max(),
        "position_noise": world.position_noise, "velocity_noise": world.velocity_noise, "delay": world.delay,
        "velocity_lag": world.velocity_lag, "delay_told": float(told.delay) - world.delay,
        "lag_told": float(told.velocity_lag) - world.velocity_lag, "jitter": world.jitter,
        "tilt": math.hypot(*world.tilt),
    }  # fmt: skip
    return {name: float(value) for name, value in found.items()}
