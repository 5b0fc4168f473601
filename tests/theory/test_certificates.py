"""The paper's conditions, model bounds and settling-time bounds."""

import dataclasses
import functools
import re

import numpy as np
import pytest
from shared import load, regressors

import eladapt as ea
from eladapt import paper
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.theory.bounds import model_bounds
from eladapt.theory.certificates import certify
from eladapt.theory.gates import gate_integral, gates_along, interval_excitation, window_excitation
from eladapt.theory.lyapunov import LyapunovFunctions
from eladapt.theory.settling import alpha_2, decay_constant, settling_bounds

OPEN = {"pole": 10.0, "linear_damping": 0.5, "d": 0.5}
DT = 5e-4
DELTA = (0.49 / 3, 0.03, 0.04 / 3, 0.981, 5.886)


def composite(d1: float = 5.0, **control) -> ea.CompositeController:
    """C1 with another d1, or other gains of the control law."""
    c1 = paper.controller("C1", **OPEN)
    pd = dataclasses.replace(c1.control, **control)
    law = dataclasses.replace(c1.law, d1=d1, b=pd.b)
    return dataclasses.replace(c1, law=law, control=pd)


@functools.cache
def bounds():
    return model_bounds(composite().regressors)


@functools.cache
def run() -> ea.Record:
    controller = composite(2.0)
    plant = ea.PinocchioPlant(controller.robot, paper.START, substeps=1)
    return ea.simulate(controller, plant, np.array(paper.GOAL), 3.0, 2e-3, theta0="zero", progress=False)


def test_bounds_of_the_papers_arm_are_its_closed_forms():
    """The stretched arm has both extreme eigenvalues of M; |g| is largest where both sines are 1."""
    d1, d2, d3, d4, d5 = DELTA
    trace, determinant = d1 + d3 + 2 * d2, d1 * d3 - d3**2 - d2**2
    root = np.sqrt(trace**2 - 4 * determinant)
    assert bounds().mu_M == pytest.approx((trace + root) / 2, rel=1e-9)
    assert bounds().mu_m == pytest.approx((trace - root) / 2, rel=1e-9)
    np.testing.assert_allclose(bounds().k_g, [d4 + d5, d4], rtol=1e-9)
    assert bounds().k_Psi == pytest.approx((1 + np.sqrt(5)) / 2, rel=1e-9)  # Psi = [[1, 1], [1, 0]]
    angles = np.linspace(0, np.pi, 2001)
    c, s = d2 * np.cos(angles), d2 * np.sin(angles)  # sin q_2 = 1
    matrices = np.array([[-s, -(c + s)], [c, 0 * c]]).transpose(2, 0, 1)
    assert bounds().L_c == pytest.approx(np.linalg.norm(matrices, 2, axis=(1, 2)).max(), rel=1e-6)


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_no_further_sample_exceeds_the_refined_bounds(name, rng):
    """300 other postures: none is outside, for limits and for continuous joints."""
    robot, reg = load(name), regressors(name)
    found = model_bounds(reg, samples=200)
    for _ in range(300):
        q, v = robot.random_configuration(rng), rng.normal(size=robot.nv)
        eigenvalues = np.linalg.eigvalsh(robot.mass_matrix(q))
        assert found.mu_m <= eigenvalues[0]
        assert eigenvalues[-1] <= found.mu_M * (1 + 1e-9)
        assert np.linalg.norm(robot.coriolis_matrix(q, v), 2) <= found.L_c * np.linalg.norm(v)
        assert np.linalg.norm(reg.gravity(q), 2) <= found.k_Psi
        assert np.all(np.abs(robot.gravity(q)) <= found.k_g * (1 + 1e-9) + 1e-9)


def test_the_papers_gains_break_its_conditions_though_not_the_function():
    """d1 = 5 with D_L = 0.5: (530), D_L >= d1 M and both parts of (602) fail, by the figures of the
    closed forms; V_1 and v(e) themselves are positive in every sample."""
    certificate = certify(composite(), dt=DT)
    d_Lm, mu_m, mu_M, root = 0.5, bounds().mu_m, bounds().mu_M, np.sqrt(2)
    assert certificate["(530)"].limit == pytest.approx(d_Lm * mu_m / mu_M**2)
    assert certificate["d_Lm / mu_M"].limit == pytest.approx(d_Lm / mu_M)
    assert certificate["D_L >= d1 M(q)"].value == pytest.approx(5 * mu_M / d_Lm, rel=1e-6)
    assert certificate["inertia bound"].limit == pytest.approx(d_Lm / (10 * (mu_M + root * bounds().L_c)))
    cross = 2 * 2 ** (1 / 4) * 2 ** ((1 / 2 - 1 / 3) / 3)  # A_0 n^((b - a)/(2 (1 + b))), nu_2 = 1/3
    assert certificate["friction bound"].limit == pytest.approx((9 / (4 * cross)) ** 2 * 0.6 / cross)
    held = {row.name: row.holds for row in certificate}
    for label in ("(530)", "d_Lm / mu_M", "D_L >= d1 M(q)", "friction bound", "inertia bound"):
        assert not certificate[label].holds, held
    for label in ("(660b)", "(d4value)", "(SLFV1)", "(defvtta)", "max D_L dt", "lambda_max"):
        assert certificate[label].holds, held


def test_weights_of_the_cross_terms_have_the_corrected_limits():
    """(660b) with k_Psi^(2 r_1/r_2), (d4value) with [3 r_1 p_m/(4 r_2)]^2; a larger one does not hold."""
    certificate = certify(composite(), samples=4)
    mu_m, mu_M, _, k_Psi, _ = bounds()
    d2 = np.sqrt(0.7 * mu_m * 4 / (2 * (k_Psi**3 * mu_M) ** 2) * (4 / 6) ** 3)
    d3 = np.sqrt(0.7**3 * 1.5 * mu_m / mu_M**2) * 3 * 1.5 * 3 / 4
    assert certificate["(660b)"].limit == pytest.approx(d2)
    assert certificate["(d4value)"].limit == pytest.approx(d3)
    above = certify(composite(), samples=4, d2=1.01 * d2, d3=0.99 * d3)
    assert not above["(660b)"].holds
    assert above["(d4value)"].holds


def test_less_d1_meets_the_sharper_condition_and_530_asks_for_d_l_that_sampling_forbids():
    """d1 = 2 holds but for (530); (530) at d1 = 5 takes D_L = 56.8, which Euler at 5e-4 s cannot hold."""
    certificate = certify(composite(2.0), dt=DT)
    assert [row.name for row in certificate if not row.holds] == [certificate["(530)"].name]
    certificate = certify(composite(D_L=56.8, evaluation="explicit"), dt=DT)
    assert certificate["(530)"].holds
    assert not certificate["max D_L dt"].holds
    assert not certificate["lambda_max"].holds
    assert "chatters" in certificate["lambda_max"].note


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_what_is_said_of_d1_and_d_l_is_enough_and_no_more_than_needed(name):
    """With a d1 below the one that the text gives a condition holds and with one above it none, and so with
    D_L: to the text's three digits."""
    controller = ea.CompositeController.for_robot(load(name))
    said = str(certify(controller, samples=4))
    d1, times = map(float, re.search(r"at most (\S+), or D_L (\S+) times larger", said).groups())
    for share in (0.99, 1.01):
        law = dataclasses.replace(controller.law, d1=share * d1)
        control = dataclasses.replace(controller.control, D_L=times / share * controller.control.D_L)
        for changed in ({"law": law}, {"control": control}):
            text = str(certify(dataclasses.replace(controller, **changed), samples=4))
            assert ("Stability:" in text) == (share > 1)


def test_without_damping_in_a_joint_no_d1_will_do():
    said = str(certify(composite(D_L=np.array([0.5, 0.0])), samples=4))
    assert "d1 would have to be at most 0, or D_L more than 0 in every joint." in said


def test_large_d1_is_caught_by_the_samples():
    """d1 = 40 makes V_1 and v(e) negative, and the note says from which speed on."""
    certificate = certify(composite(40.0))
    for label in ("(SLFV1)", "(defvtta)"):
        assert not certificate[label].holds
        assert "not positive from ||e2||" in certificate[label].note


def test_sampling_limit_knows_the_evaluation():
    """Semi-implicit: dt/H at most, whatever the gains; linear explicit: (D + D_L) dt / mu_m. A lighter
    robot than the nominal one is faster."""
    horizon = certify(composite(horizon=2 * DT), dt=DT, samples=20)["lambda_max"]
    assert horizon.value == pytest.approx(0.5)
    linear = certify(composite(linear=True, evaluation="explicit"), dt=DT)["lambda_max"]
    assert linear.value == pytest.approx(2.5 * DT / bounds().mu_m, rel=1e-6)
    limited = certify(composite(evaluation="slope_limited", D_L=0.0), dt=DT)["lambda_max"]
    assert 0 < limited.value < 1
    robot = paper.robot()
    heavy = ea.Robot.from_urdf(robot.path, armature={"shoulder": 0.05, "elbow": 0.05})
    nominal = ea.CompositeController.for_robot(heavy)
    assert not certify(nominal, robot, dt=DT, samples=20)["lambda_max"].holds
    assert certify(nominal, heavy, dt=DT, samples=20)["lambda_max"].holds


def test_table_is_aligned_and_names_its_columns():
    """One line a condition, every bar under the one above it, and a row is found by its label."""
    certificate = certify(paper.controller("C1", **OPEN, typeset=True), samples=4)
    lines = str(certificate).splitlines()
    assert "TypesetComposite on two_link" in lines[0]
    assert "no proofs" in lines[1]
    assert [cell.strip() for cell in lines[2].split("|")] == ["condition", "value", "limit", "holds"]
    table = [lines[2], *lines[4 : 4 + len(certificate)]]
    assert len({tuple(k for k, letter in enumerate(line) if letter == "|") for line in table}) == 1
    with pytest.raises(UnknownNameError, match=r"\(999\).*\(530\)"):
        certificate["(999)"]


def test_interval_excitation_is_the_smallest_eigenvalue_of_the_integral(rng):
    """(502) against the sum itself, and the least duration for half of it."""
    regressions = [ea.Regression(np.zeros(2), rng.normal(size=(2, 5))) for _ in range(50)]
    sums = np.cumsum([r.omega.T @ r.omega * 0.01 for r in regressions], axis=0)
    level = [np.linalg.eigvalsh(matrix)[0] for matrix in sums]
    whole = interval_excitation(regressions, 0.01)
    assert whole.holds
    assert whole.mu == pytest.approx(level[-1])
    half = interval_excitation(regressions, 0.01, mu=level[-1] / 2)
    assert half.duration == pytest.approx(0.01 * (1 + np.argmax(np.array(level) >= level[-1] / 2)))
    assert interval_excitation(regressions, 0.01, mu=2 * level[-1]).duration == np.inf
    poor = [ea.Regression(np.zeros(1), np.array([[1.0, 2.0]]))] * 9
    assert not interval_excitation(poor, 0.01).holds


def test_window_excitation_holds_for_every_window_and_not_for_more():
    """(IELSDREM) against every window of the run; no other ell up to half the run has a larger w/ell."""
    record, gate = run(), gates_along(composite(2.0), run())
    integral = gate_integral(record.t, gate)
    best = window_excitation(record.t, gate)
    for ell in (0.5, 1.0, best.ell):
        found, n = window_excitation(record.t, gate, ell), round(ell / record.dt)
        least = min(integral[k + n] - integral[k] for k in range(len(integral) - n))
        assert found.w == pytest.approx(least)
        assert found.w / found.ell <= best.w / best.ell * (1 + 1e-12)
    assert window_excitation(record.t, 0 * gate).w == 0


def test_settling_bounds_are_bounds_and_follow_their_formulas():
    """(Tf1) and T_0 of prop:UFT-IE from the same c_3; both are far above the time that the run took."""
    record, V = run(), LyapunovFunctions(composite(2.0), bounds=bounds())
    found = settling_bounds(V, record)
    r1, r2 = V.weights
    share = (r1 - r2) / (3 * r2)
    assert found.level == pytest.approx(V.along(record, "V_FT")[0])
    assert found.needed == pytest.approx(found.level**share / (share * V.gamma3 * found.c_3))
    ell, w = found.window
    phi = 3 * r2 * found.level**share
    assert found.short_ft == pytest.approx(ell + 2 * ell / w * phi / ((r1 - r2) * V.gamma3 * found.c_3))
    assert found.interval == pytest.approx(found.t_ie + found.needed / found.phi_m)
    gate = gates_along(composite(2.0), record)
    assert gate[record.t >= found.t_ie].min() == pytest.approx(found.phi_m)
    assert found.measured == np.inf, "three seconds of gates below 1 are no proof yet"
    assert record.settling_time(1e-3) < min(found.short_ft, found.interval)


@pytest.mark.parametrize(
    "mixing",
    [ea.Unmixed("all"), ea.Unmixed("potential"), ea.Determinant("all"), ea.SmallestEigenvalue("potential")],
    ids=str,
)
def test_parameters_alone_are_there_by_their_bound(mixing):
    """theta_error is 0 to rounding from then on, with the indirect term alone: |theta_error(0)|^(1 - b) over
    (1 - b) rate, in units of the gate's integral."""
    whole = composite(2.0)
    law = dataclasses.replace(whole.law, direct=False)
    controller = dataclasses.replace(whole, law=law, mixing=mixing)
    plant = ea.PinocchioPlant(controller.robot, paper.START, substeps=1)
    record = ea.simulate(controller, plant, np.array(paper.GOAL), 3.0, 2e-3, theta0="zero", progress=False)
    V = LyapunovFunctions(controller, bounds=bounds())
    found = settling_bounds(V, record, samples=2)
    assert found.parameters < 2.0
    error = np.linalg.norm(V.estimation_error(record), axis=1)
    # What linear interpolation of the velocity leaves of y = Omega theta at 2 ms.
    assert error[record.t >= found.parameters].max() < 1e-4 * error[0]


def test_c_3_holds_along_the_run_and_alpha_2_bounds_v_ft():
    """-dV_FT/dt >= gamma3 c_3 zeta_1 V_FT^sigma_1 at every sample, though c_3 knows nothing of the run."""
    record, V = run(), LyapunovFunctions(composite(2.0), bounds=bounds())
    value, rate = V.along(record, "V_FT"), V.rate_along(record, "V_FT")
    c_3 = decay_constant(V, value[0])
    assert c_3 > 0
    assert np.all(-rate >= V.gamma3 * c_3 * gates_along(composite(2.0), record) * value**V.weights.sigma_1)
    states = np.hstack([record.error, record.v, record.theta_error])
    radius = np.linalg.norm(states, axis=1)
    for k in (0, 300, 600):
        assert value[k] <= alpha_2(V, radius[k])


def test_no_bound_without_excitation_or_finite_time():
    """inf where the gates stay shut, and for a = b = 1."""
    record, V = run(), LyapunovFunctions(composite(2.0), bounds=bounds())
    idle = dataclasses.replace(record, zeta=np.zeros((len(record), 1)))
    found = settling_bounds(V, idle, samples=8)
    assert found.short_ft == found.interval == found.measured == found.parameters == np.inf
    linear = LyapunovFunctions(composite(2.0, linear=True), bounds=bounds())
    assert settling_bounds(linear, record, samples=8).needed == np.inf


def test_wrong_arguments_are_refused():
    with pytest.raises(ArgumentError, match="controller: expected a CompositeController"):
        certify(paper.robot())
    with pytest.raises(ArgumentError, match="dt: expected a finite number"):
        certify(composite(), dt=0.0, samples=1)
    with pytest.raises(ArgumentError, match="d2"):
        certify(composite(), d2=-1.0, samples=1)
    with pytest.raises(ArgumentError, match="samples: expected a whole number"):
        model_bounds(paper.robot(), samples=0)
    with pytest.raises(ArgumentError, match="model: expected a Robot or Regressors"):
        model_bounds("panda")
    with pytest.raises(ArgumentError, match="robot: expected one with the 2 joints"):
        certify(composite(), load("panda"))
    with pytest.raises(ArgumentError, match="ell: expected a finite number"):
        window_excitation(run().t, np.ones(len(run())), 5.0)
    with pytest.raises(ArgumentError, match="regressions: expected at least one"):
        interval_excitation([], 0.1)
