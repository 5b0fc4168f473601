"""eladapt: composite adaptive finite-time control for any robot with a URDF."""

from eladapt import paper
from eladapt.control.composite import CompositeController, ControllerState
from eladapt.control.finite_time import FiniteTimePD
from eladapt.display.plots import plot
from eladapt.display.viewer import view
from eladapt.errors import EladaptError
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.excitation import IntervalExcitation
from eladapt.estimation.extensions import Information, Kreisselmeier, LeastSquares
from eladapt.estimation.mixing import Determinant, Directional, SmallestEigenvalue
from eladapt.estimation.regressions import ForceBalance, PowerBalance
from eladapt.robot.library import names as robots
from eladapt.robot.model import Robot
from eladapt.robot.parameters import ParameterBasis
from eladapt.robot.regressors import Regressors
from eladapt.signals import Measurement, MixedRegression, Regression
from eladapt.simulation.disturbances import Friction, Noise, Payload
from eladapt.simulation.plants import PinocchioPlant
from eladapt.simulation.record import Record
from eladapt.simulation.run import simulate

__all__ = [
    "CompositeController",
    "CompositeLaw",
    "ControllerState",
    "Determinant",
    "Directional",
    "EladaptError",
    "FiniteTimePD",
    "ForceBalance",
    "Friction",
    "Information",
    "IntervalExcitation",
    "Kreisselmeier",
    "LeastSquares",
    "Measurement",
    "MixedRegression",
    "Noise",
    "ParameterBasis",
    "Payload",
    "PinocchioPlant",
    "PowerBalance",
    "Record",
    "Regression",
    "Regressors",
    "Robot",
    "SmallestEigenvalue",
    "paper",
    "plot",
    "robots",
    "simulate",
    "view",
]
