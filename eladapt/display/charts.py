"""The report's charts: what `plots` draws for papers, to be zoomed, hovered and hidden line by line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, Legend, LegendItem, Range1d, Span
from bokeh.plotting import figure

from eladapt.display.curves import ARRIVED, COLOURS, FAULT_COLOUR, NOTHING, SMALLEST, felt, reduced
from eladapt.records.description import innermost
from eladapt.records.record import Record

DASHES: tuple[Any, ...] = ("solid", (10, 3), (8, 2, 2, 2), (3, 2), (12, 2, 2, 2, 2, 2))
TOOLS = "pan,xwheel_zoom,box_zoom,reset,save"
HEIGHT = 280  # [px]
TEXT = "12px"
Chart = figure


def motion(record: Record) -> list[Any]:
    """Errors on both axes, velocities, torques, their limits, and torque from outside where it was felt."""
    names, t, x = record.joint_names, record.t, _time(record)
    settled = record.settling_time(ARRIVED)
    arrived = t[0] < settled < np.inf
    when = f": below {ARRIVED:g} rad from {settled:.3g} s on" if arrived else ""
    arrival = chart(f"position error, logarithmic{when}", "|e| [rad]", x, log=True)
    lines(arrival, t, np.abs(record.error), names, log=True)
    if arrived:
        arrival.add_layout(Span(location=settled, dimension="height", line_color="#777777"))
    error = chart("position error", "e [rad]", x)
    lines(error, t, record.error, names)
    velocity = chart("velocity", "v [rad/s]", x)
    lines(velocity, t, record.v, names)
    torque = chart("torque, commanded", "τ [N m]", x)
    lines(torque, t, record.tau, names)
    charts = [error, arrival, velocity, torque]
    for what, unit, values, limits in (
        ("velocity", "v", record.v, record.velocity_limit), ("torque", "τ", record.tau, record.effort_limit)
    ):  # fmt: skip
        limited = np.isfinite(limits)
        if limited.any():
            shown = chart(f"{what} as a share of its limit, limits dashed", f"{unit} / limit [-]", x)
            some = [name for name, has in zip(names, limited, strict=True) if has]
            shares = values[:, limited] / limits[limited]
            lines(shown, t, shares, some, limited)
            top = 1.08 * max(1.0, float(np.nanmax(np.abs(shares), initial=0.0)))
            shown.y_range = Range1d(-top, top)
            for limit in (-1, 1):
                level(shown, limit, "#222222", "dashed")
            charts.append(shown)
    if record.external is not None and felt(record):
        external = chart("torque from outside, as felt", "τ [N m]", x)
        lines(external, t, record.external, names)
        charts.append(external)
    return _marked(charts, record)


def learning(record: Record) -> list[Any]:
    """Estimates with true values and bounds, their errors, Delta and gates or what is known, and the load."""
    t, x, charts = record.t, _time(record), []
    size = record.theta.shape[1]
    numbers = [f"θ{number}" for number in range(1, size + 1)]
    if size:
        title = "gravity parameters θ" + ("; thin: true values" if record.theta_true is not None else "")
        bounds = bounds_of(record)
        estimates = chart(title + ("; dotted: bounds" if bounds is not None else ""), "θ [N m]", x)
        lines(estimates, t, record.theta, numbers)
        for index in range(size):
            colour = COLOURS[index % len(COLOURS)]
            if record.theta_true_course is not None:  # a load that comes changes them
                times, true = reduced(t, record.theta_true_course[:, index])
                source = ColumnDataSource({"t": times, "y": true})
                estimates.line(
                    "t", "y", source=source, color=colour, line_width=0.8, name=f"true {numbers[index]}"
                )
            elif record.theta_true is not None:
                level(estimates, record.theta_true[index], colour, "solid")
            for bound in bounds[index] if bounds is not None else ():
                level(estimates, bound, colour, "dotted")
        charts.append(estimates)
        if record.theta_true is not None:
            error = chart("distance of θ from the true values", "|θ - true| [N m]", x, log=True)
            lines(error, t, np.abs(record.theta_error), numbers, log=True)
            charts.append(error)
    if record.delta is not None and record.zeta is not None and (width := record.delta.shape[1]):
        ways = [f"{number}" for number in range(1, width + 1)]
        each = ", by direction" if width > 1 else ""
        delta = chart(f"excitation Δ{each}, logarithmic", "Δ [-]", x, log=True)
        lines(delta, t, np.abs(record.delta), ways, log=True)
        gates = chart(f"gates ζ{each}", "ζ [-]", x)
        lines(gates, t, record.zeta, ways)
        charts += [delta, gates]
    elif record.excitation is not None and record.excitation.shape[1] > 1:
        known = chart("known of gravity, by direction", "eigenvalues of Φ [-]", x)
        ways = [f"{number}" for number in range(1, record.excitation.shape[1])]
        lines(known, record.excitation[:, 0], record.excitation[:, 1:], ways)
        known.y_range = Range1d(-0.05, 1.05)
        charts.append(known)
    if record.carried is not None and len(record.carried):
        mass = chart("load, as estimated", "mass [kg]", x)
        lines(mass, record.carried[:, 0], record.carried[:, 1:2], ["mass"])
        mass.y_range = Range1d(*_load_range(record))
        charts.append(mass)
    return _marked(charts, record)


def comparison(records: Sequence[Record], labels: Sequence[str]) -> list[Any]:
    """One line a record: the largest error, torque and estimation error of all joints."""
    wanted: list[tuple[str, str, bool, Callable[[Record], np.ndarray | None]]] = [
        ("largest position error of all joints", "max |e| [rad]", True, lambda r: r.error),
        ("largest velocity of all joints", "max |v| [rad/s]", False, lambda r: r.v),
        ("largest torque of all joints", "max |τ| [N m]", False, lambda r: r.tau),
        ("largest error of a gravity parameter", "max |θ - true| [N m]", True,
         lambda r: r.theta_error if r.theta_true is not None and r.theta.shape[1] else None),
    ]  # fmt: skip
    charts, x = [], _time(*records)
    for title, unit, log, values_of in wanted:
        drawn = chart(title, unit, x, log=log)
        shown = [(i, r, v) for i, r in enumerate(records) if (v := values_of(r)) is not None]
        for index, record, values in shown:
            size = np.abs(values).max(axis=1)[:, None]
            lines(drawn, record.t, size, [labels[index]], log=log, first=index)
        if shown:
            charts.append(drawn)
    return charts


def chart(
    title: str, unit: str, x: Any = None, log: bool = False, *, across: str = "time [s]", log_x: bool = False
) -> Any:
    """An empty chart; those with the same ``x`` zoom together, None takes what is drawn."""
    kinds = ["log" if logarithmic else "linear" for logarithmic in (log_x, log)]
    shared = {} if x is None else {"x_range": x}
    made = figure(
        title=title, x_axis_label=across, y_axis_label=unit, height=HEIGHT, tools=TOOLS, **shared,
        x_axis_type=kinds[0], y_axis_type=kinds[1], sizing_mode="stretch_width", active_drag="box_zoom",
    )  # fmt: skip
    made.toolbar.logo = None
    made.title.text_font_size = "14px"
    for axis in made.axis:
        axis.axis_label_text_font_size = axis.major_label_text_font_size = TEXT
        axis.axis_label_text_font_style = "normal"
    made.grid.grid_line_color = "#e4e7eb"
    made.outline_line_color = None
    made.add_layout(
        Legend(
            click_policy="hide", label_text_font_size=TEXT, spacing=0, padding=4, border_line_color=None,
            glyph_width=36,
        ),
        "right",
    )  # fmt: skip
    return made


def lines(
    into: Any, t: np.ndarray, values: np.ndarray, names: Sequence[str], kept: Sequence[bool] | None = None,
    *, log: bool = False, first: int = 0,
) -> None:  # fmt: skip
    """A line a column of values (N, k), each to be hidden by a click on its name.

    kept: which of the looks of all joints the columns have. first: number of the first look. log: on a
    logarithmic axis, which ends at `SMALLEST`.
    """
    looks = np.flatnonzero(kept) if kept is not None else np.arange(first, first + values.shape[1])
    for name, column, look in zip_longest(names, values.T, looks):
        finite = np.where(np.isfinite(column), column, np.nan)
        at, y = reduced(t, np.clip(finite, NOTHING, None) if log else finite)
        source = ColumnDataSource({"t": at.astype(np.float32), "y": y.astype(np.float32)}, name=name)
        line = into.line(
            "t", "y", source=source, color=COLOURS[look % len(COLOURS)], line_width=1.6, name=name,
            line_dash=DASHES[look % len(DASHES)],
        )  # fmt: skip
        into.legend[0].items.append(LegendItem(label=name, renderers=[line]))
        tip = [("", "$name"), ("time", "@t{0.000} s"), ("value", "@y{0.000e+0}" if log else "@y{0.0000}")]
        into.add_tools(HoverTool(renderers=[line], tooltips=tip, visible=False))
    drawn = np.concatenate([line.data_source.data["y"] for line in into.renderers]) if log else values
    if log and np.nanmin(drawn, initial=1.0) < SMALLEST:
        into.y_range = Range1d(SMALLEST, 2 * float(np.nanmax(drawn, initial=10 * SMALLEST)))


def level(into: Any, at: float, colour: str, dash: str) -> None:
    """A horizontal line."""
    if np.isfinite(at):
        into.add_layout(
            Span(location=float(at), dimension="width", line_color=colour, line_dash=dash, line_width=0.8)
        )


def _marked(charts: list[Any], record: Record) -> list[Any]:
    """The charts with a line at each of a gate's faults, which the title of the first one names."""
    for fault in record.faults or ():
        for drawn in charts:
            drawn.add_layout(Span(location=fault.t, dimension="height", line_color=FAULT_COLOUR))
        if charts:
            charts[0].title.text += f"; red: fault {fault.name} at {fault.t:.3g} s"
    return charts


def bounds_of(record: Record) -> np.ndarray | None:
    """(j, 2) the bounds of theta_U that the adaptation law keeps, if it was given any."""
    given = _within(innermost(record.configuration.get("controller")).get("law"), "bounds")
    if given is None or isinstance(given, str):  # a text stands for more numbers than a record keeps
        return None
    bounds = np.asarray(given, dtype=float)
    if bounds.ndim < 2:
        bounds = np.stack([-bounds, bounds], axis=-1)
    size = record.theta.shape[1]
    bounds = np.broadcast_to(bounds[-size:] if len(bounds) > size else bounds, (size, 2))
    return bounds if np.isfinite(bounds).any() else None


def _time(*records: Record) -> Range1d:
    """From where the first of them begins to where the last one ends, at least a step."""
    ends = [max(record.t[-1], record.t[0] + record.dt) for record in records]
    return Range1d(float(min(record.t[0] for record in records)), float(max(ends)))


def _load_range(record: Record) -> tuple[float, float]:
    """Where loads can be: before it is one, the estimate is off by many times."""
    carried: Any = record.carried
    mass = carried[carried[:, -1] < 0.1, 1]
    top = float(np.nanmax(mass, initial=0.0))
    return (-0.2 * max(top, 0.1), 1.4 * max(top, 0.1))


def _within(value: Any, name: str) -> Any:
    return value.get(name) if isinstance(value, Mapping) else None
