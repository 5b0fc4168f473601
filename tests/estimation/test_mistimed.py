"""Steps whose time stamps are wrong are left out, and loads that come are not."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import eladapt as ea
from eladapt.estimation.mistimed import MistimedSteps, stale, step_errors
from eladapt.robot import library
from eladapt.signals import Regression
from eladapt.simulation.faults import FrozenSensor

DT = 1e-3


@pytest.mark.parametrize(("m", "size"), [(1, 3), (7, 40)])
def test_the_error_of_a_step_is_what_it_added(m, size, rng):
    """To y - Omega theta, by the filter's recursion; a row of zeros has none."""
    omega, before, theta = rng.normal(size=(m, size)), rng.normal(size=(m, size)), rng.normal(size=size)
    y, y_before = rng.normal(size=m), rng.normal(size=m)
    omega[-1] = 0
    found = step_errors(omega, y, before, y_before, theta, 0.98)
    expected = (y - omega @ theta) - 0.98 * (y_before - before @ theta)
    np.testing.assert_allclose(found[:-1], expected[:-1], atol=1e-12)  # rounding of 40 products
    assert np.isnan(found[-1])


def errors_fed(timing, errors):
    """Which of steps with these errors (N, m) do not count."""
    pole, m = timing.pole, errors.shape[1]
    state, y = timing.init(m), np.zeros(m)
    omega, theta, left = np.ones((m, 1)), np.zeros(1), []
    for error in errors:
        after = np.exp(-pole * DT) * y + error
        state = timing.step(state, Regression(y, omega), Regression(after, omega), theta, DT)
        left.append(state.apart > 0)
        y = after
    return np.array(left)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_what_stands_alone_is_left_out_and_what_lasts_is_not(noise, rng):
    """Twenty times the noise for a step, then for good: of that no more than `most` steps are lost."""
    timing = MistimedSteps()
    errors = noise * rng.normal(size=(3000, 3))
    errors[2000, 1] += 0.01 + 20 * noise
    errors[2500:, 2] += 0.01 + 20 * noise
    left = errors_fed(timing, errors)
    assert left[2000]
    assert left[2500]
    quiet = np.r_[1000:2000, 2002:2500, 2500 + timing.most : 3000]  # from when the noise is known
    assert left[quiet].sum() <= 2  # differences of noise are above six times their RMS in 2e-9 of cases


def test_a_sample_that_comes_again_is_stale_only_if_the_arm_moves():
    moving, resting = np.array([0.1, 0.0]), np.zeros(2)
    for v, expected in ((moving, True), (resting, False)):
        assert stale(np.ones(2), v, np.ones(2), v.copy()) is expected
        assert not stale(np.ones(2), v, np.ones(2) + 1e-9, v)
        assert not stale(np.ones(2), v, np.ones(2), v + 1e-9)


@functools.cache
def heavier(name):
    """The arm with rotors that its URDF does not have."""
    entry = library.entry(name)
    rotors = dict.fromkeys(ea.Robot.load(name).joint_names, 0.1)
    return ea.Robot.from_urdf(entry.urdf, entry.package_dirs, entry.locked, armature=rotors, tool=entry.tool)


def moved(name, timing, freezes=(), lasting=0.0, payload=None):
    """When changes are noticed in a move, and the error half a second after it [rad], with a sensor that
    freezes at these times, unknown to the gate that is not there."""
    robot, true = ea.Robot.load(name), heavier(name)
    controller = ea.CompositeController.for_robot(robot, DT)
    if not timing:
        controller = replace(controller, timing=None)
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    plant = ea.PinocchioPlant(true, start, payload=payload)
    for begin in freezes:
        plant = FrozenSensor(plant, start=begin, end=begin + lasting - 0.5 * DT)
    motion = ea.move(robot, start, goal)
    measurement = plant.reset()
    state, noticed = controller.init(measurement), []
    for k in range(round((motion.duration + 0.5) / DT)):
        before = state.change.noticed
        state, tau = controller.step(state, measurement, motion(k * DT), DT)
        if state.change.noticed > before:
            noticed.append(k * DT)
        measurement = plant.step(tau, DT)
    return noticed, np.abs(robot.difference(goal, measurement.q)).max()


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_samples_that_come_late_are_no_change(name):
    """8 ms without news at 0.1, 0.2 and 0.3 s of a move at full speed: taken for a load where nobody asks
    about time stamps."""
    freezes = (0.1, 0.2, 0.3)
    noticed, error = moved(name, True, freezes, 8 * DT)
    assert noticed == []
    assert error < 1e-6  # [rad]: as without freezes (at most 1.3e-7)
    assert moved(name, False, freezes, 8 * DT)[0] != []


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_a_load_that_comes_is_a_change(name):
    """1 kg at 0.5 s, noticed as early as without."""
    load = ea.Payload(1.0, (0.0, 0.0, 0.1), attach=0.5)
    late = moved(name, True, payload=load)[0][0] - moved(name, False, payload=load)[0][0]
    assert late <= 4 * DT  # `most`, and one for its sample
