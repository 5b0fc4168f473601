"""A controller behind a gate: the same face, for simulation and hardware alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.robot.model import Robot
from eladapt.safety.gate import Fault, GateState, TorqueGate, checked_torque
from eladapt.signals import Measurement


class Controller(Protocol):
    """What can stand behind a gate; with ``regressors``, its gravity estimate is what the fallback uses."""

    @property
    def robot(self) -> Robot: ...
    def init(self, measurement: Measurement, theta0: Any = None) -> Any: ...
    def step(
        self, state: Any, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[Any, np.ndarray]: ...


class GatedState(NamedTuple):
    """What a controller behind a gate remembers; what is not here is looked up in ``inner``."""

    inner: Any  # the controller's own state
    gate: GateState
    trusted: np.ndarray  # its theta when nothing was suspicious last

    @property
    def fault(self) -> Fault | None:
        """Why the arm is held, None as long as the controller is in charge."""
        return self.gate.fault

    def __getattr__(self, name: str) -> Any:
        """theta, mixed, excitation and the like."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.inner, name)


@dataclass(frozen=True, eq=False)
class GatedController:
    """A controller whose torque passes a `TorqueGate`, which takes over when something is wrong.

    A short spell of bad samples holds the last torque, within its limits, and the controller goes on from the
    first good one. A longer one, or a guard's alarm, latches a fault (``state.fault``): the controller is not
    stepped any more, so it learns nothing, and the gate holds the arm until `reset`. Whatever is measured,
    asked or computed, the torque is finite and within the limits. Steps raise for dt alone.
    """

    controller: Controller
    gate: TorqueGate

    def __post_init__(self) -> None:
        if self.gate.robot.joint_names != self.controller.robot.joint_names:
            raise ArgumentError(
                f"gate: expected one for the controller's joints {self.controller.robot.joint_names}, "
                f"got {self.gate.robot.joint_names}"
            )

    @classmethod
    def for_robot(cls, controller: Controller, dt: float = 1e-3, **limits: Any) -> GatedController:
        """The controller behind the limits of its robot's URDF; see `TorqueGate.for_robot`."""
        return cls(controller, TorqueGate.for_robot(controller.robot, dt, **limits))

    @property
    def robot(self) -> Robot:
        return self.controller.robot

    @property
    def regressors(self) -> Any:
        """The controller's, None if it has none."""
        return getattr(self.controller, "regressors", None)

    def init(self, measurement: Measurement, theta0: Any = None) -> GatedState:
        """Controller and gate at the first measurement. Raises ArgumentError for a bad one."""
        gate = self.gate.init(measurement)
        inner = self.controller.init(gate.measurement, theta0)
        return GatedState(inner, gate, _theta(inner))

    def step(
        self, state: GatedState, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[GatedState, np.ndarray]:
        """The state at ``measurement`` and the torque (nv,) to hold for dt [s].

        Raises ArgumentError for a dt that is not positive or above the gate's max_age, and for nothing else.
        """
        dt = require_number("dt", dt, 0)
        if dt > self.gate.max_age:
            raise ArgumentError(
                f"dt: expected at most max_age = {self.gate.max_age:g} s of the gate, got {dt:g} s"
            )
        inner, trusted, tau = state.inner, state.trusted, state.gate.tau
        gate = self.gate.watch(state.gate, measurement, goal, dt)
        if gate.fault is None and gate.age == 0:
            stepped, tau, gate = self._stepped(inner, gate, dt)
            if gate.fault is None:
                inner = stepped
                error = self.robot.difference(gate.goal, gate.q)
                trusted = _theta(inner) if self.gate.guard.quiet(gate.guard, error) else trusted
                tau = self.gate.slowed(gate, self.gate.limited(gate, tau, dt))
        elif gate.fault is None:
            gate = self.gate.coast(gate, dt)
        if gate.fault is not None:
            gate, tau = self.gate.fallback(gate, self._gravity(gate.q, trusted), dt)
            tau = tau if np.isfinite(tau).all() else gate.tau
        tau = self.gate.limited(gate, tau, dt)
        return GatedState(inner, gate._replace(tau=tau), trusted), tau

    def reset(
        self, state: GatedState, measurement: Measurement | None = None, *, forget: bool = False
    ) -> GatedState:
        """Put the controller in charge again, when the cause of the fault is gone.

        measurement: where the robot is, None for where it was seen last. The controller goes on with what it
        had learned, or, to ``forget``, afresh from the last trusted estimate. Raises ArgumentError for a bad
        measurement.
        """
        gate = self.gate.init(state.gate.measurement if measurement is None else measurement)
        gate = gate._replace(tau=state.gate.tau)
        inner = self.controller.init(gate.measurement, state.trusted) if forget else state.inner
        return GatedState(inner, gate, state.trusted)

    def _stepped(self, inner: Any, gate: GateState, dt: float) -> tuple[Any, np.ndarray, GateState]:
        """The controller's own step; whatever it raises is a fault, not a crash with an arm in the air."""
        try:
            inner, tau = self.controller.step(inner, gate.measurement, gate.goal, dt)
        except Exception as reason:
            return inner, gate.tau, self.gate.latch(gate, "controller", f"{type(reason).__name__}: {reason}")
        try:
            return inner, checked_torque(tau, self.robot.nv), gate
        except ArgumentError as reason:
            return inner, gate.tau, self.gate.latch(gate, "torque", str(reason))

    def _gravity(self, q: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(nv,) [N m] by the trusted estimate; the URDF's where the controller estimates none."""
        regressors = self.regressors
        if regressors is None:
            return self.robot.gravity(q)
        potential = theta[len(theta) - regressors.n_potential :]
        return np.asarray(regressors.gravity(q) @ potential)


def _theta(inner: Any) -> np.ndarray:
    return np.array(getattr(inner, "theta", ()), dtype=float)
