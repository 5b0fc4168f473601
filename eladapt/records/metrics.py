"""Figures of merit of a run: how soon and how well it arrived, and how it stood with the arm's limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eladapt.signals import Braking, Fault

RESOLVED = 1e-6  # [rad or m] beyond the end of a range: no arm's sensor tells less from the end itself
NOT_RECORDED = "not recorded"


class Extreme(NamedTuple):
    """Which joint came furthest towards its limit, or beyond it."""

    value: float  # nan where no joint has a limit
    joint: str
    t: float  # [s] of the sample
    lasted: float  # [s] for how long this joint was beyond its limit


class Metrics(NamedTuple):
    """Figures of merit of a run."""

    settling_time: float  # [s] from when on every |e_i| stays below the threshold; inf if it does not
    steady_error: float  # [rad] largest |e_i| in the last second, or since it settled
    parameter_settling: float  # [s] from when on |theta error| stays below 1 % of |theta|; nan if unknown
    chatter: float  # [N m] largest peak-to-peak torque, less its trend, of the same time
    control_energy: float  # [N^2 m^2 s] integral of |tau|^2
    speed: Extreme  # [-] largest |v_i| as a part of the joint's limit
    beyond: Extreme | None  # [rad or m] furthest beyond a joint's range, negative inside; None: not recorded
    faults: tuple[Fault, ...] | None  # that a gate latched; None: not recorded
    brakes: tuple[Braking, ...] = ()  # that it asked for

    @property
    def arrived(self) -> bool:
        """Whether the arm came to rest at its goal."""
        return math.isfinite(self.settling_time)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a run did that its arm would not have borne, a sentence each."""
        said = {"a speed limit was exceeded": self.speed.value > 1 and self.speed_said}
        left = self.beyond is not None and self.beyond.value > RESOLVED
        said["the joint range was not kept"] = left and self.range_said
        return tuple(f"{what}: {how}" for what, how in said.items() if how)

    @property
    def speed_said(self) -> str:
        """The largest speed in words."""
        share, joint, t, lasted = self.speed
        if math.isnan(share):
            return "no joint has a limit"
        said = f"{share:.0%} of the limit, {joint} at {t:.3g} s"
        return f"{said}, above it for {lasted:.3g} s" if share > 1 else said

    @property
    def range_said(self) -> str:
        """Whether a joint left its range, in words."""
        if self.beyond is None:
            return NOT_RECORDED
        distance, joint, t, lasted = self.beyond
        if math.isnan(distance):
            return "no joint has one"
        if distance <= RESOLVED:
            return "kept by every joint"
        return f"left by {joint}, {distance:.2g} beyond it at {t:.3g} s, outside for {lasted:.3g} s"

    @property
    def faults_said(self) -> str:
        """The gate's faults in words, and when and why it asked for the brakes."""
        if self.faults is None:
            return NOT_RECORDED
        said = "; ".join(map(str, self.faults)) or "none"
        for braking in self.brakes:  # a reason is not said twice
            known = braking.reason in said
            said += f"; brakes asked for at t = {braking.t:.4f} s" if known else f"; {braking}"
        return said


def largest_speed(
    t: np.ndarray, v: np.ndarray, limit: np.ndarray, dt: float, joint_names: Sequence[str]
) -> Extreme:
    """Of v (N, nv) at t (N,), as a part of limit (nv,), inf where there is none."""
    share = np.where(np.isfinite(limit), np.abs(v) / limit, np.nan)
    return _extreme(t, share, 1.0, dt, joint_names)


def furthest_beyond(
    t: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, dt: float, joint_names: Sequence[str]
) -> Extreme:
    """Of joint coordinates x (N, nv) at t (N,), beyond lower and upper (nv,), infinite where none is set."""
    return _extreme(t, np.maximum(x - upper, lower - x), RESOLVED, dt, joint_names)


def _extreme(
    t: np.ndarray, values: np.ndarray, most: float, dt: float, joint_names: Sequence[str]
) -> Extreme:
    """The largest of values (N, nv) and how long its joint's were above ``most``; what is nan is none."""
    known = np.where(np.isnan(values), -np.inf, values)
    k, joint = divmod(int(np.argmax(known)), known.shape[1])
    if known[k, joint] == -np.inf:
        return Extreme(math.nan, "", math.nan, 0.0)
    lasted = dt * np.count_nonzero(known[:, joint] > most)
    return Extreme(float(known[k, joint]), joint_names[joint], float(t[k]), float(lasted))


def settled(t: np.ndarray, inside: np.ndarray) -> float:
    """[s] from when on ``inside`` (N,) stays true; inf if it does not."""
    outside = np.flatnonzero(~inside)
    if not len(outside):
        return float(t[0])
    return float("inf") if outside[-1] == len(t) - 1 else float(t[outside[-1] + 1])


def chatter(t: np.ndarray, tau: np.ndarray) -> float:
    """[N m] the largest peak-to-peak torque of a joint over the samples, less a linear trend."""
    if len(t) < 3:
        return 0.0
    design = np.column_stack([t - t.mean(), np.ones_like(t)])
    trend = design @ np.linalg.lstsq(design, tau, rcond=None)[0]
    return float(np.ptp(tau - trend, axis=0).max())
