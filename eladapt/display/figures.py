"""Figures: how they look on a screen and in a paper, how they are saved, and that notebooks show them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.files import atomic_write

HANDLE = 5.0  # [em] of a legend's entry, beside its letters
SUFFIXES = (".png", ".pdf", ".svg")
StyleName = Literal["screen", "paper"]
Place = Literal["outside upper left", "outside lower left", "outside lower center"]  # of a legend
Entry = TypeVar("Entry")


class Style(NamedTuple):
    """The looks of a figure; lengths in inches, letters in points."""

    settings: Any  # matplotlib's, by name
    column: float  # width of a column of panels
    panel: float  # height of a panel
    note: float  # size of what is written into a panel
    names: float  # size of the names of the estimates
    letter: float  # [em] the width of a letter in a legend
    marked: bool  # whether curves have markers too
    dpi: int  # of a picture made of pixels


_COMMON: dict[str, Any] = {
    "axes.titlelocation": "left", "axes.grid": True, "grid.color": "0.9", "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
}  # fmt: skip
STYLES = {
    "screen": Style(
        {**_COMMON, "font.size": 9, "axes.titlesize": 9.5, "lines.linewidth": 1.2, "svg.fonttype": "none"},
        column=5.5, panel=2.2, note=8, names=7, letter=0.55, marked=False, dpi=150,
    ),
    # The width of a column and the letters of the journals of control and robotics; letters stay letters.
    "paper": Style(
        {
            **_COMMON, "font.family": "STIXGeneral", "mathtext.fontset": "stix", "font.size": 8,
            "axes.titlesize": 8, "axes.titlepad": 3, "axes.linewidth": 0.6, "grid.linewidth": 0.4,
            "lines.linewidth": 0.9, "lines.markersize": 3, "xtick.labelsize": 7, "ytick.labelsize": 7,
            "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5,
            "ytick.major.size": 2.5, "ytick.minor.size": 1.2, "legend.handlelength": 2.6,
            "legend.columnspacing": 1.2, "pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "path",
        },
        column=3.45, panel=1.25, note=6.5, names=6.5, letter=0.42, marked=True, dpi=600,
    ),
}  # fmt: skip


class Picture(Figure):
    """A figure with a style, which it is saved with; a notebook shows it where a cell ends with it."""

    def __init__(self, style: Style, width: float, height: float):
        self.style = style
        super().__init__(figsize=(width, height), layout="constrained")

    def savefig(self, *args: Any, **options: Any) -> None:
        """As matplotlib's, in the figure's own style."""
        with mpl.rc_context(self.style.settings):
            super().savefig(*args, **{"dpi": self.style.dpi, **options})

    def save(self, path: str | Path) -> Path:
        """Write a file that ends in .png, .pdf or .svg, whole or not at all; returns its path."""
        require_suffix(path)
        with atomic_write(path) as temporary:
            self.savefig(temporary)
        return Path(path)

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.savefig(picture, format="png", dpi=min(self.style.dpi, 200))
        return picture.getvalue()


def style_of(name: str) -> Style:
    """The style of that name. Raises UnknownNameError."""
    if name not in STYLES:
        raise UnknownNameError("style", [str(name)], list(STYLES))
    return STYLES[name]


def require_suffix(path: str | Path) -> None:
    """Raises ArgumentError for a file that no figure can be."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ArgumentError(f"path: expected a name that ends in {', '.join(SUFFIXES)}, got {str(path)!r}")


def plain(text: str) -> str:
    """Text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")


def add_legend(
    figure: Picture,
    handles: Sequence[Artist],
    entries: Sequence[str],
    loc: Place,
    size: float,
    **options: Any,
) -> None:
    """A legend outside the panels, in letters of ``size``, whose entries are read line by line; options:
    matplotlib's."""
    columns = _columns(figure, entries, size)
    figure.legend(
        _across(handles, columns), _across([plain(entry) for entry in entries], columns), loc=loc,
        ncols=columns, fontsize=size, **options,
    )  # fmt: skip


def _across(entries: Sequence[Entry], columns: int) -> list[Entry]:
    """As matplotlib wants them, which fills one column after the other."""
    return [entry for column in range(columns) for entry in entries[column::columns]]


def _columns(figure: Picture, entries: Sequence[str], size: float) -> int:
    """How many entries fit side by side, each with its line and the space around it."""
    width = (HANDLE + figure.style.letter * max(map(len, entries))) * size / 72
    return max(1, min(len(entries), int(figure.get_figwidth() / width)))
