"""What is written into a panel: limits, times and numbers, where no curve is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox, BboxBase

from eladapt.display.curves import ARRIVED, FAULT_COLOUR, look
from eladapt.display.figures import plain
from eladapt.records.record import Record

LIMIT_NEAR = 0.5  # of a limit: from there on it is drawn
LABEL = 0.08  # of a panel's height, by which two limits must be apart to have a label each
MOST_NUMBERS = 14  # estimates that are numbered at their right end
LOOKS = 40  # places across a text at which curves are looked at


class Spot(NamedTuple):
    """Where a text may stand, in parts of the axes: its anchor, and which side of the text that is."""

    x: float
    y: float
    ha: str
    va: str


def write(
    axes: Axes, text: str, spots: Sequence[Spot], size: float, colour: str, *, always: bool = True
) -> bool:
    """A text at the spot from which curves are farthest and where no text is, the first of those that are as
    good; whether it was written. always: even where no spot is free. The figure's layout must be known."""
    taken = [_in_parts(axes, other.get_window_extent()) for other in axes.texts]
    written = axes.annotate(
        text, (0.5, 0.5), xycoords="axes fraction", fontsize=size, color=colour, zorder=4,
        bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.3},
    )  # fmt: skip
    written.set_in_layout(False)
    own = _in_parts(axes, written.get_window_extent())
    width, height = own.width, 1.15 * own.height
    curves = _curves(axes)

    def clearance(spot: Spot) -> float:
        left = spot.x - {"left": 0.0, "center": 0.5, "right": 1.0}[spot.ha] * width
        low = spot.y - {"bottom": 0.0, "center": 0.5, "top": 1.0}[spot.va] * height
        if left < -0.01 or left + width > 1.01 or low < -0.01 or low + height > 1.05:
            return -1.0
        if any(Bbox.from_bounds(left, low, width, height).overlaps(other) for other in taken):
            return -1.0
        at = np.linspace(left, left + width, LOOKS)
        gaps = [np.abs(np.interp(at, x, y) - low - height / 2) - height / 2 for x, y in curves]
        return min(height, float(np.min(gaps, initial=height)))  # farther than a line is as good

    best = max(spots, key=clearance)
    if not always and clearance(best) <= 0:
        written.remove()
        return False
    written.xy = best[:2]
    written.set(position=best[:2], ha=best.ha, va=best.va)
    return True


def _in_parts(axes: Axes, box: BboxBase) -> Bbox:
    """A box of pixels in parts of the axes."""
    return box.transformed(axes.transAxes.inverted())


def _curves(axes: Axes) -> list[tuple[np.ndarray, np.ndarray]]:
    """The curves in parts of the axes, where they are finite."""
    found = []
    for line in axes.lines:
        if line.get_transform() != axes.transData or np.size(line.get_xdata()) < 3:
            continue  # a level, or a mark
        points = np.column_stack([line.get_xdata(), line.get_ydata()]).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            x, y = axes.transAxes.inverted().transform(axes.transData.transform(points)).T
            found.append((x, y))
    return found


def _across(axes: Axes, t: float) -> float:
    """A time as a part of the axes."""
    first, last = axes.get_xlim()
    return float((t - first) / (last - first))


def _beside(axes: Axes, t: float) -> list[Spot]:
    """Spots on both sides of a time, or else at the sides of the panel, at the top and at the bottom."""
    x = _across(axes, t)
    sides = [(x + 0.008, "left"), (x - 0.008, "right"), (1.0, "right"), (0.0, "left")]
    return [Spot(at, y, ha, va) for y, va in ((1.0, "top"), (0.02, "bottom")) for at, ha in sides]


def faults(axes: Axes, record: Record, size: float) -> None:
    """The names of a gate's faults, beside the lines that mark them."""
    for fault in record.faults or ():
        write(axes, f"{fault.name}, {fault.t:.3g} s", _beside(axes, fault.t), size, FAULT_COLOUR)


def arrival(axes: Axes, record: Record, size: float) -> None:
    """When the arm settles."""
    settled = record.settling_time(ARRIVED)
    if record.t[0] < settled < np.inf:
        write(axes, f"below {ARRIVED:g} rad from {settled:.3g} s", _beside(axes, settled), size, "0.3")


class Limit(NamedTuple):
    """Levels that are near enough to be drawn, and whose they are."""

    levels: np.ndarray
    joints: tuple[str, ...]


def limits_near(
    values: np.ndarray, limits: np.ndarray, names: Sequence[str], height: float | None = None
) -> list[Limit]:
    """The limits (nv,), up or down, of those joints whose own values (N, nv) come near them.

    height: of the axis; levels that are too close to each other on it for two labels are one entry.
    """
    high, low = (np.nan_to_num(bound(values, axis=0, initial=0.0)) for bound in (np.nanmax, np.nanmin))
    signed = [(limits, high >= LIMIT_NEAR * limits), (-limits, -low >= LIMIT_NEAR * limits)]
    found = []
    for bounds, near in signed:
        levels = np.unique(bounds[near])
        apart = np.diff(levels) > (0.0 if height is None else LABEL * height)
        for group in np.split(levels, np.flatnonzero(apart) + 1):
            joints = tuple(names[int(k)] for k in np.flatnonzero(near & np.isin(bounds, group)))
            if joints:
                found.append(Limit(group, joints))
    return found


def draw_limits(axes: Axes, near: Sequence[Limit]) -> None:
    """Lines at the limits, within the axis."""
    for limit in near:
        for level in limit.levels:
            axes.axhline(level, color="0.3", linestyle=(0, (8, 4)), linewidth=0.8)
            bottom, top = axes.get_ylim()
            axes.set_ylim(min(bottom, 1.1 * level), max(top, 1.1 * level))


def name_limits(axes: Axes, near: Sequence[Limit], size: float) -> None:
    """Whose limits they are: above or below the lines, in fewer words where there is less room, or beside the
    title where there is none."""
    bottom, top = axes.get_ylim()
    left = []
    for limit in near:
        low, high = ((limit.levels[k] - bottom) / (top - bottom) for k in (0, -1))
        heights = [(high + 0.01, "bottom"), (low - 0.01, "top")]
        spots = [
            Spot(x, y, ha, va)
            for y, va in (heights if high > 0.5 else heights[::-1])
            for x, ha in ((0.995, "right"), (0.5, "center"), (0.005, "left"))
        ]
        first, *more = limit.joints
        said = [
            f"limit of {', '.join(limit.joints)}",
            *([f"limit of {first}, {len(more)} more"] if more else ()),
        ]
        if not any(write(axes, plain(text), spots, size, "0.3", always=False) for text in said):
            left.append(f"{said[-1]}: {limit.levels[-1]:.4g}")
    if left:
        axes.annotate(
            plain("; ".join(left)), (1.0, 1.01), xycoords="axes fraction", ha="right", va="bottom",
            fontsize=size, color="0.3",
        ).set_in_layout(False)  # fmt: skip


def numbers(axes: Axes, record: Record, size: float) -> list[Artist]:
    """The estimates' numbers in the legend, at their right ends, each with a line to its curve."""
    ends = record.theta[-1]
    if not 0 < len(ends) <= MOST_NUMBERS or not np.isfinite(ends).all():
        return []
    height = axes.get_window_extent().height / axes.figure.dpi  # [in]
    low, high = axes.get_ylim()
    order = np.argsort(ends)
    ends_at = (ends[order] - low) / (high - low)
    at, gap = ends_at.copy(), 1.2 * size / 72 / height
    lowest, highest = min(0.0, 0.5 - gap * len(ends) / 2), max(1.0, 0.5 + gap * len(ends) / 2)
    for _ in range(500):  # neighbours that are too near push each other apart
        push = np.maximum(gap - np.diff(at), 0) / 2
        at[:-1] -= push
        at[1:] += push
        at[0], at[-1] = max(at[0], lowest), min(at[-1], highest)
    made: list[Artist] = []
    for place, end, index in zip(at, ends_at, order, strict=True):
        colour = look(index)["color"]
        made.append(axes.annotate(
            f"{index + 1}", (1.0, end), (1.035, place), xycoords="axes fraction", textcoords="axes fraction",
            color=colour, fontsize=size, va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0},
        ))  # fmt: skip
    return made
