"""Gains from the URDF alone, each with the rule that set it and the limit that was active.

The scaling is the homogeneous one: D = 1.5 P^(3/4) M^(1/4) makes the damping ratio independent of
the amplitude for a = 1/3, b = 1/2. The constants were measured on panda, ur5, xarm7, finger_edu,
double_pendulum and random 5-joint arms, from theta_U = 0 in random postures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, UnknownNameError, printable, require_gain, require_number
from eladapt.estimation.adaptation import RESOLVED
from eladapt.gains.extremes import Mode, adaptation_mode, configurations, effort, extremes, fall_mode
from eladapt.gains.rules import Rule, rules_table, shown
from eladapt.gains.sensing import Hardware, choose_floor, choose_horizon
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION

GAMMA, GAMMA_LEAST = 0.2, 0.002
# [rad/s^2] A rotor that the effort limit could not turn faster than this is not believed (a Panda's wrist:
# 0.24 kg m^2); D reckons with the assumed one, of an eighth of that.
LEAST_ROTOR_ACCELERATION = 50.0
# Of the effort limit: friction of some parts of it must not hold a joint far from its goal.
LEAST_STIFFNESS = 0.3
LEAST_SLIDING = 5e-3  # [rad/s]: five times a velocity noise that nobody told
# Of the effort limit. What cannot be keeps the estimate from running off along directions that motions of
# little variety do not tell: an offset against gravity, Coulomb friction against viscous.
MOST_FRICTION, MOST_OFFSET = 0.5, 0.2
MOST_PUSH = 1000.0  # [rad/s^2] by which a disturbance estimate may throw a link that has no rotor
IDEAL = Hardware()
MAY_BE_ZERO = ("rotors", "D_L", "floor", "stiction_speed", "tolerance", "still_speed")
LEAST_PRIOR, PRIOR_OF_NOISE = 1e-10, 0.01
FLOOR_SAMPLES = 20  # configurations over which the information that noise makes is taken


@dataclass(frozen=True, eq=False, repr=False)
class Gains:
    """What `CompositeController.for_robot` uses; arrays are (nv,). ``str()`` is a table of the rules."""

    P: np.ndarray  # [N m/rad^(1/3)]
    D: np.ndarray  # [N m (s/rad)^(1/2)]
    D_L: np.ndarray  # [N m s/rad]
    rotors: np.ndarray  # [kg m^2] the largest that are believed, when they are learned
    horizon: np.ndarray  # [s] of the semi-implicit law
    pole: float  # [1/s]
    row_weight: np.ndarray  # [1/(N m)]
    alpha: float  # [1/s]
    beta: float  # [1/s]
    f0: float  # initial information
    floor: float  # length of a row of Omega that is noise
    stiction_speed: float  # [rad/s] a slower joint may stick
    friction_limit: np.ndarray  # [N m] the most Coulomb friction that is believed
    offset_limit: np.ndarray  # [N m] the largest offset that is believed
    Gamma: float
    Upsilon: float
    disturbance_limit: np.ndarray  # [N m] of the disturbance estimate
    moving_limit: np.ndarray  # [N m] of the same in a joint that moves
    memory: np.ndarray  # [s] of the disturbance estimate
    tolerance: float  # [rad] within which, and
    still_speed: float  # [rad/s] below which a joint has arrived
    rules: tuple[Rule, ...]

    def __str__(self) -> str:
        return rules_table(self.rules)

    def __repr__(self) -> str:
        return f"Gains(P {shown(self.P)}, D {shown(self.D)}; {len(self.rules)} in all, which print shows)"

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.rules(repr(self), self.rules)


class SlidingGains(NamedTuple):
    """What the `for_robot` of the sliding-variable controllers uses; arrays are (nv,)."""

    K1: np.ndarray  # [N m s/rad]
    K2: np.ndarray  # [1/s]
    K_s: np.ndarray  # [N m]
    pole: float  # [1/s]
    row_weight: np.ndarray  # [1/(N m)]
    alpha: float  # [1/s]
    beta: float  # [1/s]
    xi: float
    f0: float


def derive_gains(
    regressors: Regressors,
    dt: float,
    given: Mapping[str, Any] | None = None,
    hardware: Hardware = IDEAL,
) -> Gains:
    """Gains for a torque that is held over dt [s]; those ``given`` by name are kept.

    Raises UnknownNameError for a name that is no gain, and ArgumentError, which names the joint and the
    dt that would do, where the arm cannot be controlled at this dt.
    """
    dt = require_number("dt", dt, 0)
    given = dict(given or {})
    names = [name for name in Gains.__dataclass_fields__ if name != "rules"]
    if unknown := [name for name in given if name not in names]:
        raise UnknownNameError("gain", unknown, names)
    robot = regressors.robot
    hardware = hardware.of(robot.nv)
    largest = extremes(robot)
    gravity, inertia = largest
    limit = effort(robot, largest)
    assumed = ~np.isfinite(robot.effort_limit)
    rules: list[Rule] = []

    def settle(name: str, derived: Any, rule: str, active: str = "") -> Any:
        """The given gain if there is one, else the derived one; either is entered in the table."""
        if name in given:
            size = robot.nv if np.ndim(derived) else None
            checked = require_gain(name, given[name], size, zero=name in MAY_BE_ZERO)
            derived = checked if size else float(checked)
            rule, active = "given by the caller", "given"
        rules.append(Rule(name, shown(derived), rule, active))
        return derived

    rotors = settle(
        "rotors", limit / LEAST_ROTOR_ACCELERATION,
        f"effort / {LEAST_ROTOR_ACCELERATION:g} rad/s^2: the largest rotor that is believed",
    )  # fmt: skip
    bodies, inertia = inertia, inertia + limit / ASSUMED_ROTOR_ACCELERATION
    spare, reserve, wanted = limit - gravity, 0.6 * limit, 4 * gravity + 60 * bodies
    available, least = np.maximum(spare, reserve), LEAST_STIFFNESS * limit
    stiff = np.minimum(available, wanted)
    enough = stiff >= least
    P = settle(
        "P", np.maximum(stiff, least),
        f"max(min(max(effort - max|g|, 0.6 effort), 4 max|g| + 60 max M), {LEAST_STIFFNESS:g} effort)",
        _by_joint(robot, {
            f"{LEAST_STIFFNESS:g} of the effort limit": ~enough,
            "effort limit": enough & (available <= wanted) & (spare >= reserve) & ~assumed,
            "0.6 of the effort limit": enough & (available <= wanted) & (spare < reserve) & ~assumed,
            "effort assumed as max(3 max|g|, 20 max M), URDF sets none":
                enough & (available <= wanted) & assumed,
            "gravity and inertia": enough & (available > wanted),
        }),
    )  # fmt: skip
    D = settle(
        "D", 1.5 * P**0.75 * inertia**0.25,
        f"1.5 P^(3/4) (max M + effort / {ASSUMED_ROTOR_ACCELERATION:g})^(1/4): "
        "the same damping at any amplitude, with the rotor that such a motor has",
    )  # fmt: skip
    D_L = settle("D_L", 0.1 * D, "0.1 D")
    horizon = settle("horizon", *choose_horizon(hardware, inertia, limit, dt))
    pole = settle("pole", 20.0, "20 1/s: a tenth of a second of motion in the filters")
    row_weight = settle("row_weight", 1 / limit, "1 / effort limit: rows of equal size")
    alpha = settle("alpha", 1.0, "1 1/s on scaled columns")
    beta = settle("beta", 5.0, "5 1/s: forgets in 0.2 s what the new rows say again")
    floor = settle(
        "floor",
        *choose_floor(regressors, hardware, configurations(robot, FLOOR_SAMPLES, 0), row_weight, pole),
    )
    f0 = settle(
        "f0", max(LEAST_PRIOR, PRIOR_OF_NOISE * floor**2),
        f"max({LEAST_PRIOR:g}, {PRIOR_OF_NOISE:g} floor^2): what the filters' interpolation, or noise, makes",
    )  # fmt: skip
    noisy_speed = float(np.max(hardware.velocity_noise))
    stiction_speed = settle(
        "stiction_speed",
        max(LEAST_SLIDING, 5 * noisy_speed),
        f"max({LEAST_SLIDING:g} rad/s, 5 s_v): below it a joint may stick, or v be noise",
    )
    friction_limit = settle(
        "friction_limit", np.maximum(MOST_FRICTION * limit, 2 * robot.friction),
        f"max({MOST_FRICTION:g} effort, 2 of the URDF's): the most Coulomb friction that is believed",
    )  # fmt: skip
    offset_limit = settle(
        "offset_limit", MOST_OFFSET * limit, f"{MOST_OFFSET:g} effort: the largest offset that is believed"
    )
    disturbance_limit = settle("disturbance_limit", 0.5 * limit, "0.5 effort")
    moving_limit = settle(
        "moving_limit",
        MOST_PUSH * bodies,
        f"max M {MOST_PUSH:g} rad/s^2: beside its friction, of a joint that moves",
    )
    noisy = noisy_speed > 0 or float(np.max(hardware.position_noise)) > 0
    memory = settle(
        "memory", 2 * horizon if noisy else np.maximum(0.01, 2 * horizon),
        "2 horizon; without noise at least 0.01 s, for the noise that nobody told",
    )  # fmt: skip
    tolerance = settle(
        "tolerance", 0.0 if noisy else 5e-6,
        "5e-6 rad without noise; with noise 0: an estimate that stops and goes drifts",
    )  # fmt: skip
    still_speed = settle("still_speed", max(1e-5, 3 * noisy_speed), "max(1e-5 rad/s, 3 s_v)")
    found = (0.0, "", "") if "Gamma" in given else _adaptation_gain(regressors, dt, hardware.delay)
    Gamma = settle("Gamma", *found)
    # |theta_U| is about max |g| in scaled columns: its fractional term arrives within about 0.3 s.
    rate = np.sqrt(3 * max(gravity.max(), 1e-3)) / 0.045
    Upsilon = settle("Upsilon", rate / Gamma, "Gamma Upsilon = sqrt(3 max|g|) / 0.045: arrives within 0.3 s")
    _require_resolved(fall_mode(robot), dt, hardware.delay, "gravity changes")
    return Gains(
        P, D, D_L, rotors, horizon, pole, row_weight, alpha, beta, f0, floor, stiction_speed, friction_limit,
        offset_limit, Gamma, Upsilon, disturbance_limit, moving_limit, memory, tolerance, still_speed,
        tuple(rules),
    )  # fmt: skip


def derive_sliding_gains(robot: Robot, dt: float) -> SlidingGains:
    """Gains of the Slotine-Li and terminal-sliding controllers, for a torque held over dt [s].

    K1 damps the largest inertia at 10/s, and no joint faster than a tenth of the sampling rate.
    """
    dt = require_number("dt", dt, 0)
    largest = extremes(robot)
    limit = effort(robot, largest)
    K1 = np.minimum(10.0, 0.1 / dt) * largest.inertia + 0.1 * largest.gravity
    return SlidingGains(
        K1=K1, K2=np.full(robot.nv, 2.0), K_s=0.005 * limit, pole=20.0, row_weight=1 / limit,
        alpha=10.0, beta=5.0, xi=1e4, f0=0.1,
    )  # fmt: skip


def _adaptation_gain(regressors: Regressors, dt: float, delay: float) -> tuple[float, str, str]:
    """Gamma, its rule and what was active."""
    mode = adaptation_mode(regressors, GAMMA)
    turned = mode.frequency * (dt + delay)
    largest = GAMMA if turned <= RESOLVED else GAMMA * (RESOLVED / turned) ** 2
    if largest < GAMMA_LEAST:
        slowest = mode.frequency * np.sqrt(GAMMA_LEAST / GAMMA)
        _require_resolved(Mode(slowest, mode.joint), dt, delay, "adaptation swings")
    rule = f"0.2, or less so that (dt + delay) sqrt(lambda_max(M^-1 Psi Gamma Psi')) <= {RESOLVED:g}"
    active = "0.2" if largest == GAMMA else f"sampling, joint {mode.joint}"
    return largest, rule, active


def _require_resolved(mode: Mode, dt: float, delay: float, what: str) -> None:
    if mode.frequency * (dt + delay) > RESOLVED:
        longest = RESOLVED / mode.frequency
        late, turns, cure = "", "a step", f"dt = {longest - delay:.2g} s would do"
        if delay:
            late, turns = f" and a delay of {delay:g} s", "dt + delay"
            if longest <= delay:
                cure = f"no dt would do: a delay below {longest:.2g} s is needed"
        raise ArgumentError(
            f"dt: no stable gains at dt = {dt:g} s{late}: {what} at {mode.frequency:.3g} rad/s at joint "
            f"{mode.joint!r}, and {turns} may turn {RESOLVED:g} rad of it; {cure}. If the arm should be "
            f"slower, check the inertia of that joint's links"
        )


def _by_joint(robot: Robot, masks: Mapping[str, np.ndarray]) -> str:
    """``effort limit: j1, j2; gravity and inertia: j3``, or the one limit that is active for all."""
    parts = []
    for text, mask in masks.items():
        if mask.all():
            return f"{text}: all joints"
        if mask.any():
            parts.append(f"{text}: {', '.join(map(printable, np.array(robot.joint_names)[mask]))}")
    return "; ".join(parts)
