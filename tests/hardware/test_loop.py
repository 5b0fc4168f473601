"""The loop reads, steps and writes at its rate, keeps all that happened, and always stops the robot."""

import dataclasses
import gc
import multiprocessing
import os
import re
import socket
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, BrakesWarning, HardwareError, LoopError, StateError
from eladapt.gains.extremes import effort, extremes
from eladapt.hardware.timing import Pacer, undisturbed
from eladapt.hardware.udp import MOST_PACKETS, STATE, TORQUE, Packet, serve

DT = 5e-3  # slow enough for a busy machine


class Simulated:
    """A plant behind the four methods; every call is noted, and one of them can be made to fail."""

    def __init__(self, plant, fails="", at=0, dt=DT):
        self.plant, self.fails, self.at, self.dt = plant, fails, at, dt
        self.calls, self.measurement = [], None

    def _note(self, name):
        self.calls.append(name)
        if name == self.fails and self.calls.count(name) > self.at:
            raise OSError(f"{name} failed")

    def start(self):
        self.measurement = self.plant.reset()
        self._note("start")

    def read(self):
        self._note("read")
        return self.measurement

    def write(self, tau):
        self._note("write")
        self.measurement = self.plant.step(tau, self.dt)

    def stop(self):
        self._note("stop")
        self.plant.brake()
        while np.abs(self.plant.v).max() > 1e-9:
            self.measurement = self.plant.step(self.measurement.tau, self.dt)


def made(name="two_link", **limits):
    robot = load(name)
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT, **limits)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return robot, controller, plant, robot.configuration(robot.target)


def test_the_loop_regulates_at_its_rate_and_stops_the_robot():
    """Two seconds of the two-link arm: as many calls as ticks, the set-point reached, the rate kept."""
    robot, controller, plant, goal = made()
    interface = Simulated(plant)
    began = time.monotonic()
    result = ea.run_loop(controller, interface, goal, 2.0, DT)
    took = time.monotonic() - began
    assert result.ended == "duration"
    assert result.fault is None
    ticks = result.timing.ticks
    assert interface.calls[:2] == ["start", "read"]
    assert interface.calls[2:] == [*["read", "write"] * ticks, "stop", "read"]
    assert result.unstopped == ""
    assert len(result.record) == ticks
    assert ticks + result.timing.missed == pytest.approx(400, abs=1)
    assert took > 1.9, "the loop did not wait"
    assert np.abs(result.record.error[-1]).max() < 2e-3
    assert result.record.title == robot.name


@pytest.mark.parametrize(("fails", "at"), [("read", 31), ("write", 30)])
def test_a_robot_that_fails_leaves_the_record_and_is_stopped(fails, at):
    """The 31st exchange fails: 30 samples are kept, the state too, and stop was called once, last."""
    _, controller, plant, goal = made()
    interface = Simulated(plant, fails, at)
    with pytest.raises(LoopError, match=rf"after 30 of 200 steps: OSError: {fails} failed") as caught:
        ea.run_loop(controller, interface, goal, 1.0, DT)
    assert interface.calls.count("stop") == 1
    assert interface.calls[-2:] == ["stop", "read"]
    assert len(caught.value.record) == 30
    assert np.isfinite(caught.value.record.tau).all()
    # a command that failed belongs to a step that was made
    ahead = {"read": 0, "write": DT}[fails]
    assert caught.value.state.measurement.t == pytest.approx(caught.value.record.t[-1] + ahead)
    assert caught.value.timing.ticks == 30
    assert isinstance(caught.value.__cause__, OSError)


def test_a_robot_that_does_not_start_is_stopped_too():
    _, controller, plant, goal = made()
    interface = Simulated(plant, "start")
    with pytest.raises(LoopError, match="start failed") as caught:
        ea.run_loop(controller, interface, goal, 1.0, DT)
    assert interface.calls == ["start", "stop"]
    assert caught.value.record is None


def test_a_robot_that_does_not_stop_is_said_so():
    """The run is in the error."""
    _, controller, plant, goal = made()
    with pytest.raises(LoopError, match="stop failed") as caught:
        ea.run_loop(controller, Simulated(plant, "stop"), goal, 0.1, DT)
    assert len(caught.value.record) == caught.value.timing.ticks > 0


def test_the_keyboard_ends_the_loop_in_order():
    """An interrupt stops the robot and returns what there is."""
    _, controller, plant, goal = made()

    class Interrupted(Simulated):
        def read(self):
            if self.calls.count("read") == 21:
                raise KeyboardInterrupt
            return super().read()

    interface = Interrupted(plant)
    result = ea.run_loop(controller, interface, goal, 5.0, DT)
    assert result.ended == "interrupted"
    assert len(result.record) == 20
    assert interface.calls[-1] == "stop", "it is read once more, and interrupted again"


class Unbraked(Simulated):
    """A robot whose stop does nothing: the arm moves on."""

    def stop(self):
        self._note("stop")
        self.measurement = self.plant.step(self.measurement.tau, self.dt)


def test_a_stop_that_returns_while_the_arm_moves_is_said():
    """In the midst of a move: by joint and speed, in the result, in an error and in a warning; brakes that
    close in time leave nothing to say."""
    _, controller, plant, goal = made()
    said = r"stop returned while '(shoulder|elbow)' moves at -?[\d.]+ rad/s"
    with pytest.warns(BrakesWarning, match=said):
        result = ea.run_loop(controller, Unbraked(plant), goal, 0.3, DT)
    assert re.fullmatch(said, result.unstopped)
    with pytest.warns(BrakesWarning), pytest.raises(LoopError, match=f"OSError: write failed; {said}"):
        ea.run_loop(controller, Unbraked(plant, "write", 60), goal, 1.0, DT)
    with warnings.catch_warnings():
        warnings.simplefilter("error", BrakesWarning)
        assert ea.run_loop(controller, Simulated(plant), goal, 0.3, DT).unstopped == ""


@pytest.mark.parametrize("answer", [OSError("closed"), KeyboardInterrupt(), None, "broken"])
def test_a_robot_that_has_stopped_need_not_answer(answer):
    """Whatever it raises or returns then, the result is as it was."""
    _, controller, plant, goal = made()

    class Gone(Simulated):
        def read(self):
            if "stop" not in self.calls:
                return super().read()
            if isinstance(answer, BaseException):
                raise answer
            return answer

    result = ea.run_loop(controller, Gone(plant), goal, 0.3, DT)
    assert (result.ended, result.unstopped) == ("duration", "")


def test_a_sample_of_before_the_stop_says_nothing_of_after_it():
    """An interface that gives the last sample again, in the midst of the move, is not taken for an arm that
    moves on."""
    _, controller, plant, goal = made()

    class Stale(Simulated):
        def read(self):
            if "stop" not in self.calls:
                self.last = super().read()
            return self.last

        def stop(self):
            self._note("stop")

    interface = Stale(plant)
    result = ea.run_loop(controller, interface, goal, 0.3, DT)
    assert np.abs(interface.last.v).max() > 0.1, "it moved"
    assert result.unstopped == ""


def test_a_gate_that_asks_for_brakes_ends_the_loop_in_that_tick():
    """Sensors that fail for good: all samples until then are kept, bad ones as nan; stop follows at once."""
    _, controller, plant, goal = made()

    class Blind(Simulated):
        def read(self):
            m = super().read()
            return m._replace(q=m.q * np.nan) if m.t > 0.2 + DT / 2 else m

    interface = Blind(plant)
    result = ea.run_loop(controller, interface, goal, 5.0, DT, after_fault=1.0)
    assert (result.ended, result.state.brake) == ("fault", True)
    assert interface.calls[-3:] == ["write", "stop", "read"]
    assert result.fault.name == "measurement"
    assert result.record.faults == (result.fault,)
    t, late = result.record.t, result.record.t > 0.2 + DT / 2
    assert np.allclose(np.diff(t), DT)
    assert np.isfinite(result.record.q[~late]).all()
    assert np.isnan(result.record.q[late]).all()
    assert np.isnan(result.record.error[late]).all()
    assert np.isfinite(result.record.tau).all()
    assert result.record.brakes[0].t == pytest.approx(t[-1])
    assert t[-1] == pytest.approx(result.fault.t, abs=DT / 2)


def test_a_robot_that_refuses_the_last_torque_leaves_the_gate_s_fault():
    """In the tick in which brakes are wanted, one that stops itself for the torque's step is no other end."""
    _, controller, plant, goal = made()

    class Strict(Simulated):
        def read(self):
            m = super().read()
            return m._replace(q=m.q * np.nan) if m.t > 0.2 + DT / 2 else m

        def write(self, tau):
            if self.measurement.t > 0.2 + controller.gate.max_age + DT / 2:
                raise HardwareError("protective stop")
            super().write(tau)

    interface = Strict(plant)
    result = ea.run_loop(controller, interface, goal, 1.0, DT)
    assert (result.ended, result.state.brake) == ("fault", True)
    assert interface.calls[-2:] == ["stop", "read"]
    assert str(result).startswith(f"the loop ended by the gate: {result.fault}, after ")


def test_a_fault_that_torque_can_hold_is_held_for_a_while():
    """A goal that is none: the fallback goes on for ``after_fault``, and no brakes are asked for."""
    _, controller, plant, goal = made()
    result = ea.run_loop(
        controller, Simulated(plant), lambda t: goal if t < 0.2 else goal * np.nan, 5.0, DT, after_fault=0.1
    )
    assert (result.ended, result.fault.name, result.state.brake) == ("fault", "goal", False)
    assert result.record.brakes == ()
    assert result.record.t[-1] == pytest.approx(result.fault.t + 0.1, abs=2 * DT)


def test_a_goal_may_be_a_reference_that_moves():
    """The gate and the record take it as `simulate` does; one that is broken is a fault, not a crash."""
    robot, controller, plant, goal = made()
    still, moved = np.zeros(robot.nv), np.full(robot.nv, 0.1)

    def course(t):
        return ea.Reference(robot.integrate(plant.q0, t * moved), moved, still)

    result = ea.run_loop(controller, Simulated(plant), course, 0.2, DT, shaped=False)
    record = result.record
    assert result.fault is None
    np.testing.assert_array_equal(record.goal_velocity, np.tile(moved, (len(record), 1)))
    np.testing.assert_array_equal(record.goal[-1], course(record.t[-1]).q)
    assert np.array_equal(result.state.gate.goal.v, moved)
    broken = ea.Reference(goal, "fast", still)
    result = ea.run_loop(controller, Simulated(plant), lambda t: broken, 0.2, DT, after_fault=0.05)
    assert result.fault.name == "goal"
    assert np.isnan(result.record.goal_velocity).all()
    assert np.isfinite(result.record.tau).all()


def test_a_checkpoint_carries_what_was_learned_to_the_next_run(tmp_path):
    """The next run, on a robot whose clock begins again, has the estimate and the information of the last."""
    _, controller, plant, goal = made()
    path = tmp_path / "state.npz"
    first = ea.run_loop(controller, Simulated(plant), goal, 2.0, DT, checkpoint=path, every=0.25)
    state = ea.load_state(path, controller)
    assert np.array_equal(state.theta, first.state.theta)
    second = ea.run_loop(controller, Simulated(plant), goal, 2.0, DT, state=state)
    assert second.fault is None
    assert second.record.theta_true is None, "of a real robot nothing is known"
    true = controller.regressors.theta_potential
    # the first run moved both joints, so that gravity is known to a percent from the first sample on
    assert np.abs(second.record.theta[0] - true).max() < 0.01 * np.abs(true).max()
    assert np.abs(second.record.theta[-1] - true).max() < 0.01 * np.abs(true).max()
    assert np.abs(second.record.error[-1]).max() < 2e-3
    with pytest.raises(StateError):
        ea.load_state(path, dataclasses.replace(controller, gate=made(max_age=0.5)[1].gate))


def test_a_state_with_a_fault_is_refused_until_reset():
    _, controller, plant, goal = made()
    state = controller.init(plant.reset())
    state, _ = controller.step(state, plant.reset(), goal * np.nan, DT)
    with pytest.raises(ArgumentError, match=r"holds the fault goal at .* clear it"):
        ea.run_loop(controller, Simulated(plant), goal, 0.1, DT, state=state)
    result = ea.run_loop(controller, Simulated(plant), goal, 0.1, DT, state=controller.reset(state))
    assert result.fault is None


@pytest.mark.parametrize("missing", ["start", "read", "write", "stop"])
def test_an_interface_that_lacks_a_method_is_refused_before_anything_starts(missing):
    """Above all one without stop, which would be missed when the arm moves."""
    _, controller, plant, goal = made()
    interface = Simulated(plant)
    setattr(interface, missing, None)
    with pytest.raises(ArgumentError, match=rf"interface: expected .* Simulated lacks {missing}$"):
        ea.run_loop(controller, interface, goal, 0.1, DT)
    assert interface.calls == []


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (None, r"goal: expected shape \(2,\), got \(\)"),
        ([0.1, 0.2, 0.3], r"goal: expected shape \(2,\), got \(3,\)"),
        ([0.1, np.nan], "goal: expected finite numbers"),
        ("home", "goal: expected 2 numbers, got 'home'"),
        (ea.Reference(np.zeros(2), np.zeros(3), np.zeros(2)), r"goal.v: expected shape \(2,\)"),
    ],
)
def test_a_fixed_goal_that_is_none_is_refused_before_the_robot_starts(goal, said):
    """With what was given, and what a goal may be."""
    _, controller, plant, _ = made()
    interface = Simulated(plant)
    with pytest.raises(ArgumentError, match=rf"{said}.*; expected q_d \(2,\), a Reference, or a callable"):
        ea.run_loop(controller, interface, goal, 0.1, DT)
    assert interface.calls == []


def test_a_record_that_memory_does_not_hold_is_refused_before_the_robot_starts():
    """With what it would take, and what there is."""
    _, controller, plant, goal = made()
    interface = Simulated(plant)
    with pytest.raises(ArgumentError, match=r"of 2e\+11 samples takes .* GB of memory, this computer has"):
        ea.run_loop(controller, interface, goal, 1e9, DT)
    with pytest.raises(ArgumentError, match="duration: expected a finite number"):
        ea.run_loop(controller, interface, goal, 1e308, DT)
    assert interface.calls == []


def test_a_goal_that_is_shaped_inside_a_gate_is_not_shaped_again():
    """The state is that of the controller given, whose innermost holds the reference."""
    robot, controller, plant, goal = made()
    inside = ea.GatedController.for_robot(ea.Shaped(controller.controller), DT)
    result = ea.run_loop(inside, Simulated(plant), goal, 0.1, DT)
    assert isinstance(result.state.inner.reference, ea.Reference)
    with pytest.raises(ArgumentError, match="controller: expected a controller, got Robot"):
        ea.run_loop(robot, Simulated(plant), goal, 0.1, DT)


def test_garbage_collection_is_as_before():
    assert gc.isenabled()
    with undisturbed():
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(HardwareError, match="priority: 1000 was refused"), undisturbed(priority=1000):
        pass
    assert gc.isenabled()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads are not bound to processors here")
def test_a_loop_keeps_to_its_processors_and_leaves_them_as_they_were():
    """While it runs, and no longer; processors that are not there are said before anything moves."""
    _, controller, plant, goal = made()
    before = os.sched_getaffinity(0)
    one = max(before)
    seen = set()

    class Seeing(Simulated):
        def write(self, tau):
            seen.update(os.sched_getaffinity(0))
            super().write(tau)

    ea.run_loop(controller, Seeing(plant), goal, 0.1, DT, cpus=[one])
    assert seen == {one}
    assert os.sched_getaffinity(0) == before
    interface = Seeing(plant)
    for cpus, said in (([4096], r"got \[4096\]"), ([], r"got \[\]"), (["a"], "numbers out of .*'a'")):
        with pytest.raises(HardwareError, match=f"cpus: expected .*{said}"):
            ea.run_loop(controller, interface, goal, 0.1, DT, cpus=cpus)
    assert interface.calls == []
    assert os.sched_getaffinity(0) == before


def permitted() -> bool:
    """Whether real-time priority is."""
    try:
        with undisturbed(priority=1):
            return True
    except HardwareError:
        return False


@pytest.mark.skipif(not permitted(), reason="real-time priority is not permitted here")
def test_real_time_priority_lasts_as_long_as_the_loop():
    """And what is in memory stays there meanwhile, where that is permitted."""
    before = locked_memory()
    with undisturbed(priority=3):
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        assert os.sched_getparam(0).sched_priority == 3
        if os.geteuid() == 0:
            assert locked_memory() > before
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert locked_memory() == before


def locked_memory() -> int:
    """[kB] of this process that stay in memory."""
    return int(re.search(r"VmLck:\s+(\d+)", Path("/proc/self/status").read_text())[1])


def test_the_pacer_counts_what_is_late_and_does_not_catch_up():
    """A tick of 3.5 periods is one overrun and two or more ticks missed; the next is not hurried."""
    pacer = Pacer(0.02)
    pacer.restart()
    for k in range(6):
        pacer.began(0.0)
        if k == 2:
            time.sleep(0.07)
        pacer.wait()
    timing = pacer.timing()
    assert timing.ticks == 6
    assert timing.overruns >= 1
    assert timing.missed >= 2
    assert timing.work[3] >= 0.07
    assert "1 overruns (16.67%)" in str(timing) or timing.overruns > 1
    assert sum(timing.work_counts) == sum(timing.late_counts) == timing.ticks
    assert timing.work_counts[-1] >= 1, "above the last edge, 5 ms"
    assert timing.late_counts[-1] < timing.ticks


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


def test_a_robot_that_keeps_the_clock_is_the_only_one_that_is_waited_for():
    """Its cycles are twice as long as the loop's period: as many ticks as there are cycles, none late."""
    _, controller, plant, goal = made()

    class Slow(Simulated):
        keeps_clock = True

        def read(self):
            time.sleep(2 * DT)
            return super().read()

    result = ea.run_loop(controller, Slow(plant), goal, 50 * DT, DT)
    assert result.timing.ticks == 50
    assert result.timing.missed == 0
    assert result.timing.late == (0, 0, 0, 0)


def test_what_is_missed_of_a_robot_that_keeps_the_clock_its_time_stamps_say():
    """Every tenth cycle goes unread; a controller that is slower than the cycles of a simulated clock misses
    none of them."""
    _, controller, plant, goal = made()

    class Lossy(Simulated):
        keeps_clock = True
        lost = 0

        def write(self, tau):
            super().write(tau)
            time.sleep(2 * DT)
            if self.lost and self.calls.count("write") % self.lost == 0:
                super().write(tau)

    result = ea.run_loop(controller, Lossy(plant), goal, 50 * DT, DT)
    assert (result.timing.ticks, result.timing.missed, result.timing.overruns) == (50, 0, 50)
    lossy = Lossy(plant)
    lossy.lost = 10
    result = ea.run_loop(controller, lossy, goal, 50 * DT, DT)
    assert result.timing.missed in (4, 5)
    assert result.timing.ticks + result.timing.missed == 50
    assert result.record.t[-1] - result.record.t[0] == pytest.approx(49 * DT)
