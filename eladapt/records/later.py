"""What a record has only once somebody asks for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


class Later:
    """A field of a dataclass, None by default, that may be given as a function that makes its value: it is
    called when the field is first read."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, record: Any, owner: type | None = None) -> Any:
        if record is None:
            return None  # the default
        value = vars(record).get(self._name)
        if callable(value):
            value = vars(record)[self._name] = value()
        return value

    def __set__(self, record: Any, value: Any) -> None:
        vars(record)[self._name] = value


class Review:
    """What is computed of the states that were kept, all of it when the first is asked for; the states are
    let go then."""

    def __init__(self, make: Callable[[], Mapping[str, np.ndarray]]):
        self._make: Callable[[], Mapping[str, np.ndarray]] | None = make
        self._found: Mapping[str, np.ndarray] = {}

    def get(self, name: str) -> np.ndarray | None:
        """The rows of this name, None where there are none."""
        if (make := self._make) is not None:  # two threads may both make it
            self._found, self._make = make(), None
        return self._found.get(name)
