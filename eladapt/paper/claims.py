"""The paper's claims about its simulations, each with the figure obtained and a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from eladapt.records.metrics import chatter
from eladapt.records.record import Record

FINITE_TIME = ("C1", "C2", "C3")
ARRIVED = 1e-3  # [rad]
ARRIVAL = 4.0  # [s] "approximately at 4 [s]"
ABOUT = 1.1  # how much more "approximately" may be
LEARNED = 2.5  # [s] "no later than 2.5[s]"
WITHIN = 0.01  # relative to the true value
CHATTER = 0.015  # [N m] "not greater than 0.015 [Nm]"

Runs = Mapping[tuple[str, int], Record]  # by controller and case


class Claim(NamedTuple):
    """One row of the table."""

    text: str
    figure: str
    holds: bool


def claims(runs: Runs) -> list[Claim]:
    """Every claim that the paper's simulation section makes in numbers or in comparisons."""
    return [*_motion(runs), *_excitation(runs), *_disturbed(runs)]


def table(columns: Mapping[str, list[Claim]]) -> str:
    """Markdown: claim of the paper | figure obtained | holds, the latter two for each column's arm."""
    head = ["claim of the paper"]
    for name in columns:
        head += [f"figure, {name}" if name else "figure obtained", "holds"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for same in zip(*columns.values(), strict=True):
        cells = [same[0].text]
        for claim in same:
            cells += [claim.figure, "yes" if claim.holds else "**no**"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _motion(runs: Runs) -> list[Claim]:
    arrival = {n: runs[n, 1].settling_time(ARRIVED) for n in FINITE_TIME}
    learned = {n: parameter_settling(runs[n, 1]) for n in FINITE_TIME}
    fourth = runs["C4", 1]
    errors = {"t = 5 s": _error_at(fourth, 5.0), "t = 10 s": _error_at(fourth, 10.0)}
    ripple = {f"{n} joint {j + 1}": amplitude(runs[n, 1], j) for n in ("C1", "C2") for j in (0, 1)}
    sliding, classic = (_largest_amplitude(runs[n, 1]) for n in ("C3", "C4"))
    return [
        Claim(
            f"Case 1: C1, C2, C3 regulate in finite time, about {ARRIVAL:g} s (error < {ARRIVED:g} rad)",
            _listed(arrival, "s"), all(t <= ABOUT * ARRIVAL for t in arrival.values()),
        ),
        Claim(
            "Case 1: C4 regulates asymptotically (its error still falls at 10 s)",
            _listed(errors, "rad"), 1e-6 < errors["t = 10 s"] < errors["t = 5 s"],
        ),
        Claim(
            f"Case 1: theta_U is learned by {LEARNED:g} s (within 1 %)",
            _listed(learned, "s"), all(t <= LEARNED for t in learned.values()),
        ),
        Claim(
            f"Case 1: the finite-time PD chatters by at most {CHATTER:g} N m",
            _listed(ripple, "N m"), max(ripple.values()) <= CHATTER,
        ),
        Claim(
            "Case 1: the discontinuous estimator of C3 chatters more than C2",
            _listed({"C3": sliding, "C2": _largest_amplitude(runs["C2", 1])}, "N m"),
            sliding > _largest_amplitude(runs["C2", 1]),
        ),
        Claim(
            "Case 1: C4's torque chatters significantly (more than C1's)",
            _listed({"C4": classic, "C1": _largest_amplitude(runs["C1", 1])}, "N m"),
            classic > _largest_amplitude(runs["C1", 1]),
        ),
    ]  # fmt: skip


def _excitation(runs: Runs) -> list[Claim]:
    growth = {n: last_second(_gate_integral(runs[n, 1])) for n in ("C1", "C2")}
    level = _level(runs["C3", 1])
    peak, last = float(level.max()), float(level[-1])
    classic = last_second(_level(runs["C4", 1]))
    return [
        Claim(
            "Case 1: the integral of zeta_1 of C1 tends to infinity",
            _listed({"growth in the last second": growth["C1"]}, "s"), growth["C1"] > 1e-2,
        ),
        Claim(
            "Case 1: the integral of zeta_1 of C2 tends to a constant",
            _listed({"growth in the last second": growth["C2"]}, "s"), growth["C2"] < 1e-2,
        ),
        Claim(
            "Case 1: Phi_2 of C3 is positive while it learns, and not persistently exciting",
            _listed({"lambda_min at its peak": peak, "at 10 s": last}, ""), peak > 0 and last < 0.1 * peak,
        ),
        Claim(
            "Case 1: Omega is persistently exciting with C4 (lambda_min of its integral grows)",
            _listed({"growth in the last second": classic}, ""), classic > 1e-3,
        ),
    ]  # fmt: skip


def _disturbed(runs: Runs) -> list[Claim]:
    names = (*FINITE_TIME, "C4")
    steady = {n: float(steady_error(runs[n, 2])[0]) for n in names}
    elbow = {n: float(steady_error(runs[n, 2])[1]) for n in names}
    ripple = {n: _largest_amplitude(runs[n, 2]) for n in ("C1", "C2")}
    calm = max(_largest_amplitude(runs[n, 1]) for n in ("C1", "C2"))
    wrong = {n: 100 * float(np.abs(relative_error(runs[n, 2])[-1]).max()) for n in names}
    return [
        Claim(
            "Case 2: the steady error of the finite-time schemes is below C4's, joint 1",
            _listed(steady, "rad"), all(steady[n] < steady["C4"] for n in FINITE_TIME),
        ),
        Claim(
            "Case 2: the same for joint 2",
            _listed(elbow, "rad"), all(elbow[n] < elbow["C4"] for n in FINITE_TIME),
        ),
        Claim(
            "Case 2: steady chatter of C1 and C2 is significantly increased",
            _listed(ripple, "N m"), min(ripple.values()) > 2 * calm,
        ),
        Claim(
            "Case 2: the estimate of theta_U degrades most with C4",
            _listed(wrong, "% at 10 s"), max(wrong, key=wrong.__getitem__) == "C4",
        ),
    ]  # fmt: skip


def relative_error(record: Record) -> np.ndarray:
    """(N, 2) errors of delta_4 and delta_5, relative to their true values."""
    assert record.theta_true is not None
    return record.theta_error[:, -2:] / record.theta_true[-2:]


def parameter_settling(record: Record) -> float:
    """[s] from when on both theta_U stay within 1 %; inf if they do not."""
    outside = np.flatnonzero(np.abs(relative_error(record)).max(axis=1) >= WITHIN)
    if len(outside) and outside[-1] == len(record) - 1:
        return float("inf")
    return float(record.t[outside[-1] + 1]) if len(outside) else 0.0


def amplitude(record: Record, joint: int) -> float:
    """[N m] half the peak-to-peak torque of a joint over the last second, less its trend."""
    last = record.t >= record.t[-1] - 1
    return chatter(record.t[last], record.tau[last][:, [joint]]) / 2


def steady_error(record: Record) -> np.ndarray:
    """(nv,) [rad] largest |e| of each joint in the last second."""
    return np.abs(record.error[record.t >= record.t[-1] - 1]).max(axis=0)


def last_second(values: np.ndarray) -> float:
    """Change over the last tenth of a run, its last second of ten."""
    return float(values[-1] - values[-1 - len(values) // 10])


def _largest_amplitude(record: Record) -> float:
    return max(amplitude(record, joint) for joint in range(record.tau.shape[1]))


def _error_at(record: Record, t: float) -> float:
    return float(np.abs(record.error[np.searchsorted(record.t, t - 1e-9)]).max())


def _level(record: Record) -> np.ndarray:
    assert record.level is not None
    return record.level


def _gate_integral(record: Record) -> np.ndarray:
    assert record.zeta_integral is not None
    return record.zeta_integral[:, 0]


def _listed(values: Mapping[str, float], unit: str) -> str:
    return f"{', '.join(f'{name}: {_number(value)}' for name, value in values.items())} {unit}".strip()


def _number(value: float) -> str:
    return f"{value:.2f}" if 0.1 <= abs(value) < 1000 or value == 0 else f"{value:.1e}"
