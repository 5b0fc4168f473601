"""One source, two ways to run it: as Python with numpy, or compiled by numba (extra ``fast``).

A kernel is a function of numbers and arrays in the part of the language that numba compiles. It runs as
it stands; `compiled` returns its compiled twin. Helpers that kernels call are marked with `jitable` and stand
in the same file, since numba's cache looks at that file alone.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from types import ModuleType
from typing import Any, TypeVar

from eladapt.errors import EladaptError

F = TypeVar("F", bound=Callable[..., Any])

_helpers: list[Callable[..., Any]] = []


def jitable(function: F) -> F:
    """Mark a function that compiled kernels may call."""
    _helpers.append(function)
    return function


@functools.cache
def kernel_module(name: str) -> ModuleType:
    """A module of compiled loops. Raises EladaptError without numba."""
    try:
        return importlib.import_module(name)
    except ImportError as reason:
        raise _missing(reason) from reason


@functools.cache
def compiled(kernel: F) -> F:
    """The kernel, compiled at its first call and kept on disk. Raises EladaptError without numba."""
    try:
        import numba
        from numba.extending import register_jitable
    except ImportError as reason:
        raise _missing(reason) from reason
    while _helpers:
        register_jitable(_helpers.pop())
    return numba.njit(kernel, cache=True)


def _missing(reason: ImportError) -> EladaptError:
    return EladaptError(
        f'compiled=True needs numba, which is not installed ({reason}): pip install "eladapt[fast]"'
    )
