"""The finite-time PD law and its evaluations in sampled time."""

import functools
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import load

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.control.finite_time import semi_implicit_solution
from eladapt.control.proximal import ITERATIONS, Solution, solve_scalar
from eladapt.errors import ArgumentError

H = 1e-3


class PredictedState(NamedTuple):
    """Where a horizon of feedback leads."""

    e1: np.ndarray  # (nv,) position error
    e2: np.ndarray  # (nv,) velocity


def predicted(*problem: Any) -> PredictedState:
    """(e1 + H w, w) of `semi_implicit_solution`."""
    solution = semi_implicit_solution(*problem)
    return PredictedState(solution.e1, solution.w)


def test_law_is_the_typeset_one():
    """-P|e1|^a - D|e2|^b - D_L e2 with a = 1/3, b = 1/2 for r1 = 1.5, r2 = 1 (278), (ExponeHom)."""
    law = ea.FiniteTimePD([3.0, 2.0], 2.0, 0.5)
    assert (law.a, law.b) == (pytest.approx(1 / 3), pytest.approx(1 / 2))
    np.testing.assert_allclose(
        law.law(np.array([8e-3, -1.0]), np.array([0.25, -4.0])),
        [-3 * 0.2 - 2 * 0.5 - 0.5 * 0.25, 2 + 2 * 2 + 0.5 * 4],
    )


def test_scalar_problem_is_solved_everywhere(rng):
    """The root satisfies its equation to rounding over 24 decades, kinks and coinciding kinks included."""
    for k in range(3000):
        u, s = rng.normal(size=2) * 10.0 ** rng.uniform(-12, 3, size=2)
        s *= k % 7 != 0
        spring, damper = 10.0 ** rng.uniform(-5, 3, size=2)
        linear = rng.uniform(1, 3)
        root = solve_scalar(u, s, spring, damper, linear, 1 / 3, 1 / 2)
        parts = [
            linear * root.w,
            spring * np.sign(root.x) * abs(root.x) ** (1 / 3),
            damper * np.sign(root.w) * abs(root.w) ** 0.5,
            -u,
        ]
        assert abs(sum(parts)) <= 1e-13 * max(map(abs, parts))
        assert abs(root.w + s - root.x) <= 1e-13 * max(abs(root.w), abs(s))
        assert 0 <= root.slope <= 1 / linear


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5"])
@pytest.mark.parametrize("linear", [False, True], ids=["finite-time", "linear"])
def test_semi_implicit_state_solves_the_implicit_equation(name, linear, rng):
    """M (w - v) = H law(e + H w, w) from large motions down to rest, in random postures."""
    robot = load(name)
    gains = ea.CompositeController.for_robot(robot).control
    law = ea.FiniteTimePD(gains.P, gains.D, gains.D_L, linear=linear)
    for k in range(300):
        mass = robot.mass_matrix(robot.random_configuration(rng))
        e, v = rng.normal(size=(2, robot.nv)) * 10.0 ** rng.uniform(-12, 1, size=(2, 1))
        e, v = e * (k % 5 != 0), v * (k % 7 != 0)
        end = predicted(law, e, v, mass, H)
        change, pull = mass @ (end.e2 - v), H * law.law(*end)
        assert np.abs(change - pull).max() <= 1e-9 * max(np.abs(change).max(), np.abs(mass @ v).max(), 1e-300)
        np.testing.assert_allclose(end.e1, e + H * end.e2, rtol=1e-9, atol=1e-300)


def settle(robot: ea.Robot, law: ea.FiniteTimePD, duration: float = 3.0, dt: float = H) -> ea.Record:
    """Regulation with the true gravity: only the law is on trial."""
    controller = KnownGravityPD(robot, law)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return ea.simulate(controller, plant, robot.configuration(robot.target), duration, dt, progress=False)


def test_semi_implicit_evaluation_does_not_chatter():
    """On the panda at 1 kHz: explicit evaluation chatters by newton metres, semi-implicit by rounding."""
    robot = load("panda")
    gains = ea.CompositeController.for_robot(robot).control
    ripple = {}
    for evaluation in ("explicit", "semi_implicit"):
        law = ea.FiniteTimePD(gains.P, gains.D, gains.D_L, evaluation=evaluation)
        metrics = settle(robot, law, 4.0).metrics()
        ripple[evaluation] = metrics.chatter
        assert metrics.settling_time < 2.5
    assert ripple["explicit"] > 1
    assert ripple["semi_implicit"] < 1e-6


@pytest.mark.parametrize("evaluation", ["slope_limited", "semi_implicit"])
def test_two_joints_settle_without_chatter(evaluation):
    """Both cures suit a small arm."""
    robot = load("two_link")
    metrics = settle(robot, ea.FiniteTimePD(3.0, 2.0, 0.1, evaluation=evaluation), 5.0, 5e-4).metrics()
    assert metrics.settling_time < 4
    assert metrics.chatter < 1e-6


def test_arrival_takes_finite_time():
    """The error falls to rounding, where the linear law of the same gains is still on its way."""
    robot = load("two_link")
    finite = settle(robot, ea.FiniteTimePD(3.0, 2.0, 0.1), 5.0)
    linear = settle(robot, ea.FiniteTimePD(3.0, 2.0, 0.1, linear=True), 5.0)
    assert np.abs(finite.error[-1]).max() < 1e-12
    assert np.abs(linear.error[-1]).max() > 1e-5


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"P": -1}, "P: expected positive"), ({"P": [1, 0]}, "P: expected positive"),
        ({"P": np.ones((2, 2))}, "P: expected a diagonal"), ({"D": np.nan}, "D: expected positive"),
        ({"D_L": -0.1}, "D_L: expected non-negative"), ({"r1": 1.0}, r"2 r2 > r1 > r2.*ExponeHom"),
        ({"r1": 2.0}, "2 r2 > r1"), ({"r2": -1}, "r2"), ({"evaluation": "magic"}, "evaluation"),
        ({"horizon": 0}, "horizon"), ({"P": "stiff"}, "P: expected a number"),
    ],
)  # fmt: skip
def test_gains_outside_their_range_are_refused(options, said):
    with pytest.raises(ArgumentError, match=said):
        ea.FiniteTimePD(**{"P": 3.0, "D": 2.0, **options})


class Problem(NamedTuple):
    """One evaluation of the semi-implicit law."""

    law: ea.FiniteTimePD
    e1: np.ndarray
    e2: np.ndarray
    mass: np.ndarray
    horizon: float


def inertia(name: str, seed: int) -> np.ndarray:
    robot = load(name)
    return robot.mass_matrix(robot.random_configuration(np.random.default_rng(seed)))


@functools.cache
def derived_law(name: str) -> ea.FiniteTimePD:
    gains = ea.CompositeController.for_robot(load(name)).control
    return ea.FiniteTimePD(gains.P, gains.D, gains.D_L)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda x: 10.0**x)


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """States and gains over 24 decades, joints at their kinks, horizons from a microsecond to a second."""
    name = draw(st.sampled_from(["two_link", "ur5", "panda", "xarm7", "talos_left_arm"]))
    mass = inertia(name, draw(st.integers(0, 500)))
    n = len(mass)
    signs = st.sampled_from([-1.0, 0.0, 1.0])

    def vector(low: float, high: float) -> np.ndarray:
        """A common size, and each joint within two decades of it, or zero."""
        size = draw(st.floats(low, high))
        spread = [draw(signs) * 10.0 ** (size + draw(st.floats(-2, 0))) for _ in range(n)]
        return np.array(spread)

    D = abs(vector(-8, 6)) + 1e-10
    law = ea.FiniteTimePD(abs(vector(-8, 6)) + 1e-10, D, draw(st.sampled_from([0.0, 0.1])) * D)
    return Problem(law, vector(-20, 4), vector(-20, 4), mass, draw(decades(-6, 0)))


def momenta(problem: Problem, end: PredictedState) -> tuple[np.ndarray, float]:
    """M (w - v) - H law(e + H w, w) by joint, and the size of its terms, in units of sqrt(M_ii) v."""
    law, _, e2, mass, horizon = problem
    root = np.sqrt(np.diag(mass))
    parts = horizon * law.P * np.abs(end.e1) ** law.a + horizon * law.D * np.abs(end.e2) ** law.b
    size = root * np.abs(end.e2) + root * np.abs(e2) + parts / root
    return (mass @ (end.e2 - e2) - horizon * law.law(*end)) / root, float(np.linalg.norm(size))


def check(problem: Problem, end: PredictedState) -> None:
    """The equation holds to 1e-10 of its terms, and the state is the one that w leads to."""
    missing, size = momenta(problem, end)
    assert np.isfinite(end).all()
    assert np.linalg.norm(missing) <= 1e-10 * size
    moved = np.abs(problem.e1) + np.abs(problem.horizon * end.e2)
    assert np.all(np.abs(problem.e1 + problem.horizon * end.e2 - end.e1) <= 1e-14 * moved)


def solve(problem: Problem, cap: int = ITERATIONS) -> tuple[PredictedState, Solution]:
    """The predicted state, and what it took to find it."""
    solution = semi_implicit_solution(*problem, cap)
    return PredictedState(solution.e1, solution.w), solution


@settings(max_examples=400, deadline=None)
@given(problems())
def test_the_convex_problem_is_solved_to_1e_10(problem):
    """Whatever the gains, the state and the horizon, with at most half of the evaluations allowed."""
    end, solution = solve(problem)
    check(problem, end)
    assert 0 < solution.evaluations <= ITERATIONS // 2, "12 at most in 6,000 random problems"


def test_six_evaluations_are_typical(rng):
    """With derived gains, from 1e-20 to 1e2 rad and rad/s, horizons of 0.1 to 30 ms: 99 % take no more."""
    taken = []
    for k in range(1000):
        name = ("two_link", "ur5", "panda", "xarm7", "talos_left_arm")[k % 5]
        mass, law = inertia(name, k), derived_law(name)
        e = 10.0 ** (rng.uniform(-20, 2, size=(2, 1)) + rng.uniform(-2, 0, size=(2, len(mass))))
        e *= rng.choice([-1, 0, 1], p=[0.45, 0.1, 0.45], size=e.shape)
        problem = Problem(law, *e, mass, 10.0 ** rng.uniform(-4, -1.5))
        end, solution = solve(problem)
        check(problem, end)
        taken.append(solution.evaluations)
    assert np.quantile(taken, 0.99) <= 6
    assert np.median(taken) <= 4
    assert max(taken) <= 12


def test_a_horizon_of_each_joint_keeps_the_problem_symmetric(rng):
    """H^-1/2 M H^-1/2 (w - v) = law(e + H w, w): heavy joints look further ahead than light ones."""
    for k in range(100):
        mass, law = inertia("panda", k), derived_law("panda")
        horizon = 10.0 ** rng.uniform(-3.5, -1.5, size=7)
        e, v = rng.normal(size=(2, 7)) * 10.0 ** rng.uniform(-8, 0, size=(2, 1))
        end = predicted(law, e, v, mass, horizon)
        root = np.sqrt(horizon)
        change, pull = (mass / np.outer(root, root)) @ (end.e2 - v), law.law(*end)
        # 1e-9: the solver stops at 1e-11 of the momenta that the start involves
        size = np.abs(mass / np.outer(root, root)) @ (np.abs(v) + np.abs(end.e2))
        assert np.abs(change - pull).max() <= 1e-9 * size.max() + 1e-300
        np.testing.assert_allclose(end.e1, e + horizon * end.e2, rtol=1e-9, atol=1e-300)


@settings(max_examples=100, deadline=None)
@given(problems())
def test_an_evaluation_that_is_cut_short_is_still_the_law(problem):
    """The torque is the law's at the state returned, which is one that w leads to; every further evaluation
    leaves no larger a part of the momentum equation missing."""
    law, horizon = problem.law, problem.horizon
    before = np.inf
    for cap in (1, 2, 3, 6):
        end, (*_, torque, evaluations, _) = solve(problem, cap)
        assert evaluations <= cap
        assert np.isfinite(torque).all()
        largest = law.P * np.abs(end.e1) ** law.a + law.D * np.abs(end.e2) ** law.b + law.D_L * np.abs(end.e2)
        assert np.all(np.abs(torque - law.law(*end)) <= 1e-12 * largest)
        assert np.all(np.abs(torque) <= (1 + 1e-14) * largest), "powers differ in their last digit"
        moved = np.abs(problem.e1) + np.abs(horizon * end.e2)
        assert np.all(np.abs(problem.e1 + horizon * end.e2 - end.e1) <= 1e-14 * moved)
        missing, size = momenta(problem, end)
        assert np.linalg.norm(missing) <= before + 1e-12 * size
        before = np.linalg.norm(missing)


@pytest.mark.parametrize("where", ["e1", "e2", "M"])
def test_nan_in_is_nan_out(where):
    """Feedback that cannot be computed is not zero feedback."""
    given = {"e1": np.array([0.1, 0.2]), "e2": np.zeros(2), "M": np.eye(2)}
    given[where].flat[0] = np.nan
    tau = ea.FiniteTimePD(1.0, 1.0).torque(given["e1"], given["e2"], given["M"], 1e-3)
    assert np.isnan(tau).all()
