"""What a log told: parameters, how sure they are, how well they predict, and the robot with them."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, EladaptError, printable
from eladapt.estimation.extensions import Information
from eladapt.estimation.friction import FrictionEstimate, friction_of
from eladapt.estimation.payload import PayloadEstimate, estimate_payload
from eladapt.files import atomic_write
from eladapt.identification.fitting import Fit, triangle_of
from eladapt.identification.prediction import Errors, Torques, percent
from eladapt.identification.rows import Column
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.urdf.checks import edited_urdf
from eladapt.urdf.editing import Edits

if TYPE_CHECKING:
    from eladapt.display.pages import Page


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """The parameters of ``original`` that a log tells, ``theta`` (l,), with the labels of its regressors.

    Columns of one's own stand behind theta's. ``untold``: the directions of theta, in words, that the log
    does not tell; there theta is the URDF's. ``physical`` (l,): the theta of bodies that can be, and
    ``parameters`` (s,) their standard parameters. ``errors``: of predicted torques, by name of the
    parameters, on the part of the log that was held out (on all of it where none was).
    """

    original: Robot
    regressors: Regressors
    fit: Fit
    labels: tuple[str, ...]
    untold: tuple[str, ...]
    physical: np.ndarray | None = None
    parameters: np.ndarray | None = None
    columns: Mapping[str, Column] = field(default_factory=dict)
    errors: Mapping[str, Errors] = field(default_factory=dict)
    torques: Torques | None = None
    held_out: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def theta(self) -> np.ndarray:
        """(l,) by weighted least squares."""
        return self.fit.theta

    @property
    def covariance(self) -> np.ndarray:
        """(l, l) of theta, within what the log tells."""
        return self.fit.covariance

    @functools.cached_property
    def std(self) -> np.ndarray:
        """(l,) standard deviations of theta; inf for a parameter that the log does not tell."""
        return self.fit.std

    @functools.cached_property
    def friction(self) -> FrictionEstimate:
        """Viscous and Coulomb friction and offset of every joint, in physical units."""
        return friction_of(self.regressors, self.theta, self.std)

    @functools.cached_property
    def robot(self) -> Robot:
        """The robot with the physical parameters: bodies, rotors, viscous and Coulomb friction.

        Offsets and columns of one's own have no place in a robot. Raises EladaptError without physical
        parameters.
        """
        return self.original.edited(self._edits)

    @functools.cached_property
    def merged(self) -> tuple[str, ...]:
        """Which links' inertias now stand in the link that carries them, a sentence each."""
        said = []
        for carrier, others in self._bodies.values():
            if others:
                move = "moves" if len(others) == 1 else "move"
                said.append(f"{carrier} holds the inertia of {', '.join(others)} too, which {move} with it")
                held = [joint for joint in self.original.locked if self._children.get(joint) in others]
                if held:
                    said[-1] += f" while {', '.join(held)} hold still: lock them in the new file too"
        return tuple(said)

    def save_urdf(self, path: str | Path) -> Path:
        """Write the robot's file with the physical parameters, otherwise as it was, comments too.

        The inertias of links that joints do not move apart are one, and stand in the link that the others
        hang on (``merged`` names them). Rotors are in <dynamics armature="..."> [kg m^2], which this library
        reads. Meshes with a relative path are found only beside the original. Raises EladaptError without
        physical parameters.
        """
        path = Path(path)
        text = edited_urdf(self.original.path, self.robot.edits or Edits(), self.original.text)
        with atomic_write(path) as temporary:
            temporary.write_bytes(text)
        return path

    def load_since(self, before: Identified, frame: str | None = None) -> PayloadEstimate:
        """The load that hangs on the arm here and did not ``before``, in ``frame`` (the tool if None).

        Friction and offsets may have changed too: a load changes them. Raises ArgumentError for another
        arm's parameters.
        """
        if before.labels != self.labels:
            raise ArgumentError("before: expected parameters of the same robot, with the same terms")
        after_information, before_information = self._information, before._information
        size = len(self.regressors)
        return estimate_payload(
            self.regressors, before.theta[:size], self.theta[:size], after_information, before_information,
            variance=1.0, frame=frame,
        )  # fmt: skip

    @overload
    def report(self, path: None = None) -> Page: ...
    @overload
    def report(self, path: str | Path) -> Path: ...
    def report(self, path: str | Path | None = None) -> Page | Path:
        """One page: torques measured and predicted, errors, parameters before and after. As a file and its
        path, or without a path as a `Page` that a notebook shows."""
        from eladapt.display.identification_report import identification_report
        from eladapt.display.pages import require_page

        if path is not None:
            require_page(path)
        page = identification_report(self)
        return page if path is None else page.save(path)

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.identified(self)

    def __repr__(self) -> str:
        return f"Identified({self.original.name}: {len(self.theta)} parameters, {len(self.untold)} not told)"

    def __str__(self) -> str:
        lines = [repr(self)]
        if self.errors:
            of = f"the last {self.held_out:.0%}, held out" if self.held_out else "the log itself"
            names = _short([printable(name) for name in self.original.joint_names])
            wide = max(10, *map(len, self.errors))
            lines.append(f"torque error [%] on {of}: sample by sample below 10 Hz, and filtered")
            lines.append(" " * wide + "".join(f" {name[-10:]:>10}" for name in (*names, "all")))
            for name, errors in self.errors.items():
                for kind, values in errors._asdict().items():
                    cells = "".join(f" {percent(value):>10}" for value in values)
                    lines.append(f"{name:{wide}}{cells} {kind}")
        lines += [f"not told by the log: {said}" for said in self.untold]
        lines += self.notes
        return "\n".join(lines)

    @property
    def _information(self) -> Information:
        """What is known of the bodies alone, whatever friction and the like are; in standard deviations."""
        size = len(self.regressors)
        others = np.setdiff1d(np.arange(len(self.theta)), self.regressors.inertial)
        order = np.concatenate([others, self.regressors.inertial])
        triangle = triangle_of(self.fit.triangle[:, order])
        bodies = triangle[len(others) :, len(others) :]
        whole = np.zeros((size + 1, size + 1))
        whole[: len(bodies), self.regressors.inertial] = bodies
        return Information(whole, 0.0)

    @functools.cached_property
    def _bodies(self) -> dict[str, tuple[str, list[str]]]:
        """By joint, the link that it moves and those that hang on that one without a joint between."""
        model, found = self.original.model, {}
        for k, joint in enumerate(self.original.joint_names, 1):
            links = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == k]
            carrier = self._children[joint]
            found[joint] = (carrier, [link for link in links if link != carrier])
        return found

    @functools.cached_property
    def _children(self) -> dict[str, str]:
        """By joint, its child link."""
        return {
            joint.get("name", ""): joint.find("child").get("link", "")  # type: ignore[union-attr]
            for joint in self.original.document().findall("joint")
        }

    @functools.cached_property
    def _edits(self) -> Edits:
        if self.parameters is None or self.physical is None:
            raise EladaptError(
                "found: there are no physical parameters: identify(..., physical=True) looks for them, and "
                "found.notes says where there are none"
            )
        regressors, physical = self.regressors, self.physical
        inertials: dict[str, list[float] | None] = {}
        dynamics: dict[str, dict[str, float]] = {name: {} for name in self.original.joint_names}
        for k, (carrier, others) in enumerate(self._bodies.values()):
            inertials[carrier] = [float(x) for x in self.parameters[10 * k : 10 * k + 10]]
            inertials |= dict.fromkeys(others)
        rotors = self.parameters[10 * self.original.nv :]
        for joint, rotor in zip(regressors.rotor_joints, rotors, strict=True):
            dynamics[self.original.joint_names[joint]]["armature"] = max(0.0, float(rotor))
        for term, key in (("viscous", "damping"), ("coulomb", "friction")):
            block = regressors.block(term)
            for joint, value in zip(dynamics, physical[block] / regressors.scale[block], strict=False):
                dynamics[joint][key] = max(0.0, float(value))
        return Edits(inertials, dynamics)


def _short(names: Sequence[str]) -> list[str]:
    """Without the words that they all begin with."""
    words = [name.split("_") for name in names]
    same = 0
    while all(len(parts) > same + 1 and parts[same] == words[0][same] for parts in words):
        same += 1
    return ["_".join(parts[same:]) for parts in words]
