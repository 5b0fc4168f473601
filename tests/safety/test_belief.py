"""Joints that are not to be believed are named; loads, pushes, friction and rotors are no reason to."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.safety.belief import Belief
from eladapt.simulation.faults import Misdriven, Misread
from eladapt.simulation.instruments import Encoders

DT, BEGINS = 1e-3, 0.15
NOISE = ea.Noise(1e-5, 1e-3)
ROTOR = 0.1  # [kg m^2] a Panda's wrists have about so much, of which its URDF says nothing


def put(vector, i, value):
    vector = vector.copy()
    vector[i] = value
    return vector


def turned(i):
    """An encoder that counts the wrong way from where it is."""
    return lambda m, good: m._replace(q=put(m.q, i, 2 * good.q[i] - m.q[i]), v=put(m.v, i, -m.v[i]))


def dead(i):
    return lambda m, good: m._replace(q=put(m.q, i, good.q[i]), v=put(m.v, i, 0.0))


WRONG = {
    "reversed": lambda i: (Misread, turned(i)),
    "velocity reversed": lambda i: (Misread, lambda m, good: m._replace(v=put(m.v, i, -m.v[i]))),
    "velocity dead": lambda i: (Misread, lambda m, good: m._replace(v=0 * m.v)),
    "velocity halved": lambda i: (Misread, lambda m, good: m._replace(v=m.v / 2)),
    "encoder dead": lambda i: (Misread, dead(i)),
    "drive reversed": lambda i: (Misdriven, lambda tau, good: put(tau, i, -tau[i])),
}


def watched(kind, change, duration=1.0, jump=True):
    """A record of a Panda's move, behind the gate, with something wrong from ``BEGINS`` [s] on."""
    robot = load("panda")
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    controller = controller if jump else ea.Shaped(controller)
    plant = ea.MujocoPlant(robot, robot.configuration(robot.home), noise=NOISE, seed=1, armature=ROTOR)
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, kind(plant, change, BEGINS), goal, duration, DT, progress=False)


@pytest.mark.parametrize("joint", [0, 4, 6])  # a reversed drive that bears gravity is faster itself
@pytest.mark.parametrize("kind", WRONG)
def test_what_is_not_to_be_believed_is_named_and_braked(kind, joint):
    """In a move within the limits: no joint is ever faster than 1.3 of its speed limit."""
    record = watched(*WRONG[kind](joint), jump=False)
    assert record.final_state.fault.name in ("reversed", "unresponsive", "sensor", "jump", "velocity")
    assert record.final_state.brake
    assert np.all(np.abs(record.v) < 1.3 * load("panda").velocity_limit)


def test_a_dead_encoder_at_rest_is_missed_by_its_noise():
    """A joint whose noise ends although the others' goes on, 20 samples later."""
    robot = load("panda")
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    home = robot.configuration(robot.home)
    plant = Misread(ea.PinocchioPlant(robot, home, noise=NOISE), dead(3), 0.5)
    record = ea.simulate(controller, plant, home, 0.6, DT, progress=False)
    fault = record.final_state.fault
    assert fault.name == "sensor"
    assert "panda_joint4" in fault.message
    assert fault.t < 0.53


def test_encoders_that_count_are_not_missed_at_rest():
    """Positions in whole counts stand still at rest, and their velocities decay: no reason for an alarm."""
    robot = load("panda")
    plant = Encoders(ea.PinocchioPlant(robot, robot.configuration(robot.home)))
    noise = plant.noise(DT)
    bare = ea.CompositeController.for_robot(
        robot, DT, position_noise=noise.position, velocity_noise=noise.velocity,
        velocity_lag=plant.time_constant,
    )  # fmt: skip
    controller = ea.GatedController.for_robot(bare, DT)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 3.0, DT, progress=False)
    assert record.final_state.fault is None


@pytest.mark.parametrize("what", ["load", "rotors", "friction"])
def test_what_an_arm_may_have_is_no_reason_for_an_alarm(what):
    """A load that comes and goes, rotors of which nobody told, friction of 6 % of the efforts."""
    robot = load("panda")
    home, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    plants = {
        "load": lambda: ea.PinocchioPlant(
            robot, home, noise=NOISE, payload=ea.Payload(2.0, attach=0.3, release=0.8)
        ),
        "rotors": lambda: ea.MujocoPlant(robot, home, noise=NOISE, armature=ROTOR),
        "friction": lambda: ea.PinocchioPlant(
            robot, home, noise=NOISE, friction=ea.Friction(coulomb=0.06 * robot.effort_limit)
        ),
    }
    controller = ea.Shaped(ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT))
    record = ea.simulate(controller, plants[what](), goal, 1.5, DT, progress=False)
    assert record.final_state.fault is None


def test_a_clock_that_is_set_back_is_a_new_time_base():
    """By a second in the middle of a move: the same run as if nothing had been."""
    moved = watched(Misread, lambda m, good: m._replace(t=m.t - 1.0), duration=2.5)
    usual = watched(Misread, lambda m, good: m, duration=2.5)
    assert moved.final_state.fault is None
    # The sums of steps that make the two clocks round differently.
    np.testing.assert_allclose(moved.q, usual.q, atol=1e-6)


def test_thresholds_follow_the_arm():
    """What a person who pushes makes of torque is no reason for an alarm, in no joint."""
    robot = load("panda")
    belief = Belief.for_robot(robot, robot.effort_limit, robot.velocity_limit)
    assert np.all(belief.against[:2] > 20.0)  # 24 N at 0.8 m
    assert np.all(belief.silent >= belief.against)


@pytest.mark.parametrize(("torque", "alarms"), [("to and fro", False), ("one way", True)])
def test_a_joint_that_friction_holds_may_be_pushed_to_and_fro_but_not_ever_harder(torque, alarms):
    """It stands still for two seconds, while its torque swings ten times by less than friction may bear, or
    grows within a tenth of a second to more."""
    robot = load("panda")
    belief = Belief.for_robot(robot, robot.effort_limit, robot.velocity_limit)
    state, still, gravity = belief.init(), np.zeros(robot.nv), robot.gravity(robot.configuration(robot.home))
    for k in range(2000):
        share = 0.4 * np.sin(10 * np.pi * k * DT) if torque == "to and fro" else min(14 * k * DT, 1.4)
        push = put(still, 2, share * belief.silent[2])
        state = belief.step(state, still, still, still, gravity + push, gravity, DT)
    assert (getattr(belief.alarm(state), "name", None) == "unresponsive") == alarms


@pytest.mark.parametrize(
    ("before", "needed", "alarms"), [(1.0, 0.0, True), (1.0, 0.3, False), (0.0, 0.0, False)]
)
def test_an_arm_that_moves_as_if_a_large_torque_did_not_act_is_not_believed(before, needed, alarms):
    """Within 25 ms, though the torque does not change: where it acted before, and not where a load that the
    model does not know has taken all of it from the start."""
    robot = load("panda")
    belief = Belief.for_robot(robot, robot.effort_limit, robot.velocity_limit)
    state, still = belief.init(), np.zeros(robot.nv)
    torque = put(still, 3, 1.1 * belief.silent[3])
    for part in [before] * 10 + [needed] * 25:
        state = belief.step(state, still, still, still, torque, part * torque, DT)
    assert (getattr(belief.alarm(state), "name", None) == "unresponsive") == alarms
