"""What happened in a run: arrays by sample, the set-up that made them, and metrics of both."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, RecordError
from eladapt.files import atomic_write
from eladapt.robot.model import Robot
from eladapt.simulation.disturbances import Payload

FORMAT = 1
ARRAYS = (
    "t", "q", "v", "tau", "goal", "error", "theta", "delta", "zeta", "zeta_integral", "effort_limit",
)  # fmt: skip
OPTIONAL_ARRAYS = ("theta_true", "theta_true_course", "level", "carried")
LOAD_PERIOD = 1 / 30  # [s] between the samples of the estimated load: as often as it is drawn


class Metrics(NamedTuple):
    """Figures of merit of a run."""

    settling_time: float  # [s] from when on every |e_i| stays below the threshold; inf if it does not
    steady_error: float  # [rad] largest |e_i| in the last second
    parameter_settling: float  # [s] from when on every |theta error| stays below 1 %; nan if unknown
    chatter: float  # [N m] largest peak-to-peak torque, less its trend, in the last second
    control_energy: float  # [N^2 m^2 s] integral of |tau|^2


@dataclass(frozen=True, eq=False)
class Record:
    """N samples of a run. q and v are the plant's true state, tau what was commanded at the sample.

    theta_true is what the estimates should become, where it is known, with the load that hangs on the arm
    at the end; where a load came or went, theta_true_course has it sample by sample. ``configuration``
    says what made the record: controller, robot and versions, in plain JSON types.
    """

    t: np.ndarray  # (N,) [s]
    q: np.ndarray  # (N, nq)
    v: np.ndarray  # (N, nv) [rad/s]
    tau: np.ndarray  # (N, nv) [N m]
    goal: np.ndarray  # (N, nq)
    error: np.ndarray  # (N, nv) e1 = q - q_d [rad]
    theta: np.ndarray  # (N, j) estimates
    delta: np.ndarray  # (N, k) Delta, or one a direction
    zeta: np.ndarray  # (N, k) gates zeta_1 in [0, 1)
    zeta_integral: np.ndarray  # (N, k) [s]
    effort_limit: np.ndarray  # (nv,) [N m], inf where there is none
    dt: float  # [s]
    joint_names: tuple[str, ...]
    theta_labels: tuple[str, ...]
    theta_true: np.ndarray | None  # (j,)
    robot_source: dict[str, Any]
    title: str
    configuration: dict[str, Any]
    theta_true_course: np.ndarray | None = None  # (N, j), where a load changes theta_true
    level: np.ndarray | None = None  # (N,) smallest eigenvalue of what the estimator accumulated, if kept
    carried: np.ndarray | None = None  # (m, 6) t [s], load's estimated mass [kg], centre [m], misfit
    final_state: Any = dataclasses.field(default=None, repr=False)  # the controller's last; not saved

    def __len__(self) -> int:
        return len(self.t)

    @property
    def theta_error(self) -> np.ndarray:
        """(N, j) estimate less true value. Raises RecordError where the true value is not known."""
        if self.theta_true is None:
            raise RecordError(f"record {self.title!r} does not know the true parameters")
        return self.theta - (self.theta_true if self.theta_true_course is None else self.theta_true_course)

    def settling_time(self, threshold: float = 1e-3) -> float:
        """[s] from when on every |e_i| stays below ``threshold`` [rad]; inf if it does not."""
        return _settled(self.t, np.abs(self.error).max(axis=1) < threshold)

    def parameter_settling(self, relative: float = 0.01) -> float:
        """[s] from when on every estimate stays within ``relative`` of its true value."""
        bound = relative * np.abs(self.theta_true if self.theta_true is not None else np.nan)
        return _settled(self.t, np.all(np.abs(self.theta_error) < bound, axis=1))

    def metrics(self, threshold: float = 1e-3) -> Metrics:
        """Settling, steady error, chatter and energy; ``threshold`` [rad]."""
        last = self.t >= self.t[-1] - 1
        known = self.theta_true is not None
        return Metrics(
            settling_time=self.settling_time(threshold),
            steady_error=float(np.abs(self.error[last]).max()),
            parameter_settling=self.parameter_settling() if known else float("nan"),
            chatter=chatter(self.t[last], self.tau[last]),
            control_energy=float(np.sum(self.tau**2) * self.dt),
        )

    def save(self, path: str | Path) -> Path:
        """Write one compressed .npz, first to a temporary name; returns its path."""
        path = Path(path)
        if path.suffix != ".npz":
            raise ArgumentError(f"path: expected a name that ends with .npz, got {path.name!r}")
        arrays = {name: getattr(self, name) for name in (*ARRAYS, *OPTIONAL_ARRAYS)}
        arrays = {name: array for name, array in arrays.items() if array is not None}
        rest = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in (*ARRAYS, *OPTIONAL_ARRAYS, "final_state")
        }
        header = json.dumps({"format": FORMAT, **rest})
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, header=np.array(header), **arrays)
        return path

    @classmethod
    def load(cls, path: str | Path) -> Record:
        """Read what `save` wrote. Raises RecordError for anything else."""
        if Path(path).is_file() and not zipfile.is_zipfile(path):
            raise RecordError(f"{path}: not a record, or a damaged one; Record.save writes an .npz")
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                arrays = {name: file[name] for name in file.files if name != "header"}
        except FileNotFoundError:
            raise RecordError(f"{path}: no such record; Record.save writes one") from None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as reason:
            raise RecordError(f"{path}: not a record, or a damaged one ({reason})") from reason
        if header.pop("format", None) != FORMAT:
            raise RecordError(f"{path}: written in another format than {FORMAT}; make it again")
        missing = [name for name in ARRAYS if name not in arrays]
        if missing:
            raise RecordError(f"{path}: lacks {', '.join(missing)}; make it again")
        for name in ("joint_names", "theta_labels"):
            header[name] = tuple(header[name])
        optional = dict.fromkeys(OPTIONAL_ARRAYS)
        return cls(**{**optional, **arrays, **header})


class Recorder:
    """Collects samples while a run goes on; `record` can be called at any time."""

    def __init__(
        self, robot: Robot, controller: Any, dt: float, capacity: int, title: str, plant: Any = None
    ):
        self.robot, self.controller, self.dt, self.title = robot, controller, dt, title
        self.plant, self.count, self.capacity = plant, 0, capacity
        self._columns: dict[str, np.ndarray] = {}
        self._state: Any = None
        self._kept: list[tuple[float, Any]] = []  # states from which the load is estimated afterwards

    def add(
        self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, goal: np.ndarray, state: Any
    ) -> None:
        """One sample; ``state`` is the controller's."""
        theta = getattr(state, "theta", np.zeros(0))
        mixed, excitation = getattr(state, "mixed", None), getattr(state, "excitation", None)
        sample = {
            "t": t, "q": q, "v": v, "tau": tau, "goal": goal,
            "error": _error(self.robot, goal, q),
            "theta": theta,
            "delta": np.atleast_1d(mixed.delta) if mixed else np.zeros(0),
            "zeta": excitation.gates if excitation else np.zeros(0),
            "zeta_integral": excitation.integral if excitation else np.zeros(0),
        }  # fmt: skip
        if hasattr(state, "level"):
            sample["level"] = state.level
        self._state = state
        if not self._kept or t - self._kept[-1][0] >= LOAD_PERIOD - self.dt / 2:
            self._kept.append((t, state))
        for name, value in sample.items():
            if name not in self._columns:
                self._columns[name] = np.empty((self.capacity, *np.shape(value)))
            self._columns[name][self.count] = value
        self.count += 1

    def record(self) -> Record:
        """All that was added so far."""
        columns = {name: column[: self.count].copy() for name, column in self._columns.items()}
        level = columns.pop("level", None)
        regressors = getattr(self.controller, "regressors", None)
        labels, true = (), None
        if regressors is not None:
            size = columns["theta"].shape[1]
            labels = regressors.labels[len(regressors) - size :]
            true = regressors.theta[len(regressors) - size :]
        course = None
        payload = self._payload()
        if regressors is not None and true is not None and payload is not None:
            loaded = regressors.theta_of(payload.loaded(self.robot))[len(regressors) - size :]
            held = np.array([payload.held(t) for t in columns["t"]])
            course = np.where(held[:, None], loaded, true)
            true = course[-1].copy()
        return Record(
            **columns, level=level, theta_true_course=course, carried=self._carried(),
            final_state=self._state, effort_limit=self.robot.effort_limit, dt=self.dt,
            joint_names=self.robot.joint_names, theta_labels=tuple(labels), theta_true=true,
            robot_source=self.robot.source, title=self.title or self.robot.name,
            configuration={
                "controller": describe(self.controller),
                "plant": describe_plant(self.plant),
                "versions": versions(),
            },
        )  # fmt: skip

    def _payload(self) -> Payload | None:
        plant = self.plant
        while "plant" in getattr(plant, "__dict__", ()):  # below encoders and buses
            plant = plant.plant
        return getattr(plant, "payload", None)

    def _carried(self) -> np.ndarray | None:
        """The load over time, where the plant has one or the controller noticed one."""
        estimate = getattr(self.controller, "carried", None)
        change = getattr(self._state, "change", None)
        payload = self._payload()
        if estimate is None or not (payload or (change and change.noticed)):
            return None
        frame = payload.frame if payload else None
        found = [(t, estimate(state, frame)) for t, state in self._kept]
        return np.array([[t, load.mass, *load.com, load.misfit] for t, load in found])


def _error(robot: Robot, goal: np.ndarray, q: np.ndarray) -> np.ndarray:
    """e1 = q - q_d; nan where a sensor's failure left nothing to subtract."""
    try:
        return robot.difference(goal, q)
    except ArgumentError:
        return np.full(robot.nv, np.nan)


def describe(value: Any) -> Any:
    """A configuration as plain JSON types: dataclasses by their fields, arrays as lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: describe(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"class": type(value).__name__, **fields}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, tuple | list):
        return [describe(item) for item in value]
    return type(value).__name__


SETTINGS = (
    "integrator", "substeps", "seed", "joint_friction", "friction", "noise", "payload",
    "resolution", "time_constant", "delay",
)  # fmt: skip


def describe_plant(plant: Any) -> Any:
    """What was simulated, as plain JSON types; what stands around a plant comes first."""
    if plant is None:
        return None
    settings = {name: describe(getattr(plant, name)) for name in SETTINGS if name in vars(plant)}
    inner = {"plant": describe_plant(plant.plant)} if "plant" in vars(plant) else {}
    return {"class": type(plant).__name__, **settings, **inner}


def versions() -> dict[str, str]:
    """The releases that made a record."""
    return {name: importlib.metadata.version(name) for name in ("eladapt", "pin", "numpy", "scipy")}


def chatter(t: np.ndarray, tau: np.ndarray) -> float:
    """[N m] the largest peak-to-peak torque of a joint over the samples, less a linear trend."""
    if len(t) < 3:
        return 0.0
    design = np.column_stack([t - t.mean(), np.ones_like(t)])
    trend = design @ np.linalg.lstsq(design, tau, rcond=None)[0]
    return float(np.ptp(tau - trend, axis=0).max())


def _settled(t: np.ndarray, inside: np.ndarray) -> float:
    outside = np.flatnonzero(~inside)
    if not len(outside):
        return float(t[0])
    return float("inf") if outside[-1] == len(t) - 1 else float(t[outside[-1] + 1])
