"""A load that comes unannounced: noticed, compensated, weighed."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

ATTACHED, COM = 1.5, (0.0, 0.0, 0.05)


NOISE = ea.Noise(1e-4, 1e-3)


def carry(
    noise: ea.Noise | None = None, release: float = np.inf, duration: float = 3.5, frozen: bool = False
):
    """The panda holds still when 2 kg come, and perhaps go."""
    robot = load("panda")
    known = {"position_noise": noise.position, "velocity_noise": noise.velocity} if noise else {}
    controller, theta0 = ea.CompositeController.for_robot(robot, **known), None
    if frozen:
        law = dataclasses.replace(controller.law, direct=False, indirect=False)
        controller = dataclasses.replace(controller, law=law, detector=None)
        theta0 = controller.regressors.theta_potential
    loaded = ea.Payload(2.0, COM, attach=ATTACHED, release=release)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=loaded, noise=noise)
    goal = robot.configuration(robot.target)
    return controller, ea.simulate(controller, plant, goal, duration, theta0=theta0, progress=False)


def test_a_load_is_noticed_compensated_and_weighed():
    """2 kg: noticed within 20 ms, back under 1e-3 rad within 2 s; mass and place to 1e-6.

    1e-6: the force balance is off by so much (Simpson's rule), and the load's motion is all there is.
    """
    controller, record = carry()
    change = record.final_state.change
    assert change.noticed == 1
    assert ATTACHED < change.t < ATTACHED + 0.02
    assert np.abs(record.error[record.t > ATTACHED]).max() > 1e-3, "the load did not matter"
    assert record.settling_time(1e-3) < ATTACHED + 2
    estimate = controller.payload(record.final_state)
    assert estimate.mass == pytest.approx(2.0, rel=1e-6)
    np.testing.assert_allclose(estimate.com, COM, atol=1e-6)
    assert estimate.is_load
    assert "no load" not in str(estimate)


def test_a_load_that_goes_is_a_negative_one():
    """Released 1.5 s later: noticed, back within 2 s, and the same mass is missing."""
    released = ATTACHED + 1.5
    controller, record = carry(release=released, duration=released + 1.5)
    change = record.final_state.change
    assert change.noticed == 2
    assert released < change.t < released + 0.03
    assert record.settling_time(1e-3) < released + 2
    assert controller.payload(record.final_state).mass == pytest.approx(-2.0, rel=1e-6)


def test_without_adaptation_the_load_stays_down():
    """The same law and gains with theta frozen at the URDF's gravity: 0.03 rad and more remain."""
    _, record = carry(frozen=True)
    assert np.abs(record.error[record.t < ATTACHED][-1]).max() < 5e-3, "it should have arrived before"
    assert np.abs(record.error[-100:]).max() > 0.03


def test_noise_neither_raises_alarms_nor_spoils_the_weight():
    """With 1e-4 rad and 1e-3 rad/s: no false alarm, mass within 5 % and within five of its deviations."""
    controller, record = carry(NOISE)
    assert record.final_state.change.noticed == 1
    estimate = controller.payload(record.final_state)
    assert estimate.mass == pytest.approx(2.0, rel=0.05)
    assert abs(estimate.mass - 2.0) < 5 * estimate.mass_std
    assert estimate.mass_std < 0.02
    assert estimate.is_load
    assert np.isnan(estimate.com).all(), "at rest nothing tells where along the vertical the load is"
    assert "cz" in estimate.unidentified[0]


def test_a_move_tells_where_the_load_is_through_noise():
    """Back home with 2 kg: mass and place within five of their deviations, which are below 1 % and 1 mm."""
    robot = load("panda")
    controller = ea.CompositeController.for_robot(robot, position_noise=1e-4, velocity_noise=1e-3)
    loaded = ea.Payload(2.0, COM, attach=ATTACHED)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=loaded, noise=NOISE)
    places = robot.configuration(robot.target), robot.configuration(robot.home)
    record = ea.simulate(controller, plant, lambda t: places[t >= 2.5], 4.0, progress=False)
    assert record.final_state.change.noticed == 1
    estimate = controller.payload(record.final_state)
    assert abs(estimate.mass - 2.0) < 5 * estimate.mass_std < 0.1
    assert np.all(np.abs(estimate.com - COM) < 5 * estimate.com_std)
    assert np.all(estimate.com_std < 1e-3)


def test_a_wrong_model_is_told_from_a_load():
    """TALOS' arm without its rotors: a change is noticed, and the estimate says that it is no load."""
    robot = load("talos_left_arm")
    bare = ea.Robot.from_urdf(robot.path, robot.package_dirs, robot.locked, tool=robot.tool)
    controller = ea.CompositeController.for_robot(bare)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 1.0, progress=False)
    assert record.final_state.change.noticed > 0
    estimate = controller.payload(record.final_state)
    assert not estimate.is_load
    assert "no load" in str(estimate)


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_learning_raises_no_alarm(name):
    """First excitation is no change of the arm: the innovation asks what no theta could explain."""
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 1.5, progress=False)
    assert record.final_state.change.noticed == 0


def test_without_a_change_there_is_no_load_to_weigh():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    with pytest.raises(ArgumentError, match="noticed"):
        controller.payload(controller.init(plant.reset()))
