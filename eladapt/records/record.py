"""What happened in a run: arrays by sample, the set-up that made them, and metrics of both."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, RecordError, require_number
from eladapt.files import atomic_write
from eladapt.records.archive import read_archive, reading
from eladapt.records.later import Later
from eladapt.records.metrics import Extreme, Metrics, chatter, furthest_beyond, largest_speed, settled
from eladapt.signals import Braking, Fault

FORMAT = 2
LAST, LEAST_REST = 1.0, 0.2  # [s] of a run that count as rest: at most, and at least
# Of the arrays in memory; above that, times the file's size. Those of moves take three times what it has.
MOST_BYTES, MOST_GROWTH = 1 << 27, 50
SHAPES = {
    "t": ("N",), "q": ("N", "nq"), "v": ("N", "nv"), "tau": ("N", "nv"), "goal": ("N", "nq"),
    "error": ("N", "nv"), "parameters": ("N", "l"), "effort_limit": ("nv",), "velocity_limit": ("nv",),
    "goal_velocity": ("N", "nv"), "goal_acceleration": ("N", "nv"), "delta": ("N", "k"), "zeta": ("N", "k"),
    "zeta_integral": ("N", "k"), "level": ("N",), "innovation": ("N",), "external": ("N", "nv"),
    "excitation": ("m", "1 + j"),
    "carried": ("n", "6"), "parameters_true": ("l",), "parameters_true_course": ("N", "l"),
    "lower": ("nv",), "upper": ("nv",), "q_index": ("nv",),
}  # fmt: skip
KINDS = {"title": str, "configuration": dict, "robot_source": dict, "n_potential": int}
ARRAYS = tuple(SHAPES)[:9]
OPTIONAL_ARRAYS = tuple(SHAPES)[9:]


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """N samples of a run. q and v are the plant's true state, tau what was commanded at the sample.

    parameters_true is what the estimates should become, where it is known, with the load that hangs on the
    arm at the end; where a load came or went, parameters_true_course has it sample by sample. The gravity
    parameters theta are the last ``n_potential`` ones. ``configuration`` says what made the record:
    controller, robot and versions, in plain JSON types. What is None was not there: a goal that stood still
    has no velocity, only some laws have Delta and zeta, and only a gate has faults and asks for brakes.
    ``excitation`` and ``carried`` are computed when one of them is first read, saved or pickled; until then
    the record holds the states that they are made of, 30 a second, some 60 kB each of a Panda.
    """

    t: np.ndarray  # (N,) [s]
    q: np.ndarray  # (N, nq)
    v: np.ndarray  # (N, nv) [rad/s]
    tau: np.ndarray  # (N, nv) [N m]
    goal: np.ndarray  # (N, nq)
    error: np.ndarray  # (N, nv) e1 = q - q_d at the sample [rad]
    parameters: np.ndarray  # (N, l) estimates of all that the controller learns
    n_potential: int  # j
    effort_limit: np.ndarray  # (nv,) [N m], inf where there is none
    velocity_limit: np.ndarray  # (nv,) [rad/s], inf where there is none
    dt: float  # [s]
    joint_names: tuple[str, ...]
    parameter_labels: tuple[str, ...]  # l
    robot_source: dict[str, Any]
    title: str
    configuration: dict[str, Any]
    parameters_true: np.ndarray | None = None  # (l,)
    parameters_true_course: np.ndarray | None = None  # (N, l)
    goal_velocity: np.ndarray | None = None  # (N, nv) v_d [rad/s]
    goal_acceleration: np.ndarray | None = None  # (N, nv) a_d [rad/s^2]
    delta: np.ndarray | None = None  # (N, k) Delta, or one a direction
    zeta: np.ndarray | None = None  # (N, k) gates zeta_1 in [0, 1)
    zeta_integral: np.ndarray | None = None  # (N, k) [s]
    level: np.ndarray | None = None  # (N,) smallest eigenvalue of what the estimator accumulated
    innovation: np.ndarray | None = None  # (N,) what a regression said that nothing before it had
    external: np.ndarray | None = None  # (N, nv) [N m] what was felt to act on the arm from outside
    excitation: Later = Later()  # (m, 1 + j) t [s], what is known of gravity, in [0, 1]
    carried: Later = Later()  # (m, 6) t [s], load's estimated mass [kg], centre [m], misfit
    lower: np.ndarray | None = None  # (nv,) [rad or m] of the joints' ranges, -inf where there is none
    upper: np.ndarray | None = None  # (nv,) inf where there is none
    q_index: np.ndarray | None = None  # (nv,) where a joint's coordinate stands in q
    faults: tuple[Fault, ...] | None = None  # that a gate latched, in their order
    brakes: tuple[Braking, ...] | None = None  # when it asked for them, and why
    link_names: tuple[str, ...] = ()  # nv, that the joints move; none where it was not recorded
    final_state: Any = None  # the controller's last; not saved

    def __len__(self) -> int:
        return len(self.t)

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle holds: the values."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def __repr__(self) -> str:
        learned = f", {len(self.parameter_labels)} parameters" if self.parameter_labels else ""
        return (
            f"Record({self.title!r}: {len(self.joint_names)} joints, {len(self)} samples of {self.dt:g} s"
            f"{learned})"
        )

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.record(self)

    @property
    def theta(self) -> np.ndarray:
        """(N, j) estimates of the gravity parameters."""
        return self.parameters[:, self._gravity]

    @property
    def theta_labels(self) -> tuple[str, ...]:
        """j names."""
        return self.parameter_labels[self._gravity]

    @property
    def theta_true(self) -> np.ndarray | None:
        """(j,) what theta should become, None where it is not known."""
        return None if self.parameters_true is None else self.parameters_true[self._gravity]

    @property
    def theta_true_course(self) -> np.ndarray | None:
        """(N, j) what theta should be at each sample, where a load changes it."""
        course = self.parameters_true_course
        return None if course is None else course[:, self._gravity]

    @property
    def theta_error(self) -> np.ndarray:
        """(N, j) estimate less true value. Raises RecordError where the true value is not known."""
        return self.parameter_error[:, self._gravity]

    @property
    def parameter_error(self) -> np.ndarray:
        """(N, l) estimate less true value. Raises RecordError where the true value is not known."""
        if self.parameters_true is None:
            raise RecordError(f"record {self.title!r} does not know the true parameters")
        course = self.parameters_true_course
        return self.parameters - (self.parameters_true if course is None else course)

    @property
    def _gravity(self) -> slice:
        size = self.parameters.shape[1]
        return slice(size - self.n_potential, size)

    def settling_time(self, threshold: float = 1e-3) -> float:
        """[s] from when on every |e_i| stays below ``threshold`` [rad]; inf if it does not."""
        return settled(self.t, np.abs(self.error).max(axis=1) < threshold)

    def parameter_settling(self, relative: float = 0.01) -> float:
        """[s] from when on the torque that theta's error makes stays within ``relative`` of gravity's.

        By their sizes, |theta error| <= relative |theta true|: each entry of a scaled theta is the torque
        that it typically makes, so one whose true value is 0 counts by what its error does.
        """
        error = self.theta_error
        off, size = (np.linalg.norm(values, axis=1) for values in (error, self.theta - error))
        return settled(self.t, off <= relative * size)

    def metrics(self, threshold: float = 1e-3) -> Metrics:
        """Settling, steady error, chatter, energy, speed, range and faults; ``threshold`` [rad].

        What is said of rest is of the last second, or of what of it the arm has been settled.
        """
        known, settling = self.parameters_true is not None, self.settling_time(threshold)
        since = min(settling, self.t[-1] - LEAST_REST) if np.isfinite(settling) else -np.inf
        last = self.t >= max(self.t[-1] - LAST, since)
        return Metrics(
            settling_time=settling,
            steady_error=float(np.abs(self.error[last]).max()),
            parameter_settling=self.parameter_settling() if known else float("nan"),
            chatter=chatter(self.t[last], self.tau[last]),
            control_energy=float(np.sum(self.tau**2) * self.dt),
            speed=largest_speed(self.t, self.v, self.velocity_limit, self.dt, self.joint_names),
            beyond=self._beyond(),
            faults=self.faults,
            brakes=self.brakes or (),
        )

    def _beyond(self) -> Extreme | None:
        """Furthest beyond a joint's range; None where the ranges were not recorded."""
        if self.q_index is None or self.lower is None or self.upper is None:
            return None
        x = self.q[:, self.q_index]
        return furthest_beyond(self.t, x, self.lower, self.upper, self.dt, self.joint_names)

    def save(self, path: str | Path) -> Path:
        """Write one compressed .npz, first to a temporary name; returns its path.

        Raises ArgumentError for a name that does not end with .npz.
        """
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
        header = json.dumps({"format": FORMAT, **rest}, ensure_ascii=False)  # as long as the text
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, header=np.array(header), **arrays)
        return path

    @classmethod
    def load(cls, path: str | Path, package_dirs: Sequence[str | Path] = ()) -> Record:
        """Read what `save` wrote. Raises RecordError for anything else.

        package_dirs: whence the robot's meshes may be drawn, beside the folder of its URDF. A record does not
        say so itself: it may come from somebody else.
        """
        path = Path(path)
        with reading(path, "record", "Record.save", RecordError):
            header, arrays = read_archive(path, MOST_BYTES, MOST_GROWTH)
            if (given := header.pop("format", None)) != FORMAT:
                made = header.get("configuration", {}).get("versions", {}).get("eladapt", "another release")
                raise RecordError(
                    f"{path}: a record in format {given}, written by eladapt {made}; this one reads format "
                    f"{FORMAT}. Run the simulation again, or open it with that release"
                )
            missing = [name for name in ARRAYS if name not in arrays]
            if missing:
                raise RecordError(f"{path}: lacks {', '.join(missing)}; make it again")
            for name in ("joint_names", "parameter_labels", "link_names"):
                header[name] = tuple(header.get(name, ()))
            if header.get("faults") is not None:
                header["faults"] = tuple(_fault(*fault) for fault in header["faults"])
            if header.get("brakes") is not None:
                header["brakes"] = tuple(_braking(*braking) for braking in header["brakes"])
            fields: dict[str, Any] = {**dict.fromkeys(OPTIONAL_ARRAYS), **arrays}
            record = cls(**fields, **header, final_state=None)
            record._require_consistent()
        if "urdf" in record.robot_source:
            record.robot_source["package_dirs"] = [str(Path(folder).resolve()) for folder in package_dirs]
        return record

    def _require_consistent(self) -> None:
        """Raises ValueError where what was read is not of the kinds and shapes that the fields have."""
        for name, kind in KINDS.items():
            if not isinstance(value := getattr(self, name), kind):
                raise ValueError(f"{name}: expected {kind.__name__}, got {type(value).__name__}")
        require_number("dt", self.dt, 0)
        names = (*self.joint_names, *self.parameter_labels, *self.link_names)
        if not all(isinstance(name, str) for name in names):
            raise ValueError("joint_names, parameter_labels, link_names: expected texts")
        if self.link_names and len(self.link_names) != len(self.joint_names):
            raise ValueError(f"link_names: expected none or {len(self.joint_names)}, got {self.link_names}")
        if not 0 <= self.n_potential <= len(self.parameter_labels):
            raise ValueError(
                f"n_potential: expected 0 to {len(self.parameter_labels)}, got {self.n_potential}"
            )
        if not {"load", "urdf"} & self.robot_source.keys():
            raise ValueError("robot_source: expected load or urdf in it")
        sizes = {"nv": len(self.joint_names), "l": len(self.parameter_labels), "6": 6}
        for name, letters in SHAPES.items():
            if (array := getattr(self, name)) is not None:
                _require_shape(name, array, letters, sizes)
        if not sizes["N"]:
            raise ValueError("expected at least one sample")
        legal = np.arange(sizes["nq"])
        index = legal if self.q_index is None else self.q_index
        if index.dtype.kind not in "iu" or not np.isin(index, legal).all():
            raise ValueError(f"q_index: expected whole numbers from 0 to {len(legal) - 1}, got {index}")


def _fault(name: object, t: object, message: object) -> Fault:
    """A fault as it was written. Raises ValueError for what is none."""
    if not (isinstance(name, str) and isinstance(message, str)):
        raise ValueError(f"faults: expected texts, got {name!r} and {message!r}")
    return Fault(name, require_number("faults", t, -np.inf), message)


def _braking(t: object, reason: object) -> Braking:
    """A time at which brakes were asked for, as it was written. Raises ValueError for what is none."""
    if not isinstance(reason, str):
        raise ValueError(f"brakes: expected a text, got {reason!r}")
    return Braking(require_number("brakes", t, -np.inf), reason)


def _require_shape(name: str, array: np.ndarray, letters: Sequence[str], sizes: dict[str, int]) -> None:
    """Raises ValueError for another shape, or other sizes by letter; sizes that are new are kept."""
    new = dict(zip(letters, array.shape, strict=False))
    expected = {letter: sizes.setdefault(letter, size) for letter, size in new.items()}
    if array.dtype.kind not in "biuf" or array.ndim != len(letters) or new != expected:
        wanted = ", ".join(f"{letter} = {sizes.get(letter, '?')}" for letter in letters)
        raise ValueError(f"{name}: expected numbers of shape ({wanted}), got {array.shape} of {array.dtype}")
