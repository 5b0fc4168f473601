"""The composite controller regulates arms that it knows no gravity of, and is a pure function."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError


def move(name: str, duration: float = 4.0) -> ea.Record:
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return ea.simulate(controller, plant, robot.configuration(robot.target), duration, progress=False)


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5", "kinova", "asr_twodof"])
def test_regulates_without_knowledge_of_gravity(name):
    """From theta_U = 0, gains from the URDF: below 1e-3 rad within 4 s and to rounding later."""
    record = move(name)
    metrics = record.metrics()
    assert metrics.settling_time < 4
    assert metrics.steady_error < 1e-5
    assert metrics.chatter < 1e-3
    assert np.all(np.abs(record.tau) <= record.effort_limit)


def test_learns_gravity_where_it_moved():
    """Panda: every gravity parameter within 1 % after one move."""
    assert move("panda").parameter_settling() < 4


@pytest.fixture(scope="module")
def loop():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return robot, controller, plant


def test_step_is_pure(loop):
    """The same state and measurement give the same result, and leave the state as it was."""
    robot, controller, plant = loop
    measurement = plant.reset()
    state, goal = controller.init(measurement), robot.configuration(robot.target)
    for _ in range(20):
        state, tau = controller.step(state, measurement, goal, 1e-3)
        measurement = plant.step(tau, 1e-3)
    before = [np.array(a, copy=True) for a in (state.theta, state.filters.omega, state.information.triangle)]
    first, one = controller.step(state, measurement, goal, 1e-3)
    second, other = controller.step(state, measurement, goal, 1e-3)
    assert np.array_equal(one, other)
    assert np.array_equal(first.theta, second.theta)
    after = (state.theta, state.filters.omega, state.information.triangle)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_a_repeated_sample_advances_nothing(loop):
    """The first step after init, and a packet that comes twice, are the same sample."""
    robot, controller, plant = loop
    measurement = plant.reset()
    state, goal = controller.init(measurement), robot.configuration(robot.target)
    again, _ = controller.step(state, measurement, goal, 1e-3)
    assert again is state


def test_applied_torque_counts_not_the_commanded_one():
    """An arm whose torque is clipped far below the command still learns its gravity."""
    robot = load("two_link")
    limit = np.array([5.2, 0.85])
    derived = ea.CompositeController.for_robot(robot)
    controller = ea.CompositeController(
        derived.regressors, derived.regression, derived.extension, derived.mixing, derived.law,
        derived.control, effort_limit=limit,
    )  # fmt: skip
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, plant, goal, 4.0, progress=False)
    clipped = np.mean(np.any(np.abs(record.tau) == limit, axis=1))
    assert clipped > 0.005, "the limit never mattered"
    assert record.parameter_settling() < 4
    assert record.settling_time() < 4


@pytest.mark.parametrize(
    ("field", "bad", "said"),
    [
        ("q", np.zeros(3), r"measurement.q: expected shape \(2,\)"),
        ("v", np.array([0.0, np.nan]), "measurement.v: expected finite"),
        ("tau", np.array([np.inf, 0.0]), "measurement.tau: expected finite"),
        ("t", np.nan, "measurement.t"),
        ("t", -1.0, "measurement.t: expected 0.0 s or later"),
    ],
)
def test_bad_measurements_are_named(loop, field, bad, said):
    robot, controller, plant = loop
    measurement = plant.reset()
    state = controller.init(measurement)
    with pytest.raises(ArgumentError, match=said):
        controller.step(state, measurement._replace(**{field: bad}), robot.configuration([0, 0]), 1e-3)


@pytest.mark.parametrize(
    ("goal", "dt", "said"), [([1.0], 1e-3, "goal"), ([np.nan, 0], 1e-3, "goal"), ([0, 0], 0, "dt")]
)
def test_bad_goals_and_steps_are_named(loop, goal, dt, said):
    _, controller, plant = loop
    measurement = plant.reset()
    with pytest.raises(ArgumentError, match=said):
        controller.step(controller.init(measurement), measurement, np.array(goal), dt)


def test_parts_that_do_not_fit_are_refused(loop):
    _, derived, _ = loop
    parts = [derived.regressors, derived.regression, derived.extension, derived.mixing, derived.law]
    with pytest.raises(ArgumentError, match="c = b"):
        ea.CompositeController(*parts, ea.FiniteTimePD(3, 2, r1=1.2))
    with pytest.raises(ArgumentError, match=r"P: expected a scalar or shape \(2,\)"):
        ea.CompositeController(*parts, ea.FiniteTimePD([3, 2, 1], 2))
    law = ea.CompositeLaw(Gamma=[1, 2])
    with pytest.raises(ArgumentError, match="one common value"):
        ea.CompositeController(*parts[:4], law, derived.control)
    with pytest.raises(ArgumentError, match="theta0"):
        derived.init(loop[2].reset(), theta0=[1.0])
