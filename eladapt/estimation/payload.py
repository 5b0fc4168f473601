"""What a load weighs and where its centre of mass is, from the change of the parameters.

A rigid load adds its ten standard parameters x = (m, m c, I), I about the origin of the tool frame, to those
of the body j that carries it, once they are in the frame of that body's joint; and theta is linear in them:

    theta_after - theta_before = A x,    A = scale P[:, body j] X,

P being the base's projection, X (10, 10) the change of frame. Of theta_U alone only m and m c can be told,
since gravity does not see a body's rotational inertia: then x = (m, m c), with the rows of theta_U of A.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import scipy.linalg

from eladapt.errors import ArgumentError, require_number, require_vector
from eladapt.estimation.extensions import Information
from eladapt.estimation.mixing import DUST
from eladapt.regressors.regressors import Regressors
from eladapt.regressors.standard import pseudo_inertia
from eladapt.robot.reading import frame_index

NAMES = ("m", "m cx", "m cy", "m cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
# A model that lacks something (friction, rotors) changes its mind too, and not as a load would: 2 kg on a
# panda leave a misfit of 0.002 with noise; TALOS without rotors 0.19 to 0.84.
NO_LOAD = 0.05
# Largest part of a parameter in directions that are not identified; it goes into its standard deviation.
UNSEEN = 0.01
ROUNDING = 1e-9  # relative to theta; a smaller change is no load


class PayloadEstimate(NamedTuple):
    """A load in the coordinates of ``frame``; a negative mass is a load that was released.

    What the change of theta does not tell is nan with an infinite standard deviation, and
    ``unidentified`` names it: the combinations of m [kg] and m c [kg m] that leave no trace, in the
    posture and motion that were seen. Standard deviations are nan where no noise level is known.
    """

    mass: float  # [kg]
    com: np.ndarray  # (3,) [m] centre of mass; nan without a mass
    mass_std: float  # [kg]
    com_std: np.ndarray  # (3,) [m] to first order in the errors
    parameters: np.ndarray  # (4,) m, m c: the least change where they are not all identified
    covariance: np.ndarray  # (4, 4) of parameters, within what is identified
    misfit: float  # the weighted part of the change that no load in this frame explains, 0 to 1
    unidentified: tuple[str, ...]  # empty when mass and centre of mass are both known
    frame: str

    @property
    def is_load(self) -> bool:
        """Whether a load in this frame explains all of the change but ``NO_LOAD``."""
        return self.misfit < NO_LOAD

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.payload(self)

    def __repr__(self) -> str:
        return f"PayloadEstimate({self})"

    def __str__(self) -> str:
        com = ", ".join(_with_std(c, s) for c, s in zip(self.com, self.com_std, strict=True))
        unknown = f"; not identified: {', '.join(self.unidentified)}" if self.unidentified else ""
        doubt = "" if self.is_load else f"; but {self.misfit:.0%} of what changed is no load in this frame"
        mass = _with_std(self.mass, self.mass_std)
        return f"{mass} kg at ({com}) m in {self.frame}{unknown}{doubt}"


def _with_std(value: float, std: float) -> str:
    """A value with its standard deviation, where there is one."""
    return f"{value:.4g}" if np.isnan(std) else f"{value:.4g} +- {std:.2g}"


def estimate_payload(
    regressors: Regressors,
    theta_before: np.ndarray,
    theta_after: np.ndarray,
    information: Information | None = None,
    information_before: Information | None = None,
    *,
    samples: float | None = None,
    variance: float | None = None,
    floor: float = 0.0,
    frame: str | None = None,
) -> PayloadEstimate:
    """Mass and centre of mass of a load, by weighted least squares on the change of theta.

    theta_before, theta_after: the whole theta (l,), or theta_U (n_potential,), without and with the load. The
    whole theta tells the load's inertia too, which is taken out; theta_U does not see it. frame: in which the
    centre of mass is wanted, and on which body the load hangs; the robot's tool if None.

    information: what was seen since the load came; its triangle T (of theta_U alone the bottom block T_UU) is
    the weight, so that directions which were not excited do not count. It must have been started afresh when
    the load came: old data contradict the new. information_before: the same of theta_before, whose errors
    count too; a direction unknown before tells nothing after. None takes theta as exact; both None weighs all
    parameters alike.

    samples: how many independent equations ``information`` holds: rows * duration / spacing, the spacing
    being 2/pole for what disturbs the torque (the filter keeps it correlated for so long), and dt for noise
    of the measured velocity (which the filter leaves white). The residual r, the triangle's last diagonal
    entry, then gives variance = r^2 / (samples - l); the covariance of theta is variance (T'T)^-1, and the
    one before has the same noise. ``variance`` gives that number directly; without information it is the
    variance of each entry of theta_after - theta_before. This is the scatter by noise in y = Omega theta; a
    bias that noise in Omega makes is not in it. ``floor`` is the information, for each unit of theta, that a
    prior or noise in Omega makes by itself: a direction that is known no better counts as not identified.

    Standard parameters that `zero_parameters` of the robot rules out are taken to be zero with the load
    too: a load off a symmetric arm's centre line biases the rest.

    Raises ArgumentError for wrong shapes or a load that no joint carries, UnknownNameError for the frame.
    """
    complete = np.shape(theta_after) == (len(regressors),)
    size = len(regressors) if complete else regressors.n_potential
    before = require_vector("theta_before", theta_before, size)
    after = require_vector("theta_after", theta_after, size)
    name = regressors.robot.tool if frame is None else frame
    effect = payload_regressor(regressors, name)
    effect = effect if complete else effect[len(regressors) - size :, :4]
    weight = _weight(size, regressors, information, information_before)
    noise = _variance(regressors, information, samples, variance)

    unit = np.linalg.norm(effect, axis=0)  # m and m c differ in unit: compare them by their effect
    unit[unit <= DUST * unit.max(initial=0.0)] = unit.max(initial=0.0) or 1.0
    left, singular, right = np.linalg.svd(weight @ effect / unit, full_matrices=False)
    least = np.sqrt(require_number("floor", floor, 0, np.finfo(float).max, closed=True))
    seen = singular > max(least, DUST * singular.max(initial=0.0), np.finfo(float).tiny)
    change = weight @ (after - before)
    along = (left.T @ change)[seen]
    inverse = right[seen].T / singular[seen] / unit[:, None]  # (4 or 10, rank)
    x = inverse @ along
    covariance = noise * inverse @ inverse.T
    null = (
        np.linalg.svd(right[seen], full_matrices=True)[2][seen.sum() :] if seen.any() else np.eye(len(unit))
    )
    # A direction under the floor is turned a little by noise: a parameter that has a small part in it is
    # known but for that part of the load's size.
    part = np.linalg.norm(null, axis=0)
    part[part <= DUST] = 0
    known = part <= UNSEEN
    unseen = part * np.linalg.norm(unit * x) / unit
    null = np.where(known, 0.0, null)
    whole, unexplained = np.linalg.norm(change), np.linalg.norm(change - left[:, seen] @ along)
    misfit = float(unexplained / whole) if whole > 0 else 0.0

    mass, mass_std = (x[0], np.hypot(np.sqrt(covariance[0, 0]), unseen[0])) if known[0] else (np.nan, np.inf)
    com, com_std = np.full(3, np.nan), np.full(3, np.inf)
    rounding = ROUNDING * max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0))
    if known[0] and abs(mass) * unit[0] > rounding:
        com[known[1:4]] = x[1:4][known[1:4]] / mass
        gradient = np.column_stack([-com, np.eye(3)]) / mass  # of c = (m c) / m
        for i in np.flatnonzero(known[1:4]):
            com_std[i] = np.hypot(
                np.sqrt(gradient[i] @ covariance[:4, :4] @ gradient[i]), unseen[1 + i] / mass
            )
    return PayloadEstimate(
        float(mass),
        com,
        float(mass_std),
        com_std,
        x[:4],
        covariance[:4, :4],
        misfit,
        _describe(_independent((null / unit)[:, :4])),
        name,
    )


def payload_regressor(regressors: Regressors, frame: str) -> np.ndarray:
    """A (l, 10): what (m, m c, I about the frame's origin) of a load in ``frame`` adds to theta."""
    model = regressors.robot.model
    place = model.frames[frame_index(model, frame)]
    if place.parentJoint == 0:
        raise ArgumentError(f"frame: {frame!r} stands on the base; a load there moves with no joint")
    start = 10 * (place.parentJoint - 1)
    effect = np.zeros((len(regressors), 10))
    effect[regressors.inertial] = regressors.basis.projection[:, start : start + 10] @ _moved(place.placement)
    return regressors.scale[:, None] * effect


def _moved(placement: pin.SE3) -> np.ndarray:
    """(10, 10): standard parameters in another frame, by the pseudo-inertia J' = X J X'."""
    columns = []
    for k in range(10):
        pseudo = placement.homogeneous @ pseudo_inertia(np.eye(10)[k]) @ placement.homogeneous.T
        second = pseudo[:3, :3]
        inertia = np.trace(second) * np.eye(3) - second
        columns.append([pseudo[3, 3], *pseudo[:3, 3], *inertia[np.tril_indices(3)]])
    return np.array(columns).T


def _weight(
    size: int, regressors: Regressors, after: Information | None, before: Information | None
) -> np.ndarray:
    """L with L'L = (S_after^-1 + S_before^-1)^-1, S = T'T of the last ``size`` parameters; S may be singular.

    The unknown error of theta_before is eliminated by an orthogonal complement of [T_after; T_before],
    so that nothing is squared or inverted.
    """
    blocks = [
        _block(name, information, len(regressors), size)
        for name, information in (("information", after), ("information_before", before))
        if information is not None
    ]
    if not blocks:
        return np.eye(size)
    if len(blocks) == 1:
        return blocks[0]
    left, singular, _ = np.linalg.svd(np.vstack(blocks))
    rank = int(np.sum(singular > DUST * max(singular.max(initial=0.0), np.finfo(float).tiny)))
    return left[:size, rank:].T @ blocks[0]


def _block(name: str, information: Information, size: int, last: int) -> np.ndarray:
    """T (last, last) of the last parameters."""
    triangle = np.asarray(information.triangle, dtype=float)
    if triangle.shape != (size + 1, size + 1):
        raise ArgumentError(
            f"{name}: expected a triangle of shape ({size + 1}, {size + 1}), that of these regressors, "
            f"got {triangle.shape}"
        )
    if not np.isfinite(triangle).all():
        raise ArgumentError(f"{name}: expected a finite triangle")
    return triangle[size - last : size, size - last : size]


def _variance(
    regressors: Regressors, information: Information | None, samples: float | None, variance: float | None
) -> float:
    if variance is not None:
        if samples is not None:
            raise ArgumentError("samples, variance: expected one of them, got both")
        return require_number("variance", variance, 0, np.finfo(float).max, closed=True)
    if samples is None:
        return float("nan")
    if information is None:
        raise ArgumentError("samples: counts the equations in `information`, which was not given")
    samples = require_number("samples", samples, len(regressors))
    return float(information.triangle[-1, -1] ** 2 / (samples - len(regressors)))


def _independent(rows: np.ndarray) -> np.ndarray:
    """As many rows as are independent, spanning the same."""
    _, singular, right = np.linalg.svd(rows, full_matrices=False)
    return right[singular > UNSEEN * singular.max(initial=0.0)]


def _describe(null: np.ndarray) -> tuple[str, ...]:
    """The directions (k, 4) of (m, m c) in words, in a basis that shares as few terms as possible."""
    return tuple(_combination(row) for row in reduced(null))


def reduced(rows: np.ndarray) -> np.ndarray:
    """Independent rows (k, n) in another basis of their span, in which they share as few entries as possible:
    each has a 1 where all others have 0."""
    if not len(rows):
        return rows
    triangle, pivots = scipy.linalg.qr(rows, mode="r", pivoting=True)
    k = len(rows)
    found = np.zeros_like(rows)
    found[:, pivots] = scipy.linalg.solve_triangular(triangle[:, :k], triangle)
    return found[np.argsort(pivots[:k])]


def _combination(row: np.ndarray) -> str:
    text = ""
    for value, name in zip(row, NAMES[: len(row)], strict=True):
        if abs(value) > DUST:
            size = "" if abs(abs(value) - 1) < DUST else f"{abs(value):.3g} "
            text += f"{' - ' if value < 0 else ' + '}{size}{name}"
    return text.removeprefix(" + ").strip()
