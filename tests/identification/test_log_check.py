"""What looks wrong in a log is said, with the joint, and what to do; what is right is not."""

import dataclasses
import re

import numpy as np
import pytest
from known_logs import known_log
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, LogWarning, UnknownNameError


@pytest.fixture(scope="module")
def sound():
    return known_log(load("ur5"), noise=0.01)


@pytest.mark.parametrize("name", ["two_link", "ur5", "kinova", "panda", "talos_left_arm"])
def test_a_sound_log_leaves_nothing_to_say(name):
    robot = load(name)
    remarks = known_log(robot, duration=20.0, dt=5e-3).check(robot)
    assert not [said for said in remarks if "one way only" not in said]  # as short motions may


def changed(log, **parts):
    return dataclasses.replace(log, **parts)


CHANGES = {
    "degrees": (lambda log: {"q": np.rad2deg(log.q), "v": np.rad2deg(log.v)}, r"are these degrees \("),
    "velocities in degrees": (lambda log: {"v": np.rad2deg(log.v)}, r"are 57\.\d times.*; degrees\?"),
    "time in ms": (lambda log: {"t": 1e3 * log.t}, r"times the derivative of the positions; thousandths"),
    "torques in mN m": (lambda log: {"tau": 1e3 * log.tau}, r"times the URDF's gravity; thousandths.*gains="),
    "sign": (lambda log: {"tau": -log.tau}, "with the other sign"),
    "a joint at rest": (
        lambda log: {"q": log.q * (np.arange(6) != 3), "v": log.v * (np.arange(6) != 3)},
        r"wrist_1_joint stands still .*not told",
    ),
    "one way": (
        lambda log: {"q": log.q * (np.arange(6) != 3) + np.outer(log.t, np.arange(6) == 3) / 8,
                     "v": np.where(np.arange(6) == 3, 0.125, log.v)},
        "wrist_1_joint moves one way only",
    ),
    "cut off": (lambda log: {"tau": np.clip(log.tau, -20, 20)}, "shoulder_lift_joint: its torque is cut"),
    "a torque that is zero": (
        lambda log: {"tau": log.tau * (np.arange(6) != 5)}, "wrist_3_joint: its torque is always zero"
    ),
    "beyond a limit": (lambda log: {"v": 30 * log.v, "q": 30 * log.q}, r"reaches [\d.]+ rad/s; its limit is"),
    "slow": (lambda log: {name: getattr(log, name)[::50] for name in ("t", "q", "v", "tau")}, "apart"),
}  # fmt: skip


def test_the_largest_of_few_samples_is_not_a_limit(sound):
    """One of 50 is 2 % of them."""
    remarks = sound.between(1.0, 1.1).check(load("ur5"))
    assert not any("cut off" in said for said in remarks)


def test_a_log_in_milliseconds_is_asked_about(sound):
    with (
        pytest.raises(ArgumentError, match=r"more than two steps of the log, 4 s, got 0\.1 s; is its t"),
        pytest.warns(LogWarning, match="thousandths"),
    ):
        ea.identify(load("ur5"), changed(sound, t=1e3 * sound.t), progress=False)


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_wrong_is_said(sound, name):
    change, said = CHANGES[name]
    remarks = changed(sound, **change(sound)).check(load("ur5"))
    assert any(re.search(said, remark) for remark in remarks), remarks


def test_identify_warns_of_it(sound):
    with pytest.warns(LogWarning) as told:
        ea.identify(load("ur5"), changed(sound, tau=1e3 * sound.tau), progress=False)
    assert any("log of ur5: the torques are 1.06e+03 times" in str(warning.message) for warning in told)


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (lambda log: changed(log, tau=0 * log.tau), ArgumentError, "its torques are all zero"),
        (
            lambda log: changed(log, q=0 * log.q + log.q[0], v=0 * log.v),
            ArgumentError,
            "most of it is at rest",
        ),
        (lambda log: log.between(0, 0.6), ArgumentError, "rows in which a joint moves, for 58 parameters"),
        (lambda log: log.between(0, 0.1), ArgumentError, "window: expected at most"),
        (
            lambda log: changed(log, joint_names=("a", *log.joint_names[1:])),
            UnknownNameError,
            "'shoulder_pan",
        ),
        (lambda log: log.columns(range(5)), UnknownNameError, "'wrist_3_joint'"),
        (lambda log: "log.csv", ArgumentError, "expected a Log, or the state of a CompositeController"),
    ],
)
@pytest.mark.filterwarnings("ignore::eladapt.errors.LogWarning")
def test_what_tells_nothing_is_refused(sound, change, error, said):
    with pytest.raises(error, match=said):
        ea.identify(load("ur5"), change(sound), held_out=0, progress=False)
