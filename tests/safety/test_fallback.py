"""After an alarm the arm stops or its brakes are wanted: it never gains more than a bridging time can add."""

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import load

import eladapt as ea
from eladapt.robot.joint_limits import speed
from eladapt.simulation.disturbances import Brakes

DT = 1e-3
AFTER = 0.4  # [s] that a case is watched
DELAYS = (0, 1, 3, 6)  # [steps] late


@dataclasses.dataclass(frozen=True)
class Broken:
    """What is wrong with an arm: of each joint the gains of its encoder, its velocity and its drive, and what
    its velocity is off by [rad/s]; and by how many steps torque is late."""

    encoder: np.ndarray
    speed: np.ndarray
    drive: np.ndarray
    offset: np.ndarray
    late: int


@functools.cache
def gated(robot: ea.Robot) -> ea.GatedController:
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)


def energy_gained(robot: ea.Robot, broken: Broken, v0: np.ndarray) -> tuple[float, float, bool]:
    """[J] by how much the arm's energy rises after an alarm in motion, what a bridging time can add, and
    whether the brakes were asked for."""
    controller = gated(robot)
    gate = controller.gate
    q0 = robot.configuration(robot.home)
    plant = ea.PinocchioPlant(robot, q0, v0, brakes=Brakes(closing=0.0))

    def seen(measurement):
        moved = robot.difference(q0, measurement.q)
        return measurement._replace(
            q=robot.integrate(q0, broken.encoder * moved),
            v=broken.encoder * broken.speed * measurement.v + broken.offset,
        )

    def energy():
        return robot.kinetic_energy(plant.q, plant.v) + robot.potential_energy(plant.q)

    measurement = plant.reset()
    first = seen(measurement)
    state = controller.init(first)
    state = state._replace(gate=gate.latch(state.gate, "controller", "the test says so"))
    waiting = [robot.gravity(q0)] * broken.late
    start, highest = energy(), energy()
    for _ in range(round(AFTER / DT)):
        state, tau = controller.step(state, seen(measurement), q0, DT)
        waiting.append(broken.drive * tau)
        if state.brake:
            plant.brake()
        measurement = plant.step(waiting.pop(0), DT)._replace(tau=tau)
        highest = max(highest, energy())
        if state.brake and not plant.v.any():
            break
    h, inverse = gate.fallback.bridging, np.linalg.inv(robot.mass_matrix(q0))
    added = h * gate.effort @ np.abs(v0) + h**2 / 2 * gate.effort @ np.abs(inverse) @ gate.effort
    return highest - start, float(added), state.brake


def gains(size, low, high):
    return st.lists(st.floats(low, high), min_size=size, max_size=size).map(np.array)


@st.composite
def cases(draw, robot):
    n = robot.nv
    signs = st.lists(st.sampled_from([1.0, 1.0, 1.0, -1.0]), min_size=n, max_size=n).map(np.array)
    broken = Broken(
        draw(signs) * draw(gains(n, 0.3, 3)), draw(signs) * draw(gains(n, 0, 3)),
        draw(signs) * draw(gains(n, 0, 3)), draw(gains(n, -0.5, 0.5)), draw(st.sampled_from(DELAYS)),
    )  # fmt: skip
    return broken, draw(gains(n, -0.9, 0.9)) * speed(robot.velocity_limit)


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_whatever_is_wrong_with_it_the_arm_gains_no_more_than_a_bridging_time_can_add(name):
    """Random wrong signs, gains (of encoders a third to three), offsets and delays, in motion; with brakes
    that close at once. 10,000 cases with ``make nightly``."""
    robot = load(name)

    @settings(max_examples=10_000 if settings().max_examples > 1000 else 25)
    @given(cases(robot))
    def check(case):
        gained, added, _ = energy_gained(robot, *case)
        assert gained <= added

    check()


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "z1"])
def test_a_healthy_arm_is_brought_to_rest_without_brakes(name):
    """Nothing is wrong but the controller: from half its speed limits it stops by torque, and gains
    nothing."""
    robot = load(name)
    n = robot.nv
    healthy = Broken(np.ones(n), np.ones(n), np.ones(n), np.zeros(n), 0)
    gained, _, braked = energy_gained(robot, healthy, 0.5 * robot.velocity_limit)
    assert not braked
    # The step that the first torque takes to arrive: what gravity does to an arm that had been held.
    assert gained < 1e-2 * robot.kinetic_energy(robot.configuration(robot.home), 0.5 * robot.velocity_limit)


def samples_until_brakes(v: np.ndarray, free: tuple[int, ...] = ()) -> int | None:
    """How many samples at a velocity (nv,) [rad/s] a two-link arm is held whose shoulder's gravity takes all
    of its effort, but in the samples that are ``free`` of it; None if it is held throughout."""
    robot = load("two_link")
    fallback, q = gated(robot).gate.fallback, robot.configuration(robot.home)
    weight = fallback.effort * np.array([1.0, 0.0])
    hold = fallback.begin(q, v, weight, np.zeros(2), believed=False)
    sent = weight
    for k in range(round(5 * fallback.bridging / DT)):
        hold, sent = fallback.held(hold, q, v, 0 * weight if k in free else weight, sent, DT)
        if hold.braking is not None:
            assert hold.reason == "gravity leaves the efforts nothing to brake with"
            return k + 1
    return None


def test_an_arm_that_gravity_leaves_nothing_to_brake_with_asks_for_its_brakes():
    """A shoulder that falls, with all its effort against gravity, after one bridging time in a row; not one
    that rises, which gravity itself brakes, nor one at rest."""
    bridging = round(gated(load("two_link")).gate.fallback.bridging / DT)
    falls = np.array([-0.5, 0.0])
    # the sum of so many steps is the bridging time, or just beyond it
    assert samples_until_brakes(falls) in (bridging, bridging + 1)
    assert samples_until_brakes(falls, free=(bridging - 2,)) in (2 * bridging - 1, 2 * bridging)
    assert samples_until_brakes(-falls) is None
    assert samples_until_brakes(0 * falls) is None
