"""What `simulate` does beside stepping: it says when brakes that may be asked for are not there."""

import warnings

import pytest
from shared import load

import eladapt as ea
from eladapt.errors import BrakesWarning
from eladapt.simulation.faults import LostNumbers
from eladapt.simulation.instruments import Delay


class Brakeless:
    """A plant of somebody else's, without brakes."""

    def __init__(self, plant):
        self.robot, self._plant = plant.robot, plant

    @property
    def q(self):
        return self._plant.q

    @property
    def v(self):
        return self._plant.v

    def reset(self):
        return self._plant.reset()

    def step(self, tau, dt):
        return self._plant.step(tau, dt)


def gated(robot):
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(robot))


@pytest.mark.parametrize("around", [lambda plant: plant, lambda plant: LostNumbers(Delay(plant, 0.0), 0.03)])
def test_a_plant_without_brakes_is_named_at_the_start(around):
    """Whatever stands around it, and the run goes to its end although the gate asks for them."""
    robot = load("two_link")
    q = robot.configuration(robot.home)
    plant = around(Brakeless(ea.PinocchioPlant(robot, q)))
    with pytest.warns(BrakesWarning, match=r"Brakeless of 'two_link' has no brakes: .* brake\(\)"):
        record = ea.simulate(ea.Shaped(gated(robot)), plant, q, 0.1, progress=False)
    assert len(record) == 101
    assert bool(record.brakes) == isinstance(plant, LostNumbers)


def test_nothing_is_said_where_brakes_are_there_or_nobody_asks_for_them():
    """A plant with brakes behind a gate, and one without for controllers without a gate."""
    robot = load("two_link")
    q = robot.configuration(robot.home)
    plant, bare = ea.PinocchioPlant(robot, q), ea.CompositeController.for_robot(robot)
    with warnings.catch_warnings():
        warnings.simplefilter("error", BrakesWarning)
        ea.simulate(gated(robot), LostNumbers(plant, 0.005), q, 0.01, progress=False)
        for controller in (bare, ea.Shaped(bare)):
            ea.simulate(controller, Brakeless(plant), q, 0.01, progress=False)
