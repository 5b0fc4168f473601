"""Closed-loop runs: a controller, a plant and a goal make a record."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from tqdm import tqdm

from eladapt.compiling import prepare
from eladapt.errors import (
    BrakesWarning,
    EladaptError,
    RunInterrupted,
    SimulationError,
    printable,
    require_number,
)
from eladapt.records.record import Record
from eladapt.records.recorder import LONGEST, Recorder
from eladapt.robot.protocols import (
    BareController,
    GoalCourse,
    Plant,
    gate_of,
    handed_on,
    require_controller,
)

Observer = Callable[[float, np.ndarray, np.ndarray, Any], object]  # t [s], q, q_d, the controller's state


def simulate(
    controller: BareController,
    plant: Plant,
    goal: GoalCourse,
    duration: float = 5.0,
    dt: float = 1e-3,
    *,
    theta0: Any = None,
    progress: bool = True,
    title: str = "",
    observer: Observer | None = None,
) -> Record:
    """Run the loop for ``duration`` [s] at steps of ``dt`` [s], from the plant's initial state.

    goal: q_d (nq,), a `Reference`, or a callable of t [s] that returns either, as a motion is. theta0: where
    the parameters start, as the controller's ``init`` takes it ("urdf", "zero" or numbers); None leaves the
    choice to the controller. progress: a bar on stderr, where that is a terminal. The record has
    round(duration / dt) + 1 samples, the first at t = 0; its tau is what the controller commanded at that
    sample. observer: called with (t, q, q_d, state) after each step of
    the controller, as a live view is. Where the controller may ask for brakes and the plant has none, a
    BrakesWarning says so at the start. Raises SimulationError, with the record so far, when controller, plant
    or goal fail on the way, and RunInterrupted, a KeyboardInterrupt with it, at Ctrl-C.
    """
    dt = require_number("dt", dt, 0)
    steps = round(require_number("duration", duration, 0, LONGEST) / dt)
    require_controller(controller, ("init", "step"))  # the robot is the plant's
    robot = plant.robot
    prepare()
    goal_at = goal if callable(goal) else (lambda _t: goal)
    given = () if theta0 is None else (theta0,)
    recorder = Recorder(robot, controller, dt, steps + 1, title, plant)
    measurement = plant.reset()
    state = controller.init(measurement, *given)
    unbraked = _without_brakes(plant)
    if unbraked is not None and _may_brake(state):
        said = (
            f"{type(unbraked).__name__} of {robot.name!r} has no brakes: expected a method brake() that "
            "closes them, as PinocchioPlant has; without it the arm moves on when the gate asks for them"
        )
        warnings.warn(said, BrakesWarning, stacklevel=2)
    quiet = None if progress else True  # None: where there is no terminal
    bar = tqdm(range(steps + 1), desc=printable(title or robot.name), unit="step", disable=quiet, leave=False)
    try:
        for k in bar:
            reference = robot.check_goal(goal_at(measurement.t))
            state, tau = controller.step(state, measurement, handed_on(reference), dt)
            recorder.add(measurement.t, plant.q, plant.v, tau, reference, state)
            if observer is not None:
                observer(measurement.t, np.array(plant.q), reference.q, state)
            if unbraked is None and getattr(state, "brake", False):
                plant.brake()
            if k < steps:
                measurement = plant.step(tau, dt)
    except EladaptError as reason:
        if recorder.count == 0:
            raise
        message = f"the run ended after {recorder.count} of {steps + 1} samples: {reason}"
        raise SimulationError(message, recorder.record()) from reason
    except KeyboardInterrupt as stopped:
        if recorder.count == 0:
            raise
        raise RunInterrupted(recorder.record()) from stopped
    return recorder.record()


def _may_brake(state: Any) -> bool:
    """Whether a controller with such a state may ask for brakes; `ShapedState` only hands on who does."""
    return gate_of(state) is not None or (hasattr(state, "brake") and not hasattr(state, "inner"))


def _without_brakes(plant: Any) -> Any:
    """The plant, or the one that it stands around, that has no brakes; None if all have."""
    while callable(getattr(plant, "brake", None)):
        plant = getattr(plant, "plant", None)
        if plant is None:
            return None
    return plant
