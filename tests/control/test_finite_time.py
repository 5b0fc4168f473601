"""The finite-time PD law and its evaluations in sampled time."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.control.finite_time import semi_implicit_state
from eladapt.control.proximal import solve_scalar
from eladapt.errors import ArgumentError

H = 1e-3


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
        end = semi_implicit_state(law, e, v, mass, H)
        change, pull = mass @ (end.e2 - v), H * law.law(*end)
        assert np.abs(change - pull).max() <= 1e-9 * max(np.abs(change).max(), np.abs(mass @ v).max(), 1e-300)
        np.testing.assert_allclose(end.e1, e + H * end.e2, rtol=1e-9, atol=1e-300)


def settle(robot: ea.Robot, law: ea.FiniteTimePD, duration: float = 3.0, dt: float = H) -> ea.Record:
    """Regulation that starts from the true gravity: only the law is on trial."""
    derived = ea.CompositeController.for_robot(robot)
    controller = ea.CompositeController(
        derived.regressors,
        derived.regression,
        derived.extension,
        derived.mixing,
        ea.CompositeLaw(b=law.b),
        law,
    )
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    theta = derived.regressors.theta_potential
    return ea.simulate(controller, plant, goal, duration, dt, theta0=theta, progress=False)


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
