"""What a run is made of: a controller, a plant, a goal. The only protocols of these names.

A controller also says what a record keeps of it. One of a user's own need not: it may lack all four members
of `Recorded`, or inherit them from `Unrecorded`, and then a record keeps the motion alone. `recorded_by` is
the one place where that is decided.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot
from eladapt.signals import Measurement, Reference

Goal = np.ndarray | Reference  # q_d (nq,), at rest, or where to be and how to move there
GoalCourse = Goal | Callable[[float], Goal]  # one goal, or a goal for each time t [s]


class BareController(Protocol):
    """The least that can be simulated, gated or run on a robot."""

    @property
    def robot(self) -> Robot: ...
    def init(self, measurement: Measurement, theta0: Any = None) -> Any:
        """The state at the first measurement. theta0: where the parameters start, see the controller."""

    def step(self, state: Any, measurement: Measurement, goal: Any, dt: float) -> tuple[Any, np.ndarray]:
        """The state at ``measurement``, and the torque (nv,) to hold for dt [s]; goal: a `Goal`."""


@runtime_checkable
class Recorded(Protocol):
    """What a record keeps of a controller beside the motion; see `eladapt.records.recorder` for the names."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the parameters that it learns, in their order; () if it learns none."""

    def recorded(self, state: Any) -> Mapping[str, Any]:
        """What is kept of every sample: arrays that exist already, of the same shapes every time; of a gate
        also its fault."""

    def reviewed(self, state: Any, frame: str | None) -> Mapping[str, np.ndarray]:
        """What is kept 30 times a second, and computed when the record is made.

        frame: of the load that the plant carries, None where it carries none that is known.
        """

    def true_parameters(self, model: pin.Model) -> np.ndarray | None:
        """What the parameters should become on an arm with this model, load included; None if not known."""


class Controller(BareController, Recorded, Protocol):
    """What every controller of the library is."""


def require_controller(controller: Any, needed: Sequence[str] = ("robot", "init", "step")) -> None:
    """Raises ArgumentError for what is no controller, a robot above all, or lacks what is needed of one."""
    if isinstance(controller, Robot):
        raise ArgumentError(
            f"controller: expected a controller, got {controller!r}; make one of it, as with "
            "CompositeController.for_robot(robot)"
        )
    if missing := [name for name in needed if not hasattr(controller, name)]:
        raise ArgumentError(
            f"controller: expected one with {', '.join(needed)}, see BareController; "
            f"{type(controller).__name__} lacks {', '.join(missing)}"
        )


class Unrecorded:
    """The members of `Recorded` for a controller that learns nothing, or that keeps it to itself."""

    @property
    def labels(self) -> tuple[str, ...]:
        """No parameters."""
        return ()

    def recorded(self, state: Any) -> Mapping[str, Any]:
        """Nothing."""
        return {}

    def reviewed(self, state: Any, frame: str | None) -> Mapping[str, np.ndarray]:
        """Nothing."""
        return {}

    def true_parameters(self, model: pin.Model) -> np.ndarray | None:
        """Not known."""
        return None


class Around:
    """What a controller around another one hands through; its states have the other's as ``inner``.

    Abstract: ``controller`` is the one inside.
    """

    controller: BareController

    @property
    def robot(self) -> Robot:
        return self.controller.robot

    @property
    def regressors(self) -> Any:
        """The controller's, None if it has none."""
        return getattr(self.controller, "regressors", None)

    @property
    def labels(self) -> tuple[str, ...]:
        """The controller's."""
        return self._recorded.labels

    def recorded(self, state: Any) -> Mapping[str, Any]:
        """What the controller has recorded."""
        return self._recorded.recorded(state.inner)

    def reviewed(self, state: Any, frame: str | None) -> Mapping[str, np.ndarray]:
        """What the controller has reviewed."""
        return self._recorded.reviewed(state.inner, frame)

    def true_parameters(self, model: pin.Model) -> np.ndarray | None:
        """The controller's."""
        return self._recorded.true_parameters(model)

    @functools.cached_property
    def _recorded(self) -> Recorded:
        return recorded_by(self.controller)


def of_the_inner(state: Any, name: str) -> Any:
    """What a state around another one has not itself, ``state.inner`` has."""
    if name.startswith("_"):
        raise AttributeError(name)
    return getattr(state.inner, name)


def recorded_by(controller: BareController) -> Recorded:
    """Who says what is kept of a controller: itself if it has all of `Recorded`, else nothing is kept."""
    return controller if isinstance(controller, Recorded) else Unrecorded()


def gate_of(state: Any) -> Any:
    """The state of the torque gate in a controller's state; None where there is none."""
    while not hasattr(state, "gate") and hasattr(state, "inner"):
        state = state.inner
    return getattr(state, "gate", None)


class Plant(Protocol):
    """A robot that is simulated: the same face for every simulator. q, v: the true state."""

    @property
    def robot(self) -> Robot: ...
    @property
    def q(self) -> np.ndarray: ...
    @property
    def v(self) -> np.ndarray: ...
    def reset(self) -> Measurement: ...
    def step(self, tau: np.ndarray, dt: float) -> Measurement: ...
    def brake(self) -> None:
        """Tell the brakes to close."""

    def release(self) -> None:
        """Open the brakes."""


class Load(Protocol):
    """Something that an arm carries for a while."""

    @property
    def frame(self) -> str | None: ...
    def held(self, t: float) -> bool: ...
    def loaded(self, robot: Robot) -> pin.Model: ...


class Rubbing(Protocol):
    """Friction of joints; scalars or (nv,)."""

    @property
    def viscous(self) -> Any: ...
    @property
    def coulomb(self) -> Any: ...


class Truth(NamedTuple):
    """What a plant tells of itself to whoever compares estimates with it."""

    known: bool  # whether it is the robot's own model, and the load
    load: Load | None
    rubbing: Rubbing | None  # friction that acts, None: that of the robot's own model


def truth_of(plant: Any) -> Truth:
    """The truth about a plant, or about the one inside what stands around it (``plant.plant``).

    A plant need not say anything: one without ``payload`` carries none, and one without ``knows_parameters``
    or ``rubbing`` has the robot's own model, or its friction. Of no plant at all, as of a real robot, nothing
    is known.
    """
    while (inner := getattr(plant, "plant", None)) is not None:
        plant = inner
    known = plant is not None and bool(getattr(plant, "knows_parameters", True))
    return Truth(known, getattr(plant, "payload", None), getattr(plant, "rubbing", None))


def handed_on(goal: Reference) -> Goal:
    """What a controller is given, in arrays of its own: a goal at rest as q_d alone, so that one without
    references takes it."""
    moves = np.count_nonzero(goal.v) or np.count_nonzero(goal.a)  # a fifth of any's time
    return goal.copy() if moves else goal.q.copy()
