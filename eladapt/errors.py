"""What can go wrong, as one family of exceptions; each carries its data."""

from __future__ import annotations

import contextlib
import difflib
import importlib.metadata
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

DOUBLE = np.dtype(float)
EXTRA = r"extra\s*==\s*['\"]{}['\"]"  # in a requirement of the package's metadata


def printable(text: str) -> str:
    """A text from outside as a terminal may have it: what steers a terminal or turns text round is escaped.

    These are all characters that cannot be printed, line breaks and tabs among them.
    """
    return text if text.isprintable() else "".join(map(_visible, text))


def printable_lines(text: str) -> str:
    """`printable`, line by line."""
    return "\n".join(map(printable, text.split("\n")))


def _visible(character: str) -> str:
    if character.isprintable():
        return character
    return character.encode("unicode_escape").decode("ascii")


class _Printable:
    """Of an exception: its text is `printable`, since it may quote names and paths from outside."""

    def __str__(self) -> str:
        return printable_lines(super().__str__())


class EladaptError(_Printable, Exception):
    """Base of every error that eladapt raises on purpose."""


class EladaptWarning(_Printable, UserWarning):
    """Base of every warning."""


@contextlib.contextmanager
def needing(what: str, extra: str, error: type[EladaptError] = EladaptError) -> Iterator[None]:
    """Around imports that an extra installs: raises ``error``, which says how, where they are not there.

    what: as "a report needs Bokeh".
    """
    try:
        yield
    except ImportError as reason:
        raise error(f"{what}, which is not installed ({reason}): {installing(extra)}") from reason


def installing(extra: str) -> str:
    """The command that installs what an extra of eladapt names, wherever eladapt itself came from."""
    try:
        listed = importlib.metadata.requires("eladapt") or []
    except importlib.metadata.PackageNotFoundError:  # run from a folder, without being installed
        listed = []
    wanted = [line.partition(";")[0].strip() for line in listed if re.search(EXTRA.format(extra), line)]
    if not wanted:
        return f"it comes with the extra {extra} of eladapt"
    return "pip install " + " ".join(f'"{requirement}"' for requirement in wanted)


class ArgumentError(EladaptError, ValueError):
    """An argument has the wrong shape, a non-finite entry or a value outside its range."""


class UnknownNameError(EladaptError, LookupError):
    """A name that does not exist; the message lists the legal ones, and one that may be meant.

    remedy: what to do where the name is right and the list is not.
    """

    def __init__(self, kind: str, names: Sequence[str], legal: Sequence[str], remedy: str = ""):
        self.kind, self.names, self.legal, self.remedy = kind, tuple(names), tuple(legal), remedy
        given = ", ".join(repr(name) for name in names)
        said = f"unknown {kind} {given}{did_you_mean(names, legal)}; legal names: "
        super().__init__(said + (", ".join(legal) or "(none)") + (f". {remedy}" if remedy else ""))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.kind, self.names, self.legal, self.remedy)  # as pickled between processes


def did_you_mean(names: Iterable[str], legal: Iterable[str]) -> str:
    """ " (did you mean 'panda'?)" for names that are nearly legal ones; "" where none is."""
    known = list(legal)
    near = [found[0] for name in names if (found := difflib.get_close_matches(str(name), known, 1))]
    return f" (did you mean {', '.join(map(repr, dict.fromkeys(near)))}?)" if near else ""


class Finding(NamedTuple):
    """One thing wrong with a robot description."""

    element: str
    value: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        parts = (_short(self.element), _short(self.value), self.problem)
        return f"{': '.join(map(printable, parts))}. {printable(self.remedy)}"


def _short(text: str, most: int = 300) -> str:
    """A text from a file, as far as a message should show it."""
    return (
        text
        if len(text) <= most
        else f"{text[: most // 2]} ... {text[-most // 2 :]} ({len(text)} characters)"
    )


class UrdfError(EladaptError):
    """A robot description that cannot be used; ``findings`` lists every reason found."""

    def __init__(self, path: str | Path, findings: Sequence[Finding]):
        self.path, self.findings = Path(path), tuple(findings)
        lines = "\n".join(f"  - {finding}" for finding in self.findings)
        super().__init__(f"{self.path}:\n{lines}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.findings)  # as pickled between processes


class SimulationError(EladaptError):
    """A run that ended early; ``record`` holds all that happened until then."""

    def __init__(self, message: str, record: Any = None):
        self.record = record
        super().__init__(message)


class StressError(EladaptError):
    """A stress test that cannot go on, or a folder of results that is not its own."""


class RecordError(EladaptError):
    """A file that is not a readable record."""


class LogError(EladaptError):
    """A file that is not a readable log."""


class UnphysicalError(EladaptError):
    """Parameters that no bodies can have, nor any near them."""


class MeshError(EladaptError):
    """A mesh that is not read: foreign, too large or broken."""


class HardwareError(EladaptError):
    """A robot that cannot be reached or started, or a system that cannot do what was asked."""


class LoopError(HardwareError):
    """A loop that ended early; ``record``, ``state`` and ``timing`` hold all that happened until then."""

    def __init__(self, message: str, record: Any = None, state: Any = None, timing: Any = None):
        self.record, self.state, self.timing = record, state, timing
        super().__init__(message)


class LoopTerminated(SystemExit):
    """A signal asked the process to end while a loop ran, and the robot was stopped first.

    Unless it is caught it ends the process, with the status that a shell gives for the signal. ``record``,
    ``state`` and ``timing`` hold all that happened until then. It is no `EladaptError`, so that who catches
    those and tries again does not go on.
    """

    def __init__(self, signal: int, record: Any = None, state: Any = None, timing: Any = None):
        self.signal, self.record, self.state, self.timing = signal, record, state, timing
        super().__init__(128 + signal)

    def __reduce__(self) -> tuple[Any, ...]:
        kept = (self.signal, self.record, self.state, self.timing)
        return type(self), kept  # as pickled between processes


class RunInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a simulated run; ``record`` holds all that happened until then.

    Who catches KeyboardInterrupt catches it too. It is no `EladaptError`, so that who catches those and goes
    on with the next run does stop.
    """

    def __init__(self, record: Any):
        self.record = record
        super().__init__(f"interrupted after {len(record)} samples; the exception's record has them")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.record,)  # as pickled between processes


class StateError(EladaptError):
    """A file that is not the saved state of this controller, or a damaged one."""


class BookkeepingWarning(EladaptWarning):
    """Something beside the control of a moving robot failed, as a checkpoint; the robot is controlled on."""


class BrakesWarning(EladaptWarning):
    """Brakes that are not there, or that did not stop a robot."""


class GoalWarning(EladaptWarning):
    """A goal that no arm may reach, and that was changed."""


class LogWarning(EladaptWarning):
    """A log that looks wrong, or that will not tell much."""


class MendedWarning(EladaptWarning):
    """A body of a robot file that was given the nearest physical inertia."""


class AssumedWarning(EladaptWarning):
    """What a robot file does not say, that its dynamics need, and that was assumed."""


class MeshWarning(EladaptWarning):
    """A mesh that is not drawn, and why."""


class UnitsWarning(EladaptWarning):
    """A robot file whose numbers fit no arm, as in grams and millimetres."""


class RankWarning(EladaptWarning):
    """The rank of the sampled regressors is not clear-cut."""


def require_vector(name: str, value: Any, size: int) -> np.ndarray:
    """``value`` as a float vector of shape (size,); ArgumentError when it is not, or not finite."""
    vector = value if is_vector(value, size) else _as_vector(name, value, size)
    # One dot product finds what is not finite; it may overflow, so the answer no is asked for twice.
    if not math.isfinite(vector.dot(vector)) and not np.isfinite(vector).all():
        raise ArgumentError(f"{name}: expected finite numbers of shape ({size},), got {vector}")
    return vector


def is_vector(value: object, size: int) -> bool:
    """Whether it is a plain array of ``size`` doubles."""
    # A dtype that numba or a pickle made is equal, and another object.
    return (
        type(value) is np.ndarray
        and value.shape == (size,)
        and (value.dtype is DOUBLE or value.dtype == DOUBLE)
    )


def _as_vector(name: str, value: Any, size: int) -> np.ndarray:
    """``value`` as a float vector of shape (size,); ArgumentError when it is not."""
    try:
        given = np.asarray(value)
        if given.dtype.kind == "c":  # numpy would drop the imaginary parts
            raise TypeError("complex numbers")
        vector = np.asarray(given, dtype=float)
    except (TypeError, ValueError) as reason:
        raise ArgumentError(f"{name}: expected {size} numbers, got {value!r} ({reason})") from None
    if vector.shape != (size,):
        raise ArgumentError(f"{name}: expected shape ({size},), got {vector.shape}")
    return vector


def require_gain(name: str, value: Any, size: int | None = None, *, zero: bool = False) -> np.ndarray:
    """A positive (or, with ``zero``, non-negative) gain: a scalar or (size,) diagonal, as an own array.

    A (size, size) diagonal matrix is accepted and its diagonal returned.
    """
    try:
        gain = np.array(value, dtype=float)
    except (TypeError, ValueError) as reason:
        raise ArgumentError(f"{name}: expected a number or a vector, got {value!r} ({reason})") from None
    if gain.ndim == 2 and gain.shape[0] == gain.shape[1]:
        if np.any(gain != np.diag(np.diag(gain))):
            raise ArgumentError(f"{name}: expected a diagonal matrix, got off-diagonal entries in {gain}")
        gain = np.diag(gain).copy()
    if gain.ndim > 1 or (size is not None and gain.ndim == 1 and gain.shape != (size,)):
        raise ArgumentError(f"{name}: expected a scalar or shape ({size or 'n'},), got shape {gain.shape}")
    least = "non-negative" if zero else "positive"
    if not np.isfinite(gain).all() or np.any(gain < 0) or (not zero and np.any(gain == 0)):
        raise ArgumentError(f"{name}: expected {least} finite values, got {gain}")
    return gain if size is None else np.broadcast_to(gain, (size,)).copy()


def require_number(name: str, value: Any, low: float, high: float = np.inf, *, closed: bool = False) -> float:
    """``value`` as a float in (low, high), or in [low, high] with ``closed``."""
    # The common case, in a fifth of the time.
    if type(value) is float and low < value < high and value - value == 0:
        return value
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: expected a number, got {value!r}") from None
    inside = low <= number <= high if closed else low < number < high
    if not inside or not np.isfinite(number):
        raise ArgumentError(
            f"{name}: expected a finite number in {_interval(low, high, closed)}, got {value!r}"
        )
    return number


def _interval(low: float, high: float, closed: bool) -> str:
    """In the brackets of mathematics: an end that is infinite, or the largest number there is, is open."""
    largest = np.finfo(float).max
    left = f"{'[' if closed else '('}{low:g}" if low > -largest else "(-inf"
    right = f"{high:g}{']' if closed else ')'}" if high < largest else "inf)"
    return f"{left}, {right}"
