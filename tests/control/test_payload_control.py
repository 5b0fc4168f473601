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
    controller = ea.CompositeController.for_robot(robot, **known)
    if frozen:
        law = dataclasses.replace(controller.law, direct=False, indirect=False)
        controller = dataclasses.replace(controller, law=law, detector=None, disturbance=None)
    loaded = ea.Payload(2.0, COM, attach=ATTACHED, release=release)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=loaded, noise=noise)
    goal = robot.configuration(robot.target)
    return controller, ea.simulate(controller, plant, goal, duration, progress=False)


def test_a_load_is_noticed_and_borne():
    """2 kg: noticed within 20 ms, below 1e-3 rad again within half a second."""
    _, record = carry()
    change = record.final_state.change
    assert change.noticed == 1
    assert ATTACHED < change.t < ATTACHED + 0.02
    assert np.abs(record.error[record.t > ATTACHED]).max() > 1e-4, "the load did not matter"
    assert record.settling_time(1e-3) < ATTACHED + 0.5


def move_on(noise: ea.Noise | None = None, release: float = np.inf):
    """The panda holds still when 2 kg come, goes home with them, and, where they go, moves once more."""
    robot = load("panda")
    known = {"position_noise": noise.position, "velocity_noise": noise.velocity} if noise else {}
    controller = ea.CompositeController.for_robot(robot, **known)
    loaded = ea.Payload(2.0, COM, attach=ATTACHED, release=release)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=loaded, noise=noise)
    places = robot.configuration(robot.target), robot.configuration(robot.home)
    duration = 4.5 if np.isinf(release) else release + 2.5
    goal = lambda t: places[0] if t < 2.5 or release + 0.5 <= t < release + 3 else places[1]  # noqa: E731
    return controller, ea.simulate(controller, plant, goal, duration, progress=False)


def test_a_move_weighs_a_load():
    """Home with 2 kg that nobody told: mass within 1e-5, place within a micrometre, and it is known for a
    load."""
    controller, record = move_on()
    assert record.final_state.change.noticed == 1
    estimate = ea.payload(controller, record.final_state)
    assert estimate.mass == pytest.approx(2.0, rel=1e-5)
    np.testing.assert_allclose(estimate.com, COM, atol=1e-6)
    assert estimate.is_load
    assert "no load" not in str(estimate)
    carried = ea.carried(controller, record.final_state)
    assert carried.mass == pytest.approx(2.0, rel=2e-3)


def test_a_load_that_goes_is_a_negative_one():
    """Let go when the arm has come home: noticed within 55 ms, of which 40 tell it from a contact; and after
    a move the same mass is missing."""
    controller, record = move_on(release=4.5)
    change = record.final_state.change
    assert change.noticed == 2
    assert 4.5 < change.t < 4.555
    assert ea.payload(controller, record.final_state).mass == pytest.approx(-2.0, rel=2e-4)  # 0.4 g


def test_noise_neither_raises_alarms_nor_spoils_the_weight():
    """With noise of 1e-4 rad and 1e-3 rad/s: no false alarm; mass within 2 % and five deviations."""
    controller, record = move_on(NOISE)
    assert record.final_state.change.noticed == 1
    estimate = ea.payload(controller, record.final_state)
    assert estimate.mass == pytest.approx(2.0, rel=0.02)
    assert abs(estimate.mass - 2.0) < 5 * estimate.mass_std < 0.1
    assert np.all(np.abs(estimate.com - COM) < 5 * estimate.com_std)


def test_without_adaptation_the_load_stays_down():
    """The same law and gains with theta frozen at the URDF's, and nothing fed forward for what it lacks: a
    hundredth of a radian and more remains."""
    _, record = carry(frozen=True)
    assert np.abs(record.error[record.t < ATTACHED][-1]).max() < 5e-3, "it should have arrived before"
    assert np.abs(record.error[-100:]).max() > 0.01


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
        ea.payload(controller, controller.init(plant.reset()))
