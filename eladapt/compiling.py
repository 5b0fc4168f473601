"""The kernels and their compiler: numba, for the types that are told, before a loop and never within one."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

from numba import config, njit, types

SCALAR, COUNT = types.float64, types.int64
VECTOR, MATRIX, CUBE = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
FLAGS, COUNTS, COUNT_MATRIX = types.boolean[::1], types.int64[::1], types.int64[:, ::1]
VIEW = types.Array(types.float64, 1, "A", readonly=True)  # of Pinocchio's vectors

KERNELS: list[tuple[Any, tuple[Any, ...]]] = []  # each with the types of its arguments


def kernel(*arguments: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorates a function that numba compiles, at `prepare`, for these argument types.

    Without argument types it is compiled with the kernels that call it. options: numba's. What was compiled
    is kept beside the source, or where NUMBA_CACHE_DIR says, or nowhere if nothing can be written.
    """

    def register(function: Callable[..., Any]) -> Any:
        try:
            compiled = njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:  # numba found no folder to write to
            compiled = njit(error_model="numpy", **options)(function)
        if arguments and not config.DISABLE_JIT:
            KERNELS.append((compiled, arguments))
        return compiled

    return register


def prepare() -> None:
    """Compile what is not compiled yet; says so on stderr, once, where it takes seconds.

    Whatever leads to a loop calls it first; once done, it costs microseconds.
    """
    for compiled, arguments in KERNELS:
        if compiled.signatures:
            continue
        compiled.compile(arguments)
        if VIEW in arguments:
            compiled.disable_compile()  # other vectors are views too, not a reason to compile again
        if not compiled.stats.cache_hits:
            _say(_how_often(compiled))


@functools.cache
def _say(how_often: str) -> None:
    print(f"eladapt: compiling, some seconds, {how_often}", file=sys.stderr)


def _how_often(compiled: Any) -> str:
    if compiled.stats.cache_path is not None:
        return "once on this computer"
    return "at every start: no folder can be written for the result; set NUMBA_CACHE_DIR to one that can"
