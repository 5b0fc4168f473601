"""One world: an arm that is not quite its URDF, what it carries, and how it is measured and driven."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

from eladapt.gains.sensing import Hardware
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import Motion, move
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Plant
from eladapt.simulation.disturbances import Friction, Noise, Payload
from eladapt.simulation.faults import Jitter
from eladapt.simulation.instruments import Delay, FilteredVelocity, NoisyReadings
from eladapt.simulation.plants import PinocchioPlant

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class World:
    """All that a rollout depends on beside robot and controller, in plain numbers; see `Distributions`.

    Tuples have a number a joint, in the robot's order. The controller knows ``told`` and the robot's file;
    everything else it has to find out.
    """

    seed: int
    start: Numbers  # [rad or m] joint coordinates
    goal: Numbers
    pace: float  # of the fastest motion within the arm's limits, in (0, 1]
    rest: float  # [s] at the goal
    load: float  # [kg] at the tool; 0: none
    load_centre: tuple[float, float, float]  # [m] in the tool's frame
    attach: float  # [s]
    release: float  # [s] inf: never
    masses: Numbers  # of the URDF's masses and moments, by body
    centres: tuple[tuple[float, float, float], ...]  # [m] by which the URDF's centres of mass are off
    rotors: Numbers  # [kg m^2] that the URDF does not have
    coulomb: Numbers  # [N m]
    viscous: Numbers  # [N m s/rad]
    position_noise: float  # [rad] standard deviation
    velocity_noise: float  # [rad/s]
    delay: float  # [s] from a command to its torque, beyond the step
    velocity_lag: float  # [s] of the filter in the measured velocity
    jitter: float  # of a step, by which it lasts longer or shorter
    tilt: tuple[float, float]  # [rad] of the base about its x and y axes
    integrator: Literal["rk4", "euler"]
    told: Hardware  # what commissioning measured of noise, delay and lag

    def motion(self, robot: Robot) -> Motion:
        """From start to goal at this pace. Raises what `move` raises."""
        start, goal = robot.configuration(self.start), robot.configuration(self.goal)
        limits = motion_limits(robot)
        fastest = move(robot, start, goal, limits)
        if self.pace == 1:
            return fastest
        return move(robot, start, goal, limits, duration=fastest.duration / self.pace)

    @property
    def payload(self) -> Payload | None:
        """What the arm carries for a while."""
        if not self.load:
            return None
        return Payload(self.load, self.load_centre, attach=self.attach, release=self.release)

    def arm(self, robot: Robot) -> Robot:
        """The arm that the robot's file describes not quite: masses, centres, rotors and base."""
        model = robot.model.copy()
        for k, (share, shift) in enumerate(zip(self.masses, self.centres, strict=True), 1):
            body = model.inertias[k]
            moved = body.lever + np.array(shift)
            model.inertias[k] = pin.Inertia(share * body.mass, moved, share * body.inertia)
        model.armature = model.armature + np.array(self.rotors)
        tilted = pin.rpy.rpyToMatrix(*self.tilt, 0.0)
        model.gravity.linear = tilted.T @ model.gravity.linear
        return dataclasses.replace(robot, model=model)

    def plant(self, robot: Robot, dt: float) -> Plant:
        """That arm, driven and measured as in this world, for steps of dt [s]."""
        arm = self.arm(robot)
        friction = Friction(np.array(self.viscous), np.array(self.coulomb))
        plant: Plant = PinocchioPlant(
            arm, arm.configuration(self.start), friction=friction, payload=self.payload,
            integrator=self.integrator,
        )  # fmt: skip
        if self.jitter:
            plant = Jitter(plant, (1 - self.jitter) * dt, (1 + self.jitter) * dt, seed=self.seed)
        if self.delay:
            plant = Delay(plant, self.delay)
        if self.velocity_lag:
            plant = FilteredVelocity(plant, self.velocity_lag)
        noise = Noise(self.position_noise, self.velocity_noise)
        return NoisyReadings(plant, noise, self.seed)


@functools.lru_cache(maxsize=8)
def motion_limits(robot: Robot) -> MotionLimits:
    """`MotionLimits.for_robot`, once a robot."""
    return MotionLimits.for_robot(robot)
