"""The controllers that the composite one is compared with."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD, adaptive_pd, indirect
from eladapt.comparison.slotine_li import SlotineLi
from eladapt.comparison.terminal_sliding import AdaptationGain, TerminalSliding
from eladapt.errors import ArgumentError
from eladapt.paper.proofs import slotine_li_lyapunov


def move(controller, duration: float, dt: float = 1e-3) -> ea.Record:
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, plant, goal, duration, dt, theta0="zero", progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_slotine_li_regulates_larger_arms(name):
    """From theta = 0: below 1e-3 rad, and still falling by decades, which is asymptotic."""
    record = move(SlotineLi.for_robot(load(name)), 6.0)
    assert record.settling_time(1e-3) < 5
    errors = np.abs(record.error[[3000, 4000, 5000, 6000]]).max(axis=1)
    assert np.all(np.diff(np.log10(errors)) < -0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_terminal_sliding_regulates_larger_arms(name):
    """From theta = 0: within 0.01 rad, with the chatter that its discontinuities cost."""
    record = move(TerminalSliding.for_robot(load(name)), 8.0)
    assert record.settling_time(1e-2) < 7
    assert record.metrics().chatter > 0.1


def test_c4_needs_the_weight_of_its_proof():
    """V' = -s'K1 s - (w - alpha/2) |Omega theta~|^2 - ... : V falls with w = alpha, not with w = 1.

    Explicit Euler of theta at 1e-4 s may lift V by a relative 1e-6 a step.
    """
    falling = slotine_li_lyapunov(weight=10.0)
    assert np.all(np.diff(falling) <= 1e-6 * falling[:-1])
    assert falling[-1] < 0.1 * falling[0]
    typed = slotine_li_lyapunov(weight=1.0)
    assert np.diff(typed).max() > 1e-4 * typed[0]


@pytest.mark.slow
def test_adaptive_pd_is_the_linear_direct_scheme():
    """Tomei's scheme regulates asymptotically: it gets there, but has not arrived to rounding."""
    controller = adaptive_pd(ea.CompositeController.for_robot(load("two_link")))
    assert controller.control.a == controller.control.b == 1
    record = move(controller, 8.0)
    assert record.settling_time(2e-2) < 8
    assert np.abs(record.error[-1]).max() > 1e-9


def test_indirect_scheme_learns_by_the_mixed_regression_alone():
    """Without excitation it learns nothing; with a move it arrives as the composite one does."""
    controller = indirect(ea.CompositeController.for_robot(load("two_link")))
    record = move(controller, 4.0)
    assert record.settling_time(1e-3) < 4
    psi = controller.regressors.gravity(record.q[-1])
    bound = np.abs(psi @ controller.regressors.theta_potential).max()
    assert np.abs(psi @ record.theta_error[-1]).max() < 0.01 * bound
    deaf = dataclasses.replace(controller, law=dataclasses.replace(controller.law, indirect=False))
    assert np.all(move(deaf, 0.2).theta == 0)


def test_known_gravity_needs_no_adaptation():
    robot = load("ur5")
    law = ea.CompositeController.for_robot(robot).control
    record = move(KnownGravityPD(robot, law), 3.0)
    assert record.settling_time(1e-3) < 2
    assert record.theta.shape[1] == 0


def test_terminal_reference_is_finite_at_the_goal():
    """(stsmvar) is singular at e = 0; the floor makes it finite, and it changes nothing farther away."""
    controller = ea.paper.controller("C3")
    s, vr, ar = controller.terminal_reference(np.zeros(2), np.array([0.1, -0.2]))
    assert np.isfinite([*s, *vr, *ar]).all()
    e, v = np.array([0.5, -0.2]), np.array([0.1, 0.3])
    np.testing.assert_allclose(
        controller.terminal_reference(e, v).ar, -(1 / 3) * 1.5 * np.abs(e) ** (-2 / 3) * v, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("C4", {"K1": -1}, "K1: expected positive"), ("C4", {"K2": [1, 2, 3]}, r"K2: .*shape \(2,\)"),
        ("C4", {"weight": 0}, "weight"), ("C3", {"K_s": 0}, "K_s: expected positive"),
        ("C3", {"a": 1.5}, "a: expected"), ("C3", {"floor": 0}, "floor"),
        ("C3", {"slow": AdaptationGain(-1, 1)}, "slow.Gamma"),
    ],
)  # fmt: skip
def test_gains_outside_their_range_are_refused(name, options, said):
    with pytest.raises(ArgumentError, match=said):
        dataclasses.replace(ea.paper.controller(name), **options)


@pytest.mark.parametrize("kind", [ea.SlotineLi, ea.TerminalSliding])
def test_a_buffer_that_is_used_again_changes_nothing(kind):
    """A driver may hand over the same arrays every time."""
    robot = load("two_link")
    controller, goal, zero = kind.for_robot(robot), robot.configuration(robot.target), np.zeros(2)

    def run(fresh: bool) -> np.ndarray:
        q, v = robot.configuration([0.1, 0.2]).copy(), np.array([0.3, -0.2])
        state = controller.init(ea.Measurement(0.0, q.copy() if fresh else q, v.copy() if fresh else v, zero))
        for k in range(1, 5):
            q += 1e-3 * v
            v += 1e-2
            sample = (q.copy(), v.copy()) if fresh else (q, v)
            state, _ = controller.step(state, ea.Measurement(1e-3 * k, *sample, zero), goal, 1e-3)
        return state.regression.omega

    np.testing.assert_array_equal(run(fresh=False), run(fresh=True))
