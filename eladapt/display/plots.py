"""What happened in a run, as curves: errors, velocities, torques, estimates and their excitation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eladapt.display.curves import ARRIVED, COLOURS, FAULT_COLOUR, SMALLEST, felt, reduced
from eladapt.errors import ArgumentError
from eladapt.files import atomic_write
from eladapt.records.record import Record

SUFFIXES = (".png", ".pdf", ".svg")
STYLE: Any = {
    "font.size": 9, "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.grid": True,
    "grid.color": "0.9", "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "lines.linewidth": 1.2, "legend.frameon": False, "svg.fonttype": "none",
}  # fmt: skip
DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (2, 1)), (0, (7, 1, 1, 1, 1, 1)))
MOST_NUMBERS = 14  # estimates that are numbered at their right end
NEAR = 0.5  # of a limit: from there on it is drawn
LABEL = 0.08  # of a panel's height, by which two labels must be apart
LONGEST_LABEL = 84  # characters


class _Panel(NamedTuple):
    """One kind of curves, how it is drawn, and what is added once the axis has its final range."""

    title: str
    unit: str
    draw: Callable[[Axes, Record], None]
    mark: Callable[[Axes, Record], None] | None = None
    learnt: bool = False  # what was learnt, rather than how the arm moved


def plot(
    records: Record | Sequence[Record], path: str | Path | None = None, *, labels: Sequence[str] | None = None
) -> Figure:
    """Draw one record, or several side by side on common axes, and save the figure if ``path`` is given.

    path: ends in .png, .pdf or .svg. labels: a heading for each record, instead of its title.
    Panels: positions where the goal moves, with the goal dashed; errors on a linear and a logarithmic axis
    (arrival in finite time is a vertical drop); velocities and torques with those limits that are near; the
    torque from outside, where one was felt; estimates of gravity, with the true values dashed and the errors
    where those are known; Delta and the gates zeta where the law has them, and otherwise how much of gravity
    is known, direction by direction. A gate's fault is a red line through all of them. Estimates are in N m
    with the default, scaled regressors, and in the unit of the basis otherwise.
    Raises ArgumentError for another suffix, and for labels that are not one a record.
    """
    several = (records,) if isinstance(records, Record) else tuple(records)
    if not several or not all(isinstance(record, Record) for record in several):
        raise ArgumentError(f"records: expected a Record, or a sequence of at least one, got {records!r}")
    headings = [record.title for record in several] if labels is None else list(labels)
    if len(headings) != len(several):
        raise ArgumentError(f"labels: expected {len(several)}, one a record, got {len(headings)}")
    if path is not None:
        require_suffix(path)
    with mpl.rc_context(STYLE):
        figure = _alone(several[0], headings[0]) if len(several) == 1 else _compared(several, headings)
        if path is not None:
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=150)
    return figure


def require_suffix(path: str | Path) -> None:
    """Raises ArgumentError for a file that no figure can be."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ArgumentError(f"path: expected a name that ends in {', '.join(SUFFIXES)}, got {str(path)!r}")


def _alone(record: Record, heading: str) -> Figure:
    """Two columns: the motion on the left, what was learnt on the right."""
    panels = _panels([record])
    motion, learnt = ([p for p in panels if p.learnt == kind] for kind in (False, True))
    if not learnt:  # then the motion has both columns
        motion, learnt = motion[: -(-len(motion) // 2)], motion[-(-len(motion) // 2) :]
    rows = max(len(motion), len(learnt))
    height = 2.2 * rows + 0.9 + 0.08 * record.theta.shape[1]
    figure = Figure(figsize=(11, height), layout="constrained")
    halves = figure.add_gridspec(1, 2)
    for half, shown in enumerate((motion, learnt)):  # fewer panels are higher
        column = halves[half].subgridspec(len(shown), 1).subplots(sharex=True, squeeze=False)[:, 0]
        for axes, panel in zip(column, shown, strict=True):
            _draw([axes], panel, [record])
        column[-1].set_xlabel("time [s]")
    _legends(figure, [record], heading)
    return figure


def _compared(records: Sequence[Record], headings: Sequence[str]) -> Figure:
    """A column a record and a row a panel; a row has one axis."""
    panels = _panels(records)
    size = (max(3.4 * len(records) + 0.6, 8), 2 * len(panels) + 1)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(panels), len(records), sharex=True, sharey="row", squeeze=False)
    for row, panel in zip(grid, panels, strict=True):
        _draw(row, panel, records)
        for axes in row[1:]:
            axes.set(title="", ylabel="")
    for axes, heading in zip(grid[0], headings, strict=True):
        axes.annotate(_plain(heading), (0, 1.22), xycoords="axes fraction", weight="bold")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    _legends(figure, records)
    return figure


def _panels(records: Iterable[Record]) -> list[_Panel]:
    """The panels for which at least one record has data."""
    records = list(records)
    moving = any(record.goal_velocity is not None for record in records)
    panels = [
        _Panel("position error", "rad", _errors, _faults),
        _Panel("size of the position error", "rad", _arrival),
        _Panel("velocity, goal dashed" if moving else "velocity", "rad/s", _velocities, _speed_limits),
        _Panel("torque", "N m", lambda axes, record: _curves(axes, record.t, record.tau), _torque_limits),
    ]
    if any(map(felt, records)):
        panels.append(_Panel("torque from outside", "N m", _external))
    if moving and all(map(_has_angles, records)):
        panels.insert(0, _Panel("position, goal dashed", "rad", _positions))
    if any(record.theta.shape[1] for record in records):
        known = any(record.theta_true is not None for record in records)
        title = "estimates, true values dashed" if known else "estimates"
        panels.append(_Panel(title, "N m", _estimates, _numbers, True))
        if known:
            panels.append(_Panel("size of the estimates' errors", "N m", _estimation_errors, learnt=True))
    if any(record.zeta is not None and record.zeta.shape[1] for record in records):
        panels.append(_Panel(r"excitation $\Delta$", "-", _delta, learnt=True))
        panels.append(_Panel(r"gates $\zeta$", "-", _gates, learnt=True))
    elif any(record.excitation is not None and record.excitation.shape[1] > 1 for record in records):
        panels.append(_Panel("known of gravity, by direction", "-", _excitation, learnt=True))
    return panels


def _has_angles(record: Record) -> bool:
    """Whether q is the joints' coordinates, as it is but for continuous joints."""
    return record.q.shape == record.v.shape


def _draw(row: Sequence[Axes], panel: _Panel, records: Sequence[Record]) -> None:
    ends = [(record.t[0], max(record.t[-1], record.t[0] + record.dt)) for record in records]
    first, last = min(end[0] for end in ends), max(end[1] for end in ends)
    for axes, record in zip(row, records, strict=True):
        axes.set(title=panel.title, ylabel=f"[{panel.unit}]", xlim=(first, last))
        panel.draw(axes, record)
        for fault in record.faults or ():
            axes.axvline(fault.t, color=FAULT_COLOUR, linewidth=1.0)
    if panel.mark is not None:
        row[0].set_ylim(*row[0].get_ylim())
        for axes, record in zip(row, records, strict=True):
            panel.mark(axes, record)


def _errors(axes: Axes, record: Record) -> None:
    _curves(axes, record.t, record.error)


def _faults(axes: Axes, record: Record) -> None:
    """The names of a gate's faults, beside the lines that mark them."""
    for fault in record.faults or ():
        late = fault.t > (record.t[0] + record.t[-1]) / 2
        axes.annotate(
            f" {fault.name}, {fault.t:.3g} s ", (fault.t, 1.0), xycoords=("data", "axes fraction"),
            fontsize=8, color=FAULT_COLOUR, ha="right" if late else "left", va="top",
        ).set_in_layout(False)  # fmt: skip


def _external(axes: Axes, record: Record) -> None:
    if record.external is None:
        _nothing(axes)
    else:
        _curves(axes, record.t, record.external)


def _positions(axes: Axes, record: Record) -> None:
    _curves(axes, record.t, record.q)
    _dashed(axes, record.t, record.goal)


def _velocities(axes: Axes, record: Record) -> None:
    _curves(axes, record.t, record.v)
    if record.goal_velocity is not None:
        _dashed(axes, record.t, record.goal_velocity)


def _delta(axes: Axes, record: Record) -> None:
    if record.delta is None:
        _nothing(axes)
    else:
        _logarithmic(axes, record.t, record.delta)


def _gates(axes: Axes, record: Record) -> None:
    if record.zeta is None:
        _nothing(axes)
    else:
        _curves(axes, record.t, record.zeta)


def _excitation(axes: Axes, record: Record) -> None:
    """Eigenvalues of Phi, 0 where nothing is known and 1 where all is."""
    if record.excitation is None:
        _nothing(axes)
    else:
        _curves(axes, record.excitation[:, 0], record.excitation[:, 1:])
    axes.set_ylim(-0.05, 1.05)


def _arrival(axes: Axes, record: Record) -> None:
    """|e| on a logarithmic axis, with the time at which the arm settles."""
    _logarithmic(axes, record.t, record.error)
    settled = record.settling_time(ARRIVED)
    if record.t[0] < settled < np.inf:
        axes.axvline(settled, color="0.5", linewidth=0.8)
        late = settled > (record.t[0] + record.t[-1]) / 2  # the text goes where the curves are not
        axes.annotate(
            f" below {ARRIVED:g} rad from {settled:.3g} s on ", (settled, 0.03 if late else 1.0),
            xycoords=("data", "axes fraction"), fontsize=8, color="0.3",
            ha="right" if late else "left", va="bottom" if late else "top",
        ).set_in_layout(False)  # fmt: skip


def _speed_limits(axes: Axes, record: Record) -> None:
    _limits(axes, record.v, record.velocity_limit)


def _torque_limits(axes: Axes, record: Record) -> None:
    _limits(axes, record.tau, record.effort_limit)


def _limits(axes: Axes, values: np.ndarray, limits: np.ndarray) -> None:
    """The limits (nv,), up or down, of those joints whose own values (N, nv) come near them; limits that are
    too close to each other for two labels have one."""
    high, low = (np.nan_to_num(bound(values, axis=0, initial=0.0)) for bound in (np.nanmax, np.nanmin))
    signed = [(limits, high >= NEAR * limits), (-limits, -low >= NEAR * limits)]
    for bounds, near in signed:
        for level in np.unique(bounds[near]):
            axes.axhline(level, color="0.3", linestyle=(0, (8, 4)), linewidth=0.8)
            bottom, top = axes.get_ylim()
            axes.set_ylim(min(bottom, 1.1 * level), max(top, 1.1 * level))
    bottom, top = axes.get_ylim()
    for bounds, near in signed:
        levels = np.unique(bounds[near])
        for group in np.split(levels, np.flatnonzero(np.diff(levels) > LABEL * (top - bottom)) + 1):
            joints = np.flatnonzero(near & np.isin(bounds, group)) + 1
            if len(joints):
                axes.annotate(
                    f"limit of joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}",
                    (0.995, group[-1]), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                    fontsize=7, color="0.3",
                )  # fmt: skip


def _estimates(axes: Axes, record: Record) -> None:
    if not record.theta.shape[1]:
        _nothing(axes, "nothing is estimated")
    for index, column in enumerate(record.theta.T):
        colour = _look(index)["color"]
        axes.plot(*reduced(record.t, column), color=colour)
        if record.theta_true_course is not None:
            true = reduced(record.t, record.theta_true_course[:, index])
            axes.plot(*true, color=colour, linestyle=(0, (4, 3)), linewidth=0.8)
        elif record.theta_true is not None:
            axes.axhline(record.theta_true[index], color=colour, linestyle=(0, (4, 3)), linewidth=0.8)


def _numbers(axes: Axes, record: Record) -> None:
    """The estimates' numbers in the legend, at their right ends."""
    ends = record.theta[-1]
    if not 0 < len(ends) <= MOST_NUMBERS or not np.isfinite(ends).all():
        return
    low, high = axes.get_ylim()
    order = np.argsort(ends)
    at, gap = (ends[order] - low) / (high - low), 0.07
    for _ in range(200):  # neighbours that are too near push each other apart
        push = np.maximum(gap - np.diff(at), 0) / 2
        at[:-1] -= push
        at[1:] += push
        at[0], at[-1] = max(at[0], 0.0), min(at[-1], 1.0)
    for place, index in zip(at, order, strict=True):
        axes.annotate(
            f"{index + 1}", (1.012, place), xycoords="axes fraction", color=_look(index)["color"],
            fontsize=7, va="center", annotation_clip=False,
        )  # fmt: skip


def _estimation_errors(axes: Axes, record: Record) -> None:
    if record.theta_true is None:
        _nothing(axes, "true values unknown")
    else:
        _logarithmic(axes, record.t, record.theta_error, linestyle="-")


def _nothing(axes: Axes, why: str = "not recorded") -> None:
    axes.annotate(why, (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")


def _curves(axes: Axes, t: np.ndarray, values: np.ndarray, **changes: Any) -> None:
    for index, column in enumerate(values.T):
        axes.plot(*reduced(t, column), **{**_look(index), **changes})


def _dashed(axes: Axes, t: np.ndarray, values: np.ndarray) -> None:
    """What should be, thin and dashed, in the colours of what is."""
    _curves(axes, t, values, linestyle=(0, (4, 3)), linewidth=0.8)


def _logarithmic(axes: Axes, t: np.ndarray, values: np.ndarray, **changes: Any) -> None:
    axes.set_yscale("log")
    _curves(axes, t, np.clip(np.abs(values), SMALLEST, None), **changes)


def _look(index: int) -> dict[str, Any]:
    """The colour and the dashes of curve ``index``; 40 differ."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": DASHES[index % len(DASHES)]}


def _legends(figure: Figure, records: Sequence[Record], heading: str = "") -> None:
    """The joints above and the estimates below the panels, by number where the records differ in them."""
    joints = max((record.joint_names for record in records), key=len)
    if any(record.joint_names != joints for record in records):
        joints = tuple(f"joint {number}" for number in range(1, len(joints) + 1))
    handles = [Line2D([], [], label=_plain(name), **_look(index)) for index, name in enumerate(joints)]
    columns = _columns(figure, joints, 8)
    figure.legend(
        handles=_across(handles, columns), loc="outside upper left", ncols=columns, fontsize=8,
        alignment="left", title=_plain(heading), title_fontproperties={"weight": "bold", "size": 11},
    )  # fmt: skip
    names = max((record.theta_labels for record in records), key=len)
    if names and all(record.theta_labels in (names, ()) for record in records):
        entries = [f"{number}: {_short(name)}" for number, name in enumerate(names, 1)]
        handles = [
            Line2D([], [], color=_look(index)["color"], label=_plain(entry))
            for index, entry in enumerate(entries)
        ]
        columns = _columns(figure, entries, 7)
        figure.legend(
            handles=_across(handles, columns), loc="outside lower left", ncols=columns, fontsize=7,
            alignment="left", title="estimates", title_fontsize=8,
        )  # fmt: skip


def _across(handles: Sequence[Line2D], columns: int) -> list[Line2D]:
    """A legend's entries so that they are read line by line; matplotlib fills one column after the other."""
    return [handle for column in range(columns) for handle in handles[column::columns]]


def _columns(figure: Figure, entries: Sequence[str], size: float) -> int:
    """How many legend entries fit side by side; a letter is about 0.6 of the font's size wide."""
    width = (6 + max(map(len, entries))) * 0.6 * size / 72
    return max(1, min(len(entries), int(figure.get_figwidth() / width)))


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_LABEL else text[: LONGEST_LABEL - 1] + "…"


def _plain(text: str) -> str:
    """Text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")
