"""Regressor identities: each against a formula that does not use regressors."""

from typing import NamedTuple

import numpy as np
import pytest
from shared import ROBOTS, load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError, RankWarning
from eladapt.regressors.base import Samples, independent_basis, sample
from eladapt.regressors.joint_terms import RELUCTANCE
from eladapt.regressors.standard import StandardRegressors

STATES = 100
EXACT = 1e-9  # relative; what the issue of identities demands, observed 1e-11 at worst
ALL = ("rotor", "viscous", "coulomb", "offset")
H = 1e-5  # of central differences: h^2 and rounding/h are both about 1e-10


class State(NamedTuple):
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    vr: np.ndarray
    ar: np.ndarray


def states(robot: ea.Robot, rng: np.random.Generator, count: int = STATES) -> list[State]:
    return [State(robot.random_configuration(rng), *rng.normal(size=(4, robot.nv))) for _ in range(count)]


def mismatch(pairs) -> float:
    """Largest difference over all states, relative to the largest value over all states."""
    left, right = (np.array([np.ravel(side) for side in sides]) for sides in zip(*pairs, strict=True))
    return float(np.abs(left - right).max() / np.abs(right).max())


@pytest.fixture(params=["shared", "independent"])
def sharing(request) -> str:
    return request.param


@pytest.fixture(params=[(), ALL], ids=["rigid", "joint terms"])
def reg(robot, sharing, request) -> ea.Regressors:
    return regressors(robot.name, sharing, request.param)


def test_torque_is_inverse_dynamics_with_armature_and_friction(robot, reg, rng):
    """W theta = M a + C v + g + friction."""
    pairs = [
        (
            reg.torque(s.q, s.v, s.a) @ reg.theta,
            robot.inverse_dynamics(s.q, s.v, s.a)
            + bool(reg.n_friction) * (robot.damping * s.v + robot.friction * np.sign(s.v)),
        )
        for s in states(robot, rng)
    ]
    assert mismatch(pairs) <= EXACT


def test_energy_is_kinetic_plus_potential(robot, reg, rng):
    """omega theta = E up to a constant, which differences between states remove."""
    first, *others = states(robot, rng)

    def energy(s: State) -> float:
        return robot.kinetic_energy(s.q, s.v) + robot.potential_energy(s.q)

    pairs = [
        ((reg.energy(s.q, s.v) - reg.energy(first.q, first.v)) @ reg.theta, energy(s) - energy(first))
        for s in others
    ]
    assert mismatch(pairs) <= EXACT


def test_momentum_is_mass_times_velocity(robot, reg, rng):
    pairs = [(reg.momentum(s.q, s.v) @ reg.theta, robot.mass_matrix(s.q) @ s.v) for s in states(robot, rng)]
    assert mismatch(pairs) <= EXACT


def test_kinetic_gradient_is_transposed_coriolis(robot, reg, rng):
    """1/2 grad v' M v = C' v for the Christoffel C."""
    pairs = [
        (reg.kinetic_gradient(s.q, s.v) @ reg.theta, robot.coriolis_matrix(s.q, s.v).T @ s.v)
        for s in states(robot, rng)
    ]
    assert mismatch(pairs) <= EXACT


def test_gravity_needs_theta_potential_only(robot, reg, rng):
    """Psi theta_U = g, and the potential gradient over all columns says the same."""
    theta_u = reg.theta[len(reg) - reg.n_potential :]
    every = states(robot, rng)
    assert mismatch([(reg.gravity(s.q) @ theta_u, robot.gravity(s.q)) for s in every]) <= EXACT
    assert mismatch([(reg.potential_gradient(s.q) @ reg.theta, robot.gravity(s.q)) for s in every]) <= EXACT


def test_slotine_li_uses_christoffel_coriolis(robot, reg, rng):
    """W_r theta = M ar + C vr + g + friction at vr, Coulomb as a steep tanh."""
    pairs = []
    for s in states(robot, rng):
        expected = robot.mass_matrix(s.q) @ s.ar + robot.coriolis_matrix(s.q, s.v) @ s.vr + robot.gravity(s.q)
        if reg.n_friction:
            expected += robot.damping * s.vr + robot.friction * np.tanh(s.vr / reg.coulomb_speed)
        pairs.append((reg.slotine_li(s.q, s.v, s.vr, s.ar) @ reg.theta, expected))
    assert mismatch(pairs) <= EXACT


def test_slotine_li_along_the_motion_is_the_torque_regressor(robot, reg, rng):
    """W_r(q, v, v, a) = W(q, v, a) for speeds well above that of Coulomb's tanh."""
    pairs = []
    for s in states(robot, rng):
        v = np.sign(s.v) * np.maximum(np.abs(s.v), 20 * reg.coulomb_speed)
        pairs.append((reg.slotine_li(s.q, v, v, s.a), reg.torque(s.q, v, s.a)))
    assert mismatch(pairs) <= EXACT


def test_a_reference_at_rest_needs_gravity_and_offsets_only(robot, reg, rng):
    """W_r(q, v, 0, 0) is the torque regressor at rest, whatever v is, and the limit of slow references."""
    for s in states(robot, rng, 10):
        still = np.zeros(robot.nv)
        found = reg.slotine_li(s.q, s.v, still, still)
        np.testing.assert_array_equal(found, reg.torque(s.q, still, still))
        near = reg.slotine_li(s.q, s.v, np.full(robot.nv, 1e-12), still)
        np.testing.assert_allclose(near, found, atol=1e-9)


def test_mass_matrix_derivative_is_coriolis_plus_transpose(robot, rng):
    """dM/dt = C + C' (205)."""
    pairs = []
    for s in states(robot, rng):
        ahead, behind = robot.integrate(s.q, H * s.v), robot.integrate(s.q, -H * s.v)
        rate = (robot.mass_matrix(ahead) - robot.mass_matrix(behind)) / (2 * H)
        coriolis = robot.coriolis_matrix(s.q, s.v)
        pairs.append((rate, coriolis + coriolis.T))
    assert mismatch(pairs) <= 1e-6  # central differences of a bounded third derivative


def test_momentum_balance_is_the_torque_regressor(robot, reg, rng):
    """d/dt (M_k v) - 1/2 grad v' M_k v + grad U_k + friction = W, column by column."""
    pairs = []
    for s in states(robot, rng):
        ahead = reg.momentum(robot.integrate(s.q, H * s.v + H**2 / 2 * s.a), s.v + H * s.a)
        behind = reg.momentum(robot.integrate(s.q, -H * s.v + H**2 / 2 * s.a), s.v - H * s.a)
        balance = (ahead - behind) / (2 * H) - reg.kinetic_gradient(s.q, s.v)
        balance += reg.potential_gradient(s.q) + reg.joint_torque(s.v)
        pairs.append((balance, reg.torque(s.q, s.v, s.a)))
    assert mismatch(pairs) <= 1e-6


@pytest.mark.parametrize(
    ("name", "sharing", "total", "potential"),
    [
        ("panda", "shared", 43, 12), ("panda", "independent", 51, 12), ("ur5", "shared", 36, 10),
        ("ur10", "shared", 36, 10), ("two_link", "shared", 4, 2), ("two_link", "independent", 5, 2),
    ],
)  # fmt: skip
def test_base_ranks_are_the_published_ones(name, sharing, total, potential):
    reg = regressors(name, sharing)
    assert (len(reg), reg.n_potential) == (total, potential)
    assert reg.rank_gap > 1e6


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_inertial_parameters_round_trip(robot, sharing, rng):
    """Standard parameters found from base parameters have those base parameters again."""
    reg = regressors(robot.name, sharing, ("rotor",))
    nominal = reg.robot_parameters
    assert np.abs(reg.inertial_parameters(reg.theta) - nominal).max() <= 1e-9 * np.abs(nominal).max()
    changed = nominal * rng.uniform(0.5, 2, size=len(nominal))
    theta = reg.scale * (reg.basis.projection @ changed)
    again = reg.scale * (reg.basis.projection @ reg.inertial_parameters(theta))
    assert np.abs(again - theta).max() <= 1e-9 * np.abs(theta).max()


def test_scaled_columns_have_unit_size(robot, rng):
    """One gain fits all parameters: the RMS of every column is one within sampling error, but of what looks
    like gravity while a joint moves one way: those columns are `RELUCTANCE` times smaller."""
    reg = regressors(robot.name, "shared", ALL)
    every = states(robot, rng, 400)
    motion = np.vstack([reg.torque(s.q, s.v, s.a) for s in every])
    gravity = np.vstack([reg.potential_gradient(s.q) for s in every])
    j = len(reg) - reg.n_potential
    expected = np.ones(len(reg))
    expected[reg.block("coulomb")] = expected[reg.block("offset")] = 1 / RELUCTANCE
    for columns, size in ((motion[:, :j], expected[:j]), (gravity[:, j:], expected[j:])):
        rms = np.sqrt(np.mean(columns**2, axis=0)) / size
        assert np.all((rms > 0.6) & (rms < 1.6))  # 120 and 400 samples of a variable of few large values


def test_paper_basis_is_the_papers_deltas():
    reg = ea.Regressors(load("two_link"), basis=ea.paper.basis(load("two_link")))
    assert reg.labels == ("delta_1", "delta_2", "delta_3", "delta_4", "delta_5")
    np.testing.assert_allclose(reg.theta, [0.49 / 3, 0.03, 0.04 / 3, 0.981, 5.886], rtol=1e-12)


def test_an_unclear_rank_is_reported():
    """Singular values that fade out without a drop of 100 are a warning that gives the figure."""
    standard = StandardRegressors(load("double_pendulum"))
    kinetic, gravity, velocity = sample(standard)
    size = kinetic.shape[1]
    left, right = (np.linalg.qr(np.random.default_rng(k).normal(size=(size, size)))[0] for k in (0, 1))
    fading = left @ np.diag(np.logspace(0, -15, size)) @ right
    with pytest.warns(RankWarning, match="only by a factor"):
        basis = independent_basis(standard, Samples(fading, gravity, velocity))
    assert basis.rank_gap < 100


@pytest.mark.parametrize("name", ROBOTS)
def test_labels_name_every_parameter_once(name):
    reg = regressors(name, "shared", ALL)
    assert len(reg.labels) == len(reg.theta) == len(set(reg.labels)) == len(reg)


def test_unknown_options_are_refused():
    with pytest.raises(ArgumentError, match="sharing: expected 'shared' or 'independent', got 'both'"):
        ea.Regressors(load("two_link"), "both")


def test_a_basis_that_leaves_torque_out_is_refused():
    basis = ea.paper.basis(load("two_link"))
    with pytest.raises(ArgumentError, match="do not make up"):
        ea.Regressors(load("double_pendulum"), basis=basis)


@pytest.mark.parametrize(
    ("argument", "bad"), [("q", np.zeros(3)), ("v", np.array([np.nan, 0])), ("a", "fast")]
)
def test_bad_arguments_are_named(argument, bad):
    reg = regressors("two_link")
    state = {"q": np.zeros(2), "v": np.zeros(2), "a": np.zeros(2), argument: bad}
    with pytest.raises(ArgumentError, match=rf"^{argument}: expected .*2"):
        reg.torque(**state)
