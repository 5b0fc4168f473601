"""A UR arm by ur-rtde: what acts is what is sent and what the firmware adds; stops are named.

The library is played by `URStandIn`, at 500 Hz.
"""

from __future__ import annotations

import re
import threading

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, HardwareError, LoopError
from eladapt.hardware import ur, ur_stand_in
from eladapt.hardware.ur_stand_in import PERIOD, URStandIn

BASE = np.array([1.0, 0, 0, 0, 0, 0])  # the first joint
FRICTION = ea.Friction(viscous=0.5, coulomb=0.5)


def connected(name="ur5", *, share=1.0, payload=None, delay=1, mode=7, **options):
    """A robot, its arm with friction, whose firmware takes it for ``share`` as heavy, and the interface."""
    robot = load(name)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=FRICTION, payload=payload)
    arm = URStandIn(plant, gravity=lambda q: share * robot.gravity(q), delay=delay, mode=mode)
    return robot, arm, ur.URRobot("127.0.0.1", robot, library=arm, delay=delay, **options)


def gated(robot, delay=1):
    inner = ea.CompositeController.for_robot(robot, PERIOD, delay=delay * PERIOD)
    return ea.GatedController.for_robot(inner, PERIOD)


@pytest.mark.parametrize(("share", "delay"), [(1.0, 1), (1.2, 1), (0.8, 0)])
@pytest.mark.slow
def test_a_loop_arrives_with_friction_and_a_firmware_that_is_wrong(share, delay):
    """Set-points within 1e-3 rad, with friction that nobody told and gravity a fifth off."""
    robot, arm, interface = connected(share=share, delay=delay)
    goals = [robot.home + 0.3, robot.home - 0.2]
    controller = gated(robot, delay)
    result = ea.run_loop(controller, interface, lambda t: robot.configuration(goals[int(t > 4)]), 8.0, PERIOD)
    assert result.fault is None
    assert np.abs(robot.difference(robot.configuration(goals[1]), arm.plant.q)).max() < 1e-3
    assert (arm.tripped, arm.following) == ("", False), "the firmware holds it again"


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_what_acts_is_what_was_sent_and_what_the_firmware_adds(delay):
    """So many periods later."""
    robot, arm, interface = connected(load=(1.5, (0, 0, 0.1)), delay=delay)
    interface.start()
    assert arm.load == (1.5, (0.0, 0.0, 0.1))
    first = interface.read()
    q = first.q
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
    assert second.t == pytest.approx(first.t + PERIOD)
    late = delay * [0.0] + [1.0]
    for share in late:
        assert second.tau == pytest.approx(added(second.q) + share)
        assert arm.plant.tau == pytest.approx(added(q) + share), "what acted over the period"
        q, second = second.q, interface.read()


class Provoked:
    """An interface to which something is done at a tick: what is sent is changed, or is not sent."""

    keeps_clock = True

    def __init__(self, interface, at, change):
        self.interface, self.at, self.change, self.count = interface, at, change, 0
        self.start, self.read, self.stop = interface.start, interface.read, interface.stop

    def write(self, tau):
        self.count += 1
        if self.count >= self.at:
            tau = self.change(tau)
        if tau is not None:
            self.interface.write(tau)


@pytest.mark.parametrize(
    ("change", "said", "late"),
    [
        (lambda tau: tau + 50.0 * BASE, "torque step: ", 0),
        (lambda tau: tau + np.nan * BASE, "torque: .*no number", 0),
        (lambda tau: None, "silence: no torque for 0.022 s, limit 0.02 s", 10),
    ],
)
def test_what_no_robot_takes_stops_it_and_the_loop(change, said, late):
    """In the midst of a motion: the check is named, the loop ends with a stop of the maker's, the record has
    all samples until then, and the arm rests."""
    robot, arm, interface = connected()
    provoked = Provoked(interface, at=101, change=change)
    goal = robot.configuration(robot.home + 0.3)
    with pytest.raises(LoopError, match="protective stop") as caught:
        ea.run_loop(gated(robot), provoked, goal, 1.0, PERIOD)
    assert re.match(said, arm.tripped)
    assert len(caught.value.record) == 100 + late
    assert np.isfinite(caught.value.record.tau).all()
    assert np.abs(caught.value.record.v[-1]).max() > 0.05, "it moved"
    assert np.abs(arm.plant.v).max() < 1e-5
    assert not arm.following


def test_a_joint_that_runs_away_stops_it():
    """Torque on the base that grows by 10 N m a period, whatever the controller says: its speed trips."""
    robot, arm, interface = connected()
    ramp = iter(np.minimum(10.0 * np.arange(1, 500), 120.0))
    provoked = Provoked(interface, 101, lambda tau: tau * (1 - BASE) + next(ramp) * BASE)
    with pytest.raises(LoopError, match="protective stop") as caught:
        ea.run_loop(gated(robot), provoked, robot.configuration(robot.home), 1.0, PERIOD)
    assert arm.tripped.startswith("speed: ")
    record = caught.value.record
    assert 101 < len(record) < 300
    assert np.abs(record.v[-1][0]) > 0.9 * robot.velocity_limit[0]
    assert np.abs(arm.plant.v).max() < 1e-5


def test_a_joint_beyond_a_turn_stops_it():
    robot = load("ur5")
    arm = URStandIn(ea.PinocchioPlant(robot, robot.configuration(robot.home)))
    arm.measurement = arm.measurement._replace(q=arm.measurement.q + 2 * np.pi)
    arm.pass_period()
    assert arm.tripped.startswith("position: ")


def test_the_clock_of_an_arm_that_is_held_goes_on():
    """While it is held nothing moves, and time never goes back when it is let go."""
    robot = load("ur5")
    arm = URStandIn(ea.PinocchioPlant(robot, robot.configuration(robot.home)))
    times = [arm.timestamp() for _ in range(5)]
    assert np.array_equal(arm.measurement.q, robot.configuration(robot.home))
    arm.take(np.zeros(6))
    times += [arm.timestamp() for _ in range(5)]
    assert np.diff(times) == pytest.approx(PERIOD)


def refused(said):
    raise RuntimeError(said)


def test_a_protective_stop_is_recovered_only_when_asked(monkeypatch):
    """The next start is refused and says why; with recover=True it goes on where the arm is."""
    robot, arm, interface = connected()
    interface.start()
    arm.take(np.full(6, np.nan))
    interface.stop()
    with pytest.raises(HardwareError, match=r"protective stop; see the pendant why, and unlock it there"):
        interface.start()
    again = ur.URRobot("127.0.0.1", robot, library=arm, recover=True)
    with monkeypatch.context() as refusing:
        refusing.setattr(arm, "unlock", lambda: refused("not within 5 s of the stop"))
        with pytest.raises(HardwareError, match=r"the protective stop stays: not within 5 s of the stop"):
            again.start()
    with monkeypatch.context() as deaf:
        deaf.setattr(arm, "unlock", lambda: None)
        deaf.setattr(ur, "LONGEST_UNLOCK", 0.1)
        threads = threading.active_count()
        with pytest.raises(HardwareError, match=r"the protective stop stays; see the pendant why"):
            again.start()
        assert threading.active_count() == threads, "nobody goes on to wait for it"
    goal = robot.configuration(robot.home + 0.1)
    result = ea.run_loop(gated(robot), again, goal, 0.5, PERIOD)
    assert (result.ended, arm.tripped) == ("duration", "")


def test_a_load_that_is_refused_is_refused_again(monkeypatch):
    """Nothing starts with a load that the firmware does not know."""
    _, arm, interface = connected(load=(1.5, (0, 0, 0.1)))
    with monkeypatch.context() as refusing:
        refusing.setattr(ur_stand_in.Control, "setPayload", lambda *_: False)
        for begin in (interface.connect, interface.start):
            with pytest.raises(HardwareError, match=r"the robot refused the load \(1\.5, "):
                begin()
    interface.start()
    assert arm.load[0] == 1.5


@pytest.mark.parametrize("delay", [-1, 0.5, "1"])
def test_a_delay_is_a_number_of_periods(delay):
    said = "delay: expected a whole number of periods, 0 or more"
    robot = load("ur5")
    with pytest.raises(ArgumentError, match=said):
        ur.URRobot("127.0.0.1", robot, delay=delay)
    with pytest.raises(ArgumentError, match=said):
        URStandIn(ea.PinocchioPlant(robot, robot.configuration(robot.home)), delay=delay)


@pytest.mark.parametrize(
    ("mode", "said"),
    [(5, "in mode 'idle'; power the arm on and release its brakes"), (3, "in mode 'power off'")],
)
def test_a_robot_that_will_not_move_says_why(mode, said):
    _, _, interface = connected(mode=mode)
    with pytest.raises(HardwareError, match=said):
        interface.start()


def test_an_emergency_stop_is_said():
    _, arm, interface = connected()
    interface.start()
    interface.read()
    arm.emergency = True
    with pytest.raises(HardwareError, match="emergency stop; release it"):
        interface.read()


def test_a_connection_that_is_lost_is_said_so(monkeypatch):
    _, arm, interface = connected()
    interface.start()
    interface.read()
    monkeypatch.setattr(arm, "pass_period", lambda: None)
    with pytest.raises(HardwareError, match=r"no new sample for 0\.1 s"):
        interface.read()


def test_another_arm_is_refused():
    with pytest.raises(ArgumentError, match="expected the 6 joints of a UR arm, got 7 of 'panda'"):
        ur.URRobot("127.0.0.1", load("panda"))
    with pytest.raises(ArgumentError, match="expected the 6 joints of a UR arm, got 7 of 'panda'"):
        URStandIn(ea.PinocchioPlant(load("panda"), load("panda").configuration(load("panda").home)))


def test_the_stand_in_has_no_other_face_than_the_library():
    """What is called of the stand-in is there in the real classes."""
    pytest.importorskip("rtde_receive", reason="ur-rtde is not installed")
    real = ur.ur_rtde()
    faces = (
        (ur_stand_in.Receive, real.RTDEReceiveInterface),
        (ur_stand_in.Control, real.RTDEControlInterface),
        (ur_stand_in.Dashboard, real.DashboardClient),
    )
    for face, theirs in faces:
        names = {name for name in vars(face) if not name.startswith("_")}
        assert names
        assert names <= set(dir(theirs))


def test_a_robot_that_is_not_there_is_said_so():
    """By the real library: nobody listens on this machine's ports of the robot's."""
    pytest.importorskip("rtde_receive", reason="ur-rtde is not installed")
    interface = ur.URRobot("127.0.0.1", load("ur5"))
    with pytest.raises(HardwareError, match=r"127\.0\.0\.1 does not answer.*remote control"):
        interface.start()
    interface.stop()
