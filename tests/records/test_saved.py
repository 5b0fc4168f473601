"""A state that was saved is the state; anything else is refused."""

import dataclasses
import functools
import json
import shutil
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, StateError
from eladapt.records.description import describe, identity

DT = 1e-3
CONTROLLERS = {
    "composite": lambda: ea.CompositeController.for_robot(load("ur5")),
    "no joint terms": lambda: ea.CompositeController.for_robot(load("ur5"), joint_terms=()),
    "gated": lambda: ea.GatedController.for_robot(ea.CompositeController.for_robot(load("ur5"))),
    "Slotine-Li": lambda: ea.SlotineLi.for_robot(load("ur5")),
    "terminal sliding": lambda: ea.TerminalSliding.for_robot(load("ur5")),
}


def torques(controller, plant, state, measurement, steps):
    """What the controller commands from here on, to the goal of the library."""
    goal, out = controller.robot.configuration(controller.robot.target), []
    for _ in range(steps):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        out.append(tau)
    return state, measurement, np.array(out)


def half_way(controller, steps=150):
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=ea.Payload(1.0, attach=0.1))
    measurement = plant.reset()
    state, measurement, _ = torques(controller, plant, controller.init(measurement), measurement, steps)
    return plant, state, measurement


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_a_resumed_run_is_the_run(kind, tmp_path):
    """Saved half-way, loaded by a controller made anew: 100 more torques are equal bit for bit."""
    controller = CONTROLLERS[kind]()
    plant, state, measurement = half_way(controller)
    path = ea.save_state(tmp_path / "state.npz", controller, state)
    before = plant.t, plant.q, plant.v
    _, _, expected = torques(controller, plant, state, measurement, 100)
    again = CONTROLLERS[kind]()
    plant.t, plant.q, plant.v = before
    _, _, resumed = torques(again, plant, ea.load_state(path, again), measurement, 100)
    assert np.array_equal(expected, resumed)
    assert np.ptp(expected, axis=0).min() > 0, "nothing happened"


RESUME = """
import sys
import numpy as np
import eladapt as ea
robot = ea.Robot.load("ur5")
controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot))
state = ea.load_state(sys.argv[1], controller)
seen = np.load(sys.argv[2])
out = []
for t, row in zip(seen["t"], seen["rows"]):
    measurement = ea.Measurement(float(t), row[:6], row[6:12], row[12:])
    state, tau = controller.step(state, measurement, robot.configuration(robot.target), 1e-3)
    out.append(tau)
np.save(sys.argv[3], out)
"""


def test_another_process_resumes_bit_for_bit(tmp_path):
    """A new interpreter that knows nothing but the file commands the same torques."""
    controller = CONTROLLERS["gated"]()
    plant, state, measurement = half_way(controller)
    path = ea.save_state(tmp_path / "state.npz", controller, state)
    goal, seen, expected = controller.robot.configuration(controller.robot.target), [], []
    for _ in range(50):
        seen.append(measurement)
        state, tau = controller.step(state, measurement, goal, DT)
        expected.append(tau)
        measurement = plant.step(tau, DT)
    rows = np.array([np.concatenate(m[1:]) for m in seen])
    np.savez(tmp_path / "seen.npz", t=[m.t for m in seen], rows=rows)
    command = [sys.executable, "-c", RESUME, path, tmp_path / "seen.npz", tmp_path / "out.npy"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert np.array_equal(np.load(tmp_path / "out.npy"), expected)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    _, state, _ = half_way(controller, 50)
    return controller, state, ea.save_state(tmp_path_factory.mktemp("saved") / "state.npz", controller, state)


def test_another_controller_is_refused_and_the_difference_named(saved, tmp_path):
    """A gain, a limit, an option, a robot or its inertia: the message says which and both values."""
    controller, _, path = saved
    robot = controller.robot
    text = robot.path.read_text().replace('mass value="1"', 'mass value="1.001"')
    (tmp_path / "other.urdf").write_text(text)
    heavier = ea.Robot.from_urdf(tmp_path / "other.urdf", zero_parameters=robot.zero_parameters)
    damped = robot.model.copy()
    damped.damping = np.full(robot.nv, 0.1)
    others = {
        r"model\.damping is \[0.1, 0.1\]": ea.CompositeController.for_robot(
            dataclasses.replace(robot, model=damped)
        ),
        r"control\.P is \[.*\], in the file \[": ea.CompositeController.for_robot(robot, P=[10, 5]),
        "effort_limit is": dataclasses.replace(controller, effort_limit=4.0),
        r"regressors\.coulomb is False, in the file True": ea.CompositeController.for_robot(
            robot, joint_terms=("rotor", "viscous")
        ),
        "joints is shoulder_pan": ea.CompositeController.for_robot(load("ur5")),
        "model.inertias is": ea.CompositeController.for_robot(heavier),
        "class is GatedController, in the file CompositeController": ea.GatedController.for_robot(controller),
    }
    for said, other in others.items():
        with pytest.raises(StateError, match=said):
            ea.load_state(path, other)


def test_the_place_of_the_urdf_does_not_matter(saved, tmp_path):
    """The same robot from a copy of its file elsewhere takes the state."""
    controller, state, path = saved
    shutil.copy(controller.robot.path, tmp_path / "copy.urdf")
    copied = ea.CompositeController.for_robot(
        ea.Robot.from_urdf(tmp_path / "copy.urdf", zero_parameters=controller.robot.zero_parameters)
    )
    assert np.array_equal(ea.load_state(path, copied).theta, state.theta)


def test_a_state_of_an_older_format_is_refused_by_name(saved, tmp_path, monkeypatch):
    """The message says which release wrote it, and what to do."""
    from eladapt.records import state_file as module

    controller, state, _ = saved
    monkeypatch.setattr(module, "FORMAT", 1)
    path = ea.save_state(tmp_path / "old.npz", controller, state)
    monkeypatch.undo()
    old = r"old\.npz: a state in format 1, written by eladapt 0\.1\.0; this one reads format 2\. Begin with"
    with pytest.raises(StateError, match=old):
        ea.load_state(path, controller)


def test_what_was_computed_is_no_part_of_what_a_controller_is():
    """Used or not, it does the same; a gain is another thing. A record describes it in the same words."""
    robot = load("two_link")
    plain, used = (ea.CompositeController.for_robot(robot) for _ in range(2))
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    ea.simulate(used, plant, robot.configuration(robot.target), 0.01, progress=False)
    assert identity(plain) == identity(used)
    assert identity(plain) != identity(ea.CompositeController.for_robot(robot, P=[10, 5]))
    told = describe(plain)
    assert told["control"]["P"] == list(plain.control.P)
    assert told["regressors"]["robot"]["model"]["joints"] == "shoulder, elbow"
    json.dumps(told)


def test_what_holds_itself_can_be_described_and_what_it_worked_out_is_left_out():
    class Ring:
        def __init__(self):
            self.gain, self.ring = 2.5, self

        @functools.cached_property
        def twice(self):
            return 2 * self.gain

    ring = Ring()
    assert ring.twice == 5.0
    told = describe(ring)
    assert told["gain"] == 2.5
    assert "twice" not in told


def equal(one, other):
    if isinstance(one, tuple):
        return type(one) is type(other) and all(map(equal, one, other))
    return np.array_equal(one, other)


def test_damage_is_refused(saved, tmp_path, rng):
    """Any byte changed, at 400 places, or the file cut short: StateError, or the very same state."""
    controller, state, path = saved
    sound, damaged = path.read_bytes(), tmp_path / "damaged.npz"
    refused = 0
    for k in rng.integers(len(sound), size=400):
        changed = bytearray(sound)
        changed[k] ^= int(rng.integers(1, 256))
        damaged.write_bytes(changed)
        try:
            assert equal(ea.load_state(damaged, controller), state)
        except StateError:
            refused += 1
    assert refused > 200  # dates and padding of the archive are not read
    for length in (0, 1, 100, len(sound) // 2, len(sound) - 1):
        damaged.write_bytes(sound[:length])
        with pytest.raises(StateError, match=r"damaged\.npz"):
            ea.load_state(damaged, controller)
    with pytest.raises(StateError, match="no such saved state"):
        ea.load_state(tmp_path / "none.npz", controller)
    with pytest.raises(StateError):
        ea.load_state(tmp_path, controller)


def test_a_write_that_fails_leaves_the_old_file(saved, tmp_path, monkeypatch):
    """The disk runs full: the state saved before is still there, and nothing else."""
    controller, state, _ = saved
    path = ea.save_state(tmp_path / "state.npz", controller, state)
    sound = path.read_bytes()

    def full(file, **arrays):
        file.write(b"PK")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(StateError, match="No space left"):
        ea.save_state(path, controller, state)
    assert path.read_bytes() == sound
    assert list(tmp_path.iterdir()) == [path]


class Odd(NamedTuple):
    value: object
    more: object = None


class Kept:
    """A controller whose fresh state is the one that it is given."""

    def __init__(self, state):
        self.robot, self._state = load("two_link"), state

    def init(self, measurement, theta0=None):
        return self._state


def test_numbers_of_every_kind_come_back_as_they_were(tmp_path):
    """Infinities, tiny and huge floats, numpy scalars, Fortran order, empty arrays, text, nested tuples."""
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    state = Odd(
        (
            1,
            -np.inf,
            5e-324,
            1.7976931348623157e308,
            True,
            None,
            "watchdog \u03c4",
            np.float64(0.1),
            np.int64(3),
        ),
        Odd([fortran, np.zeros((0, 3)), np.array(2.5)], Odd(())),
    )
    controller = Kept(state)
    back = ea.load_state(ea.save_state(tmp_path / "odd.npz", controller, state), controller)
    assert type(back) is Odd
    assert back.value == state.value
    assert [type(item) for item in back.value] == [type(item) for item in state.value]
    assert np.array_equal(back.more.value[0], fortran)
    assert back.more.value[0].flags.f_contiguous
    assert back.more.value[1].shape == (0, 3)
    assert back.more.more == Odd(())


def test_what_is_no_state_is_refused(saved, tmp_path):
    controller, state, _ = saved
    with pytest.raises(ArgumentError, match=r"state\.value: expected NamedTuples, arrays"):
        ea.save_state(tmp_path / "x.npz", controller, Odd(object()))
    with pytest.raises(ArgumentError, match=r"state\.value: expected numbers"):
        ea.save_state(tmp_path / "x.npz", controller, Odd(np.array([object()])))
    with pytest.raises(ArgumentError, match=r"ends with \.npz"):
        ea.save_state(tmp_path / "x.pkl", controller, state)
    assert not list(tmp_path.iterdir())


def test_a_file_cannot_make_code_run(saved, tmp_path, monkeypatch):
    """A class that is no NamedTuple of an imported module is refused before it is called."""
    from eladapt.records import state_file as module

    controller, _, _ = saved
    for name in (["subprocess", "Popen"], ["builtins", "tuple"], ["antigravity", "X"]):
        monkeypatch.setattr(module, "_encode", lambda *_, name=name: {"tuple": name, "fields": {}})
        path = ea.save_state(tmp_path / "evil.npz", controller, None)
        with pytest.raises(StateError, match="no NamedTuple of an imported module"):
            ea.load_state(path, controller)
        assert "antigravity" not in sys.modules
