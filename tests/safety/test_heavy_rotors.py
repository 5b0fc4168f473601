"""Behind a gate, an arm whose rotors and friction its URDF does not know goes where it is sent."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.simulation.instruments import Delay
from eladapt.urdf.editing import Edits

DT, EACH = 2e-3, 3.0  # [s], [s] of a set-point
LINK = [0.19, 0, 0, 0, 1.3e-4, 0, 1.3e-4, 0, 0, 1.3e-4]  # of a UR5e's last wrist: mass, and inertia [kg m^2]
ROTOR = 0.1  # [kg m^2] of each joint
FRICTION = ea.Friction(viscous=1.0, coulomb=[4.0, 4.0, 3.0, 1.0, 1.0, 1.0])  # of a UR5e, about


@pytest.fixture(scope="module", params=[0.06, -0.3], ids=lambda way: f"wrist by {way}")
def run(request):
    """A UR5 on MuJoCo, where friction sticks, to two set-points one after the other, and its states."""
    pytest.importorskip("mujoco")
    robot = load("ur5").edited(Edits({"wrist_3_link": LINK}))
    start = robot.configuration([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
    heavy = robot.edited(Edits(dynamics={name: {"armature": ROTOR} for name in robot.joint_names}))
    plant = Delay(ea.MujocoPlant(heavy, start, friction=FRICTION), DT)
    limits = ea.MotionLimits.for_robot(robot, velocity=0.5)
    inner = ea.CompositeController.for_robot(robot, DT, delay=DT)
    controller = ea.Shaped(ea.GatedController.for_robot(inner, DT), limits)
    there = start + np.array([0.3, -0.2, 0.2, 0.3, -0.2, request.param])
    course = [there, start]
    states = []
    record = ea.simulate(
        controller, plant, lambda t: course[int(t >= EACH)], 2 * EACH, DT, progress=False,
        observer=lambda _t, _q, _goal, state: states.append(state.inner.inner),
    )  # fmt: skip
    ends = ea.move(robot, start, there, limits).duration, EACH + ea.move(robot, there, start, limits).duration
    return robot, record, states, ends


def test_it_arrives(run):
    """Within 2 mrad a second after each motion, though next to nothing is known at first, and without fault:
    torque that suits the last link alone overcomes 1 N m in two."""
    _, record, _, ends = run
    assert not record.faults
    for end, until in zip(ends, (EACH, 2 * EACH), strict=True):
        seen = (record.t > end + 1.0) & (record.t < until)
        assert np.abs(record.error[seen]).max() < 2e-3


def test_a_joint_that_sticks_feels_no_contact(run):
    """While its own torque grows to what frees it, nothing acts from outside."""
    _, _, states, _ = run
    assert not any(state.touching for state in states)
