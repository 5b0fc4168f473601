"""When a trial counts as good, and what a bad one is called."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from eladapt.errors import require_number
from eladapt.records.metrics import RESOLVED


class Limit(NamedTuple):
    """One demand, in the order in which they are asked."""

    cause: str
    column: str
    most: float
    unit: str


@dataclass(frozen=True)
class Criteria:
    """A trial is good if the gate names no fault and all of this holds. Infinite: is not asked.

    Raises ArgumentError for what is negative or no number.
    """

    settled: float = 1e-3  # [rad] below which every joint has to stay
    within: float = 2.0  # [s] from the motion's end, or from a load that comes or goes after it
    tracking: float = 0.1  # [rad] largest error during the motion
    overshoot: float = 0.05  # [rad] beyond the goal, in the direction of the way there
    speed: float = 1.0  # of the speed limit
    beyond: float = RESOLVED  # [rad] beyond a joint's range
    gravity: float = float("inf")  # error of the learned gravity torque, as a part of an effort limit

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value != float("inf"):
                number = require_number(field.name, value, 0, float("1e300"), closed=True)
                object.__setattr__(self, field.name, number)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All demands."""
        return (
            Limit("left its range", "beyond", self.beyond, "rad beyond it"),
            Limit("too fast", "speed", self.speed, "of the speed limit"),
            Limit("not settled", "settling", self.within, "s after the last change"),
            Limit("not tracking", "tracking", self.tracking, "rad while moving"),
            Limit("overshoot", "overshoot", self.overshoot, "rad past the goal"),
            Limit("gravity not learned", "gravity_error", self.gravity, "of an effort limit"),
        )

    def judged(
        self, found: Mapping[str, Any], largest: Mapping[str, int], names: Sequence[str]
    ) -> dict[str, Any]:
        """Whether it was good, and else the first cause with its figures.

        found: the columns of `ROW`. largest: by column, which of the joints (their names) has the most of it.
        """
        if found["fault"]:
            return {"good": False, "cause": f"fault: {found['fault']}", "said": found["said"]}
        for cause, column, most, unit in self.limits:
            if found[column] > most:  # nan, of what is not known, is not asked
                said = f"{found[column]:.3g} {unit}, at most {most:g}"
                if (joint := largest.get(column, -1)) >= 0:
                    said += f", {names[joint]}"
                return {"good": False, "cause": cause, "said": said, "joint": joint}
        return {"good": True, "cause": "", "said": ""}
