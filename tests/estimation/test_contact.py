"""What comes to an arm at rest is felt, and told for a load or a contact; of a contact nothing is learned."""

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.contact import ContactDetector
from eladapt.robot.reading import frame_index

DT, COMES = 1e-3, 0.5
NOISE = ea.Noise(1e-5, 1e-3)


def torque_of(robot: ea.Robot, q: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(nv,) what a force at the tool makes."""
    data, frame = robot.model.createData(), frame_index(robot.model, robot.tool)
    return pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3].T @ force


def held(force=None, payload=None, duration=1.0, goes=np.inf):
    """The controller's states while a Panda holds its target, with a force [N] at the tool for a while."""
    robot = load("panda")
    q = robot.configuration(robot.target)
    controller = ea.CompositeController.for_robot(robot, DT)
    plant = ea.PinocchioPlant(robot, q, noise=NOISE, payload=payload, seed=2)
    measurement = plant.reset()
    states = [controller.init(measurement)]
    for _ in range(round(duration / DT)):
        state, tau = controller.step(states[-1], measurement, q, DT)
        states.append(state)
        pushed = force is not None and COMES <= measurement.t < goes
        acts = tau + torque_of(robot, plant.q, force) if pushed else tau
        measurement = plant.step(acts, DT)._replace(tau=tau)
    return robot, q, states


@pytest.mark.parametrize("force", [(20.0, 0, 0), (0, -20.0, 0), (0, 0, 20.0), (12.0, 12.0, -10.0)])
def test_a_contact_is_felt_told_and_not_learned(force):
    """20 N: told within 50 ms, measured to 5 % of the largest torque, and theta stays as it was."""
    robot, q, states = held(np.array(force))
    comes = round(COMES / DT)
    assert states[comes + 50].touching
    true = torque_of(robot, q, np.array(force))
    error = np.abs(states[comes + 200].external - states[comes - 1].external - true)
    assert error.max() < 0.05 * np.abs(true).max() + 0.5  # [N m] what noise of the velocity makes in 10 ms
    assert np.array_equal(states[comes + 50].parameters, states[-1].parameters)


def test_a_load_is_none():
    """2 kg that come are felt and taken for what they are."""
    _, _, states = held(payload=ea.Payload(2.0, (0, 0, 0.03), attach=COMES))
    assert states[round(COMES / DT) + 20].contact.acting
    assert not any(state.touching for state in states)


def test_when_it_is_gone_learning_goes_on():
    """A push of 0.3 s."""
    _, _, states = held(np.array([0.0, 20.0, 0.0]), goes=COMES + 0.3)
    assert states[round((COMES + 0.2) / DT)].touching
    assert not states[-1].contact.acting


def test_a_gate_may_stop_an_arm_that_is_pushed():
    """A limit of 3 N m on what acts from outside, and a person who pushes with 20 N."""
    robot = load("panda")
    q = robot.configuration(robot.target)
    bare = ea.CompositeController.for_robot(robot, DT)
    controller = ea.GatedController.for_robot(bare, DT, contact=3.0)
    plant = ea.PinocchioPlant(robot, q, noise=NOISE)
    measurement = plant.reset()
    state = controller.init(measurement)
    for _ in range(700):
        state, tau = controller.step(state, measurement, q, DT)
        push = torque_of(robot, plant.q, np.array([0.0, 20.0, 0.0])) if measurement.t > COMES else 0.0
        measurement = plant.step(tau + push, DT)._replace(tau=tau)
    assert state.fault.name == "contact"
    assert state.fault.t - COMES < 0.03
    assert not state.brake, "a healthy arm is held"


def test_what_a_detector_cannot_have_is_refused():
    regressors = ea.Regressors(load("panda"))
    for name in ("least", "memory", "rest", "patience", "longest", "misfit"):
        with pytest.raises(ArgumentError, match=name):
            ContactDetector(regressors, load("panda").effort_limit, **{name: 0.0})


@pytest.mark.parametrize(
    ("coulomb", "came", "acting"), [(0.0, 3.8, True), (2.0, 3.8, False), (2.0, 6.0, True)]
)
def test_what_friction_may_bear_is_nothing_new(coulomb, came, acting):
    """A joint that sticks bears its Coulomb friction one way and then the other; 0.9 N m count as nothing."""
    regressors = ea.Regressors(load("panda"), joint_terms=("coulomb",))
    detector = ContactDetector(regressors, load("panda").effort_limit)
    theta, block, q = regressors.theta, regressors.block("coulomb"), load("panda").home
    theta[block] = coulomb * regressors.scale[block]
    state, outside = detector.init(), np.zeros(7)
    for k in range(450):
        outside[1] = came if k >= 400 else 0.0
        state = detector.step(state, outside, q, theta, arrived=True, still=k < 400, dt=DT)
        if state.acting:
            break
    assert state.acting == acting
