"""What the controller makes of time: samples that are late, missing, repeated or impossible."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

DT = 1e-3


@pytest.fixture(scope="module")
def loop() -> tuple[ea.CompositeController, list[ea.Measurement], list]:
    """A controller, its measurements over 0.3 s of a move, and its states."""
    robot = load("ur5")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal, measurement = robot.configuration(robot.target), plant.reset()
    measurements, states, state = [], [], controller.init(measurement)
    for _ in range(300):
        state, tau = controller.step(state, measurement, goal, DT)
        measurements.append(measurement)
        states.append(state)
        measurement = plant.step(tau, DT)
    return controller, measurements, states


def goal_of(controller: ea.CompositeController) -> np.ndarray:
    return controller.robot.configuration(controller.robot.target)


def misfit(controller: ea.CompositeController, state) -> float:
    """How far the filtered regression is from the true parameters, relative to the torque in it."""
    y, omega = state.regression
    return float(np.abs(y - omega @ controller.regressors.theta).max() / max(np.abs(y).max(), 1e-12))


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf, "soon", 0.0101])
def test_an_impossible_step_is_refused(loop, dt):
    """Not positive, not finite, not a number, or above ten times the step that the gains were made for."""
    controller, measurements, states = loop
    with pytest.raises(ArgumentError, match="dt: expected"):
        controller.step(states[100], measurements[101], goal_of(controller), dt)


def test_time_that_runs_back_is_refused(loop):
    controller, measurements, states = loop
    with pytest.raises(ArgumentError, match=r"measurement.t: expected .* or later"):
        controller.step(states[100], measurements[99], goal_of(controller), DT)


def test_the_same_sample_twice_changes_nothing(loop):
    """A duplicated packet: the same state and the same torque."""
    controller, measurements, states = loop
    state, tau = controller.step(states[100], measurements[100], goal_of(controller), DT)
    again, same = controller.step(state, measurements[100], goal_of(controller), DT)
    assert again is state
    np.testing.assert_array_equal(tau, same)


@pytest.mark.parametrize("late", [-0.4, -0.1, 0.1, 0.4])
def test_a_late_sample_advances_the_filters_by_the_true_time(late):
    """A loop whose steps are off by up to 40 % of dt, told dt: y = Omega theta holds as with even steps.

    Told the wrong time, the impulse of the torque would be wrong by the same 40 %.
    """
    robot = load("ur5")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal, measurement = robot.configuration(robot.target), plant.reset()
    state = controller.init(measurement)
    for k in range(200):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT * (1 + late * (k % 2)))
    assert misfit(controller, state) < 1e-5  # as in test_regressions, with even steps


@pytest.mark.parametrize("lost", [1, 2, 30])
def test_lost_samples_start_the_filters_afresh_and_lose_no_information(loop, lost):
    """After a gap y = Omega theta holds from the next sample on; what was learned before stays."""
    controller, measurements, states = loop
    before, goal = states[200], goal_of(controller)
    state, tau = controller.step(before, measurements[201 + lost], goal, DT)
    assert np.all(state.regression.omega == 0)
    assert state.information is before.information
    assert np.isfinite(tau).all()
    for k in range(202 + lost, 240 + lost):
        state, _ = controller.step(state, measurements[k], goal, DT)
        assert misfit(controller, state) < 1e-5
    assert np.abs(state.regression.y).max() > 1e-3


def test_a_driver_may_reuse_its_buffers(loop):
    """The state keeps copies: what is written into a measurement's arrays later changes nothing."""
    controller, measurements, states = loop
    t, *arrays = measurements[101]
    buffers = [array.copy() for array in arrays]
    state, _ = controller.step(states[100], ea.Measurement(t, *buffers), goal_of(controller), DT)
    for buffer in buffers:
        buffer[:] = 7.0
    expected, _ = controller.step(states[100], measurements[101], goal_of(controller), DT)
    one, _ = controller.step(state, measurements[102], goal_of(controller), DT)
    other, _ = controller.step(expected, measurements[102], goal_of(controller), DT)
    np.testing.assert_array_equal(one.regression.omega, other.regression.omega)


@pytest.mark.parametrize("size", [1e9, 1e160])
def test_magnitudes_of_no_arm_are_refused_and_the_state_stays(loop, size):
    controller, measurements, states = loop
    wild = measurements[101]._replace(v=np.full(controller.robot.nv, size))
    with pytest.raises(ArgumentError, match=r"measurement.v: expected sizes up to 1e\+08"):
        controller.step(states[100], wild, goal_of(controller), DT)
    state, tau = controller.step(states[100], measurements[101], goal_of(controller), DT)
    assert np.isfinite(state.theta).all()
    assert np.isfinite(tau).all()
