"""How fast, how hard and how suddenly an arm may move, and which rule says so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.gains.extremes import SAMPLES, configurations, effort, extremes
from eladapt.gains.rules import Rule, rules_table, shown
from eladapt.robot.joint_limits import speed
from eladapt.robot.model import Robot
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION

SHARE = 0.5  # of the torque that gravity leaves: the rest is for loads, friction and what tracking takes
SCARCE = 0.1  # of the effort limit, which counts as left where gravity takes nearly all
RISE = 0.1  # [s] the least time to full speed and, again, to full acceleration: makers' values are near it


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Largest velocity [rad/s], acceleration [rad/s^2] and jerk [rad/s^3] of a reference, (nv,) each.

    ``print(limits)`` says which rule set each. Raises ArgumentError for what is not positive.
    """

    robot: Robot
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    rules: tuple[Rule, ...] = ()

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration", "jerk"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), self.robot.nv))

    @classmethod
    def for_robot(
        cls,
        robot: Robot,
        *,
        velocity: float | np.ndarray = 0.9,
        acceleration: float | np.ndarray = 1.0,
        jerk: float | np.ndarray = 1.0,
    ) -> MotionLimits:
        """Limits from the URDF and what the maker publishes.

        Each argument is a number, the share of what the rule gives, in (0, 1], or (nv,) the limits
        themselves. velocity: the URDF's or the maker's, the lower. acceleration: what half of the torque
        that gravity leaves gives all joints at once, over sampled configurations, full speed after 0.1 s at
        the soonest, and the maker's. jerk: full acceleration after 0.1 s, and the maker's; where the maker
        limits the torque's rate, half of that moves the arm. Raises ArgumentError for other numbers.
        """
        rules: list[Rule] = []
        largest = extremes(robot)
        limit = effort(robot, largest)

        def settle(name: str, given: float | np.ndarray, choices: dict[str, np.ndarray]) -> np.ndarray:
            if np.ndim(given):
                rules.append(Rule(name, shown(given), "given by the caller", "given"))
                return require_gain(name, given, robot.nv)
            share = require_number(name, given, 0, 1, closed=True)
            if share == 0:
                raise ArgumentError(f"{name}: expected a share in (0, 1] or ({robot.nv},) limits, got 0")
            if name in robot.published:
                choices = {**choices, "maker": robot.published[name]}
            names, values = list(choices), np.array(list(choices.values()))
            found, active = share * values.min(axis=0), np.argmin(values, axis=0)
            rules.append(Rule(
                name, shown(found), f"{share:g} of the least of: {', '.join(names)}",
                ", ".join(dict.fromkeys(names[k] for k in active)),
            ))  # fmt: skip
            return found

        top = settle("velocity", velocity, {"URDF": speed(robot.velocity_limit)})
        postures = configurations(robot, SAMPLES, 0)
        inertia = np.array([robot.mass_matrix(q) for q in postures])
        gravity = np.array([robot.gravity(q) for q in postures])
        free = SHARE * np.maximum(limit - np.abs(gravity), SCARCE * limit)
        rotor = limit / ASSUMED_ROTOR_ACCELERATION
        alone = np.min(free / (np.einsum("kii->ki", inertia) + rotor), axis=0)
        spare = alone * _together(inertia, alone, free)
        strong = settle("acceleration", acceleration, {"torque": spare, "full speed in 0.1 s": top / RISE})
        sudden = {"full acceleration in 0.1 s": strong / RISE}
        if "torque_rate" in robot.published:
            rate = SHARE * robot.published["torque_rate"]
            sudden["torque rate"] = strong * _together(inertia, strong, rate)
        return cls(robot, top, strong, settle("jerk", jerk, sudden), tuple(rules))

    def __str__(self) -> str:
        return rules_table(self.rules)

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.rules(repr(self), self.rules)

    def __repr__(self) -> str:
        parts = (f"{name} {shown(getattr(self, name))}" for name in ("velocity", "acceleration", "jerk"))
        return f"MotionLimits({self.robot.name}: {', '.join(parts)})"


def _together(inertia: np.ndarray, acceleration: np.ndarray, torque: np.ndarray) -> float:
    """By what factor all joints may have accelerations (nv,) at once with these torques (nv,) or (n, nv);
    inertia (n, nv, nv): M of the postures."""
    return float(np.min(torque / (np.abs(inertia) @ acceleration)))
