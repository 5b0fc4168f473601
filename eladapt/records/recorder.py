"""Collects what happens while a run goes on, and makes the record of it.

A controller says what is kept of it, `Controller.recorded` at every sample and `Controller.reviewed` 30 times
a second once somebody asks the record for it, by these names:

========================= ======= ======================================================================
parameters                (l,)    the estimate, in the order of its labels
theta                     (j,)    the last block of it, gravity's
delta, zeta,              (k,)    Delta, its gate zeta_1 and the gate's integral [s], where the law has
zeta_integral                     such numbers; k = 1, or one a direction
level                     ()      smallest eigenvalue of what was accumulated
innovation                ()      what the last regression said that nothing before it had
external                  (nv,)   what acts on the arm from outside [N m]
fault                     Fault   a gate's, None as long as it lets the torque through
excitation (reviewed)     (j,)    how much of gravity is known: eigenvalues in [0, 1]
carried (reviewed)        (5,)    the load's mass [kg], its centre [m], and the misfit
========================= ======= ======================================================================
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.records.description import describe, describe_plant, versions
from eladapt.records.later import Review
from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.robot.protocols import BareController, Recorded, Rubbing, gate_of, recorded_by, truth_of
from eladapt.signals import Braking, Fault, Reference

SAMPLED = (
    "parameters",
    "theta",
    "delta",
    "zeta",
    "zeta_integral",
    "level",
    "innovation",
    "external",
    "fault",
)
REVIEWED = ("excitation", "carried")
REVIEW_PERIOD = 1 / 30  # [s] as often as it is drawn
LONGEST = 1e12  # [s] that a run may be asked to last; how long a record memory holds is another matter
COPIES = 2  # of every sample: the recorder's, and the record's


class Recorder:
    """Collects samples; `record` can be called at any time. plant: None where nothing is known of it."""

    def __init__(
        self,
        robot: Robot,
        controller: BareController,
        dt: float,
        capacity: int,
        title: str,
        plant: Any = None,
    ):
        self.robot, self.controller, self.dt, self.title = robot, controller, dt, title
        self.plant, self.count, self.capacity = plant, 0, capacity
        self._recorded = recorded_by(controller)
        self._columns: dict[str, np.ndarray] = {}
        self._given: frozenset[str] = frozenset()  # what the controller gave for the last sample
        self._state: Any = None
        self._kept: list[tuple[float, Any]] = []  # states that are reviewed afterwards
        self._faults: list[Fault] | None = None  # None: there is no gate
        self._brakes: list[Braking] | None = None  # where nothing says whether they are wanted
        self._braked = False  # at the last sample

    def add(
        self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, goal: Reference, state: Any
    ) -> None:
        """One sample: t [s], q (nq,), v and tau (nv,), the goal, and the controller's state after it."""
        sample = self._sample(t, q, v, tau, goal, state)
        if "fault" in sample:
            self._notice(sample.pop("fault"))
        if sample.keys() != self._columns.keys():
            self._make_room(sample)
        self._state = state
        self._brake(t, state)
        if not self._kept or t - self._kept[-1][0] >= REVIEW_PERIOD - self.dt / 2:
            self._kept.append((t, state))
        for name, value in sample.items():
            self._columns[name][self.count] = value
        self.count += 1

    def reserve(self, state: Any) -> None:
        """Room for all samples now, which takes 0.1 s for a minute of a Panda, and not in the first tick."""
        q, still = self.robot.configuration(self.robot.home), self.robot.still
        sample = self._sample(0.0, q, still, still, Reference(q, still, still), state)
        sample.pop("fault", None)
        self._make_room(sample)

    def _sample(
        self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, goal: Reference, state: Any
    ) -> dict[str, Any]:
        given = self._recorded.recorded(state)
        if given.keys() != self._given:
            _require_known(given, SAMPLED, "recorded")
            self._given = frozenset(given)
        return {
            "t": t, "q": q, "v": v, "tau": tau, "error": _error(self.robot, goal.q, q),
            "goal": goal.q, "goal_velocity": goal.v, "goal_acceleration": goal.a,
            **given,
        }  # fmt: skip

    def _notice(self, fault: Fault | None) -> None:
        """What a gate says at a sample: a fault is kept once, however long it lasts."""
        self._faults = [] if self._faults is None else self._faults
        if fault is not None and fault not in self._faults[-1:]:
            self._faults.append(fault)

    def _brake(self, t: float, state: Any) -> None:
        """The first sample at which a gate wants the brakes, until it does not any more."""
        if not hasattr(state, "brake"):
            return
        self._brakes = [] if self._brakes is None else self._brakes
        wanted = bool(state.brake)
        if wanted and not self._braked:
            hold = getattr(gate_of(state), "hold", None)
            self._brakes.append(Braking(t, getattr(hold, "reason", "") or "not said"))
        self._braked = wanted

    def _make_room(self, sample: Mapping[str, Any]) -> None:
        """Raises ArgumentError, before the first sample is kept, for a record that memory does not hold."""
        if not self._columns:
            needed = COPIES * self.capacity * sum(8 * np.size(value) for value in sample.values())
            if needed > (there := memory()):
                raise ArgumentError(
                    f"a record of {self.capacity:.4g} samples takes {needed / 1e9:.3g} GB of memory, this "
                    f"computer has {there / 1e9:.3g} GB; expected a shorter duration, or a longer dt"
                )
        for name, value in sample.items():
            if name not in self._columns:
                self._columns[name] = np.full((self.capacity, *np.shape(value)), np.nan)

    def record(self) -> Record:
        """All that was added so far."""
        columns = {name: column[: self.count].copy() for name, column in self._columns.items()}
        for name in ("goal_velocity", "goal_acceleration"):
            if not columns[name].any():  # the goal stood still
                del columns[name]
        theta = columns.pop("theta", np.zeros((self.count, 0)))
        columns.setdefault("parameters", theta)
        size = columns["parameters"].shape[1]
        true, course = self._truth(columns["t"], size)
        load = truth_of(self.plant).load
        frame = None if load is None else load.frame or self.robot.tool
        review = Review(functools.partial(_reviewed, self._recorded, tuple(self._kept), frame))
        return Record(
            **columns, n_potential=theta.shape[1], parameters_true=true, parameters_true_course=course,
            excitation=cast(Any, functools.partial(review.get, "excitation")),
            carried=cast(Any, functools.partial(review.get, "carried")),
            final_state=self._state, effort_limit=self.robot.effort_limit,
            velocity_limit=self.robot.velocity_limit, lower=self.robot.lower, upper=self.robot.upper,
            q_index=np.array(list(self.robot.model.idx_qs)[1:]), dt=self.dt,
            faults=None if self._faults is None else tuple(self._faults),
            brakes=None if self._brakes is None else tuple(self._brakes), joint_names=self.robot.joint_names,
            link_names=self.robot.link_names,
            parameter_labels=self._labels(size), robot_source=self.robot.source,
            title=self.title or self.robot.name,
            configuration={
                "controller": describe(self.controller),
                "plant": describe_plant(self.plant),
                "versions": versions(),
            },
        )  # fmt: skip

    def _labels(self, size: int) -> tuple[str, ...]:
        labels = tuple(self._recorded.labels)
        if len(labels) != size:
            raise ArgumentError(
                f"labels: expected {size}, one a recorded parameter, got {len(labels)} of "
                f"{type(self.controller).__name__}"
            )
        return labels

    def _truth(self, t: np.ndarray, size: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """What the parameters should be at the end (l,), and at t (N,) where a load changes it (N, l)."""
        known, load, rubbing = truth_of(self.plant)
        arm = self.robot if rubbing is None else _with_friction(self.robot, rubbing)
        bare = self._recorded.true_parameters(arm.model) if known and size else None
        if bare is None or load is None:
            return bare, None
        loaded = self._recorded.true_parameters(load.loaded(arm))
        if loaded is None:
            return None, None
        held = np.array([load.held(time) for time in t])
        course = np.where(held[:, None], loaded, bare)
        return course[-1].copy(), course


def _reviewed(
    recorded: Recorded, kept: Sequence[tuple[float, Any]], frame: str | None
) -> dict[str, np.ndarray]:
    """(m, 1 + n) of each name: t [s] and the values, where the controller gave any."""
    rows: dict[str, list[np.ndarray]] = {}
    for t, state in kept:
        found = recorded.reviewed(state, frame)
        _require_known(found, REVIEWED, "reviewed")
        for name, values in found.items():
            rows.setdefault(name, []).append(np.array([t, *values]))
    return {name: np.array(some) for name, some in rows.items()}


def memory() -> float:
    """[bytes] that this computer has; inf where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return math.inf


def _with_friction(robot: Robot, rubbing: Rubbing) -> Robot:
    """The robot with the friction that acts on it."""
    model, nothing = robot.model.copy(), np.zeros(robot.nv)
    model.damping, model.friction = nothing + rubbing.viscous, nothing + rubbing.coulomb
    return dataclasses.replace(robot, model=model)


def _require_known(names: Iterable[str], legal: tuple[str, ...], where: str) -> None:
    """Raises UnknownNameError for what no record holds of what a controller gave."""
    if unknown := [name for name in names if name not in legal]:
        raise UnknownNameError(f"entry of {where}", unknown, legal)


def _error(robot: Robot, goal: np.ndarray, q: np.ndarray) -> np.ndarray:
    """e1 = q - q_d; nan where a sensor's failure left nothing to subtract."""
    try:
        return pin.difference(robot.model, goal, robot.check_q(q))
    except ArgumentError:
        return np.full(robot.nv, np.nan)
