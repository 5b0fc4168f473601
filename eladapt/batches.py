"""Arrays of a batch as compiled kernels want them: its axis last, aligned, in memory that is used again."""

from __future__ import annotations

import functools
import math
from collections import deque

import numpy as np

from eladapt.errors import ArgumentError

ALIGNMENT = 8  # doubles; a vector of eight that straddles two lines of the cache takes twice the time
LARGE = 1 << 14  # doubles; from here on, fresh memory costs more than the kernel that fills it
SPARE = 2  # arrays of one kind that are kept


def aligned(shape: tuple[int, ...]) -> np.ndarray:
    """An empty array of doubles that begins at a line of the cache."""
    size = math.prod(shape)
    return (_fresh(size) if size < LARGE else _lease(size)).reshape(shape)


def triangular(shape: tuple[int, int, int]) -> np.ndarray:
    """(n, n, B) of triangles to be filled in; what is below their diagonals is zero and must be left so.

    Writing all those zeros each time would be a third of what a kernel writes. Show the array with
    `read_only`.
    """
    return _lease(math.prod(shape), shape).reshape(shape)


def read_only(array: np.ndarray) -> np.ndarray:
    """A view that refuses to be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


def _fresh(size: int, zeros: bool = False) -> np.ndarray:
    memory = (np.zeros if zeros else np.empty)(size + ALIGNMENT)
    skipped = -(memory.ctypes.data // memory.itemsize) % ALIGNMENT
    return memory[skipped : skipped + size]


class _Lease:
    """Memory that is laid by for the next array of its kind when no array is left that shows it.

    NumPy's arrays keep what they are made of, if that is no array itself.
    """

    def __init__(self, memory: np.ndarray, spare: deque[np.ndarray]):
        self._memory, self._spare = memory, spare
        self.__array_interface__ = memory.__array_interface__

    def __del__(self) -> None:
        self._spare.append(self._memory)


def _lease(size: int, triangles: tuple[int, int, int] | None = None) -> np.ndarray:
    """Memory of ``size`` doubles; triangles: the shape, for memory with zeros where triangles have them."""
    spare = _spare(size, triangles)
    try:
        memory = spare.pop()
    except IndexError:
        memory = _fresh(size, zeros=triangles is not None)
    return np.asarray(_Lease(memory, spare))


@functools.lru_cache(maxsize=16)
def _spare(size: int, triangles: tuple[int, int, int] | None) -> deque[np.ndarray]:
    """What memory of this kind is free."""
    return deque(maxlen=SPARE)


def with_axes(array: np.ndarray, own: int, lead: tuple[int, ...]) -> np.ndarray:
    """(*lead, *own): an array with fewer or shorter leading axes counts for all. own: how many axes.

    Raises ArgumentError where they do not fit.
    """
    leading = array.shape[: array.ndim - own]
    if leading == lead:
        return array
    try:
        return np.broadcast_to(array, (*lead, *array.shape[len(leading) :]))
    except ValueError as reason:
        raise ArgumentError(
            f"batch: expected the leading axes {lead}, got {leading}, of the shape {array.shape}; "
            "give one entry for each estimator of the state, or no leading axes, to count for all"
        ) from reason


def batch_last(array: np.ndarray, own: int, lead: tuple[int, ...]) -> np.ndarray:
    """`with_axes` as (*own, B), contiguous; no copy of what `batch_first` shows."""
    array, axes = with_axes(array, own, lead), len(lead)
    moved = array.transpose(*range(axes, array.ndim), *range(axes))
    if not moved.flags.c_contiguous:
        found = aligned(moved.shape)
        found[...] = moved
        moved = found
    return moved if axes == 1 else moved.reshape(*moved.shape[:own], math.prod(lead))


def batch_first(array: np.ndarray, lead: tuple[int, ...]) -> np.ndarray:
    """(*own, B) -> (*lead, *own): a view, whose leading axes are the last in memory."""
    own = array.ndim - 1
    whole = array if len(lead) == 1 else array.reshape(*array.shape[:-1], *lead)
    return whole.transpose(*range(own, own + len(lead)), *range(own))
