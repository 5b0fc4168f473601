"""Torque regressors of many states in one call, compiled by numba (extra ``fast``).

What Pinocchio's computeJointTorqueRegressor finds for one state, with joints of one degree of freedom: motion
is carried outwards from the base, and with it each joint's axis, into all bodies behind it. The torque of
a body's parameter about an axis is the power of its wrench along that axis, both in the frame of the body. A
motion is [linear (3), angular (3)]; the base accelerates upwards, which is what gravity does.
"""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np
from numba import njit, prange

TURNING, CONTINUOUS, SLIDING = 0, 1, 2  # what a joint does; a continuous one has its cosine and sine in q

GROUP = 8  # of the batch, whose results stand in one line of the cache
REORDERED = {"reassoc", "contract", "nsz"}  # sums in any order


@njit(cache=True, inline="always")
def follow_joint(
    kind: int, q0: np.ndarray, v0: float, q1: np.ndarray, v1: float, dt: float, point: float, hermite: bool,
    state: np.ndarray,
) -> None:  # fmt: skip
    """Fill state (5,) with cosine, sine, shift, velocity and acceleration of a joint at a point in [0, 1].

    On the path from (q0, v0) to (q1, v1) that `ForceBalance` has, with its q from here on.
    """
    moved, change, bend = q1[0] - q0[0], v1 - v0, 0.0
    if kind == CONTINUOUS:
        moved = atan2(q0[0] * q1[1] - q0[1] * q1[0], q0[0] * q1[0] + q0[1] * q1[1])
    if hermite:
        bend = 6 * (moved / dt - 0.5 * (v0 + v1))
    offset = point * moved - dt / 12 * change + dt / 36 * (2 * point - 1) * bend
    state[3] = v0 + point * change + bend / 6
    state[4] = change / dt + (1 - 2 * point) / dt * bend
    if kind == SLIDING:
        state[0], state[1], state[2] = 1.0, 0.0, q0[0] + offset
    elif kind == TURNING:
        state[0], state[1], state[2] = cos(q0[0] + offset), sin(q0[0] + offset), 0.0
    else:
        length = (3 - q0[0] * q0[0] - q0[1] * q0[1]) / 2  # back to the unit circle, as Pinocchio does
        c, s = length * cos(offset), length * sin(offset)
        state[0], state[1], state[2] = q0[0] * c - q0[1] * s, q0[1] * c + q0[0] * s, 0.0


@njit(cache=True, inline="always")
def place_joint(
    turns: np.ndarray, place: np.ndarray, slide: np.ndarray, state: np.ndarray, frame: np.ndarray
) -> None:
    """Fill frame (4, 3), the rotation and the place of a body in its parent's frame.

    turns (3, 3, 3): what each of [1, cosine, sine] turns.
    """
    cosine, sine, shift = state[0], state[1], state[2]
    for i in range(3):
        frame[3, i] = place[i] + shift * slide[i]
        for j in range(3):
            frame[i, j] = turns[0, i, j] + cosine * turns[1, i, j] + sine * turns[2, i, j]


@njit(cache=True, inline="always")
def carry(frame: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
    """Fill after (6,) with the motion ``before`` of the parent, as it is at the body and in its frame."""
    x, y, z = before[3], before[4], before[5]
    u = before[0] + y * frame[3, 2] - z * frame[3, 1]
    v = before[1] + z * frame[3, 0] - x * frame[3, 2]
    w = before[2] + x * frame[3, 1] - y * frame[3, 0]
    for i in range(3):
        after[i] = frame[0, i] * u + frame[1, i] * v + frame[2, i] * w
        after[3 + i] = frame[0, i] * x + frame[1, i] * y + frame[2, i] * z


@njit(cache=True, inline="always")
def add_cross(one: np.ndarray, two: np.ndarray, factor: float, into: np.ndarray) -> None:
    """Add factor * one x two of two vectors (3,)."""
    into[0] += factor * (one[1] * two[2] - one[2] * two[1])
    into[1] += factor * (one[2] * two[0] - one[0] * two[2])
    into[2] += factor * (one[0] * two[1] - one[1] * two[0])


@njit(cache=True, inline="always")
def add_joint_motion(
    axis: np.ndarray, v: float, a: float, velocity: np.ndarray, acceleration: np.ndarray
) -> None:
    """Add a joint's motion to that of its body, which so far is the parent's."""
    for i in range(6):
        velocity[i] += v * axis[i]
        acceleration[i] += a * axis[i]
    add_cross(velocity[3:], axis[:3], v, acceleration[:3])
    add_cross(velocity[:3], axis[3:], v, acceleration[:3])
    add_cross(velocity[3:], axis[3:], v, acceleration[3:])


@njit(cache=True, inline="always")
def parameter_torques(
    axis: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, found: np.ndarray
) -> None:
    """Fill found (10,) with the torque about ``axis`` of each parameter of a body, at unit size."""
    lx, ly, lz, sx, sy, sz = axis[0], axis[1], axis[2], axis[3], axis[4], axis[5]
    vx, vy, vz, wx, wy, wz = velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5]
    ax, ay, az = acceleration[3], acceleration[4], acceleration[5]
    # d, the acceleration of the point at the origin, makes m d and mc x d.
    dx = acceleration[0] + wy * vz - wz * vy
    dy = acceleration[1] + wz * vx - wx * vz
    dz = acceleration[2] + wx * vy - wy * vx
    found[0] = lx * dx + ly * dy + lz * dz
    # The first moment: l'(a x mc + w x (w x mc)) + s'(mc x d).
    along, square = wx * lx + wy * ly + wz * lz, wx * wx + wy * wy + wz * wz
    found[1] = along * wx - square * lx + ly * az - lz * ay + dy * sz - dz * sy
    found[2] = along * wy - square * ly + lz * ax - lx * az + dz * sx - dx * sz
    found[3] = along * wz - square * lz + lx * ay - ly * ax + dx * sy - dy * sx
    # The inertia: s'I a + s'(w x I w) = s'I a + u'I w with u = s x w.
    ux, uy, uz = sy * wz - sz * wy, sz * wx - sx * wz, sx * wy - sy * wx
    found[4] = sx * ax + ux * wx
    found[5] = sx * ay + sy * ax + ux * wy + uy * wx
    found[6] = sy * ay + uy * wy
    found[7] = sx * az + sz * ax + ux * wz + uz * wx
    found[8] = sy * az + sz * ay + uy * wz + uz * wy
    found[9] = sz * az + uz * wz


@njit(cache=True, fastmath=REORDERED)
def add_regressor(
    parents: np.ndarray, turns: np.ndarray, places: np.ndarray, slides: np.ndarray, axes: np.ndarray,
    starts: np.ndarray, entries: np.ndarray, factors: np.ndarray, states: np.ndarray, into: np.ndarray,
    velocity: np.ndarray, acceleration: np.ndarray, carried: np.ndarray,
) -> None:  # fmt: skip
    """Add the regressor of one state to ``into`` (nv, l).

    states (n, 5) as `follow_joint` has them. Scratch: velocity and acceleration (n + 1, 6), the base's motion
    last; carried (n, n, 6), the axis of each joint (second) in the frame of each body behind it (first).
    """
    frame, found = np.empty((4, 3)), np.empty(10)
    for body in range(len(parents)):
        parent, first, end = parents[body], starts[body], starts[body + 1]
        place_joint(turns[body], places[body], slides[body], states[body], frame)
        carry(frame, velocity[parent], velocity[body])
        carry(frame, acceleration[parent], acceleration[body])
        add_joint_motion(axes[body], states[body, 3], states[body, 4], velocity[body], acceleration[body])
        carried[body, body] = axes[body]
        joint = body
        while joint >= 0:
            if joint != body:
                carry(frame, carried[parent, joint], carried[body, joint])
            parameter_torques(carried[body, joint], velocity[body], acceleration[body], found)
            row = into[joint]
            for e in range(first, end):
                row[entries[e, 1]] += factors[e] * found[entries[e, 0]]
            joint = parents[joint]
    for e in range(starts[len(parents)], len(entries)):  # rotors
        into[entries[e, 0], entries[e, 1]] += factors[e] * states[entries[e, 0], 4]


@njit(cache=True, parallel=True)
def filtered_regressors(
    kinds: np.ndarray, firsts: np.ndarray, parents: np.ndarray, turns: np.ndarray, places: np.ndarray,
    slides: np.ndarray, axes: np.ndarray, starts: np.ndarray, entries: np.ndarray, factors: np.ndarray,
    gravity: np.ndarray, moving: float, q0: np.ndarray, v0: np.ndarray, q1: np.ndarray, v1: np.ndarray,
    dt: float, points: np.ndarray, hermite: bool, omega: np.ndarray, rho: float, weight: np.ndarray,
    filtered: np.ndarray,
) -> None:  # fmt: skip
    """Fill in filtered (nv, l, B), rho omega + weight W with the mean W over the points of each path.

    The tree, outwards: kinds (n,) of joints, firsts (n,) where each stands in q; parents (n,), -1 for the
    base; turns, places and slides as `place_joint` wants them; axes (n, 6). The map from standard parameters:
    entries (standard, wanted) of one body after the other, body i's from starts[i] on, then the rotors'
    (joint, wanted); factors. moving: 0 for gravity alone. The paths: q0, q1 (B, nq) and v0, v1 (B, nv).
    weight (nv,).
    """
    (many, n), parameters, count = v0.shape, omega.shape[1], len(points)
    for group in prange((many + GROUP - 1) // GROUP):
        lo, hi = group * GROUP, min((group + 1) * GROUP, many)
        velocity, acceleration = np.zeros((n + 1, 6)), np.zeros((n + 1, 6))
        acceleration[n, :3] = -gravity
        carried, regressors = np.empty((n, n, 6)), np.zeros((GROUP, n, parameters))
        states = np.empty((n, 5))
        for b in range(lo, hi):
            for p in range(count):
                for i in range(n):
                    k = firsts[i]
                    follow_joint(
                        kinds[i], q0[b, k:], v0[b, i], q1[b, k:], v1[b, i], dt, points[p], hermite, states[i]
                    )
                states[:, 3:] *= moving
                add_regressor(
                    parents, turns, places, slides, axes, starts, entries, factors, states,
                    regressors[b - lo], velocity, acceleration, carried,
                )  # fmt: skip
        for i in range(n):
            factor = weight[i] / count
            for k in range(parameters):
                for b in range(lo, hi):
                    filtered[i, k, b] = rho * omega[i, k, b] + factor * regressors[b - lo, i, k]
