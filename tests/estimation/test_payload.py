"""The change of the gravity parameters tells what a load weighs, where it hangs, and how surely."""

import numpy as np
import pinocchio as pin
import pytest
from shared import load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.estimation.extensions import Information
from eladapt.estimation.payload import estimate_payload

MASS, COM = 2.0, np.array([0.03, -0.02, 0.1])


def loaded_theta(reg, payload):
    """theta_U of the loaded arm, fitted to its gravity torque: no formula of the estimator's."""
    robot, rng = reg.robot, np.random.default_rng(5)
    model = payload.loaded(robot)
    data = model.createData()
    postures = [robot.random_configuration(rng) for _ in range(80)]
    torque = np.concatenate([pin.computeGeneralizedGravity(model, data, q) for q in postures])
    theta, *_ = np.linalg.lstsq(np.vstack([reg.gravity(q) for q in postures]), torque, rcond=None)
    return theta


def rows(reg, rng, count=60):
    """(count nv, l): regressors of torque at random states."""
    robot = reg.robot
    return np.vstack(
        [reg.torque(robot.random_configuration(rng), *rng.normal(size=(2, robot.nv))) for _ in range(count)]
    )


def information(omega):
    """What these rows say, as the extensions keep it, with y = 0."""
    return Information(np.linalg.qr(np.column_stack([omega, np.zeros(len(omega))]), mode="r"), 1e-3, 1.0)


@pytest.fixture
def reg():
    return regressors("panda")


@pytest.fixture
def loaded(reg):
    return loaded_theta(reg, ea.Payload(MASS, tuple(COM)))


@pytest.mark.parametrize("sharing", ["shared", "independent"])
@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7", "kinova", "talos_left_arm"])
def test_the_load_is_recovered_from_exact_parameters(name, sharing):
    """Mass and centre of mass to 1e-9, whether the load comes or goes."""
    reg = regressors(name, sharing)
    bare, with_load = reg.theta_potential, loaded_theta(reg, ea.Payload(MASS, tuple(COM)))
    for sign, found in (
        (1, estimate_payload(reg, bare, with_load)),
        (-1, estimate_payload(reg, with_load, bare)),
    ):
        assert found.mass == pytest.approx(sign * MASS, rel=1e-9)
        np.testing.assert_allclose(found.com, COM, atol=1e-9)
        assert found.unidentified == ()
        assert found.misfit < 1e-9
        assert found.frame == load(name).tool
        assert np.isnan(found.mass_std)  # no noise level was given


def test_another_frame_gives_other_coordinates(reg):
    """A load hung on link 5 is found there; no load on link 2 would change theta_U so."""
    theta = loaded_theta(reg, ea.Payload(MASS, tuple(COM), frame="panda_link5"))
    found = estimate_payload(reg, reg.theta_potential, theta, frame="panda_link5")
    assert found.mass == pytest.approx(MASS)
    assert found.misfit < 1e-9
    assert estimate_payload(reg, reg.theta_potential, theta, frame="panda_link2").misfit > 0.1


def test_no_load_weighs_nothing(reg):
    found = estimate_payload(reg, reg.theta_potential, reg.theta_potential, variance=1e-6)
    assert found.mass == 0
    assert np.isnan(found.com).all()
    assert 0 < found.mass_std < np.inf
    assert np.isinf(found.com_std).all()


def test_friction_columns_do_not_move_the_answer(loaded):
    reg = regressors("panda", joint_terms=("viscous", "coulomb"))
    found = estimate_payload(reg, reg.theta_potential, loaded)
    assert found.mass == pytest.approx(MASS)


def test_what_was_not_excited_does_not_count(reg, loaded, rng):
    """A wrong theta_U along an unexcited direction, after or before, leaves the estimate exact."""
    omega, j = rows(reg, rng), reg.n_potential
    bare = reg.theta_potential
    directions = np.linalg.qr(rng.normal(size=(j, 2)))[0].T
    blind = []
    for direction in directions:
        seen = omega.copy()
        seen[:, -j:] -= np.outer(seen[:, -j:] @ direction, direction)
        blind.append(information(seen))
    wrong_before, wrong_after = bare + 5 * directions[0], loaded - 3 * directions[1]
    full = information(omega)
    for before, after, weights in (
        (bare, wrong_after, (blind[1], None)),
        (bare, wrong_after, (blind[1], full)),
        (wrong_before, loaded, (full, blind[0])),
        (wrong_before, loaded, (None, blind[0])),
        (wrong_before, wrong_after, (blind[1], blind[0])),
    ):
        found = estimate_payload(reg, before, after, *weights)
        assert found.mass == pytest.approx(MASS, rel=1e-8)
        np.testing.assert_allclose(found.com, COM, atol=1e-8)
        assert abs(estimate_payload(reg, before, after).mass - MASS) > 0.01


def test_the_stated_uncertainty_is_that_of_repeated_trials(reg, loaded, rng):
    """Errors over their standard deviation are of order one, with noise before and after the load."""
    bare, j, sigma, trials = reg.theta, reg.n_potential, 0.05, 300
    with_load = np.r_[bare[:-j], loaded]
    factors = [np.linalg.qr(rows(reg, rng, count)) for count in (60, 90)]
    errors, squared = [], []
    for _ in range(trials):
        seen = []
        for theta, (q, r) in zip((bare, with_load), factors, strict=True):
            noise = sigma * rng.normal(size=len(q))
            t = r @ theta + q.T @ noise
            residual = np.linalg.norm(noise - q @ (q.T @ noise))
            triangle = np.block([[r, t[:, None]], [np.zeros(len(t)), residual]])
            seen.append((Information(triangle, 1e-3, 1.0), np.linalg.solve(r, t)[-j:]))
        (before, theta_before), (after, theta_after) = seen
        found = estimate_payload(reg, theta_before, theta_after, after, before, samples=90 * 7)
        errors.append([(found.mass - MASS) / found.mass_std, *((found.com - COM) / found.com_std)])
        off = found.parameters - [MASS, *(MASS * COM)]
        squared.append(off @ np.linalg.solve(found.covariance, off))
    np.testing.assert_allclose(np.std(errors, axis=0), 1, atol=0.17)  # 4 sigma of 300 trials
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.24)
    assert np.mean(squared) == pytest.approx(4, abs=0.66)  # chi-squared of 4


def test_what_gravity_cannot_tell_is_named():
    """A planar arm does not see the load's offset along its axes; nothing is made up for it."""
    reg = regressors("double_pendulum")
    theta = loaded_theta(reg, ea.Payload(MASS, tuple(COM)))
    found = estimate_payload(reg, reg.theta_potential, theta, variance=1e-6)
    assert found.unidentified == ("m cx",)
    assert found.mass == pytest.approx(MASS)
    np.testing.assert_allclose(found.com, [np.nan, *COM[1:]], atol=1e-9)
    assert np.isinf(found.com_std[0])
    assert np.isfinite(found.com_std[1:]).all()
    assert "not identified: m cx" in str(found)


def test_an_arm_without_gravity_weighs_nothing_and_says_so():
    reg = regressors("asr_twodof")
    found = estimate_payload(reg, reg.theta_potential, reg.theta_potential)
    assert found.unidentified == ("m", "m cx", "m cy", "m cz")
    assert np.isnan(found.mass)
    assert np.isinf(found.mass_std)


def test_a_resting_arm_tells_no_mass_of_an_unknown_place(reg, loaded):
    """One posture gives a torque, not four numbers: the mass is nan, the trace-free directions named."""
    robot = reg.robot
    static = np.zeros((7, len(reg)))
    static[:, -reg.n_potential :] = reg.gravity(robot.configuration(robot.home))
    padded = np.vstack([static, np.zeros((len(reg) + 1 - 7, len(reg)))])
    found = estimate_payload(reg, reg.theta_potential, loaded, information(padded), variance=1e-6)
    assert found.unidentified
    assert np.isnan(found.mass)
    assert np.isinf(found.mass_std)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"theta_before": np.zeros(3)}, ArgumentError, r"theta_before: expected shape \(12,\)"),
        ({"theta_after": np.full(12, np.nan)}, ArgumentError, "theta_after: expected finite"),
        ({"frame": "hand"}, UnknownNameError, "'hand'; legal names: .*panda_hand"),
        ({"frame": "panda_link0"}, ArgumentError, "frame: 'panda_link0' stands on the base"),
        ({"information": Information(np.eye(5), 1, 1)}, ArgumentError, r"information: .*\(44, 44\)"),
        ({"information_before": Information(np.eye(5), 1, 1)}, ArgumentError, "information_before: "),
        ({"information": Information(np.full((44, 44), np.nan), 1, 1)}, ArgumentError, "finite triangle"),
        ({"samples": 500}, ArgumentError, "samples: .*`information`"),
        ({"samples": 500, "variance": 1.0}, ArgumentError, "samples, variance: expected one"),
        ({"variance": -1.0}, ArgumentError, "variance: expected"),
        ({"information": Information(np.eye(44), 1, 1), "samples": 40}, ArgumentError, "samples: expected"),
    ],
)
def test_bad_arguments_are_named(options, error, said, reg):
    theta = {"theta_before": reg.theta_potential, "theta_after": reg.theta_potential}
    with pytest.raises(error, match=said):
        estimate_payload(reg, **{**theta, **options})
