"""What a composite controller learns from a sample: the line of its blocks, advanced by a step."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from eladapt.control.disturbance import unexplained
from eladapt.control.state import ControllerState
from eladapt.control.stepping import Sample, elapsed, free, resting
from eladapt.estimation.change import Snapshot
from eladapt.estimation.contact import ContactState
from eladapt.estimation.mistimed import stale
from eladapt.signals import Measurement, Regression

if TYPE_CHECKING:
    from eladapt.control.composite import CompositeController

ARRIVED, STILL = 0.01, 0.02  # [rad, rad/s] within which an arm rests at its goal


def advanced(own: CompositeController, state: ControllerState, sample: Sample, dt: float) -> ControllerState:
    """The state at a sample that came dt [s] after the last one, or whenever its time stamp says."""
    measurement, before = sample.measurement, state.measurement
    dt, gap = elapsed(before.t, measurement.t, dt)
    again = own.timing and stale(before.q, before.v, measurement.q, measurement.v)
    if gap or again:
        return _begun_again(own, state, sample, dt)
    motion = motion_of(own, state, sample, dt)
    contact = contact_after(own, state, sample, motion, dt)
    disturbance = disturbance_after(own, state, sample, motion, dt)
    if contact and contact.acting:
        return _untaught(own, state, measurement)._replace(contact=contact, disturbance=disturbance)
    filters, regression = own.regression.step(state.filters, measurement, dt)
    steps = state.steps
    if own.timing and steps:
        steps = own.timing.step(steps, state.regression, regression, state.parameters, dt)
    if steps and steps.apart:
        begun = _begun_again(own, state, sample, dt)
        return begun._replace(contact=contact, disturbance=disturbance, steps=steps)
    theta = _descended(own, state, sample, dt)
    information = own.extension.step(state.information, regression, dt)
    change, inertia = state.change, state.inertia
    if own.detector and change:
        change = own.detector.step(
            change, snapshot(state), information, regression, measurement.v,
            _known_friction(own, regression, state.parameters), measurement.t, dt,
        )  # fmt: skip
        if change.noticed > state.change.noticed:  # type: ignore[union-attr]
            filters = own.regression.init(measurement)
            regression = Regression(filters.y, filters.omega)
            information = own.extension.init(len(own.regressors))
            inertia = joint_inertia(own, state)  # whatever changed, it was not the joints
    theta = own.mixing.follow(own.law, information, theta, state.n_potential, dt)
    noise = own.joints.noise(state.noise, regression, theta, dt) if own.joints else state.noise
    return state._replace(
        measurement=measurement, parameters=own.law.bounded(theta, state.n_potential), filters=filters,
        regression=regression, information=information, change=change, disturbance=disturbance, noise=noise,
        contact=contact, steps=steps, inertia=inertia,
    )  # fmt: skip


def _begun_again(
    own: CompositeController, state: ControllerState, sample: Sample, dt: float
) -> ControllerState:
    """After a gap, in which nobody knows what torque acted, or a step of which nobody knows how long it
    took."""
    begun = _untaught(own, state, sample.measurement)
    if state.contact and state.contact.acting:
        return begun
    theta = _descended(own, state, sample, dt)
    return begun._replace(parameters=own.law.bounded(theta, state.n_potential))


def _untaught(own: CompositeController, state: ControllerState, measurement: Measurement) -> ControllerState:
    """What was known, and filters that start afresh at a measurement."""
    filters = own.regression.init(measurement)
    regression = Regression(filters.y, filters.omega)
    return state._replace(measurement=measurement, filters=filters, regression=regression)


def motion_of(
    own: CompositeController, state: ControllerState, sample: Sample, dt: float
) -> np.ndarray | None:
    """W(q, v, a) (nv, l) of the step, None where nobody asks for it."""
    if not (own.touch or own.disturbance):
        return None
    _, q, v, _ = sample.measurement
    return own.regressors.torque(q, v, (v - state.measurement.v) / dt, check=False)


def contact_after(
    own: CompositeController, state: ControllerState, sample: Sample, motion: np.ndarray | None, dt: float
) -> ContactState | None:
    """What acts from outside, after the step."""
    if own.touch is None or state.contact is None or motion is None:
        return state.contact
    _, q, v, tau = sample.measurement
    arrived, still = resting(sample.e1, sample.e2, v, ARRIVED, STILL)
    outside = motion @ state.parameters - tau
    return own.touch.step(state.contact, outside, q, state.parameters, arrived, still, dt)


def disturbance_after(
    own: CompositeController, state: ControllerState, sample: Sample, motion: np.ndarray | None, dt: float
) -> np.ndarray | None:
    """d (nv,) [N m] after the step."""
    if own.disturbance is None or state.disturbance is None or motion is None:
        return state.disturbance
    (_, _, v, tau), regressor, e1, e2, _ = sample
    friction, offset = own.regressors.friction, own.regressors.block("offset")
    residual, rows = unexplained(
        tau, motion, regressor, state.parameters, e1, e2, v, own.rest_speed, friction.start, offset.start,
        friction.stop,
    )  # fmt: skip
    beside = functools.partial(_friction_beside, own, state, rows)
    return own.disturbance.step(state.disturbance, residual, beside, e1, e2, v, dt)


def _friction_beside(own: CompositeController, state: ControllerState, rows: np.ndarray) -> np.ndarray:
    """(nv,) [N m] how much more friction there is than is fed forward, as far as it is known; rows (nv,
    l): of `unexplained`."""
    if not own.joints:
        return np.zeros(len(rows))
    return own.joints.surely(rows, state.parameters, state.information, state.noise)


def _known_friction(own: CompositeController, regression: Regression, theta: np.ndarray) -> np.ndarray:
    """(m,) the Coulomb friction of joint i in row i, where each joint has a row and a coefficient."""
    block = own.regressors.block("coulomb")
    if len(regression.y) != block.stop - block.start:
        return np.zeros(len(regression.y))
    weight = np.broadcast_to(getattr(own.regression, "weight", 1.0), len(regression.y))
    return weight * np.abs(theta[block] / own.regressors.scale[block])


def joint_inertia(own: CompositeController, state: ControllerState) -> np.ndarray:
    """(nv,) [kg m^2] what is known of the joints now, or was before the last change."""
    before = np.zeros(own.robot.nv) if state.inertia is None else state.inertia
    if not own.joints:
        return before
    return own.joints.inertia(state.parameters, state.information, state.noise, before)


def _descended(own: CompositeController, state: ControllerState, sample: Sample, dt: float) -> np.ndarray:
    """theta (l,) after the direct term, in the joints that move and whose torque is not clipped, and for
    all of theta but friction.

    A joint that moves one way cannot tell its offset from its Coulomb friction: the indirect term keeps
    their sum, and the direct one would drive them apart without end.
    """
    (_, _, v, tau), regressor, e1, e2, moving = sample
    joints = free(tau, v, own.effort_limit, own.rest_speed)
    return own.law.descend(state.parameters, regressor, e1, e2, dt, joints, own.regressors.friction, moving)


def snapshot(state: ControllerState) -> Snapshot:
    """What is known now."""
    return Snapshot(state.measurement.t, state.parameters, state.information)
