"""Logs: what an arm did and with which torques, sample by sample, as its sensors told it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from eladapt.errors import ArgumentError, UnknownNameError, require_number
from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.robot.postures import turning

FEWEST = 10  # samples
GAP = 5.0  # times the median step: a longer one is a gap, over which nothing is known
JUMP = 0.75  # turns from one sample to the next are no motion, but a position within one turn
NAMED = 3  # columns that a note names
DERIVATIVE_TIME, DERIVATIVE_ORDER = 0.06, 3  # [s] of the window that fits positions to tell velocities


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """N samples of n joints.

    t (N,) [s]; q, v, tau (N, n) [rad or m, rad/s or m/s, N m or N]; joint_names: of the n columns, none where
    they are the robot's joints in its order. held: each torque acted over the whole step that ends at its t,
    as a controller commands it; otherwise it was measured at t. degrees: q and v are in degrees where a joint
    turns, and in metres where it slides: which does is the robot's to say, so that `of` makes them radians.

    What a recording lacks is dealt with by rule, and ``notes`` says where: samples with a number that is none
    are left out, and so are those with the stamp of the sample before. Without v (None, or all nan) it is the
    derivative of q, by a polynomial of the third degree through 60 ms around each sample (Savitzky and Golay
    1964), on each side of a gap for itself. A step of more than five times the median is a gap. A position
    that jumps by a turn, as that of a continuous joint, goes on without it until the next gap. Raises
    ArgumentError for shapes that do not agree, stamps that go back, and what is left of too few samples.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    tau: np.ndarray
    joint_names: tuple[str, ...] = ()
    held: bool = False
    notes: tuple[str, ...] = ()
    degrees: bool = False

    def __post_init__(self) -> None:
        t = _table("t", self.t, 1)
        arrays = {"q": _table("q", self.q, 2), "tau": _table("tau", self.tau, 2)}
        if self.v is not None and not np.isnan(v := _table("v", self.v, 2)).all():
            arrays["v"] = v
        shape = (len(t), arrays["q"].shape[1])
        for name, array in arrays.items():
            if array.shape != shape:
                raise ArgumentError(
                    f"{name}: expected {shape[0]} samples of {shape[1]} joints, got {array.shape}"
                )
        names = tuple(str(name) for name in self.joint_names)
        if names and (len(names) != shape[1] or len(set(names)) != shape[1]):
            raise ArgumentError(f"joint_names: expected {shape[1]} different names, got {', '.join(names)}")
        notes = list(self.notes)
        t, arrays = _sound(t, arrays, notes, names)
        if len(t) < FEWEST:
            raise ArgumentError(
                f"t: expected at least {FEWEST} samples with finite numbers, got {len(t)}"
                + "".join(f"; {note}" for note in notes[len(self.notes) :])
            )
        for name, value in (("t", t), ("joint_names", names), *arrays.items()):
            object.__setattr__(self, name, value)
        self._put_together(notes)
        if "v" not in arrays:
            object.__setattr__(self, "v", self._derivative())
            notes.append(
                f"no velocities: they are the derivative of the positions, over {DERIVATIVE_TIME:g} s"
            )
        object.__setattr__(self, "notes", tuple(notes))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        pieces = len(self.segments)
        gaps = f" in {pieces} pieces" if pieces > 1 else ""
        return (
            f"Log({self.q.shape[1]} joints, {len(self)} samples of {self.dt:.3g} s{gaps}, "
            f"{self.t[-1] - self.t[0]:.3g} s)"
        )

    @property
    def dt(self) -> float:
        """[s] the median step."""
        return float(np.median(np.diff(self.t)))

    @property
    def segments(self) -> list[slice]:
        """The pieces between gaps."""
        ends = np.flatnonzero(np.diff(self.t) > GAP * self.dt) + 1
        return [slice(int(a), int(b)) for a, b in zip([0, *ends], [*ends, len(self)], strict=True)]

    @classmethod
    def read(cls, path: str | Path, **options: Any) -> Log:
        """A log from a file: .csv, .tsv, .txt; .npz; a `Record`; a ROS 2 bag. See `read_log`."""
        from eladapt.identification.log_files import read_log

        return read_log(path, **options)

    @classmethod
    def from_record(cls, record: Record) -> Log:
        """What a controller's record tells: the true motion, and the torques that acted."""
        robot = Robot.from_source(record.robot_source)
        x = np.array([robot.coordinates(q) for q in record.q])
        turning = np.array(robot.model.nqs)[1:] == 2
        x[:, turning] = np.unwrap(x[:, turning], axis=0)
        # A record's torque is that commanded at its sample; it acts until the next one.
        return cls(record.t[1:], x[1:], record.v[1:], record.tau[:-1], record.joint_names, held=True)

    def of(self, robot: Robot) -> Log:
        """The same with one column for each of the robot's joints, in its order, in SI units.

        Columns of other joints, as of a gripper, are left out. Raises UnknownNameError for a joint of the
        robot that the log does not have, ArgumentError for a log without names and another number of joints.
        """
        if not self.joint_names:
            if self.q.shape[1] != robot.nv:
                raise ArgumentError(
                    f"log: expected {robot.nv} joints, those of {robot.name} in their order, got "
                    f"{self.q.shape[1]}; name the columns (joint_names), or lock joints"
                )
            return dataclasses.replace(self, joint_names=robot.joint_names)._in_radians(robot)
        if missing := [name for name in robot.joint_names if name not in self.joint_names]:
            raise UnknownNameError(
                "joint of the log", missing, self.joint_names,
                f"Say which joint of {robot.name} each column is, in their order: joint_names= (--joint)",
            )  # fmt: skip
        which = [self.joint_names.index(name) for name in robot.joint_names]
        return self.columns(which)._in_radians(robot)

    def _in_radians(self, robot: Robot) -> Log:
        """The same in SI units, of a log with the robot's joints in its order."""
        if not self.degrees:
            return self
        unit = np.where(turning(robot), np.pi / 180, 1.0)
        return dataclasses.replace(self, q=unit * self.q, v=unit * self.velocity, degrees=False)

    def columns(self, which: Sequence[int]) -> Log:
        """Some joints only, by their number."""
        which = list(which)
        names = tuple(self.joint_names[k] for k in which) if self.joint_names else ()
        return dataclasses.replace(
            self, q=self.q[:, which], v=self.velocity[:, which], tau=self.tau[:, which], joint_names=names
        )

    @property
    def velocity(self) -> np.ndarray:
        """(N, n) ``v``, which is there whatever was given."""
        assert self.v is not None
        return self.v

    def between(self, start: float, end: float) -> Log:
        """The samples with start <= t < end [s]. Raises ArgumentError where these are too few."""
        inside = (self.t >= start) & (self.t < end)
        return dataclasses.replace(
            self, t=self.t[inside], q=self.q[inside], v=self.velocity[inside], tau=self.tau[inside]
        )

    def parts(self, held_out: float) -> tuple[Log, Log | None]:
        """The log without its last part, a share of its time in [0, 1), and that part; None of nothing."""
        share = require_number("held_out", held_out, 0, 0.9, closed=True)
        if not share:
            return self, None
        cut = self.t[-1] - share * (self.t[-1] - self.t[0])
        last = int(np.sum(self.t >= cut))
        if min(last, len(self) - last) < FEWEST:
            raise ArgumentError(
                f"held_out: {share:g} of the log's time would part its {len(self)} samples into "
                f"{len(self) - last} and {last}; each needs {FEWEST}. Hold out another share, or none (0)"
            )
        return self.between(-np.inf, cut), self.between(cut, np.inf)

    def check(self, robot: Robot) -> tuple[str, ...]:
        """What in this log looks wrong or will not tell much, a sentence each; see `log_check`."""
        from eladapt.identification.log_check import remarks

        return remarks(self.of(robot), robot)

    def plot(self, path: str | Path | None = None) -> Any:
        """Positions, velocities and torques of every joint; a matplotlib figure, saved if a path is given."""
        from eladapt.display.motions import plot_log

        return plot_log(self, path)

    def _put_together(self, notes: list[str]) -> None:
        """Positions that go on where they jump by a turn from one sample to the next, in place."""
        before, turn = self.q.copy(), 360.0 if self.degrees else 2 * np.pi
        for piece in self.segments:
            self.q[piece] = np.unwrap(self.q[piece], discont=JUMP * turn, period=turn, axis=0)
        jumping = np.flatnonzero(np.abs(self.q - before).max(axis=0) > JUMP * turn)
        if jumping.size:
            named = ", ".join(_joint(self.joint_names, int(k)) for k in jumping)
            notes.append(f"positions of {named} jump by a turn from one sample to the next, and go on")

    def _derivative(self) -> np.ndarray:
        """(N, n) dq/dt, on an even grid of the median step within each piece, and back."""
        dt, found = self.dt, np.zeros_like(self.q)
        for piece in self.segments:
            t = self.t[piece]
            grid = np.arange(t[0], t[-1] + 0.5 * dt, dt)
            window = min(2 * int(0.5 * DERIVATIVE_TIME / dt) + 1, len(grid) - (len(grid) + 1) % 2)
            window = max(window, DERIVATIVE_ORDER + 2)
            for k in range(self.q.shape[1]):
                if len(grid) < window:  # too short to tell
                    found[piece, k] = np.gradient(self.q[piece, k], t) if len(t) > 1 else 0.0
                    continue
                even = np.interp(grid, t, self.q[piece, k])
                rate = savgol_filter(even, window, DERIVATIVE_ORDER, deriv=1, delta=dt)
                found[piece, k] = np.interp(t, grid, rate)
        return found


def _joint(names: Sequence[str], k: int) -> str:
    return names[k] if names else f"joint {k + 1}"


def _table(name: str, value: Any, dimensions: int) -> np.ndarray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as reason:
        raise ArgumentError(f"{name}: expected numbers, got {type(value).__name__} ({reason})") from None
    if array.ndim != dimensions:
        form = "(N,)" if dimensions == 1 else "(N, joints)"
        raise ArgumentError(f"{name}: expected an array {form}, got shape {array.shape}")
    return array


def _sound(
    t: np.ndarray, arrays: dict[str, np.ndarray], notes: list[str], joint_names: Sequence[str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The samples whose numbers are finite and whose stamps are new."""
    wrong = {"t": ~np.isfinite(t)}
    for name, array in arrays.items():
        for k, column in enumerate(array.T):
            wrong[f"{name} of {_joint(joint_names, k)}"] = ~np.isfinite(column)
    finite = ~np.any(list(wrong.values()), axis=0)
    if lost := int(np.sum(~finite)):
        where = [name for name, samples in wrong.items() if samples.any()]
        named = ", ".join(where[:NAMED]) + (f" and {len(where) - NAMED} more" if where[NAMED:] else "")
        notes.append(f"{lost} of {len(t)} samples have a number that is none ({named}), and were left out")
    kept = np.flatnonzero(finite)
    steps = np.diff(t[kept])
    if (back := np.flatnonzero(steps < 0)).size:
        k = int(kept[back[0] + 1])
        raise ArgumentError(
            f"t: expected stamps that rise, but sample {k} is at {t[k]:.9g} s and the one before it at "
            f"{t[kept[back[0]]]:.9g} s; sort the log, or cut it where the clock was set back"
        )
    if repeated := int(np.sum(steps == 0)):
        notes.append(f"{repeated} samples repeat the stamp of the one before, and were left out")
    kept = kept[np.concatenate([[True], steps > 0])] if len(kept) else kept
    return t[kept], {name: array[kept] for name, array in arrays.items()}
