"""The paper's simulations: to the letter, and with the library's numerics."""

import functools

import numpy as np
import pytest
import typeset

import eladapt as ea
from eladapt import paper
from eladapt.errors import ArgumentError

OPEN = {"pole": paper.POLE, "linear_damping": paper.LINEAR_DAMPING, "d": paper.SATURATION_EXPONENT}


@functools.cache
def run(name: str, case: int = 1) -> ea.Record:
    return paper.run(name, case, duration=5.0, progress=False)


def test_arm_is_the_papers(rng):
    """M, C and g are the typeset ones."""
    robot = paper.robot()
    d1, d2, d3, d4, d5 = 0.49 / 3, 0.03, 0.04 / 3, 0.981, 5.886
    for _ in range(50):
        q, v = rng.uniform(-4, 4, size=2), rng.normal(size=2)
        c2, s2, s12, s1 = np.cos(q[1]), np.sin(q[1]), np.sin(q.sum()), np.sin(q[0])
        mass = [[d1 + 2 * d2 * c2, d3 + d2 * c2], [d3 + d2 * c2, d3]]
        coriolis = [[-d2 * s2 * v[1], -d2 * s2 * v.sum()], [d2 * s2 * v[0], 0]]
        np.testing.assert_allclose(robot.mass_matrix(q), mass, atol=1e-12)
        np.testing.assert_allclose(robot.coriolis_matrix(q, v), coriolis, atol=1e-12)
        np.testing.assert_allclose(robot.gravity(q), [d4 * s12 + d5 * s1, d4 * s12], atol=1e-12)


@pytest.mark.parametrize("case", [1, 2])
@pytest.mark.parametrize("name", paper.NAMES)
def test_run_is_the_paper_to_rounding(name, case, monkeypatch):
    """One second of `paper.run` against an independent implementation of the typeset equations.

    Fractional powers amplify rounding (a difference of 1e-16 becomes 1e-8 under a square root), so
    rounding is measured: it is what the independent implementation itself changes by when its pole or its
    first position moves by the last digit. A hundred roundings a step are allowed for, and no more; and in
    the first tenth of a second, before anything is amplified, the two agree to 1e-9.
    """
    record = paper.run(name, case, duration=1.0, progress=False)
    expected = typeset.run(name, case, **OPEN)
    nudged = [typeset.run(name, case, **{**OPEN, "pole": np.nextafter(OPEN["pole"], np.inf)})]
    monkeypatch.setattr(typeset, "Q_0", np.nextafter(typeset.Q_0, np.inf))
    nudged.append(typeset.run(name, case, **OPEN))
    assert len(expected["t"]) == len(record) == 2001
    for quantity in ("q", "v", "tau", "theta"):
        kept = record.parameters if quantity == "theta" else getattr(record, quantity)
        difference = np.abs(kept - expected[quantity])
        size = np.abs(expected[quantity]).max()
        rounding = max(np.abs(other[quantity] - expected[quantity]).max() for other in nudged)
        assert difference.max() <= 100 * max(rounding, 1e-15 * size), quantity
        assert difference.max() <= 1e-4 * size, quantity
        assert difference[:200].max() <= 1e-9 * size, quantity
    if name in ("C1", "C2"):
        assert np.abs(record.delta[:, 0] - expected["delta"]).max() <= 1e-6 * expected["delta"].max()


def test_weight_of_the_prediction_error_is_an_option():
    """C4 with w = alpha, against the independent implementation."""
    record = paper.run("C4", weight=10.0, duration=0.5, progress=False)
    expected = typeset.run("C4", **OPEN, weight=10.0, duration=0.5)
    np.testing.assert_allclose(record.parameters, expected["theta"], rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["C1", "C2"])
def test_case_1_meets_the_papers_times(name):
    """Both errors below 1e-3 rad by 4 s, every theta_U within 1 % by 2.5 s, and they stay so."""
    record = run(name)
    assert record.settling_time(1e-3) <= 4
    assert record.parameter_settling(0.01) <= 2.5


@pytest.mark.parametrize("name", ["C1", "C2"])
def test_library_numerics_meet_them_too_without_chatter(name):
    """The same gains with exact filters, exact flow and semi-implicit control: no chatter at all."""
    controller = paper.controller(name, **OPEN)
    plant = ea.PinocchioPlant(controller.robot, paper.START)
    record = ea.simulate(controller, plant, np.array(paper.GOAL), 5.0, 5e-4, theta0="zero", progress=False)
    assert record.settling_time(1e-3) <= 4
    assert record.parameter_settling(0.01) <= 2.5
    assert record.metrics().chatter < 1e-6
    assert run(name).metrics().chatter > 1e-4, "explicit evaluation chatters"


@pytest.mark.parametrize(
    "options", [{"name": "C9"}, {"name": "C1", "case": 3}, {"name": "C4", "weight": -1.0}]
)
def test_unknown_simulations_are_refused(options):
    with pytest.raises(ArgumentError, match="expected"):
        paper.run(**options)
