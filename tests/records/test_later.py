"""What is computed of a run when somebody asks for it, once, and goes along in files and pickles."""

import pickle

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import UnknownNameError
from eladapt.robot.protocols import Unrecorded


class Reviewing(Unrecorded):
    """Holds gravity, and counts how often it is asked what it thinks of a state."""

    def __init__(self, robot, names=("excitation",)):
        self.robot, self.names, self.asked = robot, names, 0

    def init(self, measurement, theta0=None):
        return measurement

    def step(self, state, measurement, goal, dt):
        return measurement, self.robot.gravity(measurement.q)

    def reviewed(self, state, frame):
        self.asked += 1
        return {name: np.array([state.t, 1.0]) for name in self.names}


def run(controller):
    robot = controller.robot
    home = robot.configuration(robot.home)
    return ea.simulate(controller, ea.PinocchioPlant(robot, home), home, 0.2, progress=False)


def test_nothing_is_reviewed_that_nobody_asks_for():
    """A run costs no review; the first look costs one for each state kept, the second nothing."""
    controller = Reviewing(load("two_link"))
    record = run(controller)
    assert controller.asked == 0
    excitation = record.excitation
    assert controller.asked == len(excitation) == 7, "at 0 s and six times in 0.2 s"
    assert record.excitation is excitation
    assert record.carried is None
    assert controller.asked == 7


def test_what_was_not_looked_at_is_saved_and_pickled(tmp_path):
    record = run(ea.CompositeController.for_robot(load("two_link")))
    looked_at = run(ea.CompositeController.for_robot(load("two_link"))).excitation
    saved = ea.Record.load(record.save(tmp_path / "run.npz"))
    sent = pickle.loads(pickle.dumps(run(ea.CompositeController.for_robot(load("two_link")))))
    for other in (saved, sent):
        assert np.array_equal(other.excitation, looked_at)


def test_what_no_record_holds_is_refused_when_it_is_asked_for():
    record = run(Reviewing(load("two_link"), names=("exitation",)))
    with pytest.raises(
        UnknownNameError, match=r"entry of reviewed 'exitation' .*legal names: excitation, carr"
    ):
        _ = record.excitation
