"""Noise is measured from a quiet record, whatever else is in it."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

SAMPLES, DT = 4000, 1e-3


def record(robot: ea.Robot, positions: np.ndarray, velocities: np.ndarray) -> list[ea.Measurement]:
    """Measurements with these errors (N, nv) around home."""
    tau = np.zeros(robot.nv)
    return [
        ea.Measurement(DT * k, robot.configuration(robot.home + dq), dv, tau)
        for k, (dq, dv) in enumerate(zip(positions, velocities, strict=True))
    ]


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_standard_deviations_of_every_joint(name, rng):
    """White noise of a different size in each joint is found to 8 %, where 4000 samples leave about 2 %."""
    robot = load(name)
    s_q, s_v = 10.0 ** rng.uniform(-6, -3, size=robot.nv), 10.0 ** rng.uniform(-5, -1, size=robot.nv)
    errors = rng.normal(size=(2, SAMPLES, robot.nv))
    found = ea.measure_noise(robot, record(robot, s_q * errors[0], s_v * errors[1]))
    np.testing.assert_allclose(found.position_noise, s_q, rtol=0.08)
    np.testing.assert_allclose(found.velocity_noise, s_v, rtol=0.08)


def test_drift_and_outliers_do_not_count(rng):
    """A slow swing a thousand times the noise, and a glitch in each hundred samples."""
    robot, t = load("two_link"), DT * np.arange(SAMPLES)[:, None]
    swing = 0.1 * np.sin(2 * np.pi * 0.2 * t)
    errors = 1e-4 * rng.normal(size=(2, SAMPLES, 2))
    glitches = np.where(rng.uniform(size=(SAMPLES, 1)) < 0.01, 0.1, 0.0)
    found = ea.measure_noise(robot, record(robot, swing + errors[0] + glitches, swing + errors[1] + glitches))
    # A glitch spoils three differences: 3 % of them are large, which moves the median by 4 %.
    np.testing.assert_allclose(found.position_noise, 1e-4, rtol=0.12)
    np.testing.assert_allclose(found.velocity_noise, 1e-4, rtol=0.12)


def test_encoders_that_flicker_by_a_count(rng):
    """Most samples repeat, so the median difference is zero; the noise is not."""
    robot, count = load("two_link"), 5e-5
    true = 0.3 * count + 0.1 * count * rng.normal(size=(SAMPLES, 2))
    counted = count * np.round(true / count)
    deviation = counted.std(axis=0)
    assert np.all(deviation > 0)
    assert np.all(np.mean(counted != counted[0], axis=0) < 0.1)
    found = ea.measure_noise(robot, record(robot, counted, counted))
    np.testing.assert_allclose(found.position_noise, deviation, rtol=0.3)


def test_no_noise_is_none():
    """To the rounding of positions."""
    robot = load("panda")
    found = ea.measure_noise(robot, record(robot, np.zeros((100, 7)), np.zeros((100, 7))))
    assert np.all(found.position_noise < 1e-15)
    assert np.all(found.velocity_noise == 0)


def test_a_controller_takes_what_was_measured():
    """From a plant's own noise at rest to the horizon that for_robot gives for the true figures, to 10 %."""
    robot, held = load("panda"), ea.Friction(coulomb=200.0)  # brakes
    noise = ea.Noise(1e-4, 2e-2)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=held, noise=noise)
    measurements = [plant.reset(), *(plant.step(np.zeros(7), DT) for _ in range(1500))]
    measured = ea.measure_noise(robot, measurements)
    controller = ea.CompositeController.for_robot(robot, DT, **measured._asdict())
    told = ea.CompositeController.for_robot(robot, DT, position_noise=1e-4, velocity_noise=2e-2)
    assert np.all(told.control.horizon > 1.5 * DT)
    np.testing.assert_allclose(controller.control.horizon, told.control.horizon, rtol=0.1)


def test_too_little_and_foreign_measurements_are_refused():
    robot = load("two_link")
    with pytest.raises(ArgumentError, match="at least 50, got 3"):
        ea.measure_noise(robot, record(robot, np.zeros((3, 2)), np.zeros((3, 2))))
    with pytest.raises(ArgumentError, match=r"measurement\.q"):
        ea.measure_noise(load("panda"), record(robot, np.zeros((60, 2)), np.zeros((60, 2))))
