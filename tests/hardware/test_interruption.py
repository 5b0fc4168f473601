"""Signals end a loop in order: the robot's stop runs to its end, and what happened is kept."""

import pickle
import signal
import subprocess
import sys
import threading
import time
import types

import looped
import numpy as np
import pytest
from looped import DT, Simulated

import eladapt as ea
from eladapt.errors import ArgumentError, LoopError, LoopTerminated
from eladapt.hardware import interruption as module
from eladapt.hardware.interruption import ASKING, Interruption
from eladapt.hardware.loop import _driven

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.fixture(autouse=True)
def interruptible():
    """A job in a shell's background ignores Ctrl-C, and so do its children."""
    before = signal.signal(INT, signal.default_int_handler)
    yield
    signal.signal(INT, before)


class Signalled(Simulated):
    """A robot during whose calls signals come: ``at`` maps a method, and which call of it, to signals."""

    def __init__(self, plant, at, fails=""):
        super().__init__(plant, fails)
        self.signals, self.stopped = at, False

    @property
    def counts(self):
        return {name: self.calls.count(name) for name in ("start", "read", "write", "stop")}

    def _note(self, name):
        super()._note(name)
        for number in self.signals.get((name, self.calls.count(name)), ()):
            signal.raise_signal(number)

    def stop(self):
        super().stop()
        self.stopped = True


def made(at, fails=""):
    _, controller, plant, goal = looped.made()
    interface = Signalled(plant, at, fails)
    return interface, lambda **options: ea.run_loop(controller, interface, goal, 1.0, DT, **options)


@pytest.fixture(autouse=True)
def handlers():
    """Those of Python before, and after, whatever a test does."""
    before = {number: signal.getsignal(number) for number in ASKING}
    for number in (TERM, HUP):
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


IN_STOP = [(), (INT,), (TERM, HUP, INT, INT)]


@pytest.mark.parametrize("in_stop", IN_STOP)
def test_the_keyboard_ends_the_loop_with_a_result(in_stop):
    """The tick that lasts is finished, stop runs to its end whatever comes then, 20 samples are kept."""
    interface, run = made({("write", 20): (INT,), ("stop", 1): in_stop})
    if TERM in in_stop:
        with pytest.raises(LoopTerminated) as caught:
            run()
        record = caught.value.record
    else:
        result = run()
        record = result.record
        assert result.ended == "interrupted"
    assert interface.stopped
    assert interface.counts["stop"] == 1
    assert len(record) == interface.counts["write"] == 20


@pytest.mark.parametrize("in_stop", IN_STOP)
@pytest.mark.parametrize("number", [TERM, HUP])
def test_a_signal_to_end_ends_the_process_after_the_stop(number, in_stop):
    """A SystemExit with a shell's status, and record, state and timing. Handlers are as before."""
    interface, run = made({("read", 21): (number,), ("stop", 1): in_stop})
    with pytest.raises(SystemExit) as caught:
        run()
    end = caught.value
    assert interface.stopped
    assert (end.signal, end.code) == (number, 128 + number)
    assert len(end.record) == end.timing.ticks == 20
    assert end.state.measurement.t == pytest.approx(end.record.t[-1])
    assert [signal.getsignal(known) for known in (TERM, HUP)] == [signal.SIG_DFL] * 2
    assert signal.getsignal(INT) is signal.default_int_handler


def test_a_second_signal_ends_a_call_that_hangs():
    """Two during one read: it is left at once; the ones in stop leave nothing."""
    interface, run = made({("read", 21): (INT, INT), ("stop", 1): (INT, INT)})
    result = run()
    assert result.ended == "interrupted"
    assert interface.counts["write"] == len(result.record) == 19
    assert interface.stopped


def test_a_read_that_hangs_after_the_stop_is_cut():
    """Tick 201 reads first; the signal during the read after the stop raises there, and nothing is lost."""
    interface, run = made({("write", 20): (INT,), ("read", 22): (INT,)})
    result = run()
    assert interface.counts == {"start": 1, "read": 22, "write": 20, "stop": 1}
    assert interface.stopped
    assert (result.ended, len(result.record), result.unstopped) == ("interrupted", 20, "")


@pytest.mark.parametrize(("number", "error"), [(INT, LoopError), (TERM, LoopTerminated)])
def test_the_first_signal_ends_a_start_that_takes_its_time(number, error):
    interface, run = made({("start", 1): (number,)})
    with pytest.raises(error) as caught:
        run()
    assert caught.value.record is None
    assert interface.counts == {"start": 1, "read": 0, "write": 0, "stop": 1}
    assert interface.stopped


def test_a_robot_that_does_not_stop_is_louder_than_the_signal():
    interface, run = made({("write", 20): (TERM,)}, fails="stop")
    with pytest.raises(LoopError, match="after 20 of 200 steps and SIGTERM: OSError: stop failed") as caught:
        run()
    assert len(caught.value.record) == 20
    assert interface.counts["stop"] == 1


def test_a_handler_of_one_s_own_is_called_after_the_stop():
    """And the loop returns what there is, if the handler does."""
    seen = []
    interface, run = made({("write", 20): (TERM,)})
    signal.signal(TERM, lambda number, _frame: seen.append((number, interface.stopped)))
    result = run()
    assert seen == [(TERM, True)]
    assert result.ended == "interrupted"
    assert len(result.record) == 20


def test_a_signal_that_is_ignored_stays_so():
    """As under nohup: the loop goes on to its end."""
    signal.signal(HUP, signal.SIG_IGN)
    _, run = made({("write", 20): (HUP,)})
    result = run()
    assert result.ended == "duration"
    assert signal.getsignal(HUP) is signal.SIG_IGN


def test_in_another_thread_the_handlers_are_left_alone():
    """Which alone may not set any."""
    interface, run = made({})
    seen, results = [], []
    interface.start = lambda: (Signalled.start(interface), seen.append(signal.getsignal(TERM)))
    thread = threading.Thread(target=lambda: results.append(run()))
    thread.start()
    thread.join()
    assert seen == [signal.SIG_DFL]
    assert results[0].ended == "duration"


def _reached(point, noted):
    """Whether a robot was started and stopped, and how many instructions were seen, if signals come at the
    ``point``-th instruction of what stands around its calls; ``noted``: how many had come before."""
    robot = types.SimpleNamespace(started=False, stopped=False)
    seen = 0

    def start():
        robot.started = True

    def stop():
        signal.raise_signal(INT)
        robot.stopped = True

    loop = types.SimpleNamespace(
        interface=types.SimpleNamespace(start=start, stop=stop), run=lambda *_: "duration"
    )
    places = (_driven.__code__.co_filename, module.__file__)

    def trace(frame, event, _argument):
        nonlocal seen
        if frame.f_code.co_filename not in places or frame.f_code.co_name == "_came":
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            seen += 1
            if seen == point:
                signal.raise_signal(INT)
                signal.raise_signal(INT)
        return trace

    with Interruption() as interruption:
        interruption.signals += [INT] * noted
        sys.settrace(trace)
        try:
            _driven(loop, None, 0.0, interruption)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
    return robot, seen


@pytest.mark.parametrize("noted", [0, 1])
def test_no_instruction_is_the_wrong_one_for_a_signal(noted):
    """Two signals at each instruction from before the start to after the stop: who was started is stopped."""
    robot, instructions = _reached(None, noted)
    assert robot.stopped
    assert instructions > 50
    for point in range(1, instructions + 1):
        robot, _ = _reached(point, noted)
        assert robot.stopped or not robot.started, f"signals at instruction {point} of {instructions}"


PROGRAM = """
import time
import numpy as np
import eladapt as ea
robot = ea.Robot.load("two_link")
plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
class Interface:
    def start(self):
        self.measurement = plant.reset()
        print("started", flush=True)
    def read(self): return self.measurement
    def write(self, tau): self.measurement = plant.step(tau, 5e-3)
    def stop(self):
        print("stopping", flush=True)
        time.sleep(0.5)
        print("stopped", flush=True)
controller = ea.CompositeController.for_robot(robot, 5e-3)
try:
    ea.run_loop(controller, Interface(), robot.configuration(robot.target), 60.0, 5e-3)
finally:
    print("unwound", flush=True)
"""


@pytest.mark.parametrize(("number", "status"), [(TERM, 143), (HUP, 129)])
def test_a_process_that_is_killed_stops_its_robot(number, status):
    """From outside, and once more while it stops; then it ends as a process does that was asked to."""
    process = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
    lines = []
    for line in process.stdout:
        lines.append(line.strip())
        if lines[-1] in ("started", "stopping"):
            process.send_signal(number)
    assert process.wait(60) == status
    assert lines == ["started", "stopping", "stopped", "unwound"]


def test_what_a_signal_leaves_can_be_saved(tmp_path):
    """The record as any other, and all of it in a pickle."""
    _, run = made({("write", 20): (TERM,)})
    with pytest.raises(LoopTerminated) as caught:
        run()
    back = ea.Record.load(caught.value.record.save(tmp_path / "run.npz"))
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.code, again.signal, again.timing) == (143, TERM, caught.value.timing)
    assert np.array_equal(back.tau, caught.value.record.tau)


def test_another_thread_stops_the_arm():
    """In the midst of a move: the robot is stopped once, the record kept, and one line says so."""
    interface, run = made({})
    stop = threading.Event()
    results = []
    thread = threading.Thread(target=lambda: results.append(run(stop=stop)))
    thread.start()
    while interface.counts["write"] < 20:
        time.sleep(1e-3)
    stop.set()
    thread.join(10)
    (result,) = results
    assert result.ended == "stopped"
    assert interface.stopped
    assert interface.counts["stop"] == 1
    assert 20 <= len(result.record) == interface.counts["write"] < 100
    assert str(result) == f"the loop stopped by its caller, after {len(result.record)} ticks"


def test_what_does_not_stop_an_arm_is_refused_before_it_moves():
    interface, run = made({})
    stop = threading.Event()
    stop.set()
    with pytest.raises(ArgumentError, match="stop: is set already"):
        run(stop=stop)
    with pytest.raises(ArgumentError, match=r"stop: expected a threading\.Event or None, got True"):
        run(stop=True)
    assert interface.counts["start"] == 0
