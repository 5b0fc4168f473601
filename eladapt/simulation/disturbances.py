"""What a plant does that the controller is not told: friction, noise, a load."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_gain, require_number, require_vector
from eladapt.gains.extremes import effort, extremes
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index

ROUNDING = 5e-7  # [s] of sums of steps


@dataclass(frozen=True)
class Friction:
    """tau_f = viscous v + coulomb sign(v); scalars or (nv,), [N m s/rad] and [N m], >= 0."""

    viscous: float | np.ndarray = 0.0
    coulomb: float | np.ndarray = 0.0

    def __post_init__(self) -> None:
        for name in ("viscous", "coulomb"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))

    def by_joint(self, nv: int) -> tuple[np.ndarray, np.ndarray]:
        """viscous and coulomb, (nv,) each. Raises ArgumentError for another number of joints."""
        if nv not in self._by_joint:
            viscous, coulomb = (
                require_gain(name, getattr(self, name), nv, zero=True) for name in ("viscous", "coulomb")
            )
            self._by_joint[nv] = viscous, coulomb
        return self._by_joint[nv]

    @functools.cached_property
    def _by_joint(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        return {}


@dataclass(frozen=True)
class Noise:
    """Independent Gaussian noise; standard deviations, scalars or (nv,), [rad] and [rad/s]."""

    position: float | np.ndarray = 0.0
    velocity: float | np.ndarray = 0.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))

    @functools.cached_property
    def _silent(self) -> bool:
        return not (np.any(self.position) or np.any(self.velocity))

    def sample(self, t: float, nv: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Errors of position and velocity, (nv,) each; t [s] is not used."""
        if self._silent:
            return np.zeros(nv), np.zeros(nv)
        return self.position * rng.normal(size=nv), self.velocity * rng.normal(size=nv)


@dataclass(frozen=True)
class Brakes:
    """Brakes that are closed ``closing`` [s] after they were told to, and then rub with up to ``torque`` [N
    m].

    torque: a number or (nv,); None for the effort limits. Permanent-magnet brakes of an arm's size take 5 to
    40 ms.
    """

    torque: float | np.ndarray | None = None
    closing: float = 0.02

    def __post_init__(self) -> None:
        if self.torque is not None:
            object.__setattr__(self, "torque", require_gain("torque", self.torque))
        require_number("closing", self.closing, 0, np.finfo(float).max, closed=True)

    def closed(self, told: float | None, t: float) -> bool:
        """Whether they rub at t [s], told to close at ``told`` [s]; None: they were not."""
        return told is not None and t >= told + self.closing - ROUNDING

    def hold(self, robot: Robot) -> np.ndarray:
        """(nv,) [N m] with which they rub."""
        torque = effort(robot, extremes(robot)) if self.torque is None else self.torque
        return np.broadcast_to(torque, robot.nv)


@dataclass(frozen=True)
class Payload:
    """A point mass [kg] at ``com`` [m] in ``frame`` (the tool frame if None), held from ``attach``
    to ``release`` [s]."""

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: str | None = None
    attach: float = 0.0
    release: float = np.inf

    def __post_init__(self) -> None:
        require_number("mass", self.mass, 0)
        require_vector("com", self.com, 3)
        if not self.attach < self.release:
            raise ArgumentError(
                f"attach, release: expected attach < release, got {self.attach}, {self.release}"
            )

    def held(self, t: float) -> bool:
        """Whether the load hangs on the arm at time t [s]."""
        return self.attach <= t < self.release

    def loaded(self, robot: Robot) -> pin.Model:
        """A copy of the robot's model that carries the load. Raises UnknownNameError."""
        name = robot.tool if self.frame is None else self.frame
        model = robot.model.copy()
        frame = model.frames[frame_index(model, name)]
        point = pin.Inertia(self.mass, np.asarray(self.com, dtype=float), np.zeros((3, 3)))
        model.inertias[frame.parentJoint] += frame.placement.act(point)
        return model
