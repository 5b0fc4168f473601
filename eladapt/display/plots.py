"""What happened in a run, as curves: errors, velocities, torques, estimates and their excitation."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eladapt.display.curves import ARRIVED, COLOURS, SMALLEST, reduced
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
LONGEST_LABEL = 84  # characters


class _Panel(NamedTuple):
    """One kind of curves, how it is drawn, and what is added once the axis has its final range."""

    title: str
    unit: str
    draw: Callable[[Axes, Record], None]
    mark: Callable[[Axes, Record], None] | None = None


def plot(
    records: Record | Sequence[Record], path: str | Path | None = None, *, labels: Sequence[str] | None = None
) -> Figure:
    """Draw one record, or several side by side on common axes, and save the figure if ``path`` is given.

    path: ends in .png, .pdf or .svg. labels: a heading for each record, instead of its title.
    Panels: errors on a linear and a logarithmic axis (arrival in finite time is a vertical drop),
    velocities, torques with those limits that are near, estimates with the true values dashed, the
    errors of the estimates, Delta and the gates zeta. Estimates are in N m with the default,
    scaled regressors, and in the unit of the basis otherwise.
    Raises ArgumentError for another suffix, and for labels that are not one a record.
    """
    several = (records,) if isinstance(records, Record) else tuple(records)
    if not several or not all(isinstance(record, Record) for record in several):
        raise ArgumentError(f"records: expected a Record, or a sequence of at least one, got {records!r}")
    headings = [record.title for record in several] if labels is None else list(labels)
    if len(headings) != len(several):
        raise ArgumentError(f"labels: expected {len(several)}, one a record, got {len(headings)}")
    if path is not None and Path(path).suffix.lower() not in SUFFIXES:
        raise ArgumentError(f"path: expected a name that ends in {', '.join(SUFFIXES)}, got {str(path)!r}")
    with mpl.rc_context(STYLE):
        figure = _alone(several[0], headings[0]) if len(several) == 1 else _compared(several, headings)
        if path is not None:
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=150)
    return figure


def _alone(record: Record, heading: str) -> Figure:
    """Two columns: the motion on the left, what was learnt on the right."""
    panels = _panels([record])
    rows = -(-len(panels) // 2)
    height = 2.2 * rows + 0.9 + 0.08 * record.theta.shape[1]
    figure = Figure(figsize=(11, height), layout="constrained")
    grid = figure.subplots(rows, 2, sharex=True)
    for column, shown in zip(grid.T, (panels[:rows], panels[rows:]), strict=True):
        for axes, panel in itertools.zip_longest(column, shown):
            if panel is None:
                axes.remove()
            else:
                _draw([axes], panel, [record])
        column[len(shown) - 1].set_xlabel("time [s]")
        column[len(shown) - 1].tick_params(labelbottom=True)
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
    panels = [
        _Panel("position error", "rad", lambda axes, record: _curves(axes, record.t, record.error)),
        _Panel("size of the position error", "rad", _arrival),
        _Panel("velocity", "rad/s", lambda axes, record: _curves(axes, record.t, record.v)),
        _Panel("torque", "N m", lambda axes, record: _curves(axes, record.t, record.tau), _limits),
    ]
    if any(record.theta.shape[1] for record in records):
        panels.append(_Panel("estimates, true values dashed", "N m", _estimates, _numbers))
        if any(record.theta_true is not None for record in records):
            panels.append(_Panel("size of the estimates' errors", "N m", _estimation_errors))
    if any(record.delta.shape[1] for record in records):
        panels += [
            _Panel(
                r"excitation $\Delta$", "-", lambda axes, record: _logarithmic(axes, record.t, record.delta)
            ),
            _Panel(r"gates $\zeta$", "-", lambda axes, record: _curves(axes, record.t, record.zeta)),
        ]
    return panels


def _draw(row: Sequence[Axes], panel: _Panel, records: Sequence[Record]) -> None:
    for axes, record in zip(row, records, strict=True):
        axes.set(title=panel.title, ylabel=f"[{panel.unit}]")
        axes.set_xlim(record.t[0], max(record.t[-1], record.t[0] + record.dt))
        panel.draw(axes, record)
    if panel.mark is not None:
        row[0].set_ylim(*row[0].get_ylim())
        for axes, record in zip(row, records, strict=True):
            panel.mark(axes, record)


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


def _limits(axes: Axes, record: Record) -> None:
    """The torque limits that lie within the range of the torques."""
    low, high = axes.get_ylim()
    for limit in {*record.effort_limit, *-record.effort_limit}:
        if low <= limit <= high:
            joints = np.flatnonzero(record.effort_limit == abs(limit)) + 1
            axes.axhline(limit, color="0.3", linestyle=(0, (8, 4)), linewidth=0.8)
            axes.annotate(
                f"limit of joint {', '.join(map(str, joints))}", (0.995, limit),
                xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7, color="0.3",
            )  # fmt: skip


def _estimates(axes: Axes, record: Record) -> None:
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
        axes.annotate("true values unknown", (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")
    else:
        _logarithmic(axes, record.t, record.theta_error, linestyle="-")


def _curves(axes: Axes, t: np.ndarray, values: np.ndarray, **changes: Any) -> None:
    for index, column in enumerate(values.T):
        axes.plot(*reduced(t, column), **{**_look(index), **changes})


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
    figure.legend(
        handles=handles, loc="outside upper left", ncols=_columns(figure, joints, 8), fontsize=8,
        alignment="left", title=_plain(heading), title_fontproperties={"weight": "bold", "size": 11},
    )  # fmt: skip
    names = max((record.theta_labels for record in records), key=len)
    if names and all(record.theta_labels in (names, ()) for record in records):
        entries = [f"{number}: {_short(name)}" for number, name in enumerate(names, 1)]
        handles = [
            Line2D([], [], color=_look(index)["color"], label=_plain(entry))
            for index, entry in enumerate(entries)
        ]
        figure.legend(
            handles=handles, loc="outside lower left", ncols=_columns(figure, entries, 7), fontsize=7,
            alignment="left", title="estimates", title_fontsize=8,
        )  # fmt: skip


def _columns(figure: Figure, entries: Sequence[str], size: float) -> int:
    """How many legend entries fit side by side; a letter is about 0.6 of the font's size wide."""
    width = (6 + max(map(len, entries))) * 0.6 * size / 72
    return max(1, min(len(entries), int(figure.get_figwidth() / width)))


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_LABEL else text[: LONGEST_LABEL - 1] + "…"


def _plain(text: str) -> str:
    """Text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")
