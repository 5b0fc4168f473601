"""The panels of a run's figure: what each draws, and what is written into it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from eladapt.display import marks
from eladapt.display.curves import ALL_ALIKE, ARRIVED, NOTHING, SMALLEST, felt, look, reduced
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.records.record import Record

MARKERS = "os^DvXP*"
MARKED = 0.22  # of a panel's diagonal, from one marker to the next
THIN: Any = {"linestyle": (0, (4, 3)), "linewidth": 0.8}  # what should be
Limits = Callable[[Record], tuple[np.ndarray, np.ndarray]]  # values (N, nv), and their limits (nv,)


class Panel(NamedTuple):
    """One kind of curves, how it is drawn, and what is written into it once it has its place."""

    name: str
    title: str
    unit: str
    draw: Callable[[Axes, Record], None]
    write: Callable[[Axes, Record, float], None] | None = None
    limits: Limits | None = None
    learnt: bool = False  # what was learnt, rather than how the arm moved
    numbered: bool = False  # whether its curves are the estimates, numbered as in the legend


def panels_of(records: Iterable[Record], wanted: Sequence[str] | None = None) -> list[Panel]:
    """The panels for which at least one record has data, or those of them that are wanted, by name.

    Raises UnknownNameError for a panel that there is not, ArgumentError where none is wanted.
    """
    records = list(records)
    found = [*_motion(records), *_learning(records)]
    if wanted is None:
        return found
    named = {panel.name: panel for panel in found}
    if not wanted:
        raise ArgumentError(f"panels: expected at least one of {', '.join(named)}, or None for all; got none")
    if unknown := [name for name in wanted if name not in named]:
        raise UnknownNameError("panel", unknown, list(named))
    return [named[name] for name in wanted]


def _motion(records: Sequence[Record]) -> list[Panel]:
    moving = any(record.goal_velocity is not None for record in records)
    panels = [
        Panel("error", "position error", "rad", _errors, marks.faults),
        Panel("arrival", "size of the position error", "rad", _arrival, marks.arrival),
        Panel("velocity", "velocity, goal dashed" if moving else "velocity", "rad/s", _velocities,
              limits=lambda record: (record.v, record.velocity_limit)),
        Panel("torque", "torque", "N m", lambda axes, record: curves(axes, record.t, record.tau),
              limits=lambda record: (record.tau, record.effort_limit)),
    ]  # fmt: skip
    if any(map(felt, records)):
        panels.append(Panel("outside", "torque from outside", "N m", _external))
    if moving and all(map(_has_angles, records)):
        panels.insert(0, Panel("position", "position, goal dashed", "rad", _positions))
    return panels


def _learning(records: Sequence[Record]) -> list[Panel]:
    panels = []
    if any(record.theta.shape[1] for record in records):
        known = any(record.theta_true is not None for record in records)
        title = "estimates, true values dashed" if known else "estimates"
        panels.append(Panel("estimates", title, "N m", _estimates, learnt=True, numbered=True))
        if known:
            title = "size of the estimates' errors"
            panels.append(Panel("estimation", title, "N m", _estimation_errors, learnt=True))
    if any(record.zeta is not None and record.zeta.shape[1] for record in records):
        each = _each(record.zeta for record in records)
        panels.append(Panel("delta", rf"excitation $\Delta${each}", "-", _delta, learnt=True))
        panels.append(Panel("zeta", rf"gates $\zeta${each}", "-", _gates, learnt=True))
    elif any(record.excitation is not None and record.excitation.shape[1] > 1 for record in records):
        each = _each(None if r.excitation is None else r.excitation[:, 1:] for r in records)
        panels.append(Panel("excitation", f"known of gravity{each}", "-", _excitation, learnt=True))
    return panels


def _each(columns: Iterable[np.ndarray | None]) -> str:
    """How many lines there are that have no names."""
    widths = {values.shape[1] for values in columns if values is not None}
    if widths == {1}:
        return ""
    return f", a line for each of {widths.pop()} directions" if len(widths) == 1 else ", a line a direction"


def nothing(axes: Axes, why: str = "not recorded") -> None:
    """Instead of an empty panel, why there is none."""
    axes.set_axis_off()
    axes.annotate(why, (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")


def _where_recorded(
    values_of: Callable[[Record], np.ndarray | None], draw: Callable[[Axes, np.ndarray, np.ndarray], None]
) -> Callable[[Axes, Record], None]:
    """Draws (axes, t, values) of the records that have the values (N, k); of others, that they have none."""

    def drawn(axes: Axes, record: Record) -> None:
        values = values_of(record)
        if values is None:
            nothing(axes)
        else:
            draw(axes, record.t, values)

    return drawn


def curves(axes: Axes, t: np.ndarray, values: np.ndarray, **changes: Any) -> None:
    """A curve a column, each with the look of its number."""
    for index, column in enumerate(values.T):
        axes.plot(*reduced(t, column), **{**look(index), **changes})


def add_markers(axes: Axes) -> None:
    """A marker of its own on each curve, so that they differ where dashes are hard to see."""
    own = [line for line in axes.lines if np.size(line.get_xdata()) > 2]
    for index, line in enumerate(line for line in own if line.get_linewidth() > THIN["linewidth"]):
        line.set_marker(MARKERS[index % len(MARKERS)])
        line.set_markevery((MARKED * (0.15 + 0.8 * (index % 7) / 7), MARKED))


def end_at_rounding(row: Sequence[Axes]) -> None:
    """A logarithmic axis that panels share ends at `SMALLEST`: curves that go below leave it."""
    drawn = [line.get_ydata() for axes in row for line in axes.lines if np.size(line.get_xdata()) > 2]
    if row[0].get_yscale() != "log" or not drawn:
        return
    values = np.concatenate(drawn)
    low, high = np.nanmin(values), np.nanmax(values)
    if low < SMALLEST:
        row[0].set_ylim(SMALLEST, max(3 * high, 10 * SMALLEST))


def _alike(axes: Axes, t: np.ndarray, values: np.ndarray) -> None:
    """Curves without names, all of one look."""
    for column in values.T:
        axes.plot(*reduced(t, column), color=ALL_ALIKE, linewidth=0.8)


def _logarithmic(axes: Axes, t: np.ndarray, values: np.ndarray, alike: bool = False, **changes: Any) -> None:
    """Sizes on a logarithmic axis."""
    axes.set_yscale("log")
    sizes = np.clip(np.abs(values), NOTHING, None)
    _alike(axes, t, sizes) if alike else curves(axes, t, sizes, **changes)


def _has_angles(record: Record) -> bool:
    """Whether q is the joints' coordinates, as it is but for continuous joints."""
    return record.q.shape == record.v.shape


def _errors(axes: Axes, record: Record) -> None:
    curves(axes, record.t, record.error)


def _positions(axes: Axes, record: Record) -> None:
    curves(axes, record.t, record.q)
    curves(axes, record.t, record.goal, **THIN)


def _velocities(axes: Axes, record: Record) -> None:
    curves(axes, record.t, record.v)
    if record.goal_velocity is not None:
        curves(axes, record.t, record.goal_velocity, **THIN)


def _arrival(axes: Axes, record: Record) -> None:
    """|e| on a logarithmic axis, with the time at which the arm settles."""
    _logarithmic(axes, record.t, record.error)
    settled = record.settling_time(ARRIVED)
    if record.t[0] < settled < np.inf:
        axes.axvline(settled, color="0.5", linewidth=0.8)


def _eigenvalues(axes: Axes, _t: np.ndarray, excitation: np.ndarray) -> None:
    """Those of Phi, 0 where nothing is known and 1 where all is; excitation (k, 1 + n), times first."""
    _alike(axes, excitation[:, 0], excitation[:, 1:])
    axes.set_ylim(-0.05, 1.05)


_external = _where_recorded(lambda record: record.external, curves)
_delta = _where_recorded(lambda record: record.delta, partial(_logarithmic, alike=True))
_gates = _where_recorded(lambda record: record.zeta, _alike)
_excitation = _where_recorded(lambda record: record.excitation, _eigenvalues)


def _estimates(axes: Axes, record: Record) -> None:
    if not record.theta.shape[1]:
        nothing(axes, "nothing is estimated")
    for index, column in enumerate(record.theta.T):
        colour = look(index)["color"]
        axes.plot(*reduced(record.t, column), color=colour)
        if record.theta_true_course is not None:
            axes.plot(*reduced(record.t, record.theta_true_course[:, index]), color=colour, **THIN)
        elif record.theta_true is not None:
            axes.axhline(record.theta_true[index], color=colour, **THIN)


def _estimation_errors(axes: Axes, record: Record) -> None:
    if record.theta_true is None or not record.theta.shape[1]:
        nothing(axes, "true values unknown" if record.theta.shape[1] else "nothing is estimated")
    else:
        _logarithmic(axes, record.t, record.theta_error, linestyle="-")
