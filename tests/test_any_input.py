"""Whatever a driver hands over, a step raises a typed error or gives a finite torque within the limits.

A few hundred cases of each test here, 100,000 in all with ``make nightly``.
"""

import functools
import warnings

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, EladaptError
from eladapt.regressors.joint_terms import JOINT_TERMS

DT = 1e-3
ROBOTS = ("two_link", "kinova")  # with nq = nv, and with continuous joints

usual = st.floats(-3, 3)
number = st.one_of(
    usual,
    usual,
    st.floats(),  # nan, inf, subnormal and huge ones among them
    st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e154, 1e60, 1e16, 5e-324, -0.0, 1e-160]),
)


def looks(vector, how):
    """The same numbers in another outfit, or in one that does not fit."""
    size = len(vector)
    if how == "read-only":
        vector.flags.writeable = False
        return vector
    if how == "strided":
        wide = np.zeros(3 * size)
        wide[::3] = vector
        return wide[::3]
    if how == "reversed":
        return vector[::-1].copy()[::-1]
    if how == "object":
        return vector.astype(object)
    if how == "text":
        return np.array([str(x) for x in vector])
    if how == "words":
        return np.array(["home"] * size)
    if how == "complex":
        return vector + 1j
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        kinds = {"single": np.float32, "integers": np.int64, "extended": np.longdouble}
        if how in kinds:
            return vector.astype(kinds[how])
    shapes = {
        "list": vector.tolist(), "short": vector[:-1], "long": np.append(vector, 0.0),
        "column": vector[:, None], "empty": np.zeros(0), "scalar": 1.0, "None": None,
        "ragged": [vector, 0.0], "bytes": vector.tobytes(),
    }  # fmt: skip
    return shapes.get(how, vector)


OUTFITS = (
    *("as it is",) * 10, "read-only", "strided", "reversed", "object", "text", "words", "complex", "single",
    "integers", "extended", "list", "short", "long", "column", "empty", "scalar", "None", "ragged", "bytes",
)  # fmt: skip


def vectors(size):
    plain = st.one_of(
        st.lists(usual, min_size=size, max_size=size),
        st.lists(number, min_size=size, max_size=size),
    )
    return st.builds(lambda x, how: looks(np.array(x, dtype=float), how), plain, st.sampled_from(OUTFITS))


steps = st.one_of(
    st.just(DT), st.just(DT), st.floats(1e-4, 1e-2), st.floats(),
    st.sampled_from([0, -DT, np.nan, np.inf, 1e-300, 1e300, None, "1e-3", "fast", np.float32(DT)]),
    st.just(np.ones(2)),
)  # fmt: skip


@st.composite
def configurations(draw, robot):
    """Valid ones, and what is none."""
    if robot.nq != robot.nv and draw(st.booleans()):
        return robot.configuration(np.array(draw(st.lists(usual, min_size=robot.nv, max_size=robot.nv))))
    return draw(vectors(robot.nq))


@st.composite
def inputs(draw, robot):
    """(what comes after the time now, q, v, tau, goal, dt) of a step."""
    after = draw(st.one_of(st.just(DT), st.just(DT), number))
    return (
        after, draw(configurations(robot)), draw(vectors(robot.nv)), draw(vectors(robot.nv)),
        draw(configurations(robot)), draw(steps),
    )  # fmt: skip


@functools.cache
def begun(name, gated, friction, shaped=False):
    """A controller 30 steps into a move, its state, and the measurement there."""
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot, DT, joint_terms=JOINT_TERMS if friction else ())
    controller = ea.GatedController.for_robot(controller, DT) if gated else controller
    controller = ea.Shaped(controller) if shaped else controller
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state = controller.init(measurement)
    for _ in range(30):
        state, tau = controller.step(state, measurement, robot.configuration(robot.target), DT)
        measurement = plant.step(tau, DT)
    return controller, state, measurement


def finite(state, name=""):
    """Whether every number of a state is; times of what has not happened yet are minus infinity."""
    if isinstance(state, np.ndarray | float):
        return bool(np.isfinite(state).all())
    if hasattr(state, "_fields"):
        skipped = () if isinstance(state, ea.Measurement) else ("t",)
        return all(finite(getattr(state, field)) for field in state._fields if field not in skipped)
    return all(map(finite, state)) if isinstance(state, tuple) else True


def trusted(tau, limit):
    return isinstance(tau, np.ndarray) and np.isfinite(tau).all() and np.all(np.abs(tau) <= limit)


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("name", ROBOTS)
def test_the_bare_controller_raises_or_gives_a_finite_torque(name, friction):
    """Up to three steps of anything, refused or taken; the state stays finite; a good step still works."""
    robot = load(name)

    @given(st.lists(inputs(robot), min_size=1, max_size=3))
    def check(sequence):
        controller, state, measurement = begun(name, False, friction)
        limit, taken = controller.effort_limit, 0
        for after, q, v, tau, goal, dt in sequence:
            try:
                with np.errstate(all="ignore"):
                    given = ea.Measurement(state.measurement.t + after, q, v, tau)
                    state, command = controller.step(state, given, goal, dt)
            except EladaptError:
                continue
            taken += 1
            assert trusted(command, limit)
            assert finite(state)
        assume(np.isfinite(state.measurement.t + DT) and state.measurement.t + DT > state.measurement.t)
        sane = measurement._replace(t=state.measurement.t + DT)
        with np.errstate(all="ignore"):
            state, command = controller.step(state, sane, robot.configuration(robot.target), DT)
        assert trusted(command, limit)
        assert finite(state)

    check()


@pytest.mark.parametrize(("friction", "shaped"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("name", ROBOTS)
def test_behind_the_gate_nothing_is_raised_but_for_dt(name, friction, shaped):
    """Up to three steps of anything: a finite torque within its limits each time, and within its rate until
    the brakes are wanted; a finite state; with a reference that is planned around the gate too."""
    robot = load(name)

    @given(st.lists(inputs(robot), min_size=1, max_size=3))
    def check(sequence):
        controller, state, measurement = begun(name, True, friction, shaped)
        gate, t = (controller.controller if shaped else controller).gate, measurement.t
        for after, q, v, tau, goal, dt in [
            *sequence,
            (DT, measurement.q, measurement.v, measurement.tau, None, DT),
        ]:
            t += after
            before = (state.inner if shaped else state).gate.tau
            with np.errstate(all="ignore"):
                try:
                    state, command = controller.step(state, ea.Measurement(t, q, v, tau), goal, dt)
                except ArgumentError as reason:
                    refused = str(reason)
                else:
                    refused = ""
            if refused:
                assert refused.startswith("dt: ")
                continue
            assert trusted(command, gate.effort)
            if not state.brake:  # then nothing but gravity's is left, at once
                assert np.all(np.abs(command - before) <= gate.torque_rate * float(dt) * (1 + 1e-9) + 1e-12)
            assert finite(state)

    check()
