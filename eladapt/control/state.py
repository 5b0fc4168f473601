"""What a controller remembers from one sample to the next."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from eladapt.estimation.change import Change
from eladapt.estimation.excitation import Excitation
from eladapt.estimation.friction import CompensationState
from eladapt.signals import Measurement, MixedRegression, Regression


class ControllerState(NamedTuple):
    """Everything that the controller remembers; arrays and NamedTuples of arrays only."""

    measurement: Measurement  # the last one seen
    theta: np.ndarray  # (n_potential,) estimate of theta_U
    filters: Any  # of the regression block
    regression: Regression
    information: Any  # of the extension block
    mixed: MixedRegression
    excitation: Excitation
    change: Change | None = None  # what the detector noticed
    compensation: CompensationState | None = None  # what is fed forward against friction
    disturbance: np.ndarray | None = None  # (nv,) [N m] what the law's prediction lacks
