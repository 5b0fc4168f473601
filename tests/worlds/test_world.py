"""A seed makes a world, the same ever again, and one that the arm can live in."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.worlds.distributions import HELD, capacity, facts

EXACT = ea.Distributions(
    loaded=0.0, masses=0.0, centres=0.0, rotors=(0, 0), coulomb=(0, 0), viscous=(0, 0), position_noise=(0, 0),
    velocity_noise=(0, 0), delay=(0, 0), velocity_lag=(0, 0), jitter=(0, 0), tilt=0.0,
)  # fmt: skip


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5", "kinova", "talos_left_arm"])
def test_a_seed_makes_the_same_world_and_another_seed_another_one(name):
    robot, given = load(name), ea.Distributions()
    assert given.world(robot, 5) == given.world(robot, 5)
    assert given.world(robot, 5) != given.world(robot, 6)


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "talos_left_arm", "so_arm101"])
def test_the_arm_holds_itself_and_its_load_at_both_ends(name):
    """By the URDF's masses and the efforts, with a tenth to spare."""
    robot, given = load(name), ea.Distributions()
    for seed in range(20):
        world = given.world(robot, seed)
        model = world.payload.loaded(robot) if world.load else robot.model
        for x in (world.start, world.goal):
            q = robot.configuration(x)
            gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
            assert np.all(np.abs(gravity) <= HELD * facts(robot).effort * (1 + 1e-9))  # rounding
        assert all(body.mass > 0 for body in list(world.arm(robot).model.inertias)[1:])


def test_the_capacity_is_the_load_at_which_an_effort_is_used_up():
    """At it gravity takes `HELD` of one joint's effort, and of none more."""
    robot, centre, rng = load("panda"), (0.05, -0.02, 0.03), np.random.default_rng(0)
    limit = facts(robot).effort
    for _ in range(10):
        q = robot.random_configuration(rng)
        load_there = ea.Payload(capacity(robot, q, centre, limit), centre).loaded(robot)
        share = np.abs(pin.computeGeneralizedGravity(load_there, load_there.createData(), q)) / limit
        np.testing.assert_allclose(share.max(), HELD, rtol=1e-9)  # rounding


def test_without_variation_the_arm_is_the_file():
    """Dynamics to rounding, ideal measurements, and nothing that acts beside the torque."""
    robot = load("panda")
    world, rng = EXACT.world(robot, 3), np.random.default_rng(0)
    q, v, a = robot.random_configuration(rng), rng.normal(size=7), rng.normal(size=7)
    np.testing.assert_allclose(
        world.arm(robot).inverse_dynamics(q, v, a), robot.inverse_dynamics(q, v, a), rtol=0, atol=1e-12
    )
    plant, plain = world.plant(robot, 1e-3), ea.PinocchioPlant(robot, robot.configuration(world.start))
    plant.reset(), plain.reset()
    tau = rng.normal(size=7)
    for _ in range(5):
        seen, expected = plant.step(tau, 1e-3), plain.step(tau, 1e-3)
    np.testing.assert_allclose(seen.q, expected.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.v, expected.v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_what_the_controller_is_told_is_the_truth_within_a_fifth(seed):
    """Of noise, delay and lag; stamps say when a step ended, so none is off, however long the step."""
    world = ea.Distributions().world(load("panda"), seed)
    for name in ("position_noise", "velocity_noise", "delay", "velocity_lag"):
        assert float(getattr(world.told, name)) == pytest.approx(getattr(world, name), rel=0.2)
    assert world.jitter > 0
    assert world.told.jitter == 0


def test_a_tilted_base_turns_gravity_and_leaves_its_size():
    robot = load("panda")
    world = dataclasses.replace(EXACT.world(robot, 0), tilt=(np.pi / 2, 0.0))
    np.testing.assert_allclose(world.arm(robot).model.gravity.linear, [0, -9.81, 0], atol=1e-12)


def test_masses_are_off_by_body_and_stay_physical():
    """A share of mass and moments about the centre, which is shifted."""
    robot = load("panda")
    world = ea.Distributions(masses=0.5).world(robot, 1)
    for k, body in enumerate(list(world.arm(robot).model.inertias)[1:]):
        file = robot.model.inertias[k + 1]
        assert body.mass == pytest.approx(world.masses[k] * file.mass)
        np.testing.assert_allclose(body.lever - file.lever, world.centres[k], atol=1e-15)
        np.testing.assert_allclose(body.inertia, world.masses[k] * file.inertia)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"masses": -0.1}, r"masses: expected a finite number in \[0, 1\]"),
        ({"masses": 1.0}, "bodies without mass"),
        ({"load": (0.5, 0.1)}, "load: expected low <= high"),
        ({"load": (-1.0, 0.1)}, "load: expected a finite number in"),
        ({"load": 0.5}, r"load: expected a range \(low, high\)"),
        ({"coulomb": (0, float("nan"))}, "coulomb: expected a finite number"),
        ({"pace": (0, 1)}, "pace: expected above 0"),
        ({"pace": (0.5, 2)}, "pace: expected at most 1"),
        ({"jitter": (0, 1)}, "jitter: expected at most 1"),
        ({"position_noise": (0, 1e-5)}, "log-uniformly"),
        ({"reach": 0}, "reach: expected above 0"),
        ({"loaded": 2}, "loaded: expected a finite number in"),
        ({"integrators": ("rk45",)}, "integrators: expected a tuple of rk4 and euler"),
    ],
)
def test_distributions_that_make_no_world_are_refused(given, said):
    with pytest.raises(ArgumentError, match=said):
        ea.Distributions(**given)


def test_an_arm_too_heavy_for_its_motors_is_refused_by_name():
    robot = load("two_link")
    model = robot.model.copy()
    model.upperEffortLimit = np.full(2, 1e-3)
    with pytest.raises(ArgumentError, match=r"two_link.*can be held in none of"):
        ea.Distributions().world(dataclasses.replace(robot, model=model), 0)
