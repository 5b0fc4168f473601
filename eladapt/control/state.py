"""What a controller remembers from one sample to the next."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from eladapt.control.patience import Ripple
from eladapt.estimation.change import Change
from eladapt.estimation.contact import ContactState
from eladapt.estimation.mistimed import StepErrors
from eladapt.signals import JointVector, Measurement, Regression

UNKNOWN = np.zeros(0)


class ControllerState(NamedTuple):
    """Everything that the controller remembers; arrays and NamedTuples of arrays only."""

    measurement: Measurement  # the last one seen
    parameters: np.ndarray  # (l,) estimate of the whole theta
    n_potential: int  # how many of them, the last ones, are theta_U
    filters: Any  # of the regression block
    regression: Regression
    information: Any  # of the extension block
    change: Change | None = None  # what the detector noticed
    disturbance: JointVector | None = None  # (nv,) [N m] what neither theta nor the control law explains
    noise: np.ndarray = UNKNOWN  # (m,) mean square of what theta leaves of each row of the regression
    contact: ContactState | None = None  # what acts from outside
    ripple: Ripple | None = None  # whether the loop swings
    steps: StepErrors | None = None  # what single steps left unexplained
    inertia: JointVector | None = None  # (nv,) [kg m^2] of the joints, when the information last began afresh

    @property
    def theta(self) -> np.ndarray:
        """(n_potential,) estimate of theta_U, the last block of `parameters`."""
        return self.parameters[len(self.parameters) - self.n_potential :]

    @property
    def external(self) -> np.ndarray:
        """(nv,) [N m] what acts on the arm from outside; raises AttributeError where nobody looks."""
        if self.contact is None:
            raise AttributeError("external: the controller has no contact detector")
        return self.contact.external

    @property
    def touching(self) -> bool:
        """Whether the arm touches something, so that learning rests."""
        return self.contact is not None and self.contact.touching

    def __repr__(self) -> str:
        known = f"{len(self.parameters)} parameters, {self.n_potential} of gravity"
        return f"ControllerState(t = {self.measurement.t:.6g} s, {known})"
