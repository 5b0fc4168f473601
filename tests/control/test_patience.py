"""A loop that a delay makes swing looks further ahead, by itself; nothing else makes it do so."""

from dataclasses import replace

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.control.patience import Patience
from eladapt.simulation.instruments import Delay, NoisyReadings

DT = 1e-3
NOISE = ea.Noise(1e-4, 1e-3)


def ahead_after(e2, jump=0.0, every=50):
    """[steps] after these velocity errors (N,), of a joint of 1 kg m^2 with 1 N m that counts; its goal
    jumps by so many radians after so many samples."""
    patience = Patience(np.ones(1))
    state, matrix = patience.init(1), np.eye(1)
    for k, value in enumerate(e2):
        e1 = state.e1 + DT * value + (jump if k % every == 0 else 0.0)
        state = patience.step(state, e1, np.array([value]), matrix, DT)
    return state.ahead


def test_a_swing_of_eight_half_waves_makes_the_horizon_longer():
    """At 50 Hz with 5 rad/s^2: a third longer each 80 ms, and no more than `most` steps."""
    t = DT * np.arange(1000)
    swing = 5.0 / (100 * np.pi) * np.sin(100 * np.pi * t)
    assert ahead_after(swing[:75]) == 1.0
    assert ahead_after(swing[:110]) == 1.3
    assert ahead_after(swing) == 10.0
    assert ahead_after(swing, jump=0.5) == 1.0  # a goal every 50 ms
    assert ahead_after(0.19 * swing) == 1.0  # less than 1 N m
    assert ahead_after(swing * 0.75 ** (t / 0.01)) == 1.0  # three quarters from half-wave to half-wave
    assert ahead_after(1e-3 * np.random.default_rng(0).normal(size=100_000)) == 1.0
    assert ahead_after(0.5 * np.sin(2 * np.pi * 3 * t)) == 1.0  # 3 Hz is a motion


def settled(name, late=0.0, noise=None, patient=True, friction=None):
    """The state after a move and a second of rest, the error [rad] and the ripple [N m] of its last half."""
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot, DT)
    if not patient:
        controller = replace(controller, patience=None)
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    plant = ea.PinocchioPlant(robot, start, friction=friction)
    if late:
        plant = Delay(plant, late)
    if noise:
        plant = NoisyReadings(plant, noise)
    motion = ea.move(robot, start, goal)
    record = ea.simulate(controller, plant, motion, motion.duration + 1.0, DT, progress=False)
    last = record.t > record.t[-1] - 0.5
    return record.final_state, np.abs(record.error[last]).max(), np.ptp(record.tau[last], axis=0).max()


@pytest.mark.parametrize(
    ("name", "late"),
    [("panda", 2e-3), ("ur5", 5e-3), ("ur10", 2e-3), ("xarm7", 5e-3), ("kinova", 5e-3), ("z1", 2e-3)],
)
def test_a_delay_that_nobody_told_is_borne(name, late):
    """Where it makes a loop swing by tens of newton metres and millimetres, it does no more."""
    state, error, ripple = settled(name, late)
    _, swinging, torque = settled(name, late, patient=False)
    assert state.ripple.ahead > 1.0
    assert error < 1e-4  # [rad]: where the swing has died away, a second after the motion
    assert ripple < 0.05 * torque
    assert error < 0.05 * swinging


@pytest.mark.parametrize("noise", [None, NOISE])
@pytest.mark.parametrize("friction", [None, ea.Friction(coulomb=1.0)])
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_nothing_else_makes_a_loop_look_further_ahead(name, friction, noise):
    """Neither noise that nobody told nor friction that must be learned, nor both."""
    assert settled(name, noise=noise, friction=friction)[0].ripple.ahead == 1.0
