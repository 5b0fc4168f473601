"""A Franka by its maker's library: what acts is what is sent and what the firmware adds; errors are named.

The library is played by an object of the same face; benchmarks/franka_client.py has it against a simulator.
"""

import types

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, HardwareError, LoopError

franka = pytest.importorskip(
    "eladapt.hardware.franka", reason="pylibfranka is not installed", exc_type=HardwareError
)
lib = franka.pylibfranka
DT = 1e-3


class Arm:
    """What pylibfranka.Robot is, around a plant: gravity is added, torques are checked cycle by cycle."""

    def __init__(self, robot, *, firmware=1.0, mode=lib.RobotMode.Idle, lost=()):
        self.plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
        self.robot, self.firmware, self.mode, self.lost = robot, firmware, mode, set(lost)
        self.measurement, self.accepted, self.cycle = self.plant.reset(), np.zeros(7), 0
        self.calls, self.finished = [], False

    def gravity(self, q):
        return self.firmware * self.robot.gravity(q)

    def state(self):
        errors = types.SimpleNamespace(joint_reflex=True)
        return types.SimpleNamespace(
            q=self.measurement.q, dq=self.measurement.v, tau_J_d=self.accepted, robot_mode=self.mode,
            current_errors=errors,
        )  # fmt: skip

    def read_once(self):
        return self.state()

    def set_collision_behavior(self, *thresholds):
        self.calls.append(("collision", thresholds))

    def set_load(self, *load):
        self.calls.append(("load", load))

    def load_model(self):
        return types.SimpleNamespace(gravity=lambda state: self.gravity(state.q))

    def automatic_error_recovery(self):
        self.calls.append(("recovered",))
        self.mode = lib.RobotMode.Idle

    def start_torque_control(self):
        return self

    def readOnce(self):
        return self.state(), types.SimpleNamespace(to_sec=lambda: DT)

    def writeOnce(self, command):
        if getattr(command, "motion_finished", False):
            self.finished = True
            return
        self.cycle += 1
        sent = np.array(command.tau_J)
        if not np.isfinite(sent).all() or np.abs(sent - self.accepted).max() > 1.0:
            raise lib.ControlException("controller_torque_discontinuity")
        if self.cycle not in self.lost:
            self.accepted = sent
        self.measurement = self.plant.step(self.accepted + self.gravity(self.measurement.q), DT)


@pytest.fixture
def connected(monkeypatch):
    def connect(name="panda", **options):
        robot = load(name)
        arm = Arm(robot, **{key: options.pop(key) for key in ("firmware", "mode", "lost") if key in options})
        monkeypatch.setattr(lib, "Robot", lambda *arguments: arm)
        return robot, arm, franka.FrankaRobot("127.0.0.1", robot, **options)

    return connect


def test_what_acts_is_what_was_sent_and_what_the_firmware_adds(connected):
    """A firmware that thinks the arm a fifth heavier: the measured torque is what holds it all the same."""
    robot, arm, interface = connected(firmware=1.2, prompt=False)
    interface.start()
    first = interface.read()
    assert first.tau == pytest.approx(1.2 * robot.gravity(first.q))
    interface.write(first.tau - 0.5)
    assert arm.accepted == pytest.approx(np.full(7, -0.5))
    second = interface.read()
    assert second.t == pytest.approx(first.t + DT)
    assert second.tau == pytest.approx(1.2 * robot.gravity(second.q) - 0.5)


def test_no_cycle_changes_the_torque_by_more_than_the_robot_allows(connected):
    """However much is asked, and after a command that was lost: the robot goes by what it has."""
    _, arm, interface = connected(lost={3, 4}, prompt=False)
    interface.start()
    for _ in range(20):
        interface.write(interface.read().tau + 50.0)
    assert arm.accepted[:4] == pytest.approx(np.full(4, 18 * 0.99))
    assert arm.accepted[4:] == pytest.approx(np.full(3, 12.0)), "their limit"


def test_a_prompt_answer_is_that_of_the_cycle_before(connected):
    """Each read is answered at once; what is written counts a cycle later."""
    _, arm, interface = connected()
    interface.start()
    first = interface.read()
    assert arm.cycle == 1
    interface.write(first.tau + 0.5)
    assert np.array_equal(arm.accepted, np.zeros(7))
    interface.read()
    assert arm.cycle == 2
    assert arm.accepted == pytest.approx(np.full(7, 0.5))


def test_a_loop_arrives_and_ends_the_motion(connected):
    robot, arm, interface = connected(firmware=1.2)
    inner = ea.CompositeController.for_robot(robot, DT, delay=DT)
    controller = ea.GatedController.for_robot(inner, DT)
    goal = robot.configuration(robot.home + 0.1)
    result = ea.run_loop(controller, interface, goal, 2.0, DT)
    assert result.fault is None
    assert np.abs(robot.difference(goal, arm.measurement.q)).max() < 1e-3
    assert arm.finished


def test_a_reflex_is_named_and_nothing_is_asked_of_the_robot_after_it(connected, monkeypatch):
    robot, arm, interface = connected()
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    step = Arm.writeOnce

    def tripped(self, command):
        if self.cycle == 50 and not getattr(command, "motion_finished", False):
            raise lib.ControlException("libfranka: joint_reflex")
        step(self, command)

    monkeypatch.setattr(Arm, "writeOnce", tripped)
    with pytest.raises(
        LoopError, match=r"after (48|49|50) of 500 steps.*the robot ended the motion.*joint_reflex"
    ) as caught:
        ea.run_loop(controller, interface, robot.configuration(robot.home), 0.5, DT)
    assert 48 <= len(caught.value.record) <= 50
    assert not arm.finished
    with pytest.raises(HardwareError, match="not started, or stopped"):
        interface.read()


def test_load_and_thresholds_are_told_to_the_firmware(connected):
    _, arm, interface = connected(
        load=(1.0, (0, 0, 0.1), (0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01)), collision=50.0
    )
    interface.connect()
    (_, thresholds), (_, told) = arm.calls
    assert thresholds[1] == [50.0] * 7
    assert told[0] == 1.0
    assert len(arm.calls) == 2
    interface.connect()
    assert len(arm.calls) == 2, "once"


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        (lib.RobotMode.Reflex, r"in mode Reflex \(joint_reflex\); clear the errors: recover=True"),
        (lib.RobotMode.UserStopped, "release the user stop"),
        (lib.RobotMode.Guiding, "guiding button"),
        (lib.RobotMode.Move, "another program controls it"),
    ],
)
def test_a_robot_that_will_not_move_says_why(connected, mode, said):
    _, arm, interface = connected(mode=mode)
    for _ in range(2):  # and says so again
        with pytest.raises(HardwareError, match=said):
            interface.start()
    arm.mode = lib.RobotMode.Idle
    interface.start()
    assert [name for name, *_ in arm.calls] == ["collision"], "told once the robot is ready"
    interface.read()


def test_errors_from_before_are_cleared_where_that_is_wanted(connected):
    _, arm, interface = connected(mode=lib.RobotMode.Reflex, recover=True)
    interface.start()
    assert ("recovered",) in arm.calls


def test_another_arm_is_refused():
    with pytest.raises(ArgumentError, match="expected the 7 joints of a Franka arm, got 6 of 'ur5'"):
        franka.FrankaRobot("127.0.0.1", load("ur5"))


def test_a_robot_that_is_not_there_is_said_so():
    """By the real library: nobody listens on this machine's port of the robot's."""
    interface = franka.FrankaRobot("127.0.0.1", load("panda"))
    with pytest.raises(
        HardwareError, match=r"127\.0\.0\.1 does not answer; is that the robot, and is FCI activated"
    ):
        interface.start()
    interface.stop()
