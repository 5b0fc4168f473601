"""Ten seconds of small motion tell what the hardware is, or that it is not known."""

import dataclasses

import numpy as np
import pytest
from commissioning import Bench, moved
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, HardwareError
from eladapt.hardware.commissioning import RAMP, REST, Heard, Swing, assessed
from eladapt.hardware.lateness import stamp_jitter
from eladapt.simulation.faults import Misdriven
from eladapt.simulation.instruments import Delay, Encoders, NoisyReadings

DT = 1e-3
pytestmark = pytest.mark.slow


def gone_through(robot, plant):
    heard, fault = moved(robot, plant, 8.0)
    assert fault is None
    return heard


@pytest.fixture(scope="module")
def told():
    robot = load("ur5")
    friction = ea.Friction(np.full(6, 0.8), np.full(6, 0.6))
    arm = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=friction)
    plant = NoisyReadings(Delay(Encoders(arm, 2**19, 4e-3), 3e-3), ea.Noise(3e-5, 3e-4), seed=1)
    return assessed(robot, gone_through(robot, plant), DT)


def test_noise_delay_and_lag_are_found(told):
    """Within 20 %, the delay to the step."""
    assert told.position_noise == pytest.approx(np.full(6, 3e-5), rel=0.2)
    assert told.velocity_noise == pytest.approx(np.full(6, 3e-4), rel=0.2)
    assert told.delay == pytest.approx(3e-3, abs=1e-9)
    assert told.velocity_lag == pytest.approx(4e-3, rel=0.2)
    assert set(told.hardware) == {"position_noise", "velocity_noise", "delay", "velocity_lag", "jitter"}
    assert told.jitter < 1e-4  # of a step of 1 ms: what a velocity that lags makes of it
    assert told.reversed == ()


def test_a_robot_whose_stamps_slip_has_jitter(told):
    """Every tenth sample is one step later than it says, so that two steps of twenty are off by one."""
    log = told.log
    late = np.arange(len(log)) % 10 == 0
    index = np.minimum(np.arange(len(log)) + late, len(log) - 1)
    slipped = ea.Log(log.t, log.q[index], log.velocity[index], log.tau, log.joint_names)
    # 2 steps of 10 are off by dt: sqrt(2/10) dt; 20 % for the samples in which nothing moves
    assert stamp_jitter(slipped, told.position_noise) == pytest.approx(np.sqrt(0.2) * DT, rel=0.2)


def test_friction_is_found_where_it_is_said_to_be_known(told):
    known = told.friction.known
    assert known[1].sum() >= 4
    assert told.friction.coulomb[known[1]] == pytest.approx(np.full(known[1].sum(), 0.6), rel=0.2)
    assert told.friction.viscous[known[0]] == pytest.approx(np.full(known[0].sum(), 0.8), rel=0.2)
    for said in ("delay           0.003 s", "velocity lag    0.00", "friction"):
        assert said in str(told)


def test_what_changed_since_is_said(told):
    assert told.changed_since(told) == ()
    slower = dataclasses.replace(told, delay=1e-3, velocity_lag=float("nan"))
    assert slower.changed_since(told) == ("delay: 0.003 then, 0.001 now",)
    coulomb = told.friction.coulomb.copy()
    coulomb[2] *= 2
    worn = dataclasses.replace(told, friction=told.friction._replace(coulomb=coulomb))
    assert [said.split(":")[0] for said in worn.changed_since(told)] == ["coulomb of elbow_joint"]


def test_a_torque_that_is_not_reported_leaves_the_delay_unknown():
    """A drive that reports something else than what was commanded."""
    robot = load("two_link")
    arm = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    heard = gone_through(robot, arm)
    rng = np.random.default_rng(0)
    heard.measurements = [m._replace(tau=m.tau + rng.normal(size=2)) for m in heard.measurements]
    told = assessed(robot, heard, DT)
    assert np.isnan(told.delay)
    assert "delay" not in told.hardware
    assert any(note.startswith("delay:") for note in told.notes)


def test_it_runs_through_the_loop_and_stops_the_arm():
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    told = ea.commission(robot, Bench(plant, 5e-3), dt=5e-3, duration=6.0)
    assert told.delay == 0
    assert np.abs(plant.v).max() < 0.1
    with pytest.raises(ArgumentError, match="object lacks start, read, write, stop"):
        ea.commission(robot, object())
    with pytest.raises(ArgumentError, match="duration"):
        ea.commission(robot, Bench(plant), duration=1.0)
    with pytest.raises(ArgumentError, match="reach"):
        ea.commission(robot, Bench(plant), reach=0.0)


def test_an_arm_that_does_not_go_through_with_it_says_why():
    robot = load("two_link")
    arm = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    dead = Misdriven(arm, lambda sent, good: sent * [1, 0], start=1.0)
    with pytest.raises(HardwareError, match="commissioning of two_link ended early: "):
        ea.commission(robot, Bench(dead, 5e-3), dt=5e-3, duration=6.0)


def test_the_motion_is_what_it_says_it_is():
    """Velocity and acceleration are the derivatives of the way, at rest at both ends: central differences of
    0.1 ms, whose error is the third derivative's, some 100 rad/s^3 times 1e-8 / 6."""
    robot = load("ur5")
    heard = Heard(Bench(ea.PinocchioPlant(robot, robot.configuration(robot.home))))
    heard.start()
    heard.read()
    motion = Swing(robot, heard, np.full(6, 0.15), 8.0)
    step = 1e-4
    for t in np.linspace(0.5, 7.9, 60):
        before, at, after = (motion(t + k * step) for k in (-1, 0, 1))
        assert (after.q - before.q) / (2 * step) == pytest.approx(at.v, abs=1e-6)
        assert (after.v - before.v) / (2 * step) == pytest.approx(at.a, abs=1e-5)
    for t in (REST, 8.0):
        assert np.abs(motion(t).v).max() == np.abs(motion(t).a).max() == 0
    assert np.abs(motion(REST + 1.5 * RAMP).v).max() > 0.1
