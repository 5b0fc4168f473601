"""Simulated robots obey physics: energy, friction that sticks, loads that weigh."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, SimulationError, UnknownNameError
from eladapt.robot.reading import frame_index
from eladapt.simulation.instruments import Delay
from eladapt.simulation.plants import _active_set, _projected_sweeps

DT = 1e-3


def test_energy_is_work(robot, rng):
    """RK4: the change of energy is tau'(q+ - q) for a held torque, to 1e-8 of the energy moved."""
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), 0.3 * rng.normal(size=robot.nv))

    def energy() -> float:
        return robot.kinetic_energy(plant.q, plant.v) + robot.potential_energy(plant.q)

    plant.reset()
    work, start = 0.0, energy()
    for _ in range(300):
        tau, q = robot.gravity(plant.q) + rng.normal(size=robot.nv) * 0.1, plant.q
        plant.step(tau, DT)
        work += tau @ robot.difference(q, plant.q)
    assert abs(energy() - start - work) <= 1e-8 * max(abs(work), robot.kinetic_energy(plant.q, plant.v))


def test_explicit_euler_is_the_typeset_step(rng):
    """q+ = q + dt v, v+ = v + dt M^-1 (tau - C v - g - tau_f), both from old values."""
    robot = load("two_link")
    friction = ea.Friction(coulomb=[0.5, 0.4])
    plant = ea.PinocchioPlant(robot, [3.0, 0.0], [0.2, -0.1], friction=friction, integrator="euler")
    q, v, tau = plant.q, plant.v, np.array([1.0, -2.0])
    measurement = plant.step(tau, DT)
    bias = robot.coriolis_matrix(q, v) @ v + robot.gravity(q) + [0.5, -0.4]
    np.testing.assert_allclose(measurement.q, q + DT * v, rtol=1e-15)
    np.testing.assert_allclose(
        measurement.v, v + DT * np.linalg.solve(robot.mass_matrix(q), tau - bias), rtol=1e-12
    )
    assert np.array_equal(measurement.tau, tau)
    assert measurement.t == DT


def test_coulomb_friction_sticks_and_then_gives_way():
    """An arm pushed less than its friction does not creep; pushed more, it moves."""
    robot = load("panda")
    q0 = robot.configuration(robot.home)
    for push, moves in ((0.9, False), (1.5, True)):
        plant = ea.PinocchioPlant(robot, q0, friction=ea.Friction(coulomb=1.0))
        for _ in range(500):
            plant.step(robot.gravity(q0) + push * np.eye(7)[6], DT)
        assert (abs(plant.q[6] - q0[6]) > 1e-2) == moves
        if not moves:
            assert np.abs(plant.q - q0).max() < 1e-9


def test_friction_forces_solve_the_stick_slip_conditions(rng):
    """|f| <= bound, what slips is braked with all of it, what does not stays at v = 0: by active sets, and
    the same by sweeps where those are asked."""
    robot = load("panda")
    for k in range(200):
        inverse = 5e-4 * np.linalg.inv(robot.mass_matrix(robot.random_configuration(rng)))
        bound = 10.0 ** rng.uniform(-2, 1.5, size=7) * (rng.uniform(size=7) > 0.1)
        free = inverse @ (rng.normal(size=7) * 10.0 ** rng.uniform(-2, 2.5))
        force = _active_set(free, inverse, bound)
        assert force is not None, "so the sweeps are hardly ever needed"
        v, rounding = free - inverse @ force, 1e-10 * np.abs(free).max()  # cond(M) is up to 1e4
        slips = np.abs(force) >= bound * (1 - 1e-12)
        assert np.all(np.abs(force) <= bound * (1 + 1e-9))
        assert np.all(np.abs(v[~slips]) <= rounding)
        assert np.all(v[slips] * np.sign(force[slips]) >= -rounding)
        if k < 5:
            swept = _projected_sweeps(free, inverse, bound)
            np.testing.assert_allclose(swept, force, atol=1e-9 * bound.max())


def test_friction_brings_motion_to_rest():
    """Coulomb friction alone stops an arm that floats, in finite time and without chatter."""
    robot = load("ur5")
    q0 = robot.configuration(robot.home)
    plant = ea.PinocchioPlant(robot, q0, np.full(6, 0.5), friction=ea.Friction(coulomb=5.0))
    for _ in range(2000):
        plant.step(robot.gravity(plant.q), DT)
    assert np.abs(plant.v).max() < 1e-9


def test_a_load_weighs_at_its_place():
    """Static torque with a load is gravity plus J'F of the load at its centre of mass."""
    import pinocchio as pin

    robot = load("panda")
    q = robot.configuration(robot.home)
    com = np.array([0.05, -0.02, 0.1])
    loaded = ea.Payload(2.0, tuple(com)).loaded(robot)
    data = robot.model.createData()
    frame = frame_index(robot.model, robot.tool)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    jacobian = pin.getFrameJacobian(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    arm = pin.skew(data.oMf[frame].rotation @ com)
    velocity = jacobian[:3] - arm @ jacobian[3:]
    expected = robot.gravity(q) + velocity.T @ [0, 0, 2.0 * 9.81]
    found = pin.computeGeneralizedGravity(loaded, loaded.createData(), q)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_load_is_there_only_while_it_is_held():
    robot = load("two_link")
    load_ = ea.Payload(1.0, attach=0.1, release=0.2)
    plant, bare = (ea.PinocchioPlant(robot, [1.0, 0.5], payload=p) for p in (load_, None))
    for k in range(300):
        a, b = plant.step(np.zeros(2), DT), bare.step(np.zeros(2), DT)
        assert np.array_equal(a.q, b.q) == (k < 100)
    assert isinstance(ea.PinocchioPlant(robot, [1.0, 0.5], payload=2).payload, ea.Payload)


def test_noise_is_measured_not_lived_and_repeats():
    robot = load("kinova")
    q0 = robot.configuration(robot.home)
    plant = ea.PinocchioPlant(robot, q0, noise=ea.Noise(1e-3, 1e-2), seed=3)
    first = plant.reset()
    again = plant.reset()
    assert np.array_equal(first.q, again.q)
    assert np.array_equal(plant.q, q0)
    robot.check_q(first.q)  # still on the circle for continuous joints
    errors = np.array([robot.difference(q0, plant._measure().q) for _ in range(2000)])
    np.testing.assert_allclose(errors.std(axis=0), 1e-3, rtol=0.1)  # 6 sigma of 2000 samples


def test_divergence_is_an_error_that_keeps_the_record():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)

    class Runaway:
        regressors = controller.regressors

        def init(self, measurement, theta0=None):
            return controller.init(measurement)

        def step(self, state, measurement, goal, dt):
            return state, np.full(2, 10.0 ** (measurement.t * 1e4))

    plant = ea.PinocchioPlant(robot, [0.0, 0.0], integrator="euler")
    with pytest.raises(SimulationError, match=r"after \d+ of 1001 samples") as caught:
        ea.simulate(Runaway(), plant, np.zeros(2), 1.0, progress=False)
    assert 1 <= len(caught.value.record) < 1001


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"q0": [0.0]}, ArgumentError, "q0: expected shape"),
        ({"v0": [0.0, np.nan]}, ArgumentError, "v0: expected finite"),
        ({"integrator": "magic"}, ArgumentError, "integrator"),
        ({"substeps": 0}, ArgumentError, "substeps"),
        ({"payload": -1.0}, ArgumentError, "mass"),
        ({"friction": ea.Friction(viscous=[1.0] * 3)}, ArgumentError, "viscous: expected a scalar or shape"),
        ({"payload": ea.Payload(1.0, frame="hand")}, UnknownNameError, "'hand'; legal names: .*tip"),
    ],
)
def test_bad_set_ups_are_refused(options, error, said):
    with pytest.raises(error, match=said):
        ea.PinocchioPlant(load("two_link"), **{"q0": [0.0, 0.0], **options})


def test_bad_torques_are_named():
    plant = ea.PinocchioPlant(load("two_link"), [0.0, 0.0])
    with pytest.raises(ArgumentError, match="tau: expected finite"):
        plant.step(np.array([np.nan, 0]), DT)
    with pytest.raises(ArgumentError, match="dt"):
        plant.step(np.zeros(2), -DT)


def test_a_plant_says_what_it_is_in_a_line():
    """Robot, time, friction, noise and load are told where they are not nothing, through every wrapper."""
    robot = load("panda")
    plant = ea.PinocchioPlant(robot, robot.home)
    assert repr(plant) == "PinocchioPlant('panda', t = 0 s)"
    acting = {"friction": ea.Friction(0.5, np.arange(7)), "noise": ea.Noise(1e-4), "payload": 2.0}
    plant = Delay(ea.PinocchioPlant(robot, robot.home, **acting), 1e-3)
    plant.step(robot.gravity(robot.home), DT)
    assert repr(plant) == (
        "Delay(PinocchioPlant('panda', t = 0.001 s, friction up to 0.5 N m s/rad and 6 N m, "
        "noise 0.0001 rad, 0 rad/s, 2 kg at 'panda_hand_tcp'))"
    )


class Drift:
    def sample(self, t, nv, rng):
        return np.full(nv, t), np.zeros(nv)


def test_noise_of_ones_own_is_told_by_its_name():
    robot = load("two_link")
    assert (
        repr(ea.PinocchioPlant(robot, [0.0, 0.0], noise=Drift()))
        == "PinocchioPlant('two_link', t = 0 s, Drift)"
    )
