"""What several tests look at: the robots, and one closed-loop move of each."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

import eladapt as ea

# Every kind of joint and parameter: planar, 6 and 7 joints, continuous joints, rotors.
ROBOTS = (
    "two_link", "double_pendulum", "panda", "ur5", "ur10", "xarm7", "kinova", "z1", "talos_left_arm",
)  # fmt: skip
DT = 1e-3
STEPS = 600


@functools.cache
def load(name: str) -> ea.Robot:
    return ea.Robot.load(name)


@functools.cache
def regressors(name: str, sharing: str = "shared", joint_terms: tuple[str, ...] = ()) -> ea.Regressors:
    return ea.Regressors(load(name), sharing=sharing, joint_terms=joint_terms)


def link(name, inertia=0.01):
    values = " ".join(f'{key}="{inertia}"' for key in ("ixx", "iyy", "izz"))
    return (
        f'<link name="{name}"><inertial><origin xyz=".1 .3 .2" rpy="1 2 3"/><mass value="2"/>'
        f'<inertia {values} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name, kind, parent, child, lower=-3):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz=".1 0 .2" rpy=".3 .2 .7"/><axis xyz="0 1 2"/>'
        f'<limit lower="{lower}" upper="3" effort="10" velocity="1"/></joint>'
    )


# Two branches, with joints of every kind off the axes, in another order than Pinocchio's.
TREE = (
    '<robot name="tree">'
    + "".join(map(link, ("base", "a", "b", "c", "d", "e")))
    + joint("z", "revolute", "base", "a") + joint("k", "revolute", "a", "b", 0.5)
    + joint("s", "prismatic", "b", "c", 0.4) + joint("m", "continuous", "base", "d")
    + joint("p", "prismatic", "d", "e", 3) + "</robot>"
)  # fmt: skip


class Trajectory(NamedTuple):
    reg: ea.Regressors
    measurements: list[ea.Measurement]


def closed_loop(name: str, v0: float, friction: bool = False) -> Trajectory:
    """A regulation move of the composite controller at 1 kHz, from velocity v0 in every joint."""
    robot = load(name)
    rub = ea.Friction(viscous=robot.damping + 0.3) if friction else None
    start = robot.configuration(robot.home)
    plant = ea.PinocchioPlant(robot, start, np.full(robot.nv, v0), friction=rub, substeps=10)
    controller = ea.CompositeController.for_robot(robot)
    goal = robot.configuration(robot.target)
    measurement = plant.reset()
    state, measurements = controller.init(measurement), [measurement]
    for _ in range(STEPS):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        measurements.append(measurement)
    return Trajectory(regressors(name, "shared", ("viscous", "coulomb") if friction else ()), measurements)
