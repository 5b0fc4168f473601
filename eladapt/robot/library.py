"""The robots that come with eladapt: one TOML each under ``robots/``, found in a checkout or a wheel."""

from __future__ import annotations

import functools
import importlib.metadata
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from eladapt.errors import EladaptError, Finding, UnknownNameError

EXAMPLE_ROBOT_DATA = "example-robot-data"


class Entry(NamedTuple):
    """One robot's TOML, with its paths resolved."""

    urdf: Path
    package_dirs: tuple[Path, ...]
    locked: tuple[str, ...]
    armature: Mapping[str, float]
    home: list[float] | None
    goal: list[float] | None
    tool: str | None
    zero_parameters: tuple[str, ...]
    limits: Mapping[str, list[float]]
    description: str


def folder() -> Path:
    """Where the TOML files lie: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "_robots"
    return shipped if shipped.is_dir() else package.parent / "robots"


def robots() -> list[str]:
    """The robots that `Robot.load` knows, in alphabetical order."""
    return sorted(path.stem for path in folder().glob("*.toml"))


def entry(name: str) -> Entry:
    """The description of one robot. Raises UnknownNameError, which lists the legal names."""
    if name not in robots():
        raise UnknownNameError("robot", [name], robots())
    with (folder() / f"{name}.toml").open("rb") as file:
        table = tomllib.load(file)
    root = example_robot_data() if table.get("source") == EXAMPLE_ROBOT_DATA else folder()
    return Entry(
        urdf=root / table["urdf"],
        package_dirs=(
            root,
            root.parent.parent,
        ),  # package://NAME/ and package://example-robot-data/robots/NAME/
        locked=tuple(table.get("locked", ())),
        armature=table.get("armature", {}),
        home=table.get("home"),
        goal=table.get("goal"),
        tool=table.get("tool"),
        zero_parameters=tuple(table.get("zero_parameters", ())),
        limits=table.get("limits", {}),
        description=table.get("description", ""),
    )


@functools.cache
def example_robot_data() -> Path:
    """The folder of robots in the example-robot-data wheel, which has no module to import."""
    try:
        files = importlib.metadata.files(EXAMPLE_ROBOT_DATA) or []
    except importlib.metadata.PackageNotFoundError as reason:
        raise EladaptError(f"the package {EXAMPLE_ROBOT_DATA} is not installed: pip install it") from reason
    for file in files:
        if file.match("robots/panda_description/urdf/panda.urdf"):
            return Path(str(file.locate())).resolve().parents[2]
    raise EladaptError(f"the installed {EXAMPLE_ROBOT_DATA} holds no robots; reinstall it")


def unreadable(reason: Exception) -> Finding:
    """A finding for what the URDF reader itself refused."""
    text = str(reason).strip().splitlines()
    return Finding(
        "file", text[0] if text else type(reason).__name__, "the URDF reader refused it",
        "Check it with check_urdf from the liburdfdom tools",
    )  # fmt: skip
