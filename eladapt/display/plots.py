"""What happened in a run, as curves: errors, velocities, torques, estimates and their excitation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from eladapt.display import marks
from eladapt.display.curves import FAULT_COLOUR, links_of, look, short_label
from eladapt.display.figures import (
    Picture,
    Style,
    StyleName,
    add_legend,
    plain,
    require_suffix,
    style_of,
)
from eladapt.display.panels import MARKERS, Panel, add_markers, end_at_rounding, panels_of
from eladapt.errors import ArgumentError
from eladapt.records.record import Record

LONGEST_LABEL = 84  # characters


def plot(
    records: Record | Sequence[Record],
    path: str | Path | None = None,
    *,
    labels: Sequence[str] | None = None,
    style: StyleName = "screen",
    panels: Sequence[str] | None = None,
    full_names: bool = False,
) -> Picture:
    """Draw one record, or several side by side on common axes, and save the figure if ``path`` is given.

    path: ends in .png, .pdf or .svg. labels: a heading for each record, instead of its title.
    style: "screen", or "paper": as wide as a column of a journal, in its letters, every curve by a colour, a
    dash and a marker of its own. Saved as .pdf or .svg it is made of lines, not of pixels.
    panels: which of those below to draw, in this order, by name; None for all that the records have:

    - "position" where the goal moves, with the goal dashed
    - "error" and "arrival": position errors on a linear and a logarithmic axis (arrival in finite time is a
      vertical drop; what is below 1e-12 is rounding, and leaves the axis)
    - "velocity" and "torque", with those limits that are near
    - "outside": the torque from outside, where one was felt
    - "estimates" of gravity, with the true values dashed, and "estimation", their errors, where known
    - "delta" and "zeta" where the law has them, otherwise "excitation": how much of gravity is known,
      direction by direction

    A gate's fault is a red line through all of them. Estimates are in N m with the default, scaled
    regressors, and in the unit of the basis otherwise. Each is named by the largest of its terms, and by the
    link that this is of; full_names: by all of them. Raises ArgumentError for another suffix and for labels
    that are not one a record, UnknownNameError for another style or panel.
    """
    several = (records,) if isinstance(records, Record) else tuple(records)
    if not several or not all(isinstance(record, Record) for record in several):
        raise ArgumentError(f"records: expected a Record, or a sequence of at least one, got {records!r}")
    headings = [record.title for record in several] if labels is None else list(labels)
    if len(headings) != len(several):
        raise ArgumentError(f"labels: expected {len(several)}, one a record, got {len(headings)}")
    if path is not None:
        require_suffix(path)
    looks, shown = style_of(style), panels_of(several, panels)
    with mpl.rc_context(looks.settings):
        if len(several) == 1:
            figure = _alone(several[0], shown, looks, headings[0], full_names)
        else:
            figure = _compared(several, shown, looks, headings, full_names)
    if path is not None:
        figure.save(path)
    return figure


def _alone(record: Record, panels: Sequence[Panel], style: Style, heading: str, full: bool) -> Picture:
    """On a screen two columns: the motion on the left, what was learnt on the right. In a paper one."""
    halves = [[panel for panel in panels if panel.learnt == kind] for kind in (False, True)]
    if style.marked:  # markers are a paper's
        halves = [list(panels)]
    elif not all(halves):  # then what there is has both columns
        halves = [list(panels[: -(-len(panels) // 2)]), list(panels[-(-len(panels) // 2) :])]
    halves = [half for half in halves if half]
    height = style.panel * max(map(len, halves)) + 0.08 * record.theta.shape[1] + 0.1 * style.names
    figure = Picture(style, style.column * max(1, len(halves)), height)
    grid = figure.add_gridspec(1, len(halves))
    rows: list[tuple[Panel, list[Axes]]] = []
    for half, shown in enumerate(halves):  # fewer panels are higher
        column = grid[half].subgridspec(len(shown), 1).subplots(sharex=True, squeeze=False)[:, 0]
        column[-1].set_xlabel("time [s]")
        rows += [(panel, [axes]) for panel, axes in zip(shown, column, strict=True)]
    _fill(figure, rows, [record], heading if not style.marked else "", full)
    return figure


def _compared(
    records: Sequence[Record], panels: Sequence[Panel], style: Style, headings: Sequence[str], full: bool
) -> Picture:
    """A column a record and a row a panel; a row has one axis."""
    width = style.column * (0.62 * len(records) + 0.1)
    figure = Picture(style, max(width, 1.45 * style.column), 0.9 * style.panel * len(panels) + 1)
    grid = figure.subplots(len(panels), len(records), sharex=True, sharey="row", squeeze=False)
    _fill(figure, list(zip(panels, grid.tolist(), strict=True)), records, "", full)
    for row in grid:
        for axes in row[1:]:
            axes.set(title="", ylabel="")
    for axes, heading in zip(grid[0], headings, strict=True):
        above = 2.4 * figure.style.note + 3  # [points]: over the title
        axes.annotate(
            plain(heading), (0, 1), (0, above), xycoords="axes fraction", textcoords="offset points",
            weight="bold",
        )  # fmt: skip
    for column in grid.T:
        last = [axes for axes in column if axes.axison][-1:]  # below it there may be nothing
        for axes in last:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
    return figure


def _fill(
    figure: Picture, rows: Sequence[tuple[Panel, list[Axes]]], records: Sequence[Record], heading: str,
    full: bool,
) -> None:  # fmt: skip
    """Curves first, then the legends, then what is written where the curves leave room."""
    ends = [(record.t[0], max(record.t[-1], record.t[0] + record.dt)) for record in records]
    first, last = min(end[0] for end in ends), max(end[1] for end in ends)
    width: list[Artist] = []  # of what is written beside the panels, for the layout
    for panel, row in rows:
        for axes, record in zip(row, records, strict=True):
            axes.set(title=panel.title, ylabel=f"[{panel.unit}]", xlim=(first, last))
            panel.draw(axes, record)
            if figure.style.marked:
                add_markers(axes)
            for fault in record.faults or () if axes.axison else ():
                axes.axvline(fault.t, color=FAULT_COLOUR, linewidth=1.0)
        end_at_rounding(row)
        row[0].set_ylim(*row[0].get_ylim())
        for axes, record in zip(row, records, strict=True):
            if panel.limits is not None:
                marks.draw_limits(axes, marks.limits_near(*panel.limits(record), record.joint_names))
            if panel.numbered:
                width += marks.numbers(axes, record, figure.style.names)
    _legends(figure, records, heading, full, any(panel.numbered for panel, _ in rows))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    for artist in width:
        artist.remove()
    for panel, row in rows:
        for axes, record in zip(row, records, strict=True):
            if panel.numbered:
                marks.numbers(axes, record, figure.style.names)
            if panel.write is not None:
                panel.write(axes, record, figure.style.note)
            if panel.limits is not None:
                height = float(np.ptp(axes.get_ylim()))
                near = marks.limits_near(*panel.limits(record), record.joint_names, height)
                marks.name_limits(axes, near, figure.style.note)


def _legends(figure: Picture, records: Sequence[Record], heading: str, full: bool, numbered: bool) -> None:
    """The joints above and the estimates below the panels, by number where the records differ in them."""
    style = figure.style
    joints = max((record.joint_names for record in records), key=len)
    if any(record.joint_names != joints for record in records):
        joints = tuple(f"joint {number}" for number in range(1, len(joints) + 1))
    handles = [Line2D([], [], marker=_marker(style, k), **look(k)) for k in range(len(joints))]
    add_legend(
        figure, handles, joints, "outside upper left", style.note, alignment="left", title=plain(heading),
        title_fontproperties={"weight": "bold", "size": 11},
    )  # fmt: skip
    names = max((record.theta_labels for record in records), key=len)
    if not numbered or not names or any(record.theta_labels not in (names, ()) for record in records):
        return
    links = links_of(next(record for record in records if record.theta_labels == names))
    said = [name if full else short_label(name, links) for name in names]
    entries = [f"{number}: {_short(name)}" for number, name in enumerate(said, 1)]
    handles = [Line2D([], [], color=look(k)["color"], marker=_marker(style, k)) for k in range(len(entries))]
    add_legend(
        figure, handles, entries, "outside lower left", style.names, alignment="left", title="estimates",
        title_fontsize=style.note,
    )  # fmt: skip


def _marker(style: Style, index: int) -> str:
    return MARKERS[index % len(MARKERS)] if style.marked else ""


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_LABEL else text[: LONGEST_LABEL - 1] + "…"
