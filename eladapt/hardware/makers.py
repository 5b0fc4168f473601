"""What the adapters of makers' libraries have in common."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as Late
from threading import Thread
from typing import Any

from eladapt.errors import ArgumentError, HardwareError
from eladapt.robot.model import Robot

PATIENCE = 4.5  # [s] until what does not answer is said so


def require_joints(robot: Robot, count: int, arm: str) -> None:
    """Raises ArgumentError for a robot that has not as many joints as the maker's arm."""
    if robot.nv != count:
        raise ArgumentError(
            f"robot: expected the {count} joints of a {arm} arm, got {robot.nv} of {robot.name!r}: "
            f"{', '.join(robot.joint_names)}; lock the others (locked=)"
        )


def in_time(call: Callable[[], Any], said: str, raised: tuple[type[Exception], ...]) -> Any:
    """What a call of a maker's library gives, which may wait for ever.

    Raises HardwareError, beginning with what is ``said``, where it takes longer than 4.5 s, or for what the
    library ``raised``.
    """
    answer: Future[Any] = Future()

    def run() -> None:
        try:
            answer.set_result(call())
        except Exception as reason:
            answer.set_exception(reason)

    Thread(target=run, daemon=True).start()  # one that hangs must not keep the process
    try:
        return answer.result(PATIENCE)
    except Late:
        raise HardwareError(f"{said}: nothing within {PATIENCE:g} s") from None
    except raised as reason:
        raise HardwareError(f"{said}: {reason}") from reason
