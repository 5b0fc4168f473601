"""The first seconds on an arm: small, slow motion tells what a controller has to know of the hardware."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from eladapt.control.composite import CompositeController
from eladapt.errors import ArgumentError, HardwareError, LogWarning, require_gain, require_number
from eladapt.estimation.friction import FrictionEstimate
from eladapt.estimation.noise import LEAST_SAMPLES, measure_noise
from eladapt.hardware.lateness import reporting_delay, stamp_jitter, velocity_lag
from eladapt.hardware.loop import RobotInterface, require_interface, run_loop
from eladapt.identification.found import Identified
from eladapt.identification.identify import identify
from eladapt.identification.log import Log
from eladapt.regressors.joint_terms import FRICTION_TERMS
from eladapt.robot.model import Robot
from eladapt.safety.gated import GatedController
from eladapt.signals import Measurement, Reference

REST, STILL = 1.5, 0.2  # [s] of rest at the start, and at the end
RAMP = 1.0  # [s] in which motion grows, and fades
EDGE = 0.01  # [rad or m] kept free of a joint's range
SLOWEST, FASTEST = 0.5, 1.1  # [Hz] of the joints' sines, each of its own
SHARE = 0.3  # of a speed limit, at the most
CAREFUL: dict[str, Any] = {
    "position_noise": 1e-4, "velocity_noise": 2e-3, "delay": 5e-3, "velocity_lag": 5e-3,
}  # fmt: skip
DIFFERENT = 0.2  # relative change that is told
SURE = 0.05  # of a friction: a larger standard deviation leaves it unknown
NAMES = ("position_noise", "velocity_noise", "delay", "velocity_lag", "jitter")


@dataclass(frozen=True, eq=False)
class Commissioning:
    """What small motions told. nan: it is not known.

    ``for_robot(robot, dt, **commissioning.hardware)`` takes it into account.
    """

    robot: Robot
    position_noise: np.ndarray  # (nv,) [rad]
    velocity_noise: np.ndarray  # (nv,) [rad/s]
    delay: float  # [s] from a command to the torque that is reported for it
    velocity_lag: float  # [s] of a first-order filter in the measured velocity
    jitter: float  # [s] standard deviation of what time stamps are off by
    friction: FrictionEstimate
    reversed: tuple[str, ...]  # joints whose torque moves them the other way
    found: Identified
    log: Log
    notes: tuple[str, ...] = ()

    @property
    def hardware(self) -> dict[str, Any]:
        """What `CompositeController.for_robot` takes, as far as it is known."""
        return {name: value for name in NAMES if np.all(np.isfinite(value := getattr(self, name)))}

    def changed_since(self, before: Commissioning) -> tuple[str, ...]:
        """What is another than it was then, a sentence each."""
        said = []
        for name in NAMES:
            old, new = (float(np.median(getattr(each, name))) for each in (before, self))
            if np.isfinite(old + new) and abs(new - old) > DIFFERENT * max(abs(old), 1e-6):
                said.append(f"{name}: {old:.3g} then, {new:.3g} now")
        for kind, name in enumerate(FRICTION_TERMS):
            old, new = (getattr(each.friction, name) for each in (before, self))
            spread = np.hypot(before.friction.std[kind], self.friction.std[kind])
            for k in np.flatnonzero(np.abs(new - old) > np.maximum(3 * spread, DIFFERENT * np.abs(old))):
                said.append(f"{name} of {self.robot.joint_names[k]}: {old[k]:.3g} then, {new[k]:.3g} now")
        return tuple(said)

    def __str__(self) -> str:
        def row(name: str, unit: str, value: Any) -> str:
            values = ", ".join("not known" if np.isnan(x) else f"{x:.3g}" for x in np.atleast_1d(value))
            return f"{name:15} {values} {unit}"

        lines = [
            f"commissioning of {self.robot.name}",
            row("position noise", "rad", self.position_noise),
            row("velocity noise", "rad/s", self.velocity_noise),
            row("delay", "s", self.delay),
            row("velocity lag", "s", self.velocity_lag),
            row("jitter", "s", self.jitter),
        ]
        if self.reversed:
            lines.append(f"torque moves the other way: {', '.join(self.reversed)}")
        return "\n".join([*lines, str(self.friction), *self.notes])


def commission(
    robot: Robot,
    interface: RobotInterface,
    *,
    dt: float = 1e-3,
    duration: float = 10.0,
    reach: float | np.ndarray = 0.15,
) -> Commissioning:
    """Move each joint a little, and tell noise, delay, velocity lag, jitter, friction and sign.

    The arm rests for 1.5 s where it is, and then each joint swings about that place by at most ``reach``
    [rad or m], a number or (nv,), within its range and a third of its speed limit, all of them at once;
    ``duration`` [s] in all.
    The controller expects bad hardware meanwhile and stands behind its gate, which ends it with a fault as
    ever. Friction is taken for known where its standard deviation is below 5 % of it.

    Raises ArgumentError for a reach or duration that is too small, HardwareError where the arm did not go
    through with it, with the gate's reason; and what `run_loop` raises.
    """
    reach = require_gain("reach", reach, robot.nv)
    duration = require_number("duration", duration, REST + 3 * RAMP + STILL)
    require_interface(interface)
    heard = Heard(interface)
    motion = Swing(robot, heard, reach, duration)
    result = run_loop(careful(robot, dt), heard, motion, duration, dt, shaped=False)
    if result.fault is not None:
        raise HardwareError(f"commissioning of {robot.name} ended early: {result.fault}")
    return assessed(robot, heard, dt)


def careful(robot: Robot, dt: float) -> GatedController:
    """A controller that expects bad hardware, behind its gate."""
    return GatedController.for_robot(CompositeController.for_robot(robot, dt, **CAREFUL), dt)


class Heard:
    """An interface whose measurements and commands are kept."""

    def __init__(self, interface: RobotInterface):
        self.interface = interface
        self.keeps_clock = bool(getattr(interface, "keeps_clock", False))
        self.measurements: list[Measurement] = []
        self.sent: list[np.ndarray] = []
        self.start, self.stop = interface.start, interface.stop

    def read(self) -> Measurement:
        measurement = self.interface.read()
        if not self.measurements or measurement.t > self.measurements[-1].t:
            self.measurements.append(measurement.copy())
            self.sent.append(np.full(len(measurement.v), np.nan))
        return measurement

    def write(self, tau: np.ndarray) -> None:
        self.sent[-1] = tau.copy()
        self.interface.write(tau)

    def log(self, robot: Robot) -> Log:
        """What was measured, of a robot with these joints; each torque was held over the step before."""
        t, v, tau = (np.array([getattr(m, name) for m in self.measurements]) for name in ("t", "v", "tau"))
        x = np.array([robot.coordinates(m.q) for m in self.measurements])
        return Log(t, x, v, tau, robot.joint_names, held=True)


class Swing:
    """Sines of different frequencies about where the arm was first, that grow from rest and fade to it.

    way = size g(t) sin(w t), with g a smooth step up, and down at the end; the velocity and acceleration are
    its derivatives.
    """

    def __init__(self, robot: Robot, heard: Heard, reach: np.ndarray, duration: float):
        self.robot, self.heard, self.duration = robot, heard, duration
        self.rate = 2 * np.pi * np.linspace(SLOWEST, FASTEST, robot.nv)
        self.size = np.minimum(reach, SHARE * robot.velocity_limit / self.rate)

    def __call__(self, t: float) -> Reference:
        robot, w = self.robot, self.rate
        q0 = self.heard.measurements[0].q
        x = robot.coordinates(q0)
        room = np.minimum(robot.upper - x, x - robot.lower)
        size = np.clip(room - EDGE, 0.0, self.size)
        up, down = smooth_step((t - REST) / RAMP), smooth_step((self.duration - STILL - t) / RAMP)
        g, dg, ddg = (up[0] * down[0], up[1] - down[1], up[2] + down[2])  # the ramps do not overlap
        sine, cosine = np.sin(w * (t - REST)), np.cos(w * (t - REST))
        return Reference(
            robot.integrate(q0, size * g * sine),
            size * (dg / RAMP * sine + g * w * cosine),
            size * ((ddg / RAMP**2 - g * w**2) * sine + 2 * dg / RAMP * w * cosine),
        )


def smooth_step(s: float) -> tuple[float, float, float]:
    """6 s^5 - 15 s^4 + 10 s^3, from 0 to 1 over s in [0, 1], and two derivatives, 0 at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 + s * (6 * s - 15)), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


def assessed(robot: Robot, heard: Heard, dt: float) -> Commissioning:
    """What the measurements and commands of a small motion tell."""
    taken = heard.measurements
    begun = taken[0].t
    rest = [m for m in taken if 0.3 * REST < m.t - begun < REST]
    if len(rest) < LEAST_SAMPLES:
        raise ArgumentError(
            f"dt: expected at least {LEAST_SAMPLES} samples in {0.7 * REST:.2g} s of rest, got {len(rest)}"
        )
    noise = measure_noise(robot, rest)
    log = heard.log(robot)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        found = identify(robot, log, held_out=0, physical=False, progress=False)
    reported = np.array([m.tau for m in taken])
    delay, notes = reporting_delay(np.array(heard.sent), reported, dt), list(found.notes)
    if np.isnan(delay):
        notes.append("delay: what is reported as torque is not what was commanded some cycles before")
    friction = found.friction
    values = np.array([friction.viscous, friction.coulomb, friction.offset])
    friction = friction._replace(known=friction.std < SURE * np.abs(values))
    return Commissioning(
        robot, *noise, delay, velocity_lag(log), stamp_jitter(log, noise.position_noise), friction,
        _reversed(found, log.q[0]), found, log, tuple(notes),
    )  # fmt: skip


def _reversed(found: Identified, x0: np.ndarray) -> tuple[str, ...]:
    """Joints whose inertia at joint coordinates (nv,), as told, is surely negative: torque moves them the
    other way."""
    regressors, robot = found.regressors, found.original
    q, still = robot.configuration(x0), np.zeros(robot.nv)
    rest, names = regressors.torque(q, still, still), []
    for k, name in enumerate(robot.joint_names):
        row = (regressors.torque(q, still, np.eye(robot.nv)[k]) - rest)[k]
        inertia, spread = row @ found.theta, np.sqrt(max(row @ found.covariance @ row, 0.0))
        if inertia < -3 * spread:
            names.append(name)
    return tuple(names)
