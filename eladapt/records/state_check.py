"""Whether a state from a file is one that its controller could have had.

What the controller makes afresh says what each field holds: the same NamedTuples, arrays of the same shape
and type, finite where they begin finite. A field that begins as None says by its type what it may become.
"""

from __future__ import annotations

import typing
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np

from eladapt.errors import EladaptError, StateError
from eladapt.robot.model import Robot
from eladapt.robot.protocols import BareController
from eladapt.signals import Measurement

SCALARS: tuple[Any, ...] = (
    bool | np.bool_,
    int | np.integer,
    float | np.floating,
    str,
)  # a bool is an int, too


def require_state_of(controller: BareController, state: Any) -> Any:
    """The state. Raises StateError, naming the field, what it should hold and what it does."""
    robot = controller.robot
    fresh = controller.init(_seen(state, robot))
    _compare(state, fresh, "state", Any, robot)
    return state


def _seen(state: Any, robot: Robot) -> Measurement:
    """The state's own measurement, or one at home where it has none that is one."""
    try:
        return robot.check_measurement(state.measurement)
    except (EladaptError, AttributeError, TypeError, ValueError, OverflowError):
        return Measurement(0.0, robot.configuration(robot.home), *np.zeros((2, robot.nv)))


def _compare(value: Any, fresh: Any, place: str, hint: Any, robot: Robot) -> None:
    if fresh is None:
        _require_typed(value, hint, place, robot)
    elif isinstance(fresh, tuple | list):
        if type(value) is not type(fresh) or len(value) != len(fresh):
            raise _wrong(place, _named(fresh), value)
        names = getattr(fresh, "_fields", None) or [f"[{k}]" for k in range(len(fresh))]
        hints = _hints(type(fresh))
        for name, part, new in zip(names, value, fresh, strict=True):
            deeper = f"{place}.{name}".replace(".[", "[")
            _compare(part, new, deeper, hints.get(name, Any), robot)
    elif isinstance(fresh, np.ndarray):
        _require_array(value, fresh.dtype, fresh.shape, place)
        _require_numbers(value, fresh, place)
    else:
        _require_scalar(value, fresh, place)


def _require_scalar(value: Any, fresh: Any, place: str) -> None:
    kind = next((kind for kind in SCALARS if isinstance(fresh, kind)), type(fresh))
    if not isinstance(value, kind) or isinstance(value, bool) != isinstance(fresh, bool):
        raise _wrong(place, f"a {type(fresh).__name__}", value)
    if isinstance(fresh, float | np.floating):
        _require_numbers(np.asarray(value), np.asarray(fresh), place)
    elif type(fresh) is int and (int(value) != fresh if fresh else int(value) < 0):
        # what counts begins at 0; any other whole number is a size
        raise _wrong(place, f"{fresh}" if fresh else "a count", value)


def _require_numbers(value: np.ndarray, fresh: np.ndarray, place: str) -> None:
    """Finite where it begins finite, and no nan but where it begins as one."""
    if value.dtype.kind not in "fc":
        return
    bad = ~np.isfinite(value) & np.isfinite(fresh) | np.isnan(value) & ~np.isnan(fresh)
    if bad.any():
        raise _wrong(place, "finite numbers", value)


def _require_array(value: Any, dtype: np.dtype[Any], shape: tuple[int, ...], place: str) -> None:
    if not isinstance(value, np.ndarray) or value.dtype != dtype or value.shape != shape:
        raise _wrong(place, f"an array of {dtype} of shape {shape}", value)


def _require_typed(value: Any, hint: Any, place: str, robot: Robot) -> None:
    """A value where there is none at the beginning, by its type hint alone."""
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    for option in options:
        kind, *size = get_args(option) if get_origin(option) is Annotated else (option,)
        if kind is Any or (value is None and kind in (None, type(None))):
            return
        if kind is np.ndarray and isinstance(value, np.ndarray):
            sizes = [getattr(robot, name) for name in size] or [robot.nq, robot.nv]
            shape = (value.size if value.size in sizes else sizes[0],)
            _require_array(value, np.dtype(float), shape, place)
            return _require_numbers(value, np.zeros(shape), place)
        if not isinstance(kind, type) or not isinstance(value, kind):
            continue
        for name, deeper in _hints(kind).items():
            _require_typed(getattr(value, name), deeper, f"{place}.{name}", robot)
        if isinstance(value, float | np.floating):
            _require_numbers(np.asarray(value), np.zeros(()), place)
        return None
    raise _wrong(place, " or ".join(getattr(option, "__name__", str(option)) for option in options), value)


def _hints(kind: type) -> dict[str, Any]:
    """The types of a NamedTuple's fields, as far as they can be told."""
    try:
        return typing.get_type_hints(kind, include_extras=True) if hasattr(kind, "_fields") else {}
    except NameError:  # a class within a function
        return {}


def _named(fresh: Any) -> str:
    return f"a {type(fresh).__name__} of {len(fresh)} parts"


def _wrong(place: str, expected: str, value: Any) -> StateError:
    given = f"an array of {value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fc" and not np.isfinite(value).all():
        given = f"{np.count_nonzero(~np.isfinite(value))} of {value.size} that are not"
    shown = repr(value)
    given = given or (shown if len(shown) < 80 else f"a {type(value).__name__}")
    return StateError(f"{place}: expected {expected}, got {given}")
