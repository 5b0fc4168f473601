"""However a loop ends, the robot is stopped, all that happened is kept, and it is said why."""

import re
import warnings

import numpy as np
import pytest
from looped import DT, Simulated, made

import eladapt as ea
from eladapt.errors import BrakesWarning, HardwareError, LoopError


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


class Blind(Simulated):
    """A robot whose positions are no numbers from 0.2 s on."""

    def read(self):
        m = super().read()
        return m._replace(q=m.q * np.nan) if m.t > 0.2 + DT / 2 else m


def test_a_gate_that_asks_for_brakes_ends_the_loop_in_that_tick():
    """Sensors that fail for good: all samples until then are kept, bad ones as nan; stop follows at once."""
    _, controller, plant, goal = made()
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

    class Strict(Blind):
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
