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

from eladapt.control.sensing import Hardware, choose_floor, choose_horizon
from eladapt.errors import ArgumentError, UnknownNameError, require_gain, require_number
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot

SAMPLES = 200  # configurations over which the extremes of M and g are taken
# Part of a radian that the fastest motion which only sampled feedback sees may turn in one step. At 1 kHz the
# published arms stay below 0.17 (so_arm101), and explicit feedback of a mode diverges at 2.
RESOLVED = 0.3
GAMMA, GAMMA_LEAST = 0.2, 0.002
IDEAL = Hardware()
FLOOR_SAMPLES = 20  # configurations over which the information that noise makes is taken


class Rule(NamedTuple):
    """Where a gain comes from."""

    gain: str
    value: str
    rule: str
    active: str  # the limit that was active, or how the gain was given


@dataclass(frozen=True, eq=False)
class Gains:
    """What `CompositeController.for_robot` uses; arrays are (nv,). ``str()`` is a table of the rules."""

    P: np.ndarray  # [N m/rad^(1/3)]
    D: np.ndarray  # [N m (s/rad)^(1/2)]
    D_L: np.ndarray  # [N m s/rad]
    horizon: float  # [s] of the semi-implicit law
    pole: float  # [1/s]
    row_weight: np.ndarray  # [1/(N m)]
    alpha: float  # [1/s]
    beta: float  # [1/s]
    xi: float
    f0: float
    Gamma: float
    Upsilon: float
    rules: tuple[Rule, ...]

    def __str__(self) -> str:
        cells = [Rule._fields, *self.rules]
        widths = [max(len(row[k]) for row in cells) for k in range(3)]
        lines = [
            "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[3]]) for row in cells
        ]
        return "\n".join(line.rstrip() for line in lines)


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


class Extremes(NamedTuple):
    """Largest values over sampled configurations, by joint: estimates, not bounds."""

    gravity: np.ndarray  # (nv,) max |g_i| [N m]
    inertia: np.ndarray  # (nv,) max M_ii [kg m^2]


class Mode(NamedTuple):
    """The fastest motion that only sampled feedback sees, over sampled configurations."""

    frequency: float  # [rad/s]
    joint: str  # the one that moves most in it


def extremes(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> Extremes:
    """Over configurations within the joint limits."""
    configurations = _configurations(robot, samples, seed)
    gravity = np.max([np.abs(robot.gravity(q)) for q in configurations], axis=0)
    inertia = np.max([np.diag(robot.mass_matrix(q)) for q in configurations], axis=0)
    return Extremes(gravity, inertia)


def effort(robot: Robot, largest: Extremes) -> np.ndarray:
    """(nv,) [N m] the URDF's effort limits; where it sets none, max(3 max|g_i|, 20 max M_ii)."""
    assumed = np.maximum(3 * largest.gravity, 20 * largest.inertia)
    return np.where(np.isfinite(robot.effort_limit), robot.effort_limit, assumed)


def adaptation_mode(regressors: Regressors, Gamma: float, samples: int = SAMPLES, seed: int = 0) -> Mode:
    """omega^2 = lambda_max(M^-1 Psi Gamma Psi'): the direct term acts as a spring on the arm."""
    robot, fastest = regressors.robot, Mode(0.0, regressors.robot.joint_names[0])
    for q in _configurations(robot, samples, seed):
        psi = regressors.gravity(q)
        scale = np.linalg.inv(np.linalg.cholesky(robot.mass_matrix(q)))
        stiffness = scale @ (Gamma * psi @ psi.T) @ scale.T
        values, vectors = np.linalg.eigh(stiffness)
        frequency = float(np.sqrt(max(values[-1], 0.0)))
        if frequency > fastest.frequency:
            motion = np.abs(scale.T @ vectors[:, -1])
            fastest = Mode(frequency, robot.joint_names[int(np.argmax(motion))])
    return fastest


def fall_mode(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> Mode:
    """omega^2 = lambda_max(M^-1 dg/dq): how fast gravity changes under an arm between two samples."""
    fastest, step = Mode(0.0, robot.joint_names[0]), 1e-6
    for q in _configurations(robot, samples, seed):
        columns = [
            robot.gravity(robot.integrate(q, e)) - robot.gravity(robot.integrate(q, -e))
            for e in step * np.eye(robot.nv)
        ]
        values, vectors = np.linalg.eig(
            np.linalg.solve(robot.mass_matrix(q), np.array(columns).T / (2 * step))
        )
        k = int(np.argmax(np.abs(values)))
        frequency = float(np.sqrt(np.abs(values[k])))
        if frequency > fastest.frequency:
            fastest = Mode(frequency, robot.joint_names[int(np.argmax(np.abs(vectors[:, k])))])
    return fastest


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
            checked = require_gain(name, given[name], size)
            derived = checked if size else float(checked)
            rule, active = "given by the caller", "given"
        rules.append(Rule(name, _short(derived), rule, active))
        return derived

    spare, reserve, wanted = limit - gravity, 0.6 * limit, 4 * gravity + 60 * inertia
    available = np.maximum(spare, reserve)
    P = settle(
        "P", np.minimum(available, wanted), "min(max(effort - max|g|, 0.6 effort), 4 max|g| + 60 max M)",
        _by_joint(robot, {
            "effort limit": (available <= wanted) & (spare >= reserve) & ~assumed,
            "0.6 of the effort limit": (available <= wanted) & (spare < reserve) & ~assumed,
            "effort assumed as max(3 max|g|, 20 max M), URDF sets none": (available <= wanted) & assumed,
            "gravity and inertia": available > wanted,
        }),
    )  # fmt: skip
    D = settle(
        "D", 1.5 * P**0.75 * inertia**0.25, "1.5 P^(3/4) max M^(1/4): the same damping at any amplitude"
    )
    D_L = settle("D_L", 0.1 * D, "0.1 D")
    horizon = settle("horizon", *choose_horizon(hardware, inertia, limit, dt))
    pole = settle("pole", 20.0, "20 1/s: a tenth of a second of motion in the filters")
    row_weight = settle("row_weight", 1 / limit, "1 / effort limit: rows of equal size")
    alpha = settle("alpha", 1.0, "1 1/s on scaled columns")
    beta = settle("beta", 5.0, "5 1/s: forgets in 0.2 s what is known better than needed")
    postures = _configurations(robot, FLOOR_SAMPLES, 0)
    xi = settle("xi", *choose_floor(regressors, hardware, postures, row_weight, (pole, alpha, beta)))
    f0 = settle("f0", 1e-3, "1e-3: the prior is worth a millisecond of motion")
    Gamma = settle("Gamma", *_adaptation_gain(regressors, dt, hardware.delay))
    # |theta_U| is about max |g| in scaled columns: its fractional term arrives within about 0.3 s.
    rate = np.sqrt(3 * max(gravity.max(), 1e-3)) / 0.045
    Upsilon = settle("Upsilon", rate / Gamma, "Gamma Upsilon = sqrt(3 max|g|) / 0.045: arrives within 0.3 s")
    _require_resolved(fall_mode(robot), dt, hardware.delay, "gravity changes")
    return Gains(
        P, D, D_L, horizon, pole, row_weight, alpha, beta, xi, f0, Gamma, Upsilon, rules=tuple(rules)
    )


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


def _configurations(robot: Robot, samples: int, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [robot.random_configuration(rng) for _ in range(samples)]


def _by_joint(robot: Robot, masks: Mapping[str, np.ndarray]) -> str:
    """``effort limit: j1, j2; gravity and inertia: j3``, or the one limit that is active for all."""
    parts = []
    for text, mask in masks.items():
        if mask.all():
            return f"{text}: all joints"
        if mask.any():
            parts.append(f"{text}: {', '.join(np.array(robot.joint_names)[mask])}")
    return "; ".join(parts)


def _short(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=3, separator=", ", max_line_width=200)
