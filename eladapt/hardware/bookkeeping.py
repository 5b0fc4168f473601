"""What a loop keeps of a run, its record and its checkpoints, without ever stopping the robot for it."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import BookkeepingWarning, require_number
from eladapt.records.record import Record
from eladapt.records.recorder import Recorder
from eladapt.records.state_file import StateWriter
from eladapt.robot.protocols import BareController
from eladapt.signals import Reference


class Bookkeeping:
    """A recorder and a checkpoint file; what can be found wrong with them is raised when it is made.

    state: one like those that will be kept, None where none is at hand. checkpoint: a file, None for none;
    every [s]: how often it is written. After that nothing raises: a failure is kept in ``failures``, one text
    for the record and one for the checkpoint, and warned of. A record ends at its failure, so that it has no
    holes; a checkpoint is tried again. Raises ArgumentError, and StateError where the file cannot be written.
    """

    def __init__(
        self,
        controller: BareController,
        dt: float,
        capacity: int,
        title: str,
        state: Any,
        checkpoint: str | Path | None,
        every: float,
    ):
        self.failures: dict[str, str] = {}
        self.checkpoint, self.period = checkpoint, require_number("every", every, 0) / dt
        self._recorder = Recorder(controller.robot, controller, dt, capacity, title)
        self._writer = StateWriter(controller) if checkpoint else None
        self._saved = 0
        if self._writer and checkpoint:
            self._writer.rehearse(checkpoint, state)
        if state is not None:
            self._recorder.reserve(state)

    def keep(
        self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, goal: Reference, state: Any, ticks: int
    ) -> None:
        """One sample, as `Recorder.add` takes it, and a checkpoint if one is due after so many ticks."""
        if "record" not in self.failures:
            self._attempt("record", lambda: self._recorder.add(t, q, v, tau, goal, state))
        if ticks - self._saved >= self.period:
            self.save(state)
            self._saved = ticks

    def save(self, state: Any) -> None:
        """A checkpoint now, if there is a file for it."""
        writer, path = self._writer, self.checkpoint
        if writer and path and state is not None:
            self._attempt("checkpoint", lambda: writer.write(path, state))

    def record(self) -> Record | None:
        """All that was kept so far; None if there is nothing."""
        return self._attempt("record", self._recorder.record) if self._recorder.count else None

    def _attempt(self, what: str, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except Exception as reason:
            if what not in self.failures:
                said = self.failures[what] = f"{what}: {type(reason).__name__}: {reason}"
                with contextlib.suppress(Exception):  # where warnings are errors, too
                    warnings.warn(f"{said}; the robot moves on", BookkeepingWarning, stacklevel=4)
            return None
