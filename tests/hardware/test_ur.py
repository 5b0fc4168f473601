"""A UR arm by ur-rtde: what acts is what is sent and what the firmware adds; stops are named.

The library is played by two objects of the same faces around a plant, at 500 Hz.
"""

import types

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, HardwareError, LoopError
from eladapt.hardware import ur

DT = 2e-3
FASTEST = 3.3  # [rad/s] at which the arm stops by itself


class Arm:
    """RTDEControlInterface and RTDEReceiveInterface in one; friction is not compensated."""

    def __init__(self, robot, *, firmware=1.0, mode=7, deaf=False):
        friction = ea.Friction(0.5, 0.5)
        self.plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=friction)
        self.robot, self.firmware, self.mode, self.deaf = robot, firmware, mode, deaf
        self.measurement, self.sent, self.protective, self.stopped = (
            self.plant.reset(),
            np.zeros(6),
            False,
            False,
        )
        self.scales, self.loads = [], []

    def getTimestamp(self):
        return self.measurement.t

    def getActualQ(self):
        return self.measurement.q.tolist()

    def getActualQd(self):
        return self.measurement.v.tolist()

    def getRobotMode(self):
        return self.mode

    def isEmergencyStopped(self):
        return False

    def isProtectiveStopped(self):
        return self.protective

    def setPayload(self, *load_):
        self.loads.append(load_)
        return True

    def initPeriod(self):
        return None

    def waitPeriod(self, _start):
        if self.deaf:
            return
        added = self.firmware * self.robot.gravity(self.measurement.q)
        self.measurement = self.plant.step(self.sent + added, DT)
        self.protective |= bool(np.abs(self.measurement.v).max() > FASTEST)

    def directTorque(self, torque, viscous_scale, coulomb_scale):
        if self.protective or self.mode != 7:
            return False
        self.sent = np.array(torque)
        self.scales.append((viscous_scale, coulomb_scale))
        return True

    def stopJ(self, _deceleration):
        self.plant.brake()
        while np.abs(self.plant.v).max() > 1e-9:
            self.measurement = self.plant.step(self.sent, DT)
        self.stopped = True

    def stopScript(self):
        pass


@pytest.fixture
def connected(monkeypatch):
    def connect(name="ur5", **options):
        robot = load(name)
        arm = Arm(robot, **{key: options.pop(key) for key in ("firmware", "mode", "deaf") if key in options})
        made = types.SimpleNamespace(
            RTDEReceiveInterface=lambda *arguments: arm, RTDEControlInterface=lambda *arguments: arm
        )
        monkeypatch.setattr(ur, "_library", lambda name: made)
        return robot, arm, ur.URRobot("127.0.0.1", robot, **options)

    return connect


@pytest.mark.parametrize("firmware", [1.0, 1.2])
@pytest.mark.slow
def test_a_loop_arrives_with_friction_and_a_firmware_that_is_wrong(connected, firmware):
    """Set-points within 1e-3 rad, at 500 Hz, with friction that nobody told and gravity a fifth off."""
    robot, arm, interface = connected(firmware=firmware)
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    goals = [robot.home + 0.3, robot.home - 0.2]
    result = ea.run_loop(controller, interface, lambda t: robot.configuration(goals[int(t > 4)]), 8.0, DT)
    assert result.fault is None
    assert np.abs(robot.difference(robot.configuration(goals[1]), arm.measurement.q)).max() < 1e-3
    assert arm.stopped
    assert arm.scales[-1] == ([0.0] * 6, [0.0] * 6)


def test_what_acts_is_what_was_sent_and_what_the_firmware_adds(connected):
    robot, arm, interface = connected(load=(1.5, (0, 0, 0.1)))
    interface.start()
    assert arm.loads == [(1.5, [0.0, 0.0, 0.1])]
    first = interface.read()
    hung = robot.model.frames[robot.model.getFrameId(robot.tool)]
    heavier = robot.model.copy()
    heavier.appendBodyToJoint(
        hung.parentJoint, pin.Inertia(1.5, np.array([0, 0, 0.1]), np.zeros((3, 3))), hung.placement
    )

    def added(q):
        return pin.computeGeneralizedGravity(heavier, heavier.createData(), q)

    assert first.tau == pytest.approx(added(first.q))
    interface.write(first.tau + 1.0)
    assert arm.sent == pytest.approx(np.ones(6))
    second = interface.read()
    assert second.t == pytest.approx(first.t + DT)
    assert second.tau == pytest.approx(added(second.q) + 1.0)


def test_a_protective_stop_ends_the_loop_and_is_named(connected):
    robot, arm, interface = connected()
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)

    def goal(t):
        arm.protective |= t > 0.2
        return robot.configuration(robot.home)

    with pytest.raises(
        LoopError, match=r"after (99|10.) of 500 steps.*protective stop; see the pendant"
    ) as caught:
        ea.run_loop(controller, interface, goal, 1.0, DT)
    assert len(caught.value.record) > 90
    assert arm.stopped


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"mode": 5}, "in mode 'idle'; power the arm on and release its brakes"),
        ({"mode": 3}, "in mode 'power off'"),
    ],
)
def test_a_robot_that_will_not_move_says_why(connected, options, said):
    _, _, interface = connected(**options)
    with pytest.raises(HardwareError, match=said):
        interface.start()


def test_a_connection_that_is_lost_is_said_so(connected):
    _, _, interface = connected(deaf=True)
    interface.start()
    interface.read()
    with pytest.raises(HardwareError, match=r"no new sample for 0\.1 s"):
        interface.read()


def test_another_arm_is_refused():
    with pytest.raises(ArgumentError, match="expected the 6 joints of a UR arm, got 7 of 'panda'"):
        ur.URRobot("127.0.0.1", load("panda"))


def test_a_robot_that_is_not_there_is_said_so():
    """By the real library: nobody listens on this machine's ports of the robot's."""
    pytest.importorskip("rtde_receive", reason="ur-rtde is not installed")
    interface = ur.URRobot("127.0.0.1", load("ur5"))
    with pytest.raises(HardwareError, match=r"127\.0\.0\.1 does not answer.*remote control"):
        interface.start()
    interface.stop()
