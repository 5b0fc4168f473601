"""Working memory of which every thread has its own.

Pinocchio and ruckig write what they compute into memory that they are handed. Two threads that hand them the
same memory read each other's numbers, so whatever keeps such memory from call to call keeps it here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Scratch(threading.local, Generic[T]):
    """``own`` is the calling thread's, made when the thread first asks; a pickle holds ``make`` alone."""

    def __init__(self, make: Callable[[], T]):
        self._make, self.own = make, make()  # threading.local calls this once in each thread

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._make,)
