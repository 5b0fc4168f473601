"""What is kept of a loop never stops the robot: what can be found wrong is said before it starts."""

import warnings

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, BookkeepingWarning, LoopError, StateError
from eladapt.records.state_file import StateWriter

DT = 5e-3


class Robot:
    """A plant behind the four methods, which counts ticks and says whether it was started and stopped."""

    def __init__(self, fails=False):
        robot = load("two_link")
        self.plant, self.fails = ea.PinocchioPlant(robot, robot.configuration(robot.home)), fails
        self.started = self.stopped = False
        self.ticks = 0

    def start(self):
        self.started, self.measurement = True, self.plant.reset()
        if self.fails:
            raise OSError("no power")

    def read(self):
        return self.measurement

    def write(self, tau):
        self.ticks += 1
        self.measurement = self.plant.step(tau, DT)

    def stop(self):
        self.stopped = True
        self.plant.brake()
        while np.abs(self.plant.v).max() > 1e-9:
            self.measurement = self.plant.step(self.measurement.tau, DT)


def made():
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(load("two_link"), DT), DT)


def run(interface, controller=None, **options):
    robot = load("two_link")
    return ea.run_loop(controller or made(), interface, robot.configuration(robot.target), 0.5, DT, **options)


@pytest.mark.parametrize(
    ("where", "error", "said"),
    [
        ("state.txt", ArgumentError, r"ends with \.npz, got 'state\.txt'"),
        ("file/state.npz", StateError, "cannot be written"),
        ("folder.npz", StateError, "cannot be written .*directory"),
    ],
)
def test_a_checkpoint_that_cannot_be_written_is_said_before_the_robot_starts(tmp_path, where, error, said):
    (tmp_path / "file").touch()
    (tmp_path / "folder.npz").mkdir()
    interface = Robot()
    with pytest.raises(error, match=said):
        run(interface, checkpoint=tmp_path / where)
    assert not interface.started


def test_a_full_disk_is_said_before_the_robot_starts(tmp_path, monkeypatch):
    """A state is written once, for nothing."""
    interface, path = Robot(), tmp_path / "state.npz"

    def full(file, **arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(StateError, match="No space left"):
        run(interface, checkpoint=path)
    assert not interface.started
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", [{"every": 0.0}, {"every": "often"}, {"after_fault": None}])
def test_times_are_looked_at_before_the_robot_starts(bad):
    interface = Robot()
    with pytest.raises(ArgumentError, match=next(iter(bad))):
        run(interface, **bad)
    assert not interface.started


def test_the_trial_leaves_an_older_checkpoint_as_it_was(tmp_path):
    """A robot that does not start costs nothing of what was learned before."""
    path = tmp_path / "state.npz"
    run(Robot(), checkpoint=path)
    before = path.read_bytes()
    with pytest.raises(LoopError, match="no power"):
        run(Robot(fails=True), checkpoint=path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("strict", [False, True], ids=["warnings", "warnings as errors"])
def test_a_checkpoint_that_fails_in_the_move_is_warned_of_once(tmp_path, monkeypatch, strict):
    """From the second on none can be written: all ticks are made, the record is whole, the result says so."""
    interface, path, written = Robot(), tmp_path / "state.npz", []
    write = StateWriter.write

    def failing(self, path, state):
        written.append(state)
        if len(written) > 1:
            raise StateError(f"{path}: cannot be written (No space left on device)")
        return write(self, path, state)

    monkeypatch.setattr(StateWriter, "write", failing)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("error" if strict else "always")
        result = run(interface, checkpoint=path, every=0.1)
    assert result.ended == "duration"
    assert len(written) >= 4
    assert len(result.record) == interface.ticks == result.timing.ticks
    assert result.unkept == (f"checkpoint: StateError: {path}: cannot be written (No space left on device)",)
    assert [item.category for item in caught] == ([] if strict else [BookkeepingWarning])
    assert ea.load_state(path, made()).measurement.t == pytest.approx(written[0].measurement.t)


def test_a_record_that_fails_in_the_move_ends_there_and_the_move_does_not():
    """A controller of a user's own that cannot say what it estimates any more: 30 samples, and all ticks."""

    class Forgetful(ea.CompositeController):
        def recorded(self, state):
            if state.measurement.t > 29.5 * DT:
                raise ZeroDivisionError("no estimate")
            return super().recorded(state)

    controller = Forgetful.for_robot(load("two_link"), DT)
    interface = Robot()
    with pytest.warns(BookkeepingWarning, match="record: ZeroDivisionError: no estimate; the robot moves on"):
        result = run(interface, controller)
    assert interface.ticks == result.timing.ticks > 40
    assert len(result.record) == 30
    assert result.unkept == ("record: ZeroDivisionError: no estimate",)
    assert result.state.measurement.t > 40 * DT


def test_a_record_that_cannot_be_made_leaves_state_and_timing(monkeypatch):
    """The error has them, and the reason."""
    from eladapt.records.recorder import Recorder

    def broken(self):
        raise MemoryError("too long")

    monkeypatch.setattr(Recorder, "record", broken)
    interface = Robot()
    with pytest.warns(BookkeepingWarning), pytest.raises(LoopError, match="MemoryError: too long") as caught:
        run(interface)
    assert interface.stopped
    assert caught.value.record is None
    assert caught.value.timing.ticks == interface.ticks
    assert caught.value.state.measurement.t > 40 * DT


def test_a_driver_that_uses_its_buffers_again_changes_neither_torque_nor_record():
    """It scales the torque in place and returns the same three arrays at every read: the samples are those of
    a driver that does not, bit for bit, as far as both came."""

    class Frugal(Robot):
        def read(self):
            if not hasattr(self, "buffers"):
                self.buffers = self.measurement.copy()
            for buffer, values in zip(self.buffers[1:], self.measurement[1:], strict=True):
                buffer[:] = values
            return self.buffers._replace(t=self.measurement.t)

        def write(self, tau):
            super().write(tau.copy())
            tau *= 1000.0
            for buffer in self.buffers[1:]:
                buffer[:] = np.nan

    plain, frugal = run(Robot()).record, run(Frugal()).record
    both = min(len(plain), len(frugal))
    assert both > 40
    for name in ("t", "q", "v", "tau", "theta"):
        assert np.array_equal(getattr(frugal, name)[:both], getattr(plain, name)[:both]), name
