"""The composite controller on arms with friction that it is not told."""

import functools

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError


def reach(name: str, rub: ea.Friction, duration: float, **options):
    """Home to target and back on MuJoCo, where friction is a constraint that sticks."""
    pytest.importorskip("mujoco")
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot, DT, **options)
    plant = ea.MujocoPlant(robot, robot.configuration(robot.home), friction=rub)
    goals = robot.configuration(robot.target), robot.configuration(robot.home)
    measurement = plant.reset()
    state, errors = controller.init(measurement), []
    for k in range(round(duration / DT)):
        goal = goals[k * DT >= duration / 2]
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        errors.append(np.abs(robot.difference(goal, measurement.q)))
    return controller, state, np.array(errors)


@functools.cache
def panda():
    return reach("panda", ea.Friction(coulomb=1.0), 5.0)


def test_panda_reaches_its_goals_through_coulomb_friction():
    """1 N m in every joint: within 1e-4 rad at both ends."""
    _, _, errors = panda()
    half = len(errors) // 2
    assert errors[half - 100 : half].max() < 1e-4
    assert errors[-100:].max() < 1e-4


def test_panda_tells_its_friction():
    """Within 0.1 % and three deviations in every joint after two moves, and known so in the wrist."""
    controller, state, _ = panda()
    estimate = ea.friction(controller, state)
    np.testing.assert_allclose(estimate.coulomb, 1.0, rtol=1e-3)
    assert np.all(np.abs(estimate.coulomb - 1.0) < 3 * estimate.std[1])
    assert estimate.known[1, 4:].all()


@pytest.mark.parametrize("rows", ["friction", "offset"])
def test_friction_that_cannot_be_is_not_learned(rows):
    """However wrong the torque that is reported: friction that drives, or an offset of a third of the effort
    limit. What theta holds is possible at every step."""
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    reg, limit = controller.regressors, controller.gains.offset_limit / 0.2
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state, goal, learned = controller.init(measurement), robot.configuration(robot.target), []
    for _ in range(1500):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        wrong = 0.1 * limit * np.sign(measurement.v) if rows == "friction" else limit / 3
        measurement = measurement._replace(tau=measurement.tau - wrong)
        learned.append(state.parameters / reg.scale)
    learned = np.array(learned)
    assert learned[:, reg.block("coulomb")].min() >= -1e-3 * limit.max()
    assert learned[:, reg.block("viscous")].min() >= -1e-3 * limit.max()
    offset = np.abs(learned[:, reg.block("offset")]) / limit
    assert offset.max() < 0.2 + 1e-9  # rounding
    assert rows == "friction" or offset.max() > 0.2 - 1e-9, "the bound was reached"


def test_columns_cost_nothing_without_friction():
    """Two links without friction: the goal is reached, friction found to be none."""
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 3.0, progress=False)
    assert record.metrics().steady_error < 1e-5
    # 1e-2: of the 14 N m that the shoulder can make
    assert np.abs(ea.friction(controller, record.final_state).coulomb).max() < 1e-2


def test_no_friction_columns_no_estimate():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot, joint_terms=())
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    with pytest.raises(ArgumentError, match="no friction columns"):
        ea.friction(controller, controller.init(plant.reset()))


def test_step_is_pure():
    """The same state and measurement give the same torque, in the midst of friction."""
    controller, state, _ = panda()
    goal = controller.robot.configuration(controller.robot.target)
    measurement = state.measurement._replace(t=state.measurement.t + DT)
    _, one = controller.step(state, measurement, goal, DT)
    _, other = controller.step(state, measurement, goal, DT)
    np.testing.assert_array_equal(one, other)
