"""Parameters that stay physical while a controller learns them."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from eladapt.control.composite import CompositeController, ControllerState
from eladapt.errors import ArgumentError, EladaptError, require_number
from eladapt.identification.learned import learned
from eladapt.identification.physical import PhysicalBodies
from eladapt.robot.protocols import Around, Goal, of_the_inner
from eladapt.signals import JointVector, Measurement


class PhysicalState(NamedTuple):
    """The controller's state, and the physical parameters that were found last."""

    inner: Any  # the controller's
    physical: np.ndarray  # (l,) theta of bodies that can be
    asked: float  # [s] when they were asked for last, by the robot's clock
    waiting: bool  # whether there is no answer yet
    question: np.ndarray  # (l,) theta that they were asked for
    answer: np.ndarray  # (l,) the nearest, nan where it is not known yet or there is none
    changes: int  # of the load, that had been noticed then
    number: int = 0  # of the question, where an executor has it

    @property
    def measurement(self) -> Measurement:
        """The controller's last one."""
        return self.inner.measurement

    def __getattr__(self, name: str) -> Any:
        """What the controller's state says beside: parameters, external and so on."""
        return of_the_inner(self, name)


@dataclass(frozen=True, eq=False)
class Physical(Around):
    """Around a `CompositeController`: every ``period`` [s] theta moves to the nearest physical parameters.

    What is well known stays as it is, what noise has made of the rest becomes what bodies can have, near the
    URDF's; see `PhysicalBodies`. ``state.physical`` is always physical: M(q) of it is positive definite at
    every q. The answer takes some 10 ms on a Panda and counts from the step ``lag`` [s] after the question
    on, when theta has moved on: it moves by as much as theta at the question did. A load that comes in
    between makes the answer void.

    executor: computes the answers beside the loop, as ``ProcessPoolExecutor(1)``; one that is late counts
    when it is there, and where the executor is shut down or its process died, the controller goes on alone.
    None computes them in the step that asks, for simulation and for slow loops.
    Inside a gate: ``GatedController(Physical(controller), ...)``. Raises ArgumentError for another
    controller.
    """

    controller: CompositeController
    period: float = 0.1
    lag: float = 0.05
    executor: Executor | None = None
    _bodies: PhysicalBodies = field(init=False, repr=False)
    _answers: dict[int, Future[Any]] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.controller, CompositeController):
            raise ArgumentError(
                f"controller: expected a CompositeController, got {type(self.controller).__name__}; a gate "
                "and Shaped go around Physical"
            )
        require_number("period", self.period, 0)
        require_number("lag", self.lag, 0, self.period, closed=True)
        object.__setattr__(self, "_bodies", PhysicalBodies(self.controller.regressors))

    @property
    def nominal_dt(self) -> float | None:
        """The controller's."""
        return self.controller.nominal_dt

    def init(self, measurement: Measurement, *theta0: Any) -> PhysicalState:
        """As the controller's, with the physical parameters nearest to what it starts with."""
        inner = self.controller.init(measurement, *theta0)
        size = len(inner.parameters)
        # as if every parameter were known by one unit of torque: what "zero" and "urdf" are near to
        _, physical = self._bodies.nearest(inner.parameters, np.eye(size))
        none = np.full(size, np.nan)
        return PhysicalState(inner, physical, inner.measurement.t, False, none, none, _changes(inner))

    def step(
        self, state: PhysicalState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[PhysicalState, JointVector]:
        """As the controller's."""
        inner, tau = self.controller.step(state.inner, measurement, goal, dt)
        state = state._replace(inner=inner)
        since = inner.measurement.t - state.asked
        if state.waiting and since >= self.lag:
            state = self._answered(state)
        if not state.waiting and (since >= self.period or since < 0):
            state = self._asked(state)
        return state, tau

    def _asked(self, state: PhysicalState) -> PhysicalState:
        question = state.inner.parameters
        triangle = learned(self.controller.regressors, state.inner).triangle
        state = state._replace(
            asked=state.inner.measurement.t, waiting=True, question=question, changes=_changes(state.inner)
        )
        if self.executor is None:
            return state._replace(answer=_nearest(self._bodies, question, triangle))
        number = max(self._answers, default=0) + 1
        try:
            self._answers[number] = self.executor.submit(_nearest, self._bodies, question, triangle)
        except RuntimeError:  # broken, or shut down: the controller goes on without it
            return state._replace(waiting=False)
        return state._replace(number=number)

    def _answered(self, state: PhysicalState) -> PhysicalState:
        """The state with what was found, as soon as it is there."""
        answer, inner = state.answer, state.inner
        if self.executor is not None:
            found = self._answers.get(state.number)
            if found is not None and not found.done():
                return state
            if found is not None:  # None: a state that was saved, and goes on elsewhere
                del self._answers[state.number]
                answer = answer if found.cancelled() or found.exception() else found.result()
        if np.isfinite(answer).all() and _changes(inner) == state.changes:
            moved = inner.parameters + (answer - state.question)
            state = state._replace(inner=inner._replace(parameters=moved), physical=answer)
        return state._replace(waiting=False, answer=np.full_like(answer, np.nan), number=0)


def _nearest(bodies: PhysicalBodies, theta: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """theta of the nearest physical parameters, nan where the solver finds none."""
    try:
        return bodies.nearest(theta, triangle)[1]
    except EladaptError:
        return np.full_like(theta, np.nan)


def _changes(state: ControllerState) -> int:
    return state.change.noticed if state.change else 0
