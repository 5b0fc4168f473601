"""What something is made of, in plain JSON types, down to the robot's inertias.

One description serves both uses: a record keeps it as it is, and a saved state is refused by a controller
whose `identity`, the same as flat text (``control.P`` -> ``[60, 60]``), is another one. Two controllers with
the same identity do the same with the same state. Numbers in it have nine digits, so that derived gains do
not differ by the rounding of another machine's linear algebra.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.metadata
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from eladapt.regressors.base import ParameterBasis
from eladapt.robot.model import Robot

DIGITS = 9
WRITTEN_OUT = 100  # numbers; of longer arrays a hash is kept
COMPARED = 16  # numbers of an array that an identity holds one by one; of longer ones a hash
# No part of what a controller does: how fast it does it, what it shows, where its gains come from.
NOT_IDENTITY = ("progress", "gains")
SETTINGS = (
    "integrator", "substeps", "seed", "joint_friction", "friction", "noise", "payload", "mjcf",
    "resolution", "time_constant", "delay",
)  # fmt: skip


def describe(value: Any) -> Any:
    """A configuration as plain JSON types: what has fields as {"class": ..., field: ...}, without private
    ones; arrays as lists, long ones as text with a hash; anything else by the name of its class."""
    return _described(value, ())


def describe_plant(plant: Any) -> Any:
    """What was simulated, as plain JSON types; what stands around a plant comes first."""
    if plant is None:
        return None
    settings = {name: describe(getattr(plant, name)) for name in SETTINGS if name in vars(plant)}
    inner = {"plant": describe_plant(plant.plant)} if "plant" in vars(plant) else {}
    return {"class": type(plant).__name__, **settings, **inner}


def innermost(described: Any) -> Mapping[str, Any]:
    """Of a described controller, what is in whatever stands around it; empty where none is described."""
    while isinstance(described, Mapping) and isinstance(described.get("controller"), Mapping):
        described = described["controller"]
    return described if isinstance(described, Mapping) else {}


def versions() -> dict[str, str]:
    """The releases that made a record."""
    return {name: _version(name) for name in ("eladapt", "pin", "numpy", "scipy")}


_version = functools.cache(importlib.metadata.version)  # milliseconds, of which a short run has few


def identity(controller: Any) -> dict[str, str]:
    """What decides what a controller does with its state, by dotted names."""
    lines: dict[str, str] = {}
    _flatten(describe(controller), "", lines)
    return lines


def _flatten(described: Any, place: str, lines: dict[str, str]) -> None:
    if isinstance(described, Mapping):
        for name, part in described.items():
            if name not in NOT_IDENTITY:
                _flatten(part, f"{place}.{name}".removeprefix("."), lines)
    elif (array := _numbers(described)) is not None and array.size > COMPARED:
        lines[place or "value"] = _hashed(array)
    elif isinstance(described, list) and array is None:
        for k, part in enumerate(described):
            _flatten(part, f"{place}.{k}".removeprefix("."), lines)
    else:
        lines[place or "value"] = _text(described)


def _numbers(described: Any) -> np.ndarray | None:
    """Nested lists of numbers as the array that they were; None for anything else."""
    if not isinstance(described, list):
        return None
    try:
        array = np.asarray(described)
    except ValueError:  # lists of different lengths
        return None
    return array if array.dtype.kind in "biuf" else None


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:.{DIGITS}g}"
    return str(value)


def _described(value: Any, within: tuple[int, ...]) -> Any:
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return _array(np.asarray(value))
    if id(value) in within:  # it holds itself
        return type(value).__name__
    within = (*within, id(value))
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        if len(value) > WRITTEN_OUT and all(isinstance(item, int | float) for item in value):
            return _array(np.asarray(value))
        return [_described(item, within) for item in value]
    fields = _fields(value)
    if fields is None:
        name = getattr(value, "__qualname__", None)
        return name if isinstance(name, str) else type(value).__qualname__
    named = {} if isinstance(value, dict) else {"class": type(value).__qualname__}
    parts = {name: item for name, item in fields.items() if not name.startswith("_")}
    return named | {name: _described(item, within) for name, item in parts.items()}


def _fields(value: Any) -> dict[str, Any] | None:
    """What something is made of by name, as far as it matters; None if it has no parts."""
    if isinstance(value, Robot):
        return {"model": value.model, "zero_parameters": value.zero_parameters, "tool": value.tool}
    if isinstance(value, ParameterBasis):
        names = ("projection", "kinetic", "potential", "n_potential")
        return {name: getattr(value, name) for name in names}
    if isinstance(value, pin.Model):
        return _model(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return dict(zip(value._fields, value, strict=True))
    if isinstance(value, dict):
        return {str(key): item for key, item in value.items()}
    if not hasattr(value, "__dict__") or callable(value):
        return None
    kind = type(value)  # what it worked out and kept is no part of it
    cached = {n for n in vars(value) if isinstance(getattr(kind, n, None), functools.cached_property)}
    return {name: item for name, item in vars(value).items() if name not in cached}


def _model(model: pin.Model) -> dict[str, Any]:
    """Everything that a fixed-base model's dynamics and limits depend on."""
    return {
        "joints": ", ".join(list(model.names)[1:]),
        "kinds": ", ".join(joint.shortname() for joint in list(model.joints)[1:]),
        "parents": np.array(model.parents),
        "placements": np.array([place.homogeneous for place in model.jointPlacements]),
        "inertias": np.array([inertia.toDynamicParameters() for inertia in model.inertias]),
        "armature": np.array(model.armature),
        "damping": np.array(model.damping),
        "friction": np.array(model.friction),
        "gravity": np.array(model.gravity.vector),
        "effort": np.array(model.upperEffortLimit),
        "velocity": np.array(model.upperVelocityLimit),
        "lower": np.array(model.lowerPositionLimit),
        "upper": np.array(model.upperPositionLimit),
    }


def _array(value: np.ndarray) -> Any:
    if value.dtype.kind not in "biuf":
        return value.tolist() if value.dtype.kind in "US" else type(value).__name__
    return value.tolist() if value.size <= WRITTEN_OUT else _hashed(value)


def _hashed(value: np.ndarray) -> str:
    # rounding is by the largest entry: what should be zero differs in all its digits
    finite = value[np.isfinite(value)]
    unit = np.abs(finite).max(initial=0.0) or 1.0
    rounded = np.round(value / unit, DIGITS) + 0.0  # no negative zeros
    digest = hashlib.sha256(rounded.tobytes(order="C")).hexdigest()[:16]
    return f"{value.shape} of size {unit:.6g}, {digest}"
