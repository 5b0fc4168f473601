"""Brakes stop an arm by friction, after the time they take to close."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.simulation.disturbances import Brakes
from eladapt.simulation.instruments import Delay

DT = 1e-3


@pytest.mark.parametrize("make", [ea.PinocchioPlant, ea.MujocoPlant])
def test_brakes_close_stop_hold_and_open(make):
    robot = load("panda")
    plant = Delay(make(robot, robot.configuration(robot.home), np.full(robot.nv, 0.5)), 2 * DT)
    free = make(robot, robot.configuration(robot.home), np.full(robot.nv, 0.5))
    plant.reset()
    plant.brake()
    closing = round(Brakes().closing / DT)
    for _ in range(closing):
        plant.step(np.zeros(robot.nv), DT)
        free.step(np.zeros(robot.nv), DT)
    assert np.array_equal(plant.v, free.v), "not closed yet"
    before = robot.kinetic_energy(plant.q, plant.v)
    for _ in range(150):
        plant.step(np.zeros(robot.nv), DT)
        after = robot.kinetic_energy(plant.q, plant.v)
        assert after <= before + 1e-9
        before = after
    # MuJoCo's friction is as hard as it allows; Pinocchio's plant sticks to rounding.
    assert np.abs(plant.v).max() < 1e-6
    plant.release()
    for _ in range(20):
        plant.step(np.zeros(robot.nv), DT)
    assert np.abs(plant.v).max() > 0.05, "it falls"


def test_simulate_closes_the_brakes_when_they_are_wanted():
    """A gate that has no measurement any more: the arm stands soon after, and the record goes on."""
    from eladapt.simulation.faults import LostNumbers

    robot = load("ur5")
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    plant = LostNumbers(ea.PinocchioPlant(robot, robot.configuration(robot.home)), 0.2)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 0.6, DT, progress=False)
    assert len(record) == 601
    assert record.final_state.brake
    assert np.abs(record.v[record.t > 0.4]).max() < 1e-9
    assert not record.tau[record.t > 0.25].any(), "gravity has faded"


def test_what_brakes_cannot_have_is_refused():
    for wrong in ({"torque": 0.0}, {"closing": -1.0}, {"closing": np.inf}):
        with pytest.raises(ArgumentError, match=next(iter(wrong))):
            Brakes(**wrong)
