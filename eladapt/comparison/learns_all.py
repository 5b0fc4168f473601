"""What the sliding-variable controllers share: a theta that is learned whole, and what a record keeps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot


class LearnsAll:
    """The robot, the names and the true values of theta (l,), and how it is recorded. Abstract."""

    regressors: Regressors

    @property
    def robot(self) -> Robot:
        return self.regressors.robot

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of all parameters, see `Regressors.labels`."""
        return self.regressors.labels

    def estimate(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """The whole theta (l,) and theta_U, its last block, as a record has them."""
        return {"parameters": theta, "theta": theta[len(theta) - self.regressors.n_potential :]}

    def reviewed(self, state: Any, frame: str | None) -> dict[str, np.ndarray]:
        """Nothing."""
        return {}

    def true_parameters(self, model: pin.Model) -> np.ndarray:
        """(l,) on an arm with this model. Raises ArgumentError for one with other joints."""
        return self.regressors.theta_of(model)
