"""A controller behind a gate: the same face, for simulation and hardware alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_number
from eladapt.robot.protocols import (
    Around,
    BareController,
    Goal,
    handed_on,
    of_the_inner,
    require_controller,
)
from eladapt.safety.gate import GateState, TorqueGate, checked_torque
from eladapt.signals import Fault, Measurement


class GatedState(NamedTuple):
    """What a controller behind a gate remembers."""

    inner: Any  # the controller's own state
    gate: GateState
    trusted: np.ndarray  # its parameters when nothing was suspicious last; empty if it has none

    def __repr__(self) -> str:
        return f"GatedState({self.inner!r}, {self.gate!r})"

    @property
    def fault(self) -> Fault | None:
        """Why the arm is held, None as long as the controller is in charge."""
        return self.gate.fault

    @property
    def brake(self) -> bool:
        """Whether torque cannot keep the arm safe, or nothing says that it does: brakes, now."""
        return self.gate.hold is not None and self.gate.hold.braking is not None

    @property
    def measurement(self) -> Measurement:
        """The last trusted one."""
        return self.gate.measurement

    def __getattr__(self, name: str) -> Any:
        """What the controller's state says beside: parameters, external, touching and so on."""
        return of_the_inner(self, name)


@dataclass(frozen=True, eq=False, repr=False)
class GatedController(Around):
    """A controller whose torque passes a `TorqueGate`, which takes over when something is wrong.

    A short spell of bad samples holds the last torque, within its limits, and the controller goes on from the
    first good one. A longer one, or a guard's alarm, latches a fault (``state.fault``): the controller is not
    stepped any more, so it learns nothing, and the gate holds the arm until `reset`, or asks for its brakes
    (``state.brake``). Whatever is measured, asked or computed, the torque is finite and within the limits.
    Steps raise for dt alone.
    """

    controller: BareController
    gate: TorqueGate

    def __post_init__(self) -> None:
        require_controller(self.controller)
        if self.gate.robot.joint_names != self.controller.robot.joint_names:
            raise ArgumentError(
                f"gate: expected one for the controller's joints {self.controller.robot.joint_names}, "
                f"got {self.gate.robot.joint_names}"
            )

    @classmethod
    def for_robot(cls, controller: BareController, dt: float = 1e-3, **limits: Any) -> GatedController:
        """The controller behind the limits of its robot's URDF, for steps of dt [s]; see `TorqueGate`."""
        require_controller(controller)
        return cls(controller, TorqueGate.for_robot(controller.robot, dt, **limits))

    def __repr__(self) -> str:
        kind, name = type(self.controller).__name__, self.robot.name
        return f"GatedController({kind} of {name}, without a measurement for at most {self.gate.max_age:g} s)"

    def init(self, measurement: Measurement, theta0: Any = None) -> GatedState:
        """Controller and gate at the first measurement; theta0 as the controller takes it, None for its
        own choice. Raises ArgumentError for a bad one."""
        gate = self.gate.init(measurement)
        return self._begun(gate, theta0)

    def step(
        self, state: GatedState, measurement: Measurement, goal: Goal, dt: float
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
            gate = self.gate.touched(gate, getattr(stepped, "external", None))
            if gate.fault is None:
                inner = stepped
                error = pin.difference(self.robot.model, gate.goal.q, gate.q)
                trusted = self._parameters(inner) if self.gate.guard.quiet(gate.guard, error) else trusted
                tau = self.gate.slowed(gate, self.gate.limited(gate, tau, dt))
        if gate.fault is not None:
            gate, tau = self.gate.stopped(gate, self._gravity(gate.q, trusted), dt)
        else:
            tau = self.gate.limited(gate, tau, dt)
            gate = gate._replace(tau=tau)
        return GatedState(inner, gate, trusted), tau.copy()

    def reset(
        self, state: GatedState, measurement: Measurement | None = None, *, forget: bool = False
    ) -> GatedState:
        """Put the controller in charge again, when the cause of the fault is gone.

        measurement: where the robot is, None for where it was seen last. The controller goes on with what it
        had learned, or, to ``forget``, afresh from the last trusted estimate. Raises ArgumentError for a bad
        measurement.
        """
        last, clock = state.gate.measurement, state.gate.clock
        if measurement is not None:
            given = self.robot.check_measurement(measurement)
            if given.t + clock < last.t:  # it was set back
                clock = last.t + self.gate.max_age - given.t
            last = given._replace(t=given.t + clock)
        gate = self.gate.init(last)._replace(tau=state.gate.tau, clock=clock)
        if forget:
            return self._begun(gate, state.trusted if len(state.trusted) else None)
        return GatedState(state.inner, gate, state.trusted)

    def recorded(self, state: GatedState) -> dict[str, Any]:
        """What the controller has recorded, and the gate's fault."""
        return {**super().recorded(state), "fault": state.fault}

    def _begun(self, gate: GateState, theta0: Any) -> GatedState:
        given = () if theta0 is None else (theta0,)
        inner = self.controller.init(gate.measurement.copy(), *given)
        if np.isfinite(self.gate.contact).any() and not hasattr(inner, "external"):
            raise ArgumentError(
                "contact: expected a controller whose state says what acts from outside (external), "
                f"got {type(self.controller).__name__}; leave it inf"
            )
        return GatedState(inner, gate, self._parameters(inner))

    def _parameters(self, inner: Any) -> np.ndarray:
        """What the controller has estimated, a copy."""
        return np.array(self._recorded.recorded(inner).get("parameters", ()), dtype=float)

    def _stepped(self, inner: Any, gate: GateState, dt: float) -> tuple[Any, np.ndarray, GateState]:
        """The controller's own step; whatever it raises is a fault, not a crash with an arm in the air."""
        try:
            inner, tau = self.controller.step(inner, gate.measurement.copy(), handed_on(gate.goal), dt)
        except Exception as reason:
            return inner, gate.tau, self.gate.latch(gate, "controller", f"{type(reason).__name__}: {reason}")
        try:
            return inner, checked_torque(tau, self.robot.nv), gate
        except ArgumentError as reason:
            return inner, gate.tau, self.gate.latch(gate, "torque", str(reason))

    def _gravity(self, q: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(nv,) [N m] by the trusted estimate; the URDF's where the controller estimates none."""
        regressors = self.regressors
        if regressors is None or not len(theta):
            return self.robot.gravity(q)
        potential = theta[len(theta) - regressors.n_potential :]
        return np.asarray(regressors.gravity(q) @ potential)
