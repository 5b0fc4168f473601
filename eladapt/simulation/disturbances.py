"""What a plant does that the controller is not told: friction, noise, a load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_gain, require_number, require_vector
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index


@dataclass(frozen=True)
class Friction:
    """tau_f = viscous v + coulomb sign(v); scalars or (nv,), [N m s/rad] and [N m], >= 0."""

    viscous: float | np.ndarray = 0.0
    coulomb: float | np.ndarray = 0.0

    def __post_init__(self) -> None:
        for name in ("viscous", "coulomb"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))


@dataclass(frozen=True)
class Noise:
    """Independent Gaussian noise; standard deviations, scalars or (nv,), [rad] and [rad/s]."""

    position: float | np.ndarray = 0.0
    velocity: float | np.ndarray = 0.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))

    def sample(self, t: float, nv: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Errors of position and velocity, (nv,) each; t [s] is not used."""
        return self.position * rng.normal(size=nv), self.velocity * rng.normal(size=nv)


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
