"""What a robot file says of how far, how fast and how strong joints are; 0 or missing is "not set"."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError, require_gain

PUBLISHED = ("velocity", "acceleration", "jerk", "torque_rate")  # [rad/s, rad/s^2, rad/s^3, N m/s]
UNSET_VELOCITY = 2.0  # [rad/s or m/s] of a joint for which nobody sets a speed limit
POSTURES = 50  # in which gravity is compared with the effort limits


def set_or_inf(limit: np.ndarray) -> np.ndarray:
    """The limits (nv,), +inf where none is set."""
    return np.where(limit > 0, limit, np.inf)


def speed(limit: np.ndarray) -> np.ndarray:
    """Speed limits (nv,) that are all finite: `UNSET_VELOCITY` where none is set."""
    return np.where(np.isfinite(limit), limit, UNSET_VELOCITY)


def position_limits(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper (nv,) [rad or m], infinite for continuous joints and where no range is set."""
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    for joint in range(1, model.njoints):
        i, k = model.idx_vs[joint], model.idx_qs[joint]
        low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
        if model.nqs[joint] == 1 and low < high:
            lower[i], upper[i] = low, high
    return lower, upper


def random_configurations(model: pin.Model, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """``count`` of them, each (nq,), uniform within the joint limits; (-pi, pi) where none is set."""
    lower, upper = position_limits(model)
    low, high = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
    return [pin.integrate(model, pin.neutral(model), rng.uniform(low, high)) for _ in range(count)]


def clipped_neutral(model: pin.Model) -> np.ndarray:
    """The neutral configuration, with the joints whose limits exclude it at the nearest limit."""
    q = pin.neutral(model)
    for joint in range(1, model.njoints):
        k = model.idx_qs[joint]
        low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
        if model.nqs[joint] == 1 and low < high:
            q[k] = np.clip(q[k], low, high)
    return q


def require_limit(name: str, value: Any, nv: int, *, positive: bool = True) -> np.ndarray:
    """(nv,) a limit of joints, inf where there is none. Raises ArgumentError, naming it."""
    try:
        limit = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        limit = np.array(np.nan)
    if limit.shape not in ((), (nv,)) or np.isnan(limit).any() or (positive and np.any(limit <= 0)):
        kind = "positive numbers" if positive else "numbers"
        raise ArgumentError(f"{name}: expected {kind}, one for all joints or ({nv},), got {value!r}")
    return np.broadcast_to(limit, (nv,)).copy()


def published_limits(given: Mapping[str, Sequence[float] | np.ndarray], nv: int) -> dict[str, np.ndarray]:
    """A maker's limits by name, (nv,) each. Raises UnknownNameError, ArgumentError."""
    if unknown := [name for name in given if name not in PUBLISHED]:
        raise UnknownNameError("published limit", unknown, PUBLISHED)
    return {name: require_gain(f"published {name}", values, nv) for name, values in given.items()}


def too_heavy(model: pin.Model) -> Iterator[str]:
    """Says so where gravity is more than the motors can hold wherever the arm is."""
    rng, data, limit = np.random.default_rng(0), model.createData(), set_or_inf(model.upperEffortLimit)
    postures = random_configurations(model, rng, POSTURES)
    shares = np.abs([pin.computeGeneralizedGravity(model, data, q) / limit for q in postures])
    if shares.max(axis=1).min() > 1:
        k = int(np.argmax(shares.min(axis=0)))
        yield (
            f"gravity is more than the effort limits everywhere; {model.names[1 + k]} would need "
            f"{np.median(shares[:, k]):.3g} times its {limit[k]:g} N m. Are masses and lengths in kg and m?"
        )
