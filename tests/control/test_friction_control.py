"""The composite controller on arms with friction that it is not told."""

import functools

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError


def reach(name: str, rub: ea.Friction, duration: float, **options):
    """One move on MuJoCo, where friction is a constraint that sticks."""
    pytest.importorskip("mujoco")
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot, DT, **options)
    plant = ea.MujocoPlant(robot, robot.configuration(robot.home), friction=rub)
    goal, measurement = robot.configuration(robot.target), plant.reset()
    state, errors = controller.init(measurement), []
    for _ in range(round(duration / DT)):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        errors.append(np.abs(robot.difference(goal, measurement.q)))
    return controller, state, np.array(errors)


@functools.cache
def panda():
    return reach("panda", ea.Friction(coulomb=1.0), 2.0, friction=True)


def test_panda_reaches_its_goal_through_coulomb_friction():
    """1 N m in every joint, twice what the last joint's P makes at 1 rad: below 5e-3 rad all the same."""
    _, _, errors = panda()
    assert errors[-200:].max() < 5e-3


def test_panda_tells_its_friction():
    """Coulomb friction within 3 % in every joint, viscous within 0.05 N m s/rad, after one move."""
    controller, state, _ = panda()
    estimate = controller.friction(state)
    assert estimate.known.all()
    np.testing.assert_allclose(estimate.coulomb, 1.0, rtol=0.03)
    np.testing.assert_allclose(estimate.viscous, 0.003, atol=0.05)


def test_without_columns_the_last_joint_stays_behind():
    """The same arm without feed-forward stops where friction holds it."""
    _, _, errors = reach("panda", ea.Friction(coulomb=1.0), 1.0, friction=True, friction_feedforward=False)
    assert errors[-1, 6] > 0.1


def test_columns_cost_nothing_without_friction():
    """Two links without friction, controller with columns: the goal is reached, friction found to be none."""
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot, friction=True)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 2.0, progress=False)
    assert record.metrics().steady_error < 5e-4


def test_no_friction_no_estimate():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    assert controller.compensation is None
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    state = controller.init(plant.reset())
    assert state.compensation is None
    with pytest.raises(ArgumentError, match="no friction columns"):
        controller.friction(state)


def test_step_is_pure():
    """With feed-forward too: the same state and measurement give the same torque."""
    controller, state, _ = panda()
    goal = controller.robot.configuration(controller.robot.target)
    measurement = state.measurement._replace(t=state.measurement.t + DT)
    _, one = controller.step(state, measurement, goal, DT)
    _, other = controller.step(state, measurement, goal, DT)
    np.testing.assert_array_equal(one, other)
