"""A controller's state on disk, so that a run goes on after a crash where it was, bit for bit.

A state is NamedTuples of arrays, numbers and text, however deep. Its shape is kept as JSON, its arrays as
they lie in memory; nothing in the file is code. The file also holds what the controller was made of, with a
hash of that, and a hash of all it holds: another robot's or another configuration's state is refused, and so
is a file that was cut short or changed.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import importlib.metadata
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, EladaptError, StateError
from eladapt.files import atomic_write
from eladapt.records.archive import read_archive, reading
from eladapt.records.description import identity
from eladapt.records.state_check import require_state_of
from eladapt.robot.protocols import BareController

FORMAT = 2
MOST_BYTES = 1 << 26  # of arrays in memory; a Panda's state has 0.3 MB
SHOWN = 4  # differences named in a message


class StateWriter:
    """Writes states of one controller, of which what it is made of is looked up but once."""

    def __init__(self, controller: Any):
        self.configuration = identity(controller)
        self.key = _key(self.configuration)

    def write(self, path: str | Path, state: Any) -> Path:
        """See `save_state`."""
        path, contents = Path(path), self._contents(path, state)
        with _named_failure(path), atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **contents)  # type: ignore[arg-type]
        return path

    def rehearse(self, path: str | Path, state: Any) -> None:
        """Write the state to a nameless file beside ``path``, which stays as it is. Raises as `write`."""
        path, contents = Path(path), self._contents(path, state)
        with _named_failure(path):
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path.parent) as file:
                np.savez(file, **contents)  # type: ignore[arg-type]

    def _contents(self, path: str | Path, state: Any) -> dict[str, np.ndarray]:
        """The arrays of the file. Raises ArgumentError for what is no state, or no name for one."""
        if Path(path).suffix != ".npz":
            raise ArgumentError(f"path: expected a name that ends with .npz, got {Path(path).name!r}")
        arrays: dict[str, np.ndarray] = {}
        tree = _encode(state, arrays, "state")
        header = json.dumps(
            {
                "format": FORMAT, "tree": tree, "configuration": self.configuration, "key": self.key,
                "digest": _digest(tree, arrays), "eladapt": importlib.metadata.version("eladapt"),
            }
        )  # fmt: skip
        return {"header": np.array(header), **arrays}


def save_state(path: str | Path, controller: Any, state: Any) -> Path:
    """Write ``state`` of ``controller``, first to a temporary name, then renamed; returns the path.

    path: ends with .npz. Raises ArgumentError for what is no state, StateError where writing fails.
    """
    return StateWriter(controller).write(path, state)


def load_state(path: str | Path, controller: Any) -> Any:
    """The state that `save_state` wrote for such a controller: same robot, same configuration.

    Raises StateError for a file that is missing, damaged, or another controller's, or whose state is none
    that ``controller.init`` could have led to; it names what differs.
    """
    path = Path(path)
    with reading(path, "saved state", "save_state", StateError):
        header, arrays = read_archive(path, MOST_BYTES, ratio=1)
        if header["format"] != FORMAT:
            raise StateError(
                f"{path}: a state in format {header['format']}, written by eladapt {header.get('eladapt')}; "
                f"this one reads format {FORMAT}. Begin with controller.init, or go on with that release"
            )
        tree, kept, key, digest = (header[name] for name in ("tree", "configuration", "key", "digest"))
        if digest != _digest(tree, arrays) or key != _key(kept):
            raise StateError(f"{path}: damaged, its contents are not what was written; use an older one")
        made_of = identity(controller)
        if key != _key(made_of):
            said = _differences(kept, made_of)
            raise StateError(f"{path}: saved by another controller or for another robot: {said}")
        return _checked(controller, _decode(tree, arrays, path), path)


def _checked(controller: BareController, state: Any, path: Path) -> Any:
    """The state if the controller could have had it; StateError names the file, too."""
    try:
        return require_state_of(controller, state)
    except EladaptError as reason:
        raise StateError(f"{path}: not a state of this controller (use an older file): {reason}") from reason


@contextlib.contextmanager
def _named_failure(path: Path) -> Iterator[None]:
    """What the system says against writing, as a StateError."""
    try:
        yield
    except OSError as reason:
        raise StateError(f"{path}: cannot be written ({reason.strerror})") from reason


def on_clock(state: Any, shift: float) -> Any:
    """The state with every time stamp later by ``shift`` [s]: the robot's clock has been set."""
    if not isinstance(state, tuple):
        return state
    if not hasattr(state, "_fields"):
        return tuple(on_clock(item, shift) for item in state)
    moved = {name: on_clock(getattr(state, name), shift) for name in state._fields}
    if isinstance(moved.get("t"), float):
        moved["t"] += shift
    return type(state)(**moved)


def _key(made_of: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()


def _digest(tree: Any, arrays: Mapping[str, np.ndarray]) -> str:
    total = hashlib.sha256(json.dumps(tree).encode())
    for name in sorted(arrays):
        array = arrays[name]
        layout = f"{name} {array.dtype.str} {array.shape} {array.flags.f_contiguous}"
        total.update(layout.encode())
        total.update(array.tobytes(order="A"))
    return total.hexdigest()


def _differences(kept: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    names = [name for name in {*kept, *wanted} if kept.get(name) != wanted.get(name)]
    # what both have comes first, and the robot, its joints before all: other differences may follow from it
    names.sort(
        key=lambda name: (
            not (name in kept and name in wanted), ".model." not in name,
            not name.endswith(".model.joints"), name,
        )
    )  # fmt: skip
    said = [
        f"{name} is {wanted.get(name, 'absent')}, in the file {kept.get(name, 'absent')}" for name in names
    ]
    rest = f"; and {len(said) - SHOWN} more" if len(said) > SHOWN else ""
    return "; ".join(said[:SHOWN]) + rest


def _encode(value: Any, arrays: dict[str, np.ndarray], place: str) -> Any:
    """JSON for a node; arrays (and numpy's numbers, as arrays without dimension) are put aside."""
    if isinstance(value, np.ndarray | np.generic):
        if np.asarray(value).dtype.hasobject:
            raise ArgumentError(f"{place}: expected numbers, got an array of objects")
        name = f"a{len(arrays)}"
        # a copy in the order it lies in: what reads it next adds in the same order
        arrays[name] = np.array(value, order="K")
        return {"array": name, "number": isinstance(value, np.generic)}
    if value is None or isinstance(value, bool | int | str):
        return {"value": value}
    if isinstance(value, float):
        return {"float": value.hex()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        fields = {name: _encode(getattr(value, name), arrays, f"{place}.{name}") for name in value._fields}
        return {"tuple": [type(value).__module__, type(value).__qualname__], "fields": fields}
    if isinstance(value, tuple | list):
        items = [_encode(item, arrays, f"{place}[{k}]") for k, item in enumerate(value)]
        return {"list" if isinstance(value, list) else "plain": items}
    raise ArgumentError(
        f"{place}: expected NamedTuples, arrays, numbers, text or None, got {type(value).__name__}"
    )


def _decode(node: Any, arrays: Mapping[str, np.ndarray], path: Path) -> Any:
    if "array" in node:
        array = arrays[node["array"]]
        return array[()] if node["number"] else array
    if "float" in node:
        return float.fromhex(node["float"])
    if "tuple" in node:
        module, name = node["tuple"]
        kind = _class(module, name, path)
        if tuple(kind._fields) != tuple(node["fields"]):
            raise StateError(
                f"{path}: {kind.__name__} has the fields {', '.join(kind._fields)}, in the file "
                f"{', '.join(node['fields'])}; it was saved by another version"
            )
        return kind._make(_decode(field, arrays, path) for field in node["fields"].values())
    if "list" in node or "plain" in node:
        items = [_decode(item, arrays, path) for item in node.get("list", node.get("plain"))]
        return items if "list" in node else tuple(items)
    return node["value"]


def _class(module: str, name: str, path: Path) -> Any:
    """A NamedTuple class of a module that is imported already: a file cannot make code run."""
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if not (isinstance(found, type) and issubclass(found, tuple) and hasattr(found, "_fields")):
        raise StateError(f"{path}: holds a {module}.{name}, which is no NamedTuple of an imported module")
    return found
