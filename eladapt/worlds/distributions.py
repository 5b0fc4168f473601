"""From which distributions the worlds of a stress test are drawn."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_number
from eladapt.gains.extremes import SAMPLES, configurations, effort, extremes
from eladapt.gains.sensing import Hardware
from eladapt.robot.joint_limits import speed
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION
from eladapt.worlds.world import World

Range = tuple[float, float]
INTEGRATORS = ("rk4", "euler")
HELD = 0.9  # of the efforts that gravity may take where an arm rests or passes
WEAKEST = 0.05  # of the postures, in which the arm holds less than what it is said to carry
WAYPOINTS = np.linspace(0, 1, 7)  # of the way, where the load has to be held
TRIES = 1000  # postures among which one that the arm can hold is looked for
BEFORE, AFTER = 0.1, 0.3  # [s] since the start, and after the arrival, in which loads come and go
OPEN = ("pace",)  # ranges whose low end may not be 0
LOGARITHMIC = ("position_noise", "velocity_noise")


@dataclass(frozen=True)
class Distributions:
    """What worlds are drawn from. A range is (low, high), both alike for what is not to vary.

    Uniform: everything but noise, which is log-uniform. Narrow or widen any of them; all zero leaves the arm
    as its file describes it.
    """

    reach: float = 0.9  # of the joints' ranges, in which starts and goals are, at most a turn
    pace: Range = (0.5, 1.0)  # of the fastest motion within `MotionLimits.for_robot`
    rest: float = 3.0  # [s] after the motion
    loaded: float = 0.75  # probability of a load
    comes: float = 0.3  # that it comes on the way, where there is one
    goes: float = 0.3  # that it goes again
    # Of what the motors hold beside gravity at 95 % of the postures, or all along the way where that is less,
    # and at most the arm's own mass: up to 1.9 kg (panda), 5.5 (ur5), 2.7 (kinova), rated 3, 5, 2.6.
    load: Range = (0.0, 0.5)
    load_centre: Range = (0.0, 0.1)  # [m] from the tool's origin, in any direction
    masses: float = 0.1  # up to which part masses and moments of the URDF are off, by body
    centres: float = 0.01  # [m] up to which their centres are off, along each axis
    # Of the rotor that the effort limit turns at 400 rad/s^2, 0.22 and 0.03 kg m^2 for a Panda (0.2 and 0.07
    # by MuJoCo Menagerie).
    rotors: Range = (0.0, 1.0)
    coulomb: Range = (0.0, 0.02)  # of the effort limit: a Panda has 0.6 to 1.3 N m of 87, 0.3 to 0.8 of 12
    viscous: Range = (0.0, 0.05)  # of the effort limit, at the speed limit
    position_noise: Range = (1e-6, 3e-5)  # [rad] encoders of 20 to 17 bits have 2e-6 to 1.4e-5
    velocity_noise: Range = (1e-4, 2e-3)  # [rad/s] behind the drive's filter
    delay: Range = (0.0, 2e-3)  # [s] beyond the step; in whole steps when simulated
    velocity_lag: Range = (0.0, 3e-3)  # [s]
    told: float = 0.2  # up to which part commissioning is off about noise, delay and lag
    jitter: Range = (0.0, 0.1)  # of a step, by which it lasts longer or shorter, as its stamp says
    tilt: float = 0.0175  # [rad] up to which the base is not level, 1 degree
    integrators: tuple[Literal["rk4", "euler"], ...] = ("rk4",)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, name = getattr(self, field.name), field.name
            if name == "integrators":
                _check_integrators(value)
            elif isinstance(field.default, tuple):
                object.__setattr__(self, name, _range(name, value))
            else:
                high = np.finfo(float).max if name in ("rest", "centres") else 1.0
                object.__setattr__(self, name, require_number(name, value, 0, high, closed=True))
        if not self.reach > 0:
            raise ArgumentError(f"reach: expected above 0, so that there are postures, got {self.reach:g}")
        if self.masses >= 1:
            raise ArgumentError(
                f"masses: expected below 1, the part of itself by which a mass may be off, got "
                f"{self.masses:g}: that makes bodies without mass"
            )
        for name in ("pace", "jitter"):
            if getattr(self, name)[1] > 1 or (name == "jitter" and self.jitter[1] == 1):
                raise ArgumentError(f"{name}: expected at most 1, got {getattr(self, name)}")

    def world(self, robot: Robot, seed: int) -> World:
        """The world of this seed, the same ever again. Raises ArgumentError for an arm that cannot be held
        anywhere."""
        rng, arm = np.random.default_rng(seed), facts(robot)
        start, goal = (self._posture(robot, rng) for _ in range(2))
        pace = rng.uniform(*self.pace)
        world = World(
            seed=seed, start=start, goal=goal, pace=pace, rest=self.rest,
            load=0.0, load_centre=(0.0, 0.0, 0.0), attach=0.0, release=np.inf,
            masses=_plain(1 + rng.uniform(-self.masses, self.masses, robot.nv)),
            centres=tuple(map(_plain, rng.uniform(-self.centres, self.centres, (robot.nv, 3)))),
            rotors=_plain(rng.uniform(*self.rotors, robot.nv) * arm.effort / ASSUMED_ROTOR_ACCELERATION),
            coulomb=_plain(_alike(rng, self.coulomb, robot.nv) * arm.effort),
            viscous=_plain(_alike(rng, self.viscous, robot.nv) * arm.effort / arm.speed),
            position_noise=_drawn(rng, self.position_noise), velocity_noise=_drawn(rng, self.velocity_noise),
            delay=rng.uniform(*self.delay), velocity_lag=rng.uniform(*self.velocity_lag),
            jitter=rng.uniform(*self.jitter), tilt=_tilted(rng, self.tilt),
            integrator=self.integrators[rng.integers(len(self.integrators))], told=Hardware(),
        )  # fmt: skip
        told = {name: getattr(world, name) * rng.uniform(1 - self.told, 1 + self.told) for name in TOLD}
        world = dataclasses.replace(world, told=Hardware(**told))
        return dataclasses.replace(world, **self._load(robot, arm, world, rng))

    def _posture(self, robot: Robot, rng: np.random.Generator) -> tuple[float, ...]:
        """Joint coordinates of one that the arm can hold."""
        lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
        middle, half = (lower + upper) / 2, self.reach * (upper - lower) / 2
        for _ in range(TRIES):
            x = rng.uniform(middle - half, middle + half)
            if np.all(np.abs(robot.gravity(robot.configuration(x))) <= HELD * facts(robot).effort):
                return _plain(x)
        raise ArgumentError(
            f"robot: {robot.name!r} can be held in none of {TRIES} postures; expected efforts beyond gravity"
        )

    def _load(self, robot: Robot, arm: Facts, world: World, rng: np.random.Generator) -> dict[str, Any]:
        """Mass, centre and times, as the world has them. Always draws the same number of times."""
        loaded, comes, goes = rng.random(3) < (self.loaded, self.comes, self.goes)
        share, distance, direction = (
            rng.uniform(*self.load),
            rng.uniform(*self.load_centre),
            rng.normal(size=3),
        )
        times = np.sort(rng.random(2))
        centre = _plain(distance * direction / np.linalg.norm(direction))
        if not loaded or not share:
            return {}
        motion = world.motion(robot)
        way = [motion(part * motion.duration).q for part in WAYPOINTS]
        mass = share * min(arm.carries, *(capacity(robot, q, centre, arm.effort) for q in way))
        attach, release = BEFORE + times * (motion.duration + AFTER - BEFORE)
        if mass <= 0:
            return {}
        return {
            "load": float(mass), "load_centre": centre,
            "attach": float(attach) if comes else 0.0, "release": float(release) if goes else np.inf,
        }  # fmt: skip


TOLD = ("position_noise", "velocity_noise", "delay", "velocity_lag")  # stamps say how long a step lasted


class Facts(NamedTuple):
    """What distributions need to know of an arm."""

    effort: np.ndarray  # (nv,) [N m]
    speed: np.ndarray  # (nv,) [rad/s]
    carries: float  # [kg]


@functools.lru_cache(maxsize=8)
def facts(robot: Robot) -> Facts:
    """Limits, and the load that the motors hold at most postures."""
    limit = effort(robot, extremes(robot))
    nothing = (0.0, 0.0, 0.0)
    held = [capacity(robot, q, nothing, limit) for q in configurations(robot, SAMPLES, 0)]
    some = [mass for mass in held if mass > 0]
    own = sum(body.mass for body in list(robot.model.inertias)[1:])
    carries = min(float(np.quantile(some, WEAKEST, method="lower")), own) if some else 0.0
    return Facts(limit, speed(robot.velocity_limit), carries)


def capacity(robot: Robot, q: np.ndarray, centre: Sequence[float], limit: np.ndarray) -> float:
    """[kg] that the arm holds at q (nq,) with ``centre`` [m] in the tool's frame; negative where it does not
    even hold itself."""
    model = robot.model
    data, frame = model.createData(), frame_index(model, robot.tool)
    placement = model.frames[frame].placement * pin.SE3(np.eye(3), np.array(centre))
    joint = model.frames[frame].parentJoint
    pin.computeJointJacobians(model, data, q)
    at = pin.SE3(np.eye(3), data.oMi[joint].rotation @ placement.translation)
    jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
    pull = at.toActionMatrixInverse()[:3] @ jacobian  # of the centre
    each = -pull.T @ model.gravity.linear  # [N m] a kilogram
    left = HELD * limit - np.sign(each) * robot.gravity(q)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.min(np.where(np.abs(each) > 1e-9, left / np.abs(each), np.inf)))


def _plain(x: np.ndarray) -> Any:
    return tuple(map(float, x))


def _drawn(rng: np.random.Generator, given: Range) -> float:
    """Log-uniform, or the number that both ends are."""
    low, high = given
    share = rng.random()
    return float(low) if low == high else float(low * (high / low) ** share)


def _alike(rng: np.random.Generator, given: Range, nv: int) -> np.ndarray:
    """(nv,) shares: a level that all joints have in common, and half to all of it in each; never below the
    low end."""
    low, high = given
    return low + rng.uniform(0, high - low) * rng.uniform(0.5, 1.0, nv)


def _tilted(rng: np.random.Generator, most: float) -> tuple[float, float]:
    """By an angle up to ``most`` about any level axis."""
    angle, axis = rng.uniform(0, most), rng.uniform(0, 2 * np.pi)
    return float(angle * np.cos(axis)), float(angle * np.sin(axis))


def _range(name: str, given: Any) -> Range:
    """(low, high). Raises ArgumentError for what is none, or makes no world."""
    if not isinstance(given, Sequence) or len(given) != 2:
        raise ArgumentError(f"{name}: expected a range (low, high), got {given!r}; (x, x) for a fixed one")
    low, high = (require_number(name, end, 0, np.finfo(float).max, closed=True) for end in given)
    if low > high:
        raise ArgumentError(f"{name}: expected low <= high, got ({low:g}, {high:g})")
    if name in OPEN and low == 0:
        raise ArgumentError(f"{name}: expected above 0, got ({low:g}, {high:g})")
    if name in LOGARITHMIC and low == 0 < high:
        raise ArgumentError(
            f"{name}: is drawn log-uniformly, expected (0, 0) or ends above 0, got ({low:g}, {high:g})"
        )
    return low, high


def _check_integrators(given: Any) -> None:
    if not isinstance(given, tuple) or not given or any(name not in INTEGRATORS for name in given):
        raise ArgumentError(f"integrators: expected a tuple of {' and '.join(INTEGRATORS)}, got {given!r}")
