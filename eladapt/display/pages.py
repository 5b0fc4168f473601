"""Pages that hold all they need, Bokeh's code included; their policy has the browser refuse any request."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eladapt.display import tables
from eladapt.display.inline import frame
from eladapt.errors import ArgumentError, needing
from eladapt.files import atomic_write
from eladapt.viewing.page import POLICY

with needing("a report needs Bokeh", "report"):
    from bokeh.embed import file_html
    from bokeh.layouts import column, row
    from bokeh.models import Div, TabPanel, Tabs
    from bokeh.resources import INLINE

TEMPLATE = (
    '{% block preamble %}<meta name="viewport" content="width=device-width">'
    '<meta http-equiv="Content-Security-Policy" content="'
    + POLICY
    + '"><style>body { margin: 14px }</style>{% endblock %}'
)
LEFT = 80  # [px] beside a chart, so that the times of one are below those of another
HALF = ":host { flex: 0 0 50% } @media (max-width: 700px) { :host { flex: 0 0 100% } }"
WIDE: Any = {"sizing_mode": "stretch_width"}


def require_page(path: str | Path) -> Path:
    """The path, if it can be a page's. Raises ArgumentError."""
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"path: expected a file name that ends in .html, got {str(path)!r}")
    return path


@dataclass(frozen=True, repr=False)
class Page:
    """A page, which a notebook shows, and its HTML ``text``."""

    title: str
    text: str

    def save(self, path: str | Path) -> Path:
        """Write it, whole or not at all; returns its path. Raises ArgumentError for a name that does not
        end in .html."""
        path = require_page(path)
        with atomic_write(path) as temporary:
            temporary.write_text(self.text, encoding="utf-8")
        return path

    def __repr__(self) -> str:
        return f"Page({self.title!r}, {len(self.text) / 1e6:.1f} MB; save(path) writes it)"

    def _repr_html_(self) -> str:
        return frame(self.text, self.title)


def made(title: str, pages: Sequence[tuple[str, Any]]) -> Page:
    """A page of tabs."""
    heading = f"<h1 style='font-size: 22px; margin: 0'>{html.escape(title)}</h1>"
    whole = column(words(heading), tabs(pages), **WIDE)
    return Page(title, file_html(whole, INLINE, title=f"eladapt: {title}", template=TEMPLATE))


def pairs(drawn: Sequence[Any]) -> Any:
    """Charts, two a row, or one where the page is narrow."""
    for chart in drawn:
        chart.stylesheets, chart.min_border_left = [*chart.stylesheets, HALF], LEFT
    return row(list(drawn), styles={"flex-wrap": "wrap"}, **WIDE)


def tabs(pages: Sequence[tuple[str, Any]]) -> Any:
    """A tab for each name."""
    return Tabs(tabs=[TabPanel(title=name, child=child) for name, child in pages], **WIDE)


def words(content: str) -> Any:
    """HTML in the style of the tables."""
    return Div(text=content, stylesheets=[tables.STYLE], disable_math=True, **WIDE)
