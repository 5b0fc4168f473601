"""A load that comes unannounced: noticed, compensated, weighed."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

ATTACHED = 1.5


def carry(noise: ea.Noise | None = None, **given) -> tuple[ea.CompositeController, ea.Record]:
    """The panda holds still when 2 kg come."""
    robot = load("panda")
    controller = ea.CompositeController.for_robot(robot, **given)
    loaded = ea.Payload(2.0, (0.0, 0.0, 0.05), attach=ATTACHED)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=loaded, noise=noise)
    return controller, ea.simulate(controller, plant, robot.configuration(robot.target), 3.5, progress=False)


def test_a_load_is_noticed_compensated_and_weighed():
    """2 kg: one change noticed within 20 ms, back under 1e-3 rad within 2 s, mass within 2 %."""
    controller, record = carry()
    change = record.final_state.change
    assert change.noticed == 1
    assert ATTACHED < change.t < ATTACHED + 0.02
    assert np.abs(record.error[record.t > ATTACHED]).max() > 1e-3, "the load did not matter"
    assert record.settling_time(1e-3) < ATTACHED + 2
    estimate = controller.payload(record.final_state)
    assert estimate.mass == pytest.approx(2.0, rel=0.02)


def test_noise_neither_raises_alarms_nor_spoils_the_weight():
    """With 1e-4 rad and 1e-3 rad/s of noise: mass within 5 %, and no false alarm."""
    controller, record = carry(ea.Noise(1e-4, 1e-3), xi=1e5)
    assert record.final_state.change.noticed == 1
    assert controller.payload(record.final_state).mass == pytest.approx(2.0, rel=0.05)


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
