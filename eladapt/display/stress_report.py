"""One page about a stress test: how many worlds failed, where in their space, and the worst of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from eladapt.display import tables
from eladapt.errors import needing
from eladapt.worlds.explanations import explanations
from eladapt.worlds.result import QUANTILES, SUMMED, Failure, Stress
from eladapt.worlds.rows import FACTORS, MEASURES, text

with needing("a report needs Bokeh", "report"):
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource, HoverTool, LegendItem, Range1d

    from eladapt.display import charts
    from eladapt.display.curves import COLOURS, FAULT_COLOUR
    from eladapt.display.pages import WIDE, made, pairs, require_page, words

BINS = 10  # of a factor, with as many worlds in each
MOST_POINTS = 4000  # of a cloud: all failures up to half of them, and some of the good worlds
MOST_ROWS = 100  # of the table of failures
WORST = 10  # good worlds with the largest errors
LOGARITHMIC = ("position_noise", "velocity_noise")
GOOD = "#9aa4ae"

WHAT = (
    "<p>A world: an arm that is not quite its file, with a load that nobody told, friction, rotors, noise, "
    "delay and a base that is not level. It is good if the gate named no fault and every demand was met. "
    "<code>result.replay(seed)</code> simulates it again, with its full record.</p>"
)
TOLD = (
    "<p>Strength: 1 if the number alone tells failed from good worlds, 0 if both have alike much of it "
    "(|2P - 1|, P: that a failed world has more of it than a good one). Listed is what chance would make "
    "with a probability below 1 % in any of the numbers.</p>"
)


def stress_report(result: Stress, path: str | Path) -> Path:
    """Write the page; returns its path. Raises ArgumentError for a name that does not end in .html."""
    path = require_page(path)
    failures = result.failures(MOST_ROWS)
    overview = words(f"{_counts(result)}{WHAT}{_explained(result)}{_quantiles(result)}")
    pages: list[tuple[str, Any]] = [
        ("Overview", column(overview, **WIDE)),
        ("Where it fails", pairs(_where(result))),
        ("Distributions", pairs([_distribution(result, name) for name in SUMMED if _known(result, name)])),
        ("Worst worlds", words(_failed(result, failures) + _nearly(result))),
        ("Set-up", words(_setup(result))),
    ]
    return made(f"{result.trials.robot.name} in {result.worlds:,} worlds", pages).save(path)


def _counts(result: Stress) -> str:
    good = int(np.count_nonzero(result.good))
    low, high = _interval(good, result.worlds)
    said = (
        f"<h2>{good:,} of {result.worlds:,} good: {good / result.worlds:.2%}</h2><p>With 95 % confidence "
        f"between {low:.2%} and {high:.2%} of all such worlds are.</p>"
    )
    if not result.causes:
        return said
    rows = [[cause, f"{count:,}", f"{count / result.worlds:.2%}"] for cause, count in result.causes.items()]
    return said + tables.table(["cause of failure", "worlds", "share"], rows, numbers=(1, 2))


def _interval(good: int, worlds: int) -> tuple[float, float]:
    """Clopper and Pearson's."""
    from scipy.stats import binomtest

    found = binomtest(good, worlds).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def _explained(result: Stress) -> str:
    """What tells failures from good worlds, of all and of each cause."""
    rows = []
    whole = [("any", ~result.good)] if len(result.causes) != 1 else []
    for cause, failed in [*whole, *((c, result.rows["cause"] == c.encode("ascii")) for c in result.causes)]:
        some = failed | result.good
        for one in explanations(result.rows[some], failed[some])[:5]:
            more = "more" if one.larger else "less"
            chance = f"{one.probability:.1g}"
            rows.append([cause, f"{more} {FACTORS[one.factor]}", f"{one.strength:.2f}", chance])
    if not rows:
        few = "nothing failed" if result.good.all() else "no number of the worlds tells them from good ones"
        return f"<h2>What explains failures</h2><p>{few[0].upper()}{few[1:]}.</p>"
    head = ["cause", "failed worlds have", "strength", "by chance"]
    return f"<h2>What explains failures</h2>{tables.table(head, rows, numbers=(2, 3))}{TOLD}"


def _quantiles(result: Stress) -> str:
    head = ["of all worlds", *(f"{q:.0%}" if q < 1 else "largest" for q in QUANTILES)]
    rows = [[MEASURES[n], *map(tables.figure, values)] for n, values in result.quantiles().items()]
    return f"<h2>Quantiles</h2>{tables.table(head, rows, numbers=range(1, len(head)))}"


def _known(result: Stress, name: str) -> bool:
    return bool(np.isfinite(result.rows[name]).any())


def _where(result: Stress) -> list[Any]:
    """The share of failures over each factor that varies, strongest first, and a cloud over two of them."""
    strong = [one.factor for one in result.explanations]
    names = [*strong, *(name for name in FACTORS if name not in strong)]
    varied = [name for name in names if len(np.unique(result.rows[name][_finite(result, name)])) > 1]
    if not varied:
        return [charts.chart("no number of the worlds varies", "")]
    first, second = [*varied, varied[0]][:2]
    return [_cloud(result, first, second), *(_share(result, name) for name in varied)]


def _finite(result: Stress, name: str) -> np.ndarray:
    return np.isfinite(result.rows[name])


def _share(result: Stress, name: str) -> Any:
    """Failures of the worlds in each tenth of a factor."""
    known = _finite(result, name)
    values, failed = result.rows[name][known], ~result.good[known]
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(place, minlength=len(edges) - 1)
    shares = 100 * np.bincount(place, failed, minlength=len(edges) - 1) / np.maximum(counts, 1)
    meaning, log = FACTORS[name], name in LOGARITHMIC
    drawn = charts.chart(f"failed over: {meaning}", "failed [%]", across=meaning, log_x=log)
    source = ColumnDataSource({"left": edges[:-1], "right": edges[1:], "top": shares, "count": counts})
    drawn.quad("left", "right", "top", 0, source=source, color=COLOURS[2], line_color="white")
    drawn.add_tools(HoverTool(tooltips=[("failed", "@top{0.0} %"), ("worlds", "@count")]))
    drawn.y_range = Range1d(0, max(1.0, 1.1 * float(shares.max())))
    return drawn


def _cloud(result: Stress, x: str, y: str) -> Any:
    """Worlds over two factors, failures in the colour of their cause."""
    drawn = charts.chart(
        "worlds; failed ones coloured by cause", FACTORS[y], log=y in LOGARITHMIC, across=FACTORS[x],
        log_x=x in LOGARITHMIC,
    )  # fmt: skip
    known, left = _finite(result, x) & _finite(result, y), MOST_POINTS
    colours = [FAULT_COLOUR, *COLOURS[1:]]
    for k, cause in enumerate(result.causes):
        failed = _some(known & (result.rows["cause"] == cause.encode("ascii")), left // 2)
        left -= len(failed)
        _dots(
            drawn, result.rows[failed], x, y, cause, color=colours[k % len(colours)], size=7, level="overlay"
        )
    good = _some(known & result.good, left)
    _dots(drawn, result.rows[good], x, y, "good", color=GOOD, size=4, alpha=0.6)
    drawn.add_tools(HoverTool(tooltips=[("world", "@seed"), ("", "@said")]))
    return drawn


def _some(which: np.ndarray, most: int) -> np.ndarray:
    """Numbers of the worlds, at random where there are more than that."""
    found = np.flatnonzero(which)
    if len(found) <= most:
        return found
    return np.sort(np.random.default_rng(0).choice(found, most, replace=False))


def _dots(drawn: Any, rows: np.ndarray, x: str, y: str, label: str, **style: Any) -> None:
    said = [text(one) for one in rows["said"]]
    source = ColumnDataSource({"x": rows[x], "y": rows[y], "seed": rows["seed"], "said": said})
    dots = drawn.scatter("x", "y", source=source, **style)
    drawn.legend[0].items.append(LegendItem(label=label, renderers=[dots]))


def _distribution(result: Stress, name: str) -> Any:
    """The share of worlds above each value, of a measure: 1 - its distribution function."""
    values = result.rows[name]
    ended = np.sort(values[np.isfinite(values)])
    above = 100 * (1 - np.arange(len(ended)) / len(values))
    kept = np.unique(np.linspace(0, len(ended) - 1, 500).astype(int))
    positive = bool(ended[0] > 0 and ended[-1] > 20 * ended[0])
    meaning = MEASURES[name]
    drawn = charts.chart(f"worlds above: {meaning}", "worlds [%]", log=True, across=meaning, log_x=positive)
    drawn.step(ended[kept], above[kept], color=COLOURS[0], line_width=2)
    return drawn


def _failed(result: Stress, failures: list[Failure]) -> str:
    if not failures:
        return "<h2>Failures</h2><p>None.</p>"
    rows = [[str(one.seed), one.cause, one.said, one.likely or "-"] for one in failures]
    listed = tables.table(["world", "cause", "figures", "stands out by"], rows, numbers=(0,))
    left = int(np.count_nonzero(~result.good)) - len(failures)
    more = f"<p>and {left:,} more: <code>result.failures()</code> lists them.</p>" if left else ""
    return f"<h2>Failures</h2>{listed}{more}"


def _nearly(result: Stress) -> str:
    """The good worlds with the largest errors."""
    good = np.flatnonzero(result.good)
    worst = good[np.argsort(-result.rows["tracking"][good], kind="stable")[:WORST]]
    names = ("tracking", "settling", "steady", "overshoot", "torque", "load", "coulomb", "viscous")
    rows = [
        [str(row["seed"]), *(tables.figure(float(row[name])) for name in names)] for row in result.rows[worst]
    ]
    head = ["world", *((FACTORS | MEASURES)[name] for name in names)]
    listed = tables.table(head, rows, numbers=range(len(head)))
    return f"<h2>Good ones with the largest errors while moving</h2>{listed}"


def _setup(result: Stress) -> str:
    """Distributions and criteria, field by field."""
    trials, found = result.trials, ""
    for title, part in (("Distributions", trials.distributions), ("A world is good if", trials.criteria)):
        rows = [[name, str(value)] for name, value in vars(part).items()]
        found += f"<h2>{title}</h2>{tables.table(['', ''], rows)}"
    return found
