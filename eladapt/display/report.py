"""One page that keeps a run: set-up, metrics, charts, motion, gains and certificates, in one file.

The page holds all it needs, Bokeh's and MeshCat's code included; its content security policy has the
browser refuse any request. It opens from a disk, without a server.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

from eladapt.display import tables
from eladapt.errors import ArgumentError, EladaptError, needing
from eladapt.records.record import Record
from eladapt.viewing.viewer import page_of

with needing("a report needs Bokeh", "report"):
    from bokeh.layouts import column
    from bokeh.models import Div

    from eladapt.display import charts
    from eladapt.display.pages import WIDE, Page, made, pairs, require_page, tabs, words

FRAME_STYLE = ".bk-clearfix { display: block; width: 100% } iframe { width: 100%; height: 78vh; border: 0 }"


@overload
def report(
    records: Record | Sequence[Record],
    path: None = None,
    *,
    labels: Sequence[str] | None = None,
    certificates: Iterable[Any] = (),
    animation: bool = True,
) -> Page: ...
@overload
def report(
    records: Record | Sequence[Record],
    path: str | Path,
    *,
    labels: Sequence[str] | None = None,
    certificates: Iterable[Any] = (),
    animation: bool = True,
) -> Path: ...
def report(
    records: Record | Sequence[Record],
    path: str | Path | None = None,
    *,
    labels: Sequence[str] | None = None,
    certificates: Iterable[Any] = (),
    animation: bool = True,
) -> Page | Path:
    """One self-contained HTML page about a record, or several beside each other, as a file and its path, or
    without a path as a `Page` that a notebook shows.

    labels: a name for each record instead of its title. certificates: of `certify`, added to those that a
    record's configuration keeps. animation: the motion in three dimensions, about 5 MB a record.
    Raises ArgumentError for a file name that does not end in .html, and labels that are not one a record. A
    record whose robot cannot be had any more is reported without its motion, and the page says why.
    """
    several = (records,) if isinstance(records, Record) else tuple(records)
    if not several or not all(isinstance(record, Record) for record in several):
        raise ArgumentError(f"records: expected a Record, or a sequence of at least one, got {records!r}")
    names = _distinct([record.title for record in several]) if labels is None else list(labels)
    if len(names) != len(several):
        raise ArgumentError(f"labels: expected {len(several)}, one a record, got {len(names)}")
    if path is not None:
        require_page(path)
    given = [tables.plain_certificate(certificate) for certificate in certificates]
    title = names[0] if len(several) == 1 else f"{len(several)} runs"
    metrics, limits = tables.metrics(several, names), tables.limits(several, names)
    overview = [words(f"<h2>Metrics</h2>{metrics}<h2>Limits</h2>{limits}{MEANING}")]
    if len(several) == 1:
        sections = _sections(several[0], given, animation)
        first, rest = sections[0], sections[1:]
        pages = [("Overview", column(*overview, first[1], **WIDE)), *rest]
    else:
        compared = pairs(charts.comparison(several, names))
        pages = [("Comparison", column(*overview, compared, **WIDE))]
        for name, record in zip(names, several, strict=True):
            pages.append((name, tabs(_sections(record, given, animation))))
    page = made(title, pages)
    return page if path is None else page.save(path)


MEANING = (
    "<p>Settled: every joint's error stays below 1e-3 rad from then on. Steady error, torque ripple (peak to "
    "peak, less its trend): the largest of the last second, or of as much of it as the arm was settled. θ: "
    "the gravity parameters, by the torque that their error makes. Limits of speed and range: the URDF's. "
    "Fault: a gate's; without a gate none is recorded. Drag a rectangle to zoom, click a name in a legend to "
    "hide its line, hover over a line for its values.</p>"
)


def _sections(
    record: Record, certificates: Sequence[Mapping[str, Any]], animation: bool
) -> list[tuple[str, Any]]:
    """What is said of one record, by tab; the first is the summary."""
    kept = [*record.configuration.get("certificates", ()), *certificates]
    motion, learnt = charts.motion(record), charts.learning(record)
    sections = [
        ("Motion", pairs(motion)),
        (
            "Learning",
            column(*([pairs(learnt)] if learnt else []), words(tables.parameters(record)), **WIDE),
        ),
        ("3D", _animation(record)) if animation else None,
        ("Gains", words(tables.gains(record))),
        ("Certificates", words(tables.certificates(kept))),
        ("Set-up", words(tables.setup(record))),
    ]
    return [section for section in sections if section is not None]


def _animation(record: Record) -> Any:
    """MeshCat's page in a frame of its own, which has no access to this page; why there is none, where the
    robot cannot be had any more."""
    try:
        page = html.escape(page_of(record), quote=True)
    except EladaptError as reason:
        return words(f"<p>Not drawn: {html.escape(str(reason))}</p>")
    frame = f'<iframe title="3D" sandbox="allow-scripts" srcdoc="{page}"'
    return Div(text=f"{frame}></iframe>", stylesheets=[FRAME_STYLE], disable_math=True, **WIDE)


def _distinct(titles: Sequence[str]) -> list[str]:
    """Titles that occur more than once get a number."""
    return [
        f"{title} ({number})" if titles.count(title) > 1 else title for number, title in enumerate(titles, 1)
    ]
