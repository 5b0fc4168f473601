"""Torque limits: respected by the command, and no reason to learn what is not true."""

import dataclasses

import numpy as np
from shared import DT, load

import eladapt as ea

SHARE = 1.3  # of the effort that the two-link arm's own gravity needs


def weak(name: str) -> ea.Robot:
    """The arm with effort limits little above its gravity, so that the controller saturates."""
    robot = load(name)
    rng = np.random.default_rng(0)
    need = np.max([np.abs(robot.gravity(robot.random_configuration(rng))) for _ in range(200)], axis=0)
    model = robot.model.copy()
    model.upperEffortLimit, model.lowerEffortLimit = SHARE * need, -SHARE * need
    return dataclasses.replace(robot, model=model)


def test_a_saturated_arm_learns_its_gravity_all_the_same():
    """Limits of 1.3 times gravity, which is first believed forty times as large and upside down: torque is
    clipped, gravity at the goal learned within 1 %, the goal reached, and no limit exceeded."""
    robot = weak("two_link")
    controller = ea.CompositeController.for_robot(robot)
    np.testing.assert_array_equal(controller.effort_limit, robot.effort_limit)
    start = -40 * controller.regressors.theta_potential
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, plant, goal, 4.0, theta0=start, progress=False)
    assert np.all(np.abs(record.tau) <= robot.effort_limit)
    assert np.mean(np.any(np.abs(record.tau) == robot.effort_limit, axis=1)) > 0.01, "it never saturated"
    psi = controller.regressors.gravity(record.q[-1])
    bound = np.abs(psi @ controller.regressors.theta_potential).max()
    assert np.abs(psi @ record.theta_error[-1]).max() < 0.01 * bound
    assert record.settling_time() < 4


def step_theta(applied: np.ndarray) -> np.ndarray:
    """The change of theta_U over one step with errors and velocities in both joints; indirect term off."""
    robot = weak("two_link")
    controller = ea.CompositeController.for_robot(robot)
    law = dataclasses.replace(controller.law, indirect=False)
    controller = dataclasses.replace(controller, law=law)
    q, v = robot.configuration([0.4, 0.3]), np.array([0.5, -0.2])
    state = controller.init(ea.Measurement(0.0, q, v, np.zeros(2)))
    state, _ = controller.step(state, ea.Measurement(DT, q, v, applied), robot.configuration([0, 0]), DT)
    return state.theta - controller.regressors.theta_potential


def test_the_direct_term_rests_in_the_joint_that_is_clipped():
    """What a joint that cannot do more does wrong says nothing of gravity; the other joint still teaches."""
    robot = weak("two_link")
    limit = robot.effort_limit
    free, one, both = (step_theta(applied) for applied in (0.5 * limit, limit * [1, 0.5], limit * [-1, 1]))
    assert np.abs(free).max() > 1e-5, "the direct term should act"
    np.testing.assert_array_equal(both, 0)
    controller = ea.CompositeController.for_robot(robot)
    reg, law = controller.regressors, controller.law
    q, v = robot.configuration([0.4, 0.3]), np.array([0.5, -0.2])
    drive = law.gamma1 * law.d1 * np.tanh([0.4, 0.3]) + (law.gamma1 + law.gamma2) * v
    expected = -DT * law.Gamma * reg.gravity(q)[1] * drive[1]
    # 1e-9: a difference of parameters that hardly changed
    np.testing.assert_allclose(one, expected, rtol=1e-9, atol=1e-12)
