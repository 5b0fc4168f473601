"""eladapt: composite adaptive finite-time control for any robot with a URDF.

The public names and where they come from are in ``__init__.pyi``, which type checkers read. Each is imported
when it is asked for: a control loop on a robot's computer draws nothing, and the import takes milliseconds.
"""

import importlib.metadata
from typing import Any

import lazy_loader

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.metadata.version("eladapt")
    return _named(name)
