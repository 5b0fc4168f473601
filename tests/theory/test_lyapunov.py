"""The paper's Lyapunov functions: positive, and non-increasing where its conditions say so."""

import dataclasses
import functools

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt import paper
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.theory.gates import gates_along
from eladapt.theory.lyapunov import (
    NAMES,
    LyapunovFunctions,
    decay,
    dissipation,
    log_cosh,
    v_0,
    v_1,
)

OPEN = {"pole": 10.0, "linear_damping": 0.5, "d": 0.5}
FINE = 4e-4  # [s]
SHARP = 2.0  # d1 with D_L = 0.5 >= d1 M(q), where mu_M = 0.232; (530) would ask for 0.044


def composite(name: str = "C1", d1: float = SHARP) -> ea.CompositeController:
    controller = paper.controller(name, **OPEN)
    return dataclasses.replace(controller, law=dataclasses.replace(controller.law, d1=d1))


@functools.cache
def functions(name: str = "C1", d1: float = SHARP) -> LyapunovFunctions:
    return LyapunovFunctions(composite(name, d1))


@functools.cache
def run(name: str, d1: float, dt: float) -> ea.Record:
    """Case 1 by Runge-Kutta, until half a second before the arm arrives."""
    plant = ea.PinocchioPlant(paper.robot(), paper.START, substeps=1)
    goal = np.array(paper.GOAL)
    return ea.simulate(composite(name, d1), plant, goal, 1.8, dt, theta0="zero", progress=False)


def panda() -> ea.CompositeController:
    """Derived gains with the largest d1 that D_L >= d1 M(q) allows, about."""
    controller = ea.CompositeController.for_robot(load("panda"))
    return dataclasses.replace(controller, law=dataclasses.replace(controller.law, d1=0.5))


def states(controller, rng, count=400):
    """Random e1, e2, q and theta_error of sizes 1e-4 to 1e2."""
    robot, j = controller.robot, controller.regressors.n_potential
    e1, e2, error = (rng.normal(size=(count, n)) for n in (robot.nv, robot.nv, j))
    e2[: count // 2] = -e1[: count // 2]
    sizes = 10.0 ** rng.uniform(-4, 2, size=(3, count, 1))
    q = np.array([robot.random_configuration(rng) for _ in range(count)])
    return sizes[0] * e1, sizes[1] * e2, q, sizes[2] * error


@pytest.mark.parametrize("make", [composite, panda], ids=["two_link", "panda"])
def test_every_function_is_positive(make, rng):
    """At random states where D_L >= d1 M(q), with the largest d2 and d3 allowed, at little gamma4 too."""
    controller = make()
    V = LyapunovFunctions(controller)
    cross = LyapunovFunctions(controller, gamma4=1e-6, bounds=V.bounds)
    e1, e2, q, error = states(controller, rng)
    terms = V.terms(q, e2, error)
    for name in NAMES:
        assert np.all(V.value(name, e1, e2, error, terms) > 0), name
        assert np.all(cross.value(name, e1, e2, error, terms) > 0), name
        zero = np.zeros(controller.robot.nv)
        assert V(name, zero, zero, q[0], 0 * error[0]) == 0


def test_sharper_condition_is_where_v_nn1_turns_negative(rng):
    """V_nn1 (549) >= 0 at d1 = d_Lm / mu_M, and not at 1.1 times that."""
    spring = 1e-14  # what is left of V_1 without it, theta_error and gamma2 is V_nn1
    control = dataclasses.replace(composite().control, P=spring)
    robot, law = paper.robot(), ea.CompositeLaw(1.0, 0.0)
    limit = 0.5 / functions().bounds.mu_M
    e1 = np.linalg.eigh(robot.mass_matrix(np.zeros(2)))[1][:, -1] * 10.0 ** rng.uniform(-3, 1, size=(200, 1))
    q, error = np.zeros((200, 2)), np.zeros((200, 2))
    least = {}
    for factor in (1.0, 1.1):
        d1 = factor * limit
        e2 = -d1 * np.tanh(e1)  # the worst velocity
        terms = functions().terms(q, e2, error)
        scale = d1 * np.sum(0.5 * np.tanh(e1) ** 2, axis=-1)
        least[factor] = np.min(v_1(dataclasses.replace(law, d1=d1), control, e1, e2, error, terms) / scale)
    assert least[1.0] >= -1e-9
    assert least[1.1] < -0.01


def closed_loop(controller, e1, e2, q, error, zeta, h):
    """(476) for a time h from a state, by one explicit midpoint step; nothing of lyapunov.py is used."""
    law, control, robot = controller.law, controller.control, controller.robot

    def rates(e1, e2, q, error):
        psi, total = controller.regressors.gravity(q), law.gamma1 + law.gamma2
        acceleration = np.linalg.solve(
            robot.mass_matrix(q), control.law(e1, e2) - robot.coriolis_matrix(q, e2) @ e2 + psi @ error
        )
        direct = psi.T @ (law.gamma1 * law.d1 * np.tanh(e1) + total * e2)
        power = np.sign(error) * np.abs(error) ** law.b
        return e2, acceleration, e2, -law.Gamma * direct - total * law.Gamma * law.Upsilon * zeta * power

    half = rates(e1, e2, q, error)
    middle = rates(*(x + h / 2 * r for x, r in zip((e1, e2, q, error), half, strict=True)))
    return [x + h * r for x, r in zip((e1, e2, q, error), middle, strict=True)]


@pytest.mark.parametrize("name", ["V_0", "V_1", "V_A1", "V_FT"])
def test_rate_is_the_derivative_along_the_closed_loop(name, rng):
    """Central differences through (476) at random states, to a part in 1e5; d1 = 5, as typeset."""
    V, controller, h = functions("C1", 5.0), composite("C1", 5.0), 1e-6
    for _ in range(40):
        e1, e2, q, error = rng.normal(size=(4, 2))
        zeta = rng.uniform()
        ends = [closed_loop(controller, e1, e2, q, error, zeta, step) for step in (-h, h)]
        found = np.diff([V(name, *end) for end in ends])[0] / (2 * h)
        expected = V.rate(name, e1, e2, error, V.terms(q, e2, error), zeta)
        scale = abs(expected) + 1e-2 * V(name, e1, e2, q, error)
        assert abs(found - expected) < 1e-5 * scale


def test_typeset_v_has_the_wrong_sign_before_its_last_bracket(rng):
    """At rest away from the goal V_1 falls, so v(e) > 0; (defvtta) as typeset makes it rise."""
    controller, h = composite(), 1e-7
    law, control = controller.law, controller.control
    V, zero = functions(), np.zeros(2)
    for e1, q in zip(rng.normal(size=(20, 2)), rng.normal(size=(20, 2)), strict=True):
        ends = [closed_loop(controller, e1, zero, q, zero, 0.0, step) for step in (-h, h)]
        found = np.diff([V("V_1", *end) for end in ends])[0] / (2 * h)
        terms = V.terms(q, zero, zero)
        right = decay(law, control, e1, zero, terms)
        typeset = right - 2 * dissipation(law, control, e1, zero).sum()  # e2 = 0: the bracket alone
        assert found == pytest.approx(-(law.gamma1 + law.gamma2) * right, rel=1e-5)
        assert found < 0 < -(law.gamma1 + law.gamma2) * typeset


@pytest.mark.parametrize(("name", "d1", "dt"), [("C1", SHARP, FINE), ("C2", SHARP, FINE), ("C1", 5.0, 1e-3)])
def test_v_1_falls_along_case_1(name, d1, dt):
    """At every single step of C1 and C2 with D_L >= d1 M(q), and of C1 with the paper's own d1 = 5."""
    record, V = run(name, d1, dt), functions(name, d1)
    for function in ("V_1", "V_A1", "V_A2"):
        value = V.along(record, function)
        assert np.all(np.diff(value) < 0), function
        assert value[-1] < 1e-2 * value[0]
    assert np.all(V.rate_along(record, "V_1") < 0)


@pytest.mark.parametrize("name", ["C1", "C2"])
def test_rate_along_a_run_is_the_derivative_of_the_value(name):
    """Central differences of V_1 and V_FT agree with the right-hand side, but where the gates open.

    Torque and gates are held over a step of the run, so agreement is of first order in dt.
    """
    record, V = run(name, SHARP, FINE), functions(name)
    steady = np.abs(np.gradient(gates_along(composite(name), record), record.t))[1:-1] < 0.5
    for function in ("V_1", "V_FT"):
        value, rate = V.along(record, function), V.rate_along(record, function)[1:-1]
        found = (value[2:] - value[:-2]) / (2 * record.dt)
        difference = np.abs(found - rate)
        assert np.all(difference < 0.05 * np.abs(rate).max())
        assert np.quantile(difference[steady] / np.abs(rate[steady]), 0.95) < 0.01


@pytest.mark.parametrize("name", ["C1", "C2"])
def test_v_ft_obeys_dotvft_with_one_power_and_not_with_the_sum(name):
    """V_FT falls at every step, and -dV_FT/dt >= gamma3 c_3 zeta_1 V_FT^sigma_1 along the run with a c_3
    that stays above 10. With V^sigma_1 + V^sigma_2 as typeset, the largest c_3 shrinks with V_FT: it is
    attained at the run's end, nearest the goal, so that none is left at the goal itself."""
    record, V = run(name, SHARP, FINE), functions(name)
    value, rate, zeta = (
        V.along(record, "V_FT"),
        V.rate_along(record, "V_FT"),
        gates_along(composite(name), record),
    )
    assert np.all(np.diff(value) < 0)
    assert np.all(rate < 0)
    with np.errstate(divide="ignore"):
        per_gate = -rate / (V.gamma3 * zeta)
    s1, s2 = V.weights.sigma_1, V.weights.sigma_2
    assert s2 < s1 < 1
    single, typeset = per_gate / value**s1, per_gate / (value**s1 + value**s2)
    assert single.min() > 10
    near = value < 1
    assert typeset.argmin() == len(record.t) - 1
    slope = np.polyfit(np.log(value[near]), np.log(typeset[near]), 1)[0]
    assert slope > 0.5 * (s1 - s2)


@pytest.mark.parametrize("scope", ["all", "potential"])
@pytest.mark.parametrize("extension", [ea.LeastSquares(10.0, 10.0, 10.0, 1.0), ea.Kreisselmeier(1.0, 1.3)])
def test_v_1_stays_below_its_bound_without_mixing(extension, scope):
    """dV_1/dt <= -(gamma1 + gamma2) [v(e) + Upsilon g |theta_error|^(1 + b)] along C1 and C2 unmixed, by
    central differences where the gate is steady, and V_1 falls at every step."""
    controller = dataclasses.replace(composite(), extension=extension, mixing=ea.Unmixed(scope))
    plant, goal = ea.PinocchioPlant(paper.robot(), paper.START, substeps=1), np.array(paper.GOAL)
    record = ea.simulate(controller, plant, goal, 1.8, FINE, theta0="zero", progress=False)
    V = LyapunovFunctions(controller)
    value, bound = V.along(record), V.rate_along(record)[1:-1]
    assert np.all(np.diff(value) < 0)
    found = (value[2:] - value[:-2]) / (2 * FINE)
    # Torque is held over a step and the law's implicit, so the two agree to first order in dt.
    assert np.all(found <= bound + 0.02 * np.abs(found).max())


def test_kinetic_part_is_the_robots_energy(rng):
    """V_0 at e1 = 0 is the kinetic energy, and its spring is the integral of P |e1|^a."""
    V, control, robot = functions(), composite().control, paper.robot()
    q, v, zero = rng.normal(size=2), rng.normal(size=2), np.zeros(2)
    assert V("V_0", zero, v, q, zero) == pytest.approx(robot.kinetic_energy(q, v))
    e1 = np.array([0.3, -2.0])
    spring = v_0(control, e1, zero, V.terms(q, zero, zero))
    assert spring == pytest.approx(sum(3 * abs(x) ** (4 / 3) * 3 / 4 for x in e1))


def test_log_cosh_is_accurate_near_and_far():
    """x^2/2 near 0 and |x| - ln 2 far away, to rounding, and continuous where they meet."""
    x = np.array([1e-12, 1e-4, 0.5, 1 - 1e-12, 1.0, 20.0, 1e4])
    expected = [5e-25, 5e-9, np.log(np.cosh(0.5)), np.log(np.cosh(1)), np.log(np.cosh(1)), 20 - np.log(2), 0]
    np.testing.assert_allclose(log_cosh(x)[:-1], expected[:-1], rtol=1e-8)
    assert log_cosh(np.array(-1e4)) == 1e4 - np.log(2)


def test_v_a1_is_not_a_number_where_v_1_is_negative():
    """A d1 far above its limit makes V_1 negative, and powers of it meaningless."""
    controller = composite(d1=1e4)
    V = LyapunovFunctions(controller)
    e1, zero = np.array([1.0, 1.0]), np.zeros(2)
    e2 = np.linalg.solve(controller.robot.mass_matrix(zero), -np.array([1.0, 1.0]))
    assert V("V_1", e1, e2, zero, zero) < 0
    assert np.isnan(V("V_A1", e1, e2, zero, zero))


def test_wrong_arguments_are_refused():
    controller = composite()
    controller = dataclasses.replace(controller, law=dataclasses.replace(controller.law, gamma1=0.0))
    with pytest.raises(ArgumentError, match=r"law\.gamma1: expected a positive"):
        LyapunovFunctions(controller)
    with pytest.raises(ArgumentError, match="gamma3"):
        LyapunovFunctions(composite(), gamma3=0.0)
    with pytest.raises(ArgumentError, match="d2"):
        LyapunovFunctions(composite(), d2=-1.0)
    with pytest.raises(ArgumentError, match="controller: expected a CompositeController"):
        LyapunovFunctions(paper.robot())
    with pytest.raises(ArgumentError, match="robot: expected one with the 2 joints"):
        LyapunovFunctions(composite(), robot=load("panda"))
    with pytest.raises(UnknownNameError, match=r"V_2.*legal names: V_0"):
        functions()("V_2", *np.zeros((4, 2)))
