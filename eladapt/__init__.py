"""eladapt: composite adaptive finite-time control for any robot with a URDF."""

import importlib
from typing import TYPE_CHECKING, Any

from eladapt import paper
from eladapt.comparison.slotine_li import SlotineLi
from eladapt.comparison.terminal_sliding import TerminalSliding
from eladapt.control.composite import CompositeController, ControllerState
from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.reports import carried, friction, payload
from eladapt.errors import EladaptError
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.excitation import IntervalExcitation
from eladapt.estimation.extensions import Information, Kreisselmeier, LeastSquares, SubspaceLeastSquares
from eladapt.estimation.friction import FrictionEstimate
from eladapt.estimation.mixing import Determinant, SmallestEigenvalue, Unmixed
from eladapt.estimation.noise import MeasuredNoise, measure_noise
from eladapt.estimation.payload import PayloadEstimate, estimate_payload
from eladapt.estimation.regressions import ForceBalance, PowerBalance
from eladapt.hardware.commissioning import Commissioning, commission
from eladapt.hardware.loop import LoopResult, RobotInterface, run_loop
from eladapt.hardware.timing import Timing
from eladapt.hardware.udp import UdpRobot
from eladapt.identification.currents import CurrentGains, current_gains
from eladapt.identification.found import Identified
from eladapt.identification.identify import identify
from eladapt.identification.log import Log
from eladapt.motion.excitation import Excitation, excitation
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import Motion, move
from eladapt.motion.shaped import Shaped, ShapedState
from eladapt.motion.waypoints import waypoints
from eladapt.records.record import Record
from eladapt.records.state_file import load_state, save_state
from eladapt.regressors.base import ParameterBasis
from eladapt.regressors.regressors import Regressors
from eladapt.robot.library import names as robots
from eladapt.robot.model import Robot
from eladapt.safety.gate import FAULTS, TorqueGate
from eladapt.safety.gated import GatedController, GatedState
from eladapt.signals import Braking, Fault, Measurement, MixedRegression, Reference, Regression
from eladapt.simulation.disturbances import Friction, Noise, Payload
from eladapt.simulation.many import simulate_many
from eladapt.simulation.plants import PinocchioPlant
from eladapt.simulation.run import simulate
from eladapt.theory.bounds import model_bounds
from eladapt.theory.certificates import certify, settling_bounds
from eladapt.theory.lyapunov import LyapunovFunctions
from eladapt.worlds.criteria import Criteria
from eladapt.worlds.distributions import Distributions
from eladapt.worlds.result import Stress
from eladapt.worlds.stress import stress
from eladapt.worlds.world import World

if TYPE_CHECKING:
    from eladapt.display.motions import plot_log, plot_motion
    from eladapt.display.plots import plot
    from eladapt.display.report import report
    from eladapt.identification.online import Physical, PhysicalState
    from eladapt.motion.reach import reach
    from eladapt.simulation.mujoco_plant import MujocoPlant
    from eladapt.viewing.live import LiveView
    from eladapt.viewing.viewer import view

__all__ = [
    "FAULTS",
    "Braking",
    "Commissioning",
    "CompositeController",
    "CompositeLaw",
    "ControllerState",
    "Criteria",
    "CurrentGains",
    "Determinant",
    "Distributions",
    "EladaptError",
    "Excitation",
    "Fault",
    "FiniteTimePD",
    "ForceBalance",
    "Friction",
    "FrictionEstimate",
    "GatedController",
    "GatedState",
    "Identified",
    "Information",
    "IntervalExcitation",
    "Kreisselmeier",
    "LeastSquares",
    "LiveView",
    "Log",
    "LoopResult",
    "LyapunovFunctions",
    "MeasuredNoise",
    "Measurement",
    "MixedRegression",
    "Motion",
    "MotionLimits",
    "MujocoPlant",
    "Noise",
    "ParameterBasis",
    "Payload",
    "PayloadEstimate",
    "Physical",
    "PhysicalState",
    "PinocchioPlant",
    "PowerBalance",
    "Record",
    "Reference",
    "Regression",
    "Regressors",
    "Robot",
    "RobotInterface",
    "Shaped",
    "ShapedState",
    "SlotineLi",
    "SmallestEigenvalue",
    "Stress",
    "SubspaceLeastSquares",
    "TerminalSliding",
    "Timing",
    "TorqueGate",
    "UdpRobot",
    "Unmixed",
    "World",
    "carried",
    "certify",
    "commission",
    "current_gains",
    "estimate_payload",
    "excitation",
    "friction",
    "identify",
    "load_state",
    "measure_noise",
    "model_bounds",
    "move",
    "paper",
    "payload",
    "plot",
    "plot_log",
    "plot_motion",
    "reach",
    "report",
    "robots",
    "run_loop",
    "save_state",
    "settling_bounds",
    "simulate",
    "simulate_many",
    "stress",
    "view",
    "waypoints",
]


# Imported when asked for: matplotlib and MeshCat are slow to import, Bokeh, MuJoCo and pink optional.
_LATER = {
    "LiveView": "eladapt.viewing.live",
    "MujocoPlant": "eladapt.simulation.mujoco_plant",
    "Physical": "eladapt.identification.online",
    "PhysicalState": "eladapt.identification.online",
    "plot": "eladapt.display.plots",
    "plot_log": "eladapt.display.motions",
    "plot_motion": "eladapt.display.motions",
    "reach": "eladapt.motion.reach",
    "report": "eladapt.display.report",
    "view": "eladapt.viewing.viewer",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name]), name)
    raise AttributeError(f"module 'eladapt' has no attribute {name!r}")
