"""Many rollouts in one call are the single ones, over any executor, and none takes others with it."""

import dataclasses
import os
import pickle
import sys
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, Finding, SimulationError, UnknownNameError, UrdfError

DURATION, DT = 0.05, 1e-3


def panda_plants(n: int) -> list[ea.PinocchioPlant]:
    """Each from another posture, with its own noise; every other one carries a load."""
    robot, rng = load("panda"), np.random.default_rng(1)
    return [
        ea.PinocchioPlant(
            robot, robot.random_configuration(rng), noise=ea.Noise(1e-4, 1e-3), seed=k, payload=k % 2 or None
        )
        for k in range(n)
    ]


def swinging(t: float) -> np.ndarray:
    """A goal that moves, as a callable that other processes find by its name."""
    return np.sin(t + np.arange(7))


def drifting(t: float) -> ea.Reference:
    """The same with a velocity."""
    return ea.Reference(swinging(t), np.cos(t + np.arange(7)), -swinging(t))


def test_a_reference_is_one_goal_and_a_list_of_them_many():
    """Though it is a tuple; and a callable may return it."""
    controller, plant = ea.SlotineLi.for_robot(load("panda")), panda_plants(1)[0]
    still = ea.Reference(swinging(0), np.full(7, 0.1), np.zeros(7))
    with ThreadPoolExecutor(1) as executor:
        options = {"executor": executor, "progress": False}
        one = ea.simulate_many(controller, plant, still, 0.01, DT, **options)
        many = ea.simulate_many(controller, plant, [still, drifting], 0.01, DT, **options)
    alone = [ea.simulate(controller, plant, goal, 0.01, DT, progress=False) for goal in (still, drifting)]
    assert len(one) == 1
    assert same(one[0], alone[0])
    assert all(map(same, many, alone))
    assert many[1].goal_velocity[3, 0] == np.cos(many[1].t[3])


def same(one: ea.Record, other: ea.Record) -> bool:
    """Bit for bit, the controller's last state included."""
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "final_state":
            equal = leaves(a) == leaves(b)
        else:
            equal = bits(a) == bits(b) if isinstance(a, np.ndarray) else a == b
        if not equal:
            return False
    return True


def bits(array: np.ndarray) -> tuple:
    return array.shape, array.tobytes()


def leaves(state) -> list[bytes]:
    """The bits of every array in a tree of tuples."""
    if isinstance(state, tuple):
        return [leaf for item in state for leaf in leaves(item)]
    return [np.asarray(state, dtype=float).tobytes()] if state is not None else [b"none"]


@pytest.mark.parametrize("pool", [None, ThreadPoolExecutor, ProcessPoolExecutor])
def test_rollouts_equal_single_runs_in_order(pool):
    """Noise, loads, a moving goal and set-points, over processes and over threads with one controller."""
    controller, plants = ea.CompositeController.for_robot(load("panda")), panda_plants(5)
    goals = [swinging, *(swinging(k) for k in range(4))]
    alone = [
        ea.simulate(controller, plant, goal, DURATION, DT, progress=False)
        for plant, goal in zip(plants, goals, strict=True)
    ]
    executor = pool(2) if pool else None
    together = ea.simulate_many(controller, plants, goals, DURATION, DT, executor=executor, progress=False)
    for one, other in zip(alone, together, strict=True):
        assert same(one, other)
    assert not same(alone[1], alone[2])
    if executor:
        assert executor.submit(abs, -1).result() == 1, "the caller's executor stays open"
        executor.shutdown()


def test_one_plant_serves_many_goals_and_controllers():
    """What is not a sequence is shared, and the plant given is left as it was."""
    robot, plant = load("ur5"), ea.PinocchioPlant(load("ur5"), np.zeros(6))
    controllers = [ea.CompositeController.for_robot(robot, Gamma=gamma) for gamma in (0.1, 0.2)]
    goals = np.array([[0.1] * 6, [0.2] * 6])
    theta0 = np.ones(controllers[0].regressors.n_potential)
    records = ea.simulate_many(controllers, plant, goals, DURATION, theta0=theta0, progress=False)
    for k, record in enumerate(records):
        single = ea.simulate(controllers[k], plant, goals[k], DURATION, theta0=theta0, progress=False)
        assert same(record, single)
    plant.reset()
    records = ea.simulate_many(controllers[0], plant, [0.1] * 6, DURATION, progress=False)
    assert len(records) == 1, "a list of numbers is one goal"
    assert plant.t == 0


def test_mujoco_plants_go_to_other_processes():
    """Compiled MuJoCo models, friction and load included, behave there as here."""
    pytest.importorskip("mujoco")
    robot = load("panda")
    plant = ea.MujocoPlant(
        robot,
        robot.configuration(robot.home),
        friction=ea.Friction(0.1, 0.5),
        payload=ea.Payload(1, attach=0.02),
    )
    controller, goal = ea.CompositeController.for_robot(robot), robot.configuration(robot.target)
    with ProcessPoolExecutor(1) as executor:
        record, again = ea.simulate_many(
            controller, [plant, plant], goal, DURATION, executor=executor, progress=False
        )
    assert same(record, ea.simulate(controller, plant, goal, DURATION, progress=False))
    assert same(record, again)


class Broken(ea.PinocchioPlant):
    """A plant that fails in one of the ways there are, at its eleventh step."""

    def __init__(self, way: str):
        super().__init__(load("two_link"), np.zeros(2))
        self.way, self.count = way, 0

    def step(self, tau, dt):
        self.count += 1
        if self.count == 11:
            if self.way == "diverges":
                raise SimulationError("it flew off")
            if self.way == "has a fault":
                raise ZeroDivisionError("one over nothing")
            os._exit(3)  # as a crash in compiled code does
        return super().step(tau, dt)


def test_a_failed_rollout_loses_no_other():
    """Its error stands in its place and carries what was recorded; the rest are complete."""
    robot = load("two_link")
    good = ea.PinocchioPlant(robot, np.zeros(2))
    plants = [good, Broken("diverges"), good, Broken("has a fault"), good]
    controller = ea.CompositeController.for_robot(robot)
    results = ea.simulate_many(controller, plants, [0.5, 0.5], DURATION, progress=False)
    whole = ea.simulate(controller, good, [0.5, 0.5], DURATION, progress=False)
    assert all(same(results[k], whole) for k in (0, 2, 4))
    assert isinstance(results[1], SimulationError)
    assert "rollout 1" in str(results[1])
    assert "it flew off" in str(results[1])
    assert len(results[1].record) == 11
    np.testing.assert_array_equal(results[1].record.q, whole.q[:11])
    assert isinstance(results[3], SimulationError)
    assert "rollout 3: ZeroDivisionError: one over nothing" in str(results[3])
    assert isinstance(results[3].__cause__, ZeroDivisionError)
    assert results[3].record is None


def test_a_process_that_dies_loses_no_other_rollout(capfd, monkeypatch):
    """The rollouts that shared its pool are run again, each in a process of its own."""
    robot = load("two_link")
    good = ea.PinocchioPlant(robot, np.zeros(2))
    controller = ea.CompositeController.for_robot(robot)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    results = ea.simulate_many(controller, [good, Broken("dies"), good], [0.5, 0.5], DURATION)
    whole = ea.simulate(controller, good, [0.5, 0.5], DURATION, progress=False)
    assert same(results[0], whole)
    assert same(results[2], whole)
    assert isinstance(results[1], SimulationError)
    assert "rollout 1: BrokenProcessPool" in str(results[1])
    shown = capfd.readouterr().err
    assert "3/3" in shown, "the bar counts every rollout"
    assert "failed=1" in shown


class Inline:
    """The least there is of an executor: runs at once, in order."""

    def __init__(self):
        self.calls = 0

    def submit(self, function, *arguments):
        self.calls += 1
        future: Future = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as reason:
            future.set_exception(reason)
        return future


def test_any_executor_will_do():
    robot, inline = load("two_link"), Inline()
    controller = ea.CompositeController.for_robot(robot)
    plants = (ea.PinocchioPlant(robot, [0.1 * k, 0]) for k in range(3))
    records = ea.simulate_many(controller, plants, [0.5, 0.5], DURATION, executor=inline, progress=False)
    assert inline.calls == 3
    assert [record.q[0, 0] for record in records] == [0.0, 0.1, 0.2]
    assert ea.simulate_many(controller, [], [0.5, 0.5], executor=inline, progress=False) == []


def test_what_cannot_be_run_is_refused_at_once():
    robot = load("two_link")
    controller, plant = ea.CompositeController.for_robot(robot), ea.PinocchioPlant(robot, np.zeros(2))
    with pytest.raises(ArgumentError, match="same length, got 2 in plants, 3 in goals"):
        ea.simulate_many(controller, [plant] * 2, [np.zeros(2)] * 3, progress=False)
    with pytest.raises(ArgumentError, match=r"can be pickled.*lambda"):
        ea.simulate_many(controller, [plant], lambda t: np.zeros(2), progress=False)
    (result,) = ea.simulate_many(controller, [plant], np.zeros(3), executor=Inline(), progress=False)
    assert isinstance(result, SimulationError), "what simulate refuses is reported like any failure"
    assert "goal: expected shape (2,)" in str(result)


@pytest.mark.parametrize(
    "error",
    [
        SimulationError("why", record=3), UnknownNameError("joint", ["a"], ["b", "c"]),
        UrdfError("x.urdf", [Finding("link a", "0", "no mass", "give it one")]), ArgumentError("dt: no"),
    ],
)  # fmt: skip
def test_errors_keep_their_data_between_processes(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_a_robot_is_the_same_after_a_pickle():
    """With its file's text, and without Pinocchio's scratch, which would be nine tenths of it."""
    robot = load("kinova")
    packed = pickle.dumps(robot)
    again, q, v = pickle.loads(packed), robot.configuration(robot.target), np.arange(robot.nv)
    assert len(packed) < len(pickle.dumps(robot.model)) + len(robot.text) + 5_000
    np.testing.assert_array_equal(again.inverse_dynamics(q, v, v), robot.inverse_dynamics(q, v, v))
    assert again.source == robot.source
    assert again._scratch.own is not robot._scratch.own
