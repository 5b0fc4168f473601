"""A fixed-base robot from its URDF: dynamics, limits and the arithmetic of its configurations.

Every formula is Pinocchio's; this file gives them one convention (armature included everywhere,
damping and friction nowhere), checked arguments, and limits in which 0 or missing is "not set".
"""

from __future__ import annotations

import copy
import functools
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError, require_vector
from eladapt.robot import library
from eladapt.robot.joint_limits import (
    clipped_neutral,
    position_limits,
    published_limits,
    random_configurations,
    set_or_inf,
)
from eladapt.robot.reading import frame_index, last_body, read_document, read_robot, read_visuals
from eladapt.robot.source import arguments, beside_the_model, with_edits
from eladapt.robot.space import Space
from eladapt.scratch import Scratch
from eladapt.signals import Measurement, Reference
from eladapt.urdf.assets import MeshUse
from eladapt.urdf.checks import read_bytes
from eladapt.urdf.editing import Edits
from eladapt.urdf.weighing import require_density


@dataclass(frozen=True, eq=False)
class Robot:
    """M(q) a + C(q, v) v + g(q) = tau (237) for a fixed-base tree of 1-DoF joints.

    Build it with `from_urdf` or `load`. Arrays are in joint order; nq exceeds nv by one for each
    continuous joint, whose configuration is (cos, sin). Threads may share it.
    """

    model: pin.Model
    name: str
    path: Path
    home: np.ndarray  # (nv,) joint coordinates
    target: np.ndarray  # (nv,) joint coordinates of a demonstration move from home
    package_dirs: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    tool: str = ""  # frame of the end effector
    zero_parameters: tuple[str, ...] = ()  # standard parameters known to be zero, as "my(elbow)"
    # What the maker publishes beside the URDF, (nv,) each: any of `robot.joint_limits.PUBLISHED`.
    published: Mapping[str, np.ndarray] = field(default_factory=dict)
    mend: bool = False  # whether bodies that are not physical were mended when the file was read
    density: float | None = None  # [kg/m^3] of links that were weighed by their shapes
    weighed: Mapping[str, pin.Inertia] = field(default_factory=dict)  # those links, each in its own frame
    edits: Edits | None = None  # what is another than in the file
    text: bytes = field(default=b"", repr=False)  # the file's, so that it may move or change
    _space: Space = field(init=False, repr=False)
    _scratch: Scratch[pin.Data] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_space", Space.of(self.model))
        object.__setattr__(self, "_scratch", Scratch(self.model.createData))

    def __repr__(self) -> str:
        ends = self.joint_names if self.nv < 3 else (self.joint_names[0], self.joint_names[-1])
        joints = (" ... " if self.nv > 2 else ", ").join(repr(name[:40]) for name in ends)
        weighed = f", weighed at {self.density:g} kg/m^3: {len(self.weighed)}" if self.weighed else ""
        return f"Robot({self.name[:40]!r}, {self.nv} joints: {joints}, tool {self.tool[:40]!r}{weighed})"

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle holds: all but what was computed."""
        kind, kept = type(self), vars(self)
        computed = {n for n in kept if isinstance(getattr(kind, n, None), functools.cached_property)}
        return {name: value for name, value in kept.items() if name not in computed}

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        package_dirs: Sequence[str | Path] = (),
        locked: Iterable[str] = (),
        *,
        name: str | None = None,
        armature: Mapping[str, float] | None = None,
        home: Sequence[float] | np.ndarray | None = None,
        target: Sequence[float] | np.ndarray | None = None,
        tool: str | None = None,
        zero_parameters: Iterable[str] = (),
        published: Mapping[str, Sequence[float] | np.ndarray] | None = None,
        gravity: Sequence[float] | np.ndarray | None = None,
        mend: bool = False,
        density: float | None = None,
        edits: Edits | None = None,
        text: bytes | None = None,
    ) -> Robot:
        """Read a URDF, lock the joints named (``*`` matches any characters), refuse what is broken.

        Locked joints stay at their neutral position, clipped to their limits; "mimic" stands for all
        that follow another joint. ``gravity`` [m/s^2] is that of the base's frame: (0, 0, 9.81) for
        an arm that hangs from the ceiling. ``armature`` maps joint names to rotor inertias [kg m^2]; a
        joint that turns no inertia and is given none gets an assumed one, with a warning, see
        `assume_rotors`. ``zero_parameters`` are standard parameters that
        symmetry makes zero, as "my(elbow)" for the body behind that joint: `Regressors` then has no
        column for them. ``published`` are limits that the maker gives beside the URDF, a positive
        number a joint, velocity, acceleration, jerk or torque_rate; motions and the torque gate keep to them.
        ``home`` defaults to the neutral posture, clipped to the limits, and ``target`` to home.
        ``mend`` takes the nearest physical inertia for bodies whose principal moments no body has, and
        warns of each change; without it they are refused. ``density`` [kg/m^3] weighs moving links that have
        no <inertial> by their shapes, see `weigh`; from 10 to 23,000. ``edits``: inertias, friction and
        rotors in place of the file's, see `Edits`; a file gives rotors itself as <dynamics armature="...">.
        ``text``: what the file held when it was read before; ``path`` is then where its meshes are.
        Raises UrdfError with every fault found, and UnknownNameError for a joint, frame or limit
        that does not exist.
        """
        path = Path(path)
        density = None if density is None else require_density("density", density)
        text = read_bytes(path) if text is None else text
        read = read_robot(
            path, package_dirs, locked, armature=armature or {}, gravity=gravity, mend=mend, density=density,
            text=text, edits=None if edits is None else Edits(*edits),
        )  # fmt: skip
        model = read.model
        if tool is not None:
            frame_index(model, tool)
        neutral = pin.difference(model, pin.neutral(model), clipped_neutral(model))
        home = neutral if home is None else np.array(require_vector("home", home, model.nv))
        return cls(
            model=model,
            name=name or model.name,
            path=path.resolve(),
            package_dirs=tuple(str(Path(folder).resolve()) for folder in package_dirs),
            locked=read.locked,
            tool=tool or last_body(model),
            zero_parameters=tuple(zero_parameters),
            published=published_limits(published or {}, model.nv),
            mend=mend,
            density=density,
            weighed=read.weighed,
            edits=None if edits is None else Edits(*edits),
            text=text,
            home=home,
            target=np.array(home if target is None else require_vector("target", target, model.nv)),
        )

    def edited(self, edits: Edits) -> Robot:
        """The same with other inertias, friction and rotors.

        Where these are silent, earlier edits stay, and so do links that were weighed or mended. Raises what
        `from_urdf` raises, and UnknownNameError for links, joints and dynamics that there are not.
        """
        return Robot.from_source(with_edits(self, edits))

    @classmethod
    def load(cls, name: str) -> Robot:
        """A robot of the library by name, as described in ``robots/NAME.toml``."""
        entry = library.entry(name)
        return cls.from_urdf(
            entry.urdf, entry.package_dirs, entry.locked, name=name, armature=entry.armature,
            home=entry.home, target=entry.goal, tool=entry.tool, zero_parameters=entry.zero_parameters,
            published=entry.limits,
        )  # fmt: skip

    @functools.cached_property
    def nq(self) -> int:
        """How many numbers a configuration has: two for each continuous joint, one for each other."""
        return self._space.nq

    @functools.cached_property
    def nv(self) -> int:
        """How many joints move."""
        return self._space.nv

    @functools.cached_property
    def joint_names(self) -> tuple[str, ...]:
        """The nv joints that move, in the order of all arrays."""
        return tuple(self.model.names)[1:]

    @functools.cached_property
    def link_names(self) -> tuple[str, ...]:
        """(nv,) the link that each joint moves; links on fixed joints move with it."""
        children = {
            joint.get("name", ""): joint.find("child").get("link", "")  # type: ignore[union-attr]
            for joint in self.document().findall("joint")
        }
        return tuple(children[joint] for joint in self.joint_names)

    @property
    def effort_limit(self) -> np.ndarray:
        """(nv,) [N m or N], +inf where the URDF sets none."""
        return set_or_inf(self.model.upperEffortLimit)

    @property
    def velocity_limit(self) -> np.ndarray:
        """(nv,) [rad/s or m/s], +inf where the URDF sets none."""
        return set_or_inf(self.model.upperVelocityLimit)

    @property
    def lower(self) -> np.ndarray:
        """(nv,) lower joint limits, -inf for continuous joints and where none is set."""
        return position_limits(self.model)[0]

    @property
    def upper(self) -> np.ndarray:
        """(nv,) upper joint limits, +inf for continuous joints and where none is set."""
        return position_limits(self.model)[1]

    @property
    def armature(self) -> np.ndarray:
        """(nv,) rotor inertia seen at the joint [kg m^2]."""
        return np.array(self.model.armature)

    @property
    def damping(self) -> np.ndarray:
        """(nv,) the URDF's viscous friction [N m s/rad]; no dynamics method applies it."""
        return np.array(self.model.damping)

    @property
    def friction(self) -> np.ndarray:
        """(nv,) the URDF's Coulomb friction [N m]; no dynamics method applies it."""
        return np.array(self.model.upperDryFrictionLimit)

    def configuration(self, x: Sequence[float] | np.ndarray | Mapping[str, float]) -> np.ndarray:
        """Joint coordinates (nv,) [rad or m], or one for each joint by name -> q (nq,).

        Raises ArgumentError for another number of them, UnknownNameError for a joint that is none.
        """
        if isinstance(x, Mapping):
            if unknown := [name for name in x if name not in self.joint_names]:
                raise UnknownNameError("joint", unknown, self.joint_names)
            if missing := ", ".join(name for name in self.joint_names if name not in x):
                raise ArgumentError(f"x: expected a coordinate for every joint, none is given for {missing}")
            x = [x[name] for name in self.joint_names]
        return pin.integrate(self.model, pin.neutral(self.model), require_vector("x", x, self.nv))

    def names(self, q: np.ndarray) -> dict[str, float]:
        """The joint coordinates of q (nq,) by joint name, the inverse of `configuration`."""
        return dict(zip(self.joint_names, map(float, self.coordinates(q)), strict=True))

    def coordinates(self, q: np.ndarray, *, check: bool = True) -> np.ndarray:
        """q (nq,) -> joint coordinates (nv,); those of continuous joints in (-pi, pi]. check: whether q is to
        be validated."""
        return pin.difference(self.model, self._neutral, self.check_q(q) if check else q)

    @functools.cached_property
    def _neutral(self) -> np.ndarray:
        return pin.neutral(self.model)

    def mass_matrix(self, q: np.ndarray, *, check: bool = True) -> np.ndarray:
        """M(q) (nv, nv), armature included. check: whether q is to be validated."""
        mass_matrix = pin.crba(self.model, self._scratch.own, self.check_q(q) if check else q)  # a copy
        return mass_matrix if self.nv > 1 else np.reshape(mass_matrix, (1, 1))

    def coriolis_matrix(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """C(q, v) (nv, nv) of the Christoffel symbols, so that dM/dt = C + C' (205)."""
        q, v = self.check_q(q), self.check_v(v)
        return _square(pin.computeCoriolisMatrix(self.model, self._scratch.own, q, v), self.nv)

    def gravity(self, q: np.ndarray, *, check: bool = True) -> np.ndarray:
        """g(q) = grad U(q) (nv,) (209). check: whether q is to be validated."""
        return np.array(
            pin.computeGeneralizedGravity(self.model, self._scratch.own, self.check_q(q) if check else q)
        )

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, *, check: bool = True
    ) -> np.ndarray:
        """M a + C v + g (nv,). check: whether the arguments are to be validated."""
        if check:
            q, v, a = self.check_q(q), self.check_v(v), self.check_v(a, "a")
        return np.array(pin.rnea(self.model, self._scratch.own, q, v, a))

    @functools.cached_property
    def weightless(self) -> pin.Model:
        """A copy of the model without gravity."""
        model = self.model.copy()
        model.gravity = pin.Motion.Zero()
        return model

    def forward_dynamics(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, *, check: bool = True
    ) -> np.ndarray:
        """The acceleration M^-1 (tau - C v - g) (nv,). check: whether the arguments are to be validated."""
        if check:
            q, v, tau = self.check_q(q), self.check_v(v), self.check_v(tau, "tau")
        return np.array(pin.aba(self.model, self._scratch.own, q, v, tau))

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """1/2 v' M(q) v [J], the rotors' included; q (nq,), v (nv,)."""
        v = self.check_v(v)
        return float(0.5 * v @ self.mass_matrix(q) @ v)

    def potential_energy(self, q: np.ndarray) -> float:
        """U(q) [J]; q (nq,)."""
        return float(pin.computePotentialEnergy(self.model, self._scratch.own, self.check_q(q)))

    def difference(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        """The tangent vector (nv,) that leads from q0 to q1; the short way round on continuous joints."""
        return pin.difference(self.model, self.check_q(q0, "q0"), self.check_q(q1, "q1"))

    def integrate(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """q moved by the tangent vector dq (nv,)."""
        return pin.integrate(self.model, self.check_q(q), self.check_v(dq, "dq"))

    def random_configuration(self, rng: np.random.Generator) -> np.ndarray:
        """q (nq,) uniform within the joint limits; (-pi, pi) where none is set."""
        return self.random_configurations(rng, 1)[0]

    def random_configurations(self, rng: np.random.Generator, count: int) -> list[np.ndarray]:
        """``count`` of them, a list of (nq,)."""
        return random_configurations(self.model, rng, count)

    def document(self) -> Element:
        """The URDF's <robot> element, with locked joints held and links weighed."""
        return read_document(self.path, self.locked, self.weighed, self.edits, self.text)

    def visual_model(self) -> tuple[pin.GeometryModel, dict[str, MeshUse]]:
        """The URDF's visuals, attached to the joints that are left, and the meshes among them by name.

        A box stands for a mesh: no mesh file is opened here. Raises UrdfError.
        """
        return read_visuals(self.document(), self.path, self.locked)

    @property
    def source(self) -> dict[str, Any]:
        """What `from_source` needs to build this robot again; plain JSON types."""
        return copy.deepcopy(self._source)

    @functools.cached_property
    def _source(self) -> dict[str, Any]:
        if self.name in library.robots():
            listed = Robot.load(self.name)
            if listed.model == self.model and beside_the_model(listed) == beside_the_model(self):
                return {"load": self.name}
        return arguments(self)

    @classmethod
    def from_source(cls, source: Mapping[str, Any]) -> Robot:
        """The inverse of `source`. Raises ArgumentError for what is none, and what `from_urdf` raises."""
        if "load" in source:
            return cls.load(source["load"])
        options = dict(source)
        try:
            if options.get("text") is not None:
                options["text"] = options["text"].encode("latin-1")
            return cls.from_urdf(options.pop("urdf"), **options)
        except (TypeError, KeyError, AttributeError, UnicodeError) as reason:  # a record from somebody else
            raise ArgumentError(
                f"source: expected what Robot.source gives, got {reprlib.repr(source)} ({reason})"
            ) from reason

    def check_q(self, q: np.ndarray, name: str = "q") -> np.ndarray:
        """q as a finite (nq,) vector on the configuration space; raises ArgumentError."""
        return self._space.check_q(q, name)

    def check_v(self, v: np.ndarray, name: str = "v") -> np.ndarray:
        """v as a finite (nv,) vector; raises ArgumentError."""
        return self._space.check_v(v, name)

    def check_goal(self, goal: np.ndarray | Reference) -> Reference:
        """A goal q_d (nq,), at rest, or a `Reference`, as a reference of finite vectors of this robot's size
        that are its own, so that whoever asked may go on writing to theirs.

        Raises ArgumentError, naming what is wrong: a shape, a number that is not finite, a continuous joint
        whose (cos, sin) is off the unit circle.
        """
        if isinstance(goal, Reference):
            return self._space.check_reference(goal)
        return Reference(self.check_q(goal, "goal").copy(), self.still, self.still)

    @functools.cached_property
    def still(self) -> np.ndarray:
        """(nv,) zeros: no velocity, no acceleration. Not to be written to."""
        still = np.zeros(self.nv)
        still.setflags(write=False)
        return still

    def check_measurement(self, measurement: Measurement) -> Measurement:
        """The measurement with float vectors of its own, so that a driver may reuse its buffers.

        Raises ArgumentError, naming the field, for wrong shapes, for what is not finite, and for what is no
        arm's: a filter that has taken in 1e80 rad/s is of no use for any sample after.
        """
        return self._space.check_measurement(measurement)


def _square(matrix: np.ndarray, size: int) -> np.ndarray:
    """A copy, square also for one joint, of which the bindings return a vector."""
    return np.array(matrix).reshape(size, size)
