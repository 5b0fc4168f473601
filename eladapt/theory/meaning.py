"""The conditions of a certificate, and what it means that some do not hold, for someone who has not read the
paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

STABLE, STABLE_SAMPLED = ("(530)", "d1 <= d_Lm / mu_M", "D_L >= d1 M(q)"), "V_1 > 0"
FINITE, FINITE_SAMPLED = ("(602)",), "v(e) > 0"
WEIGHTS = ("(660b)", "(d4value)")
STEPPED = ("max D_L dt", "lambda_max(")
PROOFS = (
    "These are conditions of the paper's proofs, sufficient and not necessary. Where one fails, a theorem "
    "does not say that the arm arrives; nothing says that it does not. The derived gains use the torque that "
    "the motors have, and do not look at these conditions; how runs go with them is measured, not proven."
)


class Row(NamedTuple):
    """One condition of a certificate."""

    name: str  # with the paper's label
    value: float
    limit: float
    holds: bool
    note: str = ""


def meaning(rows: Sequence[Row]) -> tuple[str, ...]:
    """Sentences for what does not hold, the most important last; none where all of it does."""
    failed = [row for row in rows if not row.holds]
    if not failed:
        return ()
    said = [f"{len(failed)} of {len(rows)} conditions do not hold."]
    stable = _of(rows, STABLE)
    if stable and not any(row.holds for row in stable):
        d1, times = stable[0].value, min(row.value / row.limit for row in stable if row.limit)
        larger = f"{times:.3g} times larger" if math.isfinite(times) else "more than 0 in every joint"
        said.append(
            f"Stability: it is enough that one of the first {len(stable)} holds. None does: d1 would have to "
            f"be at most {d1 / times:.3g}, or D_L {larger}.{_sampled(rows, STABLE_SAMPLED)}"
        )
    if any(not row.holds for row in _of(rows, FINITE)):
        said.append(
            "Finite time: the bounds on gamma_A1 are enough for v(e) > 0, the rate at which energy is lost."
            f"{_sampled(rows, FINITE_SAMPLED)}"
        )
    if any(not row.holds for row in _of(rows, WEIGHTS)):
        said.append("A weight of a Lyapunov function is beyond its limit: without it the largest is taken.")
    said.append(PROOFS)
    if stepped := [row.name for row in _of(rows, STEPPED) if not row.holds]:
        said.append(
            f"{' and '.join(stepped)}: this is about sampling, not about proofs. Beyond the limit the loop "
            "may chatter or diverge: take a smaller dt or smaller gains."
        )
    return tuple(said)


def _of(rows: Sequence[Row], labels: Sequence[str]) -> list[Row]:
    return [row for row in rows if any(label in row.name for label in labels)]


def _sampled(rows: Sequence[Row], label: str) -> str:
    """What sampling said of the function itself."""
    found = _of(rows, (label,))
    if not found:
        return ""
    if found[0].holds:
        return f" On the states that were sampled {label} holds all the same."
    return f" {label} does not hold on all states that were sampled: {found[0].note}."
