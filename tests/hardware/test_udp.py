"""A robot behind UDP, in another process: regulated, and not disturbed by what is no packet."""

import multiprocessing
import socket
import time

import numpy as np
import pytest
from looped import DT, made
from shared import load

import eladapt as ea
from eladapt.errors import HardwareError
from eladapt.gains.extremes import effort, extremes
from eladapt.hardware.udp import MOST_PACKETS, STATE, TORQUE, Packet, serve


def arm(name, pipe):
    """A robot in another process."""
    robot = load(name)
    pipe.send(
        serve(ea.PinocchioPlant(robot, robot.configuration(robot.home)), DT, ready=pipe.send, patience=60)
    )


@pytest.fixture
def served():
    """A two-link robot behind a socket: its port, and its report when it has ended."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=arm, args=("two_link", there))
    process.start()
    there.close()
    assert here.poll(60)
    yield here.recv(), here
    process.join(10)
    assert not process.is_alive()


def test_a_robot_in_another_process_is_regulated_over_udp(served):
    """The set-point within 2e-3 rad, torques taken, nothing refused, an end in order."""
    port, report = served
    robot, controller, _, goal = made(max_age=0.2)
    interface = ea.UdpRobot(robot, port, dt=DT)
    result = ea.run_loop(controller, interface, goal, 3.0, DT)
    end = report.recv()
    assert end.ended == "stop"
    assert end.refused == 0
    assert end.commands > 0.5 * result.timing.ticks
    assert result.fault is None
    assert np.abs(result.record.error[-1]).max() < 2e-3


def test_what_is_no_packet_is_ignored(served):
    """Noise on the port, another sender and a torque that is nan change nothing; silence ends the robot."""
    port, report = served
    robot = load("two_link")
    interface = ea.UdpRobot(robot, port, dt=DT)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(("127.0.0.1", port))
        stranger.send(b"hello")
        stranger.send(b"ELA1torq" + b"\0" * 7)
        interface.start()
        stranger.send(Packet(TORQUE, 1, np.full(2, 9.0)).pack())
        interface.write(np.array([np.nan, 0.0]))
        time.sleep(0.1)
        assert interface.read().t == 0.0, "the brakes hold until a torque is taken"
        last = interface.read()
        last.q[:] = np.nan
        assert np.isfinite(interface.read().q).all(), "what was read is one's own"
    assert report.poll(10)
    end = report.recv()
    assert end.ended == "silence"
    assert end.commands == 0
    assert end.refused == 3, "what the stranger sent after the start never arrived"


def test_packets_without_end_do_not_stop_the_clock(monkeypatch):
    """A socket that always has another one: the robot waits for as long as it was told to, and no longer."""

    class Flooded(socket.socket):
        def recvfrom(self, size):
            return b"hello", ("127.0.0.1", 9)

    monkeypatch.setattr("eladapt.hardware.udp.socket.socket", Flooded)
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    end = serve(plant, DT, ready=lambda port: None, patience=1.0)
    assert end.ended == "nobody came"
    assert end.timing.ticks > 20, "of 200, on a machine that is busy"
    assert end.refused == MOST_PACKETS * end.timing.ticks


def test_a_torque_beyond_the_effort_limits_is_held_to_them(served):
    """1e6 N m, under which a plant would diverge within a step, and 1 N m, which is taken as it is."""
    port, report = served
    robot = load("two_link")
    interface = ea.UdpRobot(robot, port, dt=DT)
    most = effort(robot, extremes(robot))  # this URDF sets none
    interface.start()
    for torque, applied in (([1e6, -1e6], most * [1, -1]), ([1.0, -1.0], [1.0, -1.0])):
        interface.write(np.array(torque))
        time.sleep(0.05)
        np.testing.assert_array_equal(interface.read().tau, applied)
    interface.stop()
    end = report.recv()
    assert end.ended == "stop"
    assert (end.commands, end.clipped, end.refused) == (2, 1, 0)


def test_nobody_answers_is_said():
    interface = ea.UdpRobot(load("two_link"), 9, dt=DT)
    with pytest.raises(HardwareError, match=r"no robot answers at 127\.0\.0\.1:9"):
        interface.start(timeout=0.2)
    interface.stop()
    with pytest.raises(HardwareError, match="start the robot first"):
        interface.read()


def test_packets_come_back_as_they_were():
    packet = Packet(STATE, 2**40, np.array([np.pi, -0.0, 1e300]))
    back = Packet.unpack(packet.pack(), {STATE: 3})
    assert back.kind == STATE
    assert back.number == 2**40
    assert np.array_equal(back.values, packet.values)
    for data in (b"", packet.pack()[:-1], packet.pack() + b"\0", b"x" + packet.pack()[1:]):
        assert Packet.unpack(data, {STATE: 3}) is None
    assert Packet.unpack(packet.pack(), {TORQUE: 3}) is None
