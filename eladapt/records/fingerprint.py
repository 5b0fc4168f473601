"""What a controller is made of, as flat text: ``control.P`` -> ``[60, 60]``, down to the robot's inertias.

Two controllers with the same text do the same with the same state. Numbers have nine digits, so that derived
gains do not differ by the rounding of another machine's linear algebra.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
import pinocchio as pin

from eladapt.control.gains import Gains
from eladapt.regressors.base import ParameterBasis
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot

DIGITS = 9
WRITTEN_OUT = 16  # longer arrays are hashed


def configuration(controller: Any) -> dict[str, str]:
    """The configuration of a controller, or of any part of one, by dotted names."""
    lines: dict[str, str] = {}
    _describe(controller, "", lines)
    return lines


def _describe(value: Any, place: str, lines: dict[str, str]) -> None:
    if isinstance(value, Robot):
        fields: dict[str, Any] = {"model": value.model, "zero_parameters": value.zero_parameters}
    elif isinstance(value, Regressors):
        fields = {
            name: getattr(value, name)
            for name in ("robot", "sharing", "viscous", "coulomb", "scale", "basis")
        }
    elif isinstance(value, ParameterBasis):
        names = ("projection", "kinetic", "potential", "n_potential")
        fields = {name: getattr(value, name) for name in names}
    elif isinstance(value, Gains):
        return  # says where gains come from; they are in the parts
    elif isinstance(value, pin.Model):
        fields = _model(value)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        fields = dict(zip(value._fields, value, strict=True))
    elif isinstance(value, dict):
        fields = {str(key): item for key, item in value.items()}
    elif isinstance(value, tuple | list):
        fields = {str(k): item for k, item in enumerate(value)}
    elif hasattr(value, "__dict__") and not callable(value):
        fields = vars(value)
    else:
        lines[place or "value"] = _text(value)
        return
    if not isinstance(value, tuple | list | dict):
        lines[f"{place}.class".removeprefix(".")] = type(value).__qualname__
    for name, item in fields.items():
        if not name.startswith("_"):
            _describe(item, f"{place}.{name}".removeprefix("."), lines)


def _model(model: pin.Model) -> dict[str, Any]:
    """Everything that a fixed-base model's dynamics and limits depend on."""
    return {
        "joints": ", ".join(list(model.names)[1:]),
        "kinds": ", ".join(joint.shortname() for joint in list(model.joints)[1:]),
        "parents": np.array(model.parents),
        "placements": np.array([place.homogeneous for place in model.jointPlacements]),
        "inertias": np.array([inertia.toDynamicParameters() for inertia in model.inertias]),
        "armature": np.array(model.armature),
        "gravity": np.array(model.gravity.vector),
        "effort": np.array(model.upperEffortLimit),
        "velocity": np.array(model.upperVelocityLimit),
        "lower": np.array(model.lowerPositionLimit),
        "upper": np.array(model.upperPositionLimit),
    }


def _text(value: Any) -> str:
    if isinstance(value, bool | np.bool_ | str | None):
        return str(value)
    if isinstance(value, int | float | np.number):
        return f"{value:.{DIGITS}g}"
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        if value.size <= WRITTEN_OUT:
            return np.array2string(value, separator=", ", max_line_width=10_000, formatter={"all": _text})
        # rounding is by the largest entry: what should be zero differs in all its digits
        finite = value[np.isfinite(value)]
        unit = np.abs(finite).max(initial=0.0) or 1.0
        rounded = np.round(value / unit, DIGITS) + 0.0  # no negative zeros
        digest = hashlib.sha256(rounded.tobytes(order="C")).hexdigest()[:16]
        return f"{value.shape} of size {unit:.6g}, {digest}"
    name = getattr(value, "__qualname__", None)
    return name if isinstance(name, str) else type(value).__qualname__
