"""What a notebook shows of a result where a cell ends with it: small tables, and pages in frames."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from eladapt.display import tables
from eladapt.gains.rules import Rule

if TYPE_CHECKING:
    from eladapt.estimation.friction import FrictionEstimate
    from eladapt.estimation.payload import PayloadEstimate
    from eladapt.identification.found import Identified
    from eladapt.records.record import Record
    from eladapt.theory.certificates import Certificate

STYLE = """
.eladapt td, .eladapt th { text-align: left !important; vertical-align: top; max-width: 44em }
.eladapt td.number, .eladapt th.number { text-align: right !important; white-space: nowrap;
font-variant-numeric: tabular-nums } .eladapt h2 { font-size: 1.1em; margin: 0.8em 0 0.3em }
.eladapt p, .eladapt li { max-width: 62em } .eladapt .no { font-weight: 600; color: #c2410c }
"""
HEIGHT = 560  # [px] of a page


def block(heading: str, *parts: str) -> str:
    """HTML parts below a heading, in a style that reaches nothing else of the notebook."""
    title = f"<b>{html.escape(heading)}</b>"
    return f'<div class="eladapt"><style>{STYLE}</style>{title}{"".join(parts)}</div>'


def frame(page: str, title: str) -> str:
    """A whole page in a frame, which has no access to the notebook."""
    return (
        f'<iframe title="{html.escape(title, quote=True)}" sandbox="allow-scripts" width="100%" '
        f'height="{HEIGHT}" style="border: 1px solid #d0d5da" srcdoc="{html.escape(page, quote=True)}">'
        "</iframe>"
    )


def record(shown: Record) -> str:
    """Metrics and limits of a run."""
    named = [shown.title]
    return block(repr(shown), tables.metrics([shown], named), tables.limits([shown], named))


def rules(heading: str, given: Sequence[Rule]) -> str:
    """Gains or limits, each with the rule that set it."""
    head = ["", "value, by joint where there are several", "rule", "what limited it"]
    return block(heading, tables.table(head, [list(rule) for rule in given]))


def identified(found: Identified) -> str:
    """How well parameters predict, and what is not told."""
    from eladapt.display import identified_tables as told

    parts = [f"<h2>Torque error{told.judged(found)}</h2>{told.errors(found)}", told.not_told(found)]
    return block(repr(found), *parts, friction_table(found.friction))


def payload(load: PayloadEstimate) -> str:
    """Mass and centre of mass with their standard deviations, and what is not identified."""
    names = ("mass [kg]", "x [m]", "y [m]", "z [m]")
    values, deviations = [load.mass, *load.com], [load.mass_std, *load.com_std]
    rows = [
        [
            name,
            f"{value:.4g}" if np.isfinite(value) else "not told",
            "unknown" if np.isnan(std) else f"{std:.2g}",
        ]
        for name, value, std in zip(names, values, deviations, strict=True)
    ]
    said = [f"not identified: {', '.join(load.unidentified)}"] if load.unidentified else []
    if not load.is_load:
        said.append(f"{load.misfit:.0%} of what changed is no load in this frame")
    table = tables.table(["", "load", "standard deviation"], rows, numbers=(1, 2))
    return block(f"Load in {load.frame}", table, *(f"<p>{html.escape(text)}</p>" for text in said))


def friction(found: FrictionEstimate) -> str:
    """A row a joint."""
    return block(repr(found), friction_table(found))


def friction_table(found: FrictionEstimate) -> str:
    """Viscous and Coulomb friction and offset, a row a joint."""
    head, *rows = found.rows()
    return tables.table(head, rows)


def certificate(found: Certificate) -> str:
    """The conditions, and what it means where some do not hold."""
    return block(repr(found), tables.certificates([tables.plain_certificate(found)]))
