"""Joint terms: rotors, friction and offsets of every joint, in theta and out of it again."""

import dataclasses
import pickle

import numpy as np
import pytest
from shared import load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.regressors.base import sample
from eladapt.regressors.standard import StandardRegressors

ALL = ("rotor", "viscous", "coulomb", "offset")
ARMS = ("panda", "kinova", "ur5", "double_pendulum", "talos_left_arm", "two_link")


@pytest.fixture(params=ARMS)
def arm(request) -> ea.Robot:
    return load(request.param)


def state(robot, rng):
    return robot.random_configuration(rng), *rng.normal(size=(2, robot.nv))


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_what_joints_add_is_a_rotor_friction_and_an_offset(arm, sharing, rng):
    """y = W theta with numbers put into theta by hand: inverse dynamics + Ir a + c v + f sign v + o."""
    reg = regressors(arm.name, sharing, ALL)
    rotor, viscous, coulomb, offset = rng.uniform(0.1, 1, size=(4, arm.nv))
    standard = reg.robot_parameters.copy()
    standard[-arm.nv :] += rotor
    theta = reg.theta
    p = reg.basis.projection @ standard
    theta[: reg.n_inertial] = p[: reg.n_inertial] * reg.scale[: reg.n_inertial]
    for name, values in (("viscous", viscous), ("coulomb", coulomb), ("offset", offset)):
        theta[reg.block(name)] = values * reg.scale[reg.block(name)]
    for _ in range(20):
        q, v, a = state(arm, rng)
        expected = arm.inverse_dynamics(q, v, a) + rotor * a + viscous * v + coulomb * np.sign(v) + offset
        np.testing.assert_allclose(reg.torque(q, v, a) @ theta, expected, rtol=1e-9, atol=1e-9)
        energy = (reg.energy(q, v) - reg.energy(q, np.zeros(arm.nv))) @ theta
        assert energy == pytest.approx(arm.kinetic_energy(q, v) + 0.5 * rotor @ v**2)


def test_base_parameters_with_rotors_are_independent(arm, rng):
    """The stacked regressor of all terms has full column rank, that of all standard parameters."""
    reg = regressors(arm.name, "shared", ALL)
    stacked = np.vstack([reg.torque(*state(arm, rng)) for _ in range(120)])
    assert np.linalg.matrix_rank(stacked, tol=1e-9 * np.linalg.norm(stacked)) == len(reg)
    samples = sample(StandardRegressors(arm, every_rotor=True))
    everything = samples.kinetic + samples.gravity
    norms = np.linalg.norm(everything, axis=0)
    present = norms > 1e-10 * norms.max()
    # the kinova's rounded angles make singular values of 1e-9
    assert np.linalg.matrix_rank(everything[:, present] / norms[present], 1e-8) == len(reg) - reg.n_friction
    assert reg.rank_gap > 1e6


def test_a_first_joints_rotor_is_its_links_inertia():
    """A panda's rotors add five parameters, not seven: joint 1's is no other than an Izz of its link,
    nor one of joint 2, whose axis meets that of joint 1 at a right angle."""
    reg, rigid = regressors("panda", "shared", ("rotor",)), regressors("panda")
    assert (len(reg), reg.n_potential) == (48, 12)
    assert (len(rigid), rigid.n_potential) == (43, 12)
    assert len(reg.robot_parameters) == 77


def test_terms_stand_in_one_order_whatever_order_they_are_given_in():
    robot = load("two_link")
    reg = ea.Regressors(robot, joint_terms=["offset", "coulomb", "rotor", "offset", "viscous"])
    assert reg.joint_terms == ALL
    assert reg.n_friction == 6
    assert [reg.block(name) for name in ALL[1:]] == [
        slice(reg.n_inertial + 2 * k, reg.n_inertial + 2 * k + 2) for k in range(3)
    ]
    names = [f"{term}({joint})" for term in ALL[1:] for joint in robot.joint_names]
    friction = slice(reg.n_inertial, reg.n_inertial + 6)
    assert all(name in label for name, label in zip(names, reg.labels[friction], strict=True))
    alone = ea.Regressors(robot, joint_terms="coulomb")
    assert (alone.joint_terms, alone.viscous, alone.coulomb, alone.offset) == (
        ("coulomb",),
        False,
        True,
        False,
    )
    assert len(alone.theta[alone.block("offset")]) == 0
    with pytest.raises(UnknownNameError, match="unknown block 'rotor'; legal names: viscous, coulomb"):
        alone.block("rotor")


def test_unknown_terms_are_refused():
    robot = load("two_link")
    for given in ("dry", ["viscous", "dry"]):
        with pytest.raises(UnknownNameError, match="unknown joint term 'dry'; legal names: rotor, visc"):
            ea.Regressors(robot, joint_terms=given)
    with pytest.raises(ArgumentError, match=r"joint_terms: expected any of rotor, .*, got False"):
        ea.Regressors(robot, joint_terms=False)


def test_nominal_values_are_the_urdfs():
    robot = load("talos_left_arm")
    reg = regressors(robot.name, "shared", ALL)
    np.testing.assert_array_equal(reg.robot_parameters[-robot.nv :], robot.armature)
    physical = reg.theta / reg.scale
    np.testing.assert_allclose(physical[reg.block("viscous")], robot.damping)
    np.testing.assert_allclose(physical[reg.block("coulomb")], robot.friction)
    np.testing.assert_array_equal(physical[reg.block("offset")], 0)


def test_theta_of_a_loaded_arm_differs_in_its_bodies_only(arm, rng):
    """W theta_of(loaded) is the loaded arm's torque, with its friction, which the load leaves as it was."""
    reg = regressors(arm.name, "shared", ALL)
    model = arm.model.copy()
    model.inertias[arm.nv].mass += 2.0
    heavy = dataclasses.replace(arm, model=model)
    theta = reg.theta_of(model)
    friction = slice(reg.n_inertial, reg.n_inertial + reg.n_friction)
    np.testing.assert_array_equal(theta[friction], reg.theta[friction])
    if arm.zero_parameters:  # their columns are left out: this load is none that the base allows for
        return
    q, v, a = state(arm, rng)
    expected = heavy.inverse_dynamics(q, v, a) + reg.joint_torque(v) @ theta
    np.testing.assert_allclose(reg.torque(q, v, a) @ theta, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_inertial_parameters_reproduce_the_torque(arm, sharing, rng):
    """Standard parameters found from a theta make the same torque as it, friction aside."""
    reg = regressors(arm.name, sharing, ALL)
    standard = StandardRegressors(arm, every_rotor=True)
    changed = standard.parameters * rng.uniform(0.5, 2, size=len(standard.parameters))
    changed[-arm.nv :] += 0.1
    theta = reg.theta
    base = np.r_[0 : reg.n_inertial, reg.n_inertial + reg.n_friction : len(reg)]
    theta[base] = reg.scale[base] * (reg.basis.projection @ changed)
    theta[reg.block("viscous")] = 3.0
    found = reg.inertial_parameters(theta)
    assert found.shape == (10 * arm.nv + arm.nv,)
    for _ in range(20):
        q, v, a = state(arm, rng)
        expected = (reg.torque(q, v, a) - reg.joint_torque(v)) @ theta
        np.testing.assert_allclose(standard.torque(q, v, a) @ found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("terms", [(), ALL], ids=["rigid", "joint terms"])
def test_the_sparse_product_is_the_dense_one(arm, terms, rng):
    """Equal to 1e-13 of the largest entry."""
    reg = regressors(arm.name, "shared", terms)
    standard = StandardRegressors(arm, every_rotor="rotor" in terms)
    for _ in range(20):
        q, v, a = state(arm, rng)
        dense = standard.torque(q, v, a) @ reg._kinetic_map + reg.joint_torque(v)
        np.testing.assert_allclose(reg.torque(q, v, a), dense, rtol=0, atol=1e-13 * np.abs(dense).max())


def test_joint_columns_are_velocity_direction_and_one():
    """Columns of theta_F in physical units, row by row; nothing anywhere else."""
    reg = ea.Regressors(load("two_link"), joint_terms=ALL, scaled=False)
    assert np.all(reg.scale == 1)
    v = np.array([-0.3, 0.0])
    found, expected = reg.joint_torque(v), np.zeros((2, len(reg)))
    expected[:, reg.block("viscous")] = np.diag(v)
    expected[:, reg.block("coulomb")] = np.diag([-1.0, 0.0])
    expected[:, reg.block("offset")] = np.eye(2)
    np.testing.assert_array_equal(found, expected)
    v = np.array([0.005, -0.02])
    rest = np.zeros(2)
    q = reg.robot.configuration([0.3, 0.4])
    feedforward = reg.slotine_li(q, rest, v, rest)[:, reg.block("coulomb")]
    np.testing.assert_allclose(feedforward, np.diag(np.tanh(v / reg.coulomb_speed)))


def test_a_basis_of_ones_own_keeps_joint_terms_in_physical_units():
    robot = load("two_link")
    reg = ea.Regressors(robot, joint_terms=ALL[1:], basis=ea.paper.basis(robot))
    assert np.all(reg.scale == 1)
    assert (reg.n_inertial, reg.n_friction, reg.n_potential) == (3, 6, 2)
    with pytest.raises(ArgumentError, match=r"projection of shape \(p, 22\)"):
        ea.Regressors(robot, joint_terms="rotor", basis=ea.paper.basis(robot))


def test_regressors_say_what_they_are():
    said = repr(regressors("panda", "shared", ALL))
    assert said.startswith(
        "Regressors(panda, sharing='shared', joint_terms=('rotor', 'viscous', 'coulomb', 'off"
    )
    assert said.endswith("l = 69 parameters = 36 inertial + 21 friction + 12 potential")


def test_regressors_travel_between_processes(rng):
    reg = regressors("panda", "shared", ALL)
    q, v, a = state(reg.robot, rng)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(reg)).torque(q, v, a), reg.torque(q, v, a))
