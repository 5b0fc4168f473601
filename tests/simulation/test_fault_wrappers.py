"""Faults between a plant and a controller do what they say, when they say it, and nothing else."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.robot.reading import frame_index
from eladapt.simulation.faults import FrozenSensor, LostNumbers, Misdriven, Misread, Push

STEPS, BEGIN, END = 8, 3, 6  # samples: the fault is in those from BEGIN to END - 1
SPAN = {"start": BEGIN * DT, "end": END * DT}


def arm(name="ur5", engine=ea.PinocchioPlant):
    robot = load(name)
    return engine(robot, robot.configuration(robot.home), np.full(robot.nv, 0.3))


def measured(plant, tau):
    plant.reset()
    return [plant.step(tau, DT) for _ in range(STEPS)]


def samples(wrapped):
    """Samples 1, 2, ... of a plant with a fault, and of one without."""
    tau = np.ones(load("ur5").nv)
    return list(enumerate(zip(measured(wrapped(arm()), tau), measured(arm(), tau), strict=True), 1))


def same(one, other):
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


def test_sensors_misread_while_the_fault_lasts_and_the_arm_does_not_notice():
    """The change sees what is and the last good measurement, and may write to both."""

    def change(measurement, good):
        measurement.q[0] = good.q[0]
        good.v[:] = np.inf
        return measurement._replace(t=measurement.t + 1.0)

    pairs = samples(lambda plant: Misread(plant, change, **SPAN))
    good = pairs[BEGIN - 2][1][1]
    for k, (found, true) in pairs:
        if BEGIN <= k < END:
            true = true._replace(t=true.t + 1.0, q=np.concatenate([good.q[:1], true.q[1:]]))
        assert same(found, true)


def test_a_first_measurement_can_be_misread():
    wrong = Misread(arm(), lambda m, _: m._replace(q=-m.q))
    assert np.array_equal(wrong.reset().q, -wrong.q)


def test_lost_numbers_are_nan_and_frozen_ones_the_last():
    for k, (found, true) in samples(lambda plant: LostNumbers(plant, **SPAN)):
        lost = BEGIN <= k < END
        assert np.isnan(found.q).all() == np.isnan(found.v).all() == lost
        assert found.t == true.t
    pairs = samples(lambda plant: FrozenSensor(plant, **SPAN))
    good = pairs[BEGIN - 2][1][1]
    for k, (found, true) in pairs:
        assert same(found, true._replace(q=good.q, v=good.v) if BEGIN <= k < END else true)


@pytest.mark.parametrize("kind", [LostNumbers, FrozenSensor])
def test_a_fault_runs_in_another_process_as_in_this_one(kind):
    tau = np.ones(6)
    plant = kind(arm(), **SPAN)
    for found, expected in zip(
        measured(pickle.loads(pickle.dumps(plant)), tau), measured(plant, tau), strict=True
    ):
        assert same(found, expected)


def test_drives_do_something_else_and_report_what_was_commanded():
    """The change sees the last command before it began: here that of a motor which is stuck at it."""
    plant, straight = Misdriven(arm(), lambda _, good: good, **SPAN), arm()
    plant.reset(), straight.reset()
    for k in range(STEPS):
        told = np.full(6, float(k))
        acted = np.full(6, BEGIN - 1.0) if BEGIN <= k < END else told
        found, true = plant.step(told, DT), straight.step(acted, DT)
        assert same(found, true._replace(tau=told))


@pytest.mark.parametrize("engine", [ea.PinocchioPlant, ea.MujocoPlant])
def test_a_push_is_a_force_in_world_axes(engine):
    """20 N for a step change the momentum along a virtual motion by the work that they do in it.

    2 %: the force is that of the posture when the step begins, and the joints move by 3e-4 rad in it; what
    else acts is the same to second order.
    """
    force, robot = np.array([12.0, -16.0, 0.0]), load("ur5")
    moved = []
    for plant in (Push(arm(engine=engine), force, "wrist_2_link"), arm(engine=engine)):
        plant.reset()
        plant.step(np.zeros(6), DT)
        moved.append(plant.v)
    model, data = robot.model, robot.model.createData()
    q = robot.configuration(robot.home)
    frame = frame_index(model, "wrist_2_link")
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
    gained = robot.mass_matrix(q) @ (moved[0] - moved[1])
    expected = DT * jacobian.T @ force
    assert np.abs(gained - expected).max() < 0.02 * np.abs(expected).max()


def test_a_push_comes_and_goes_by_its_ramp_and_no_measurement_tells_of_it():
    plant = Push(arm(), (30.0, 0.0, 0.0), start=2 * DT, end=6 * DT, ramp=2 * DT)
    plant.reset()
    shares = []
    for _ in range(10):
        shares.append(plant.share)
        assert np.array_equal(plant.step(np.ones(6), DT).tau, np.ones(6))
    np.testing.assert_allclose(shares, [0, 0, 0, 0.5, 1, 1, 1, 0.5, 0, 0], atol=1e-9)  # sums of steps


def test_a_force_may_depend_on_where_its_frame_is_and_how_it_moves():
    """The position and velocity are those of finite differences of the placement, to 1e-5 of 1 ms squared."""
    robot, seen = load("ur5"), []

    def force(t, x, speed):
        seen.append((t, x, speed))
        return np.zeros(3)

    plant = Push(arm(), force)
    plant.reset()
    for _ in range(3):
        plant.step(robot.gravity(plant.q), DT)
    (t0, x0, v0), (t1, x1, v1) = seen[1:]
    assert t1 - t0 == pytest.approx(DT)
    np.testing.assert_allclose((x1 - x0) / DT, (v0 + v1) / 2, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "error", "said"),
    [
        (lambda: Misread(arm(), lambda m, _: m, 1.0, 1.0), ArgumentError, "start, end: expected start < end"),
        (lambda: Push(arm(), (1.0, 2.0)), ArgumentError, r"force: expected shape \(3,\)"),
        (lambda: Push(arm(), (1.0, 0.0, np.nan)), ArgumentError, "force: expected finite"),
        (lambda: Push(arm(), (1.0, 0.0, 0.0), ramp=-1.0), ArgumentError, "ramp: expected"),
        (lambda: Push(arm(), (1.0, 0.0, 0.0), "nose"), UnknownNameError, "nose"),
    ],
)
def test_bad_faults_are_named(make, error, said):
    with pytest.raises(error, match=said):
        make()
