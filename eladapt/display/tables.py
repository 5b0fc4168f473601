"""The report's words: set-up, gains and their rules, certificates and metrics, as tables of plain HTML."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from eladapt.errors import EladaptError
from eladapt.records.description import innermost
from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.theory.meaning import Row, meaning

STYLE = """
:host { font: 14px/1.5 sans-serif; color: #223 }
h2 { font-size: 17px; margin: 14px 0 6px } p { margin: 6px 0; max-width: min(62em, 94vw) }
table { border-collapse: collapse; margin: 6px 0 14px; display: block; overflow-x: auto;
max-width: 94vw } td, th { padding: 3px 14px 3px 0; vertical-align: top;
text-align: left; border-bottom: 1px solid #dde2e7; max-width: 44em; overflow-wrap: break-word }
th { font-weight: 600; border-bottom: 2px solid #9aa4ae } td.number, th.number { text-align: right;
font-variant-numeric: tabular-nums; white-space: nowrap } .no { font-weight: 600; color: #a3320b }
pre { font: 12px/1.4 monospace; background: #f4f6f8; padding: 10px; white-space: pre-wrap;
overflow-wrap: anywhere; max-height: 50vh; overflow: auto }
"""
METRICS = (
    ("settled to 1e-3 rad", "s"), ("steady error", "rad"), ("θ within 1 %", "s"),
    ("torque ripple at rest", "N m"), ("control energy", "N² m² s"),
)  # fmt: skip


def metrics(records: Sequence[Record], labels: Sequence[str]) -> str:
    """Figures of merit, a row a record."""
    head = ["run", *(f"{name} [{unit}]" for name, unit in METRICS)]
    rows = []
    for label, record in zip(labels, records, strict=True):
        found = record.metrics()
        values = (
            found.settling_time, found.steady_error, found.parameter_settling, found.chatter,
            found.control_energy,
        )  # fmt: skip
        rows.append([label, *("never" if np.isposinf(value) else figure(value) for value in values)])
    return table(head, rows, numbers=range(1, len(head)))


def limits(records: Sequence[Record], labels: Sequence[str]) -> str:
    """How each record stands with the arm's limits and with the gate, a row a record."""
    head = ["run", "largest torque", "largest speed", "joint range", "fault"]
    rows = []
    for label, record in zip(labels, records, strict=True):
        with np.errstate(invalid="ignore"):
            share = np.nanmax(np.abs(record.tau) / record.effort_limit, initial=0.0)
        torque = f"{share:.0%} of the limit" if share else "no joint has a limit"
        found = record.metrics()
        rows.append([label, torque, found.speed_said, found.range_said, found.faults_said])
    return table(head, rows)


def setup(record: Record) -> str:
    """Robot, plant, controller and versions, with the seeds, and all of the configuration below."""
    made = record.configuration
    source, names = record.robot_source, record.joint_names
    coordinates: Callable[[np.ndarray], np.ndarray]
    try:
        robot = Robot.from_source(source)
        name, locked, urdf, coordinates = robot.name, robot.locked, robot.path.name, robot.coordinates
    except EladaptError as reason:  # an older record, which does not hold its URDF, on another computer
        name, locked = source.get("load") or source.get("name") or "unknown", source.get("locked", ())
        urdf, coordinates = f"not to be read: {' '.join(str(reason).split())}", _as_it_is
    goal = "moving" if np.any(record.goal != record.goal[0]) else _vector(coordinates(record.goal[0]))
    controller, plant = made.get("controller") or {}, made.get("plant")
    rows = [
        ["robot", f"{name}: {len(names)} joints, {', '.join(names)}"],
        ["locked joints", ", ".join(map(str, locked)) or "none"],
        ["URDF", urdf],
        ["torque limits [N m]", _vector(record.effort_limit)],
        ["speed limits [rad/s]", _vector(record.velocity_limit)],
        ["start [rad]", _vector(coordinates(record.q[0]))],
        ["set-point [rad]", goal],
        ["samples", f"{len(record)} at steps of {record.dt:g} s"],
        ["controller", _class(controller)],
        ["plant", _plant(plant) if plant else "not recorded"],
        ["seeds", _seeds(plant) if plant else "not recorded"],
        ["versions", ", ".join(f"{name} {number}" for name, number in made.get("versions", {}).items())],
    ]
    kept = {name: value for name, value in made.items() if name != "certificates"}
    text = json.dumps(kept, indent=1, ensure_ascii=False)
    short = re.sub(r"\[[^\[\]{}\"]*\]", lambda numbers: " ".join(numbers[0].split()), text)
    return table(["", ""], rows) + f"<h2>Whole configuration</h2><pre>{html.escape(short)}</pre>"


def gains(record: Record) -> str:
    """Every gain with the rule that set it, where the controller has such a table; else its parts."""
    controller = innermost(record.configuration.get("controller"))
    rules = (controller.get("gains") or {}).get("rules")
    if rules:
        head = ["gain", "value, by joint where there are several", "rule", "what limited it"]
        return table(
            head, [[str(rule[name]) for name in ("gain", "value", "rule", "active")] for rule in rules]
        )
    rows = [[name, json.dumps(value)] for name, value in sorted(_leaves(controller)) if name != "class"]
    return "<p>These gains were given, not derived.</p>" + table(["gain", "value"], rows)


def parameters(record: Record) -> str:
    """The gravity parameters that were learnt: number, meaning, true value, estimate."""
    head = ["", "base parameter, scaled to the torque it makes", "true [N m]", "at the end [N m]", "off by"]
    rows = []
    for index, label in enumerate(record.theta_labels):
        true = float(record.theta_true[index]) if record.theta_true is not None else math.nan
        last = float(record.theta[-1, index])
        rows.append([f"θ{index + 1}", label, figure(true), figure(last), figure(last - true)])
    return table(head, rows, numbers=(2, 3, 4)) if rows else "<p>This controller estimates nothing.</p>"


def certificates(given: Iterable[Mapping[str, Any]]) -> str:
    """Each condition with value and limit; ``given`` as `plain_certificate` makes them."""
    text = ""
    for certificate in given:
        head = ["condition", "value", "limit", "holds", "note"]
        rows = [
            [
                row["name"],
                figure(row["value"]),
                figure(row["limit"]),
                "yes" if row["holds"] else "no",
                row["note"],
            ]
            for row in certificate["rows"]
        ]
        text += f"<h2>{html.escape(certificate['title'])}</h2>"
        told = meaning([Row(**row) for row in certificate["rows"]])
        text += "".join(f"<p>{html.escape(said)}</p>" for said in ("Sampled estimates, no proofs.", *told))
        text += table(head, rows, numbers=(1, 2))
    return text or (
        "<p>No certificates were kept with this record. <code>ea.report(record, path, "
        "certificates=[ea.certify(controller)])</code> puts them here.</p>"
    )


def plain_certificate(certificate: Any) -> dict[str, Any]:
    """A `Certificate` in plain JSON types, as a record's configuration may keep it."""
    rows = [
        {"name": r.name, "value": r.value, "limit": r.limit, "holds": r.holds, "note": r.note}
        for r in certificate
    ]
    return {"title": certificate.title, "rows": rows}


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Iterable[int] = ()) -> str:
    """An HTML table of text; what is in a cell cannot become markup."""
    right = set(numbers)

    def cell(kind: str, column: int, text: str) -> str:
        look = ' class="number"' if column in right else ' class="no"' if text == "no" else ""
        return f"<{kind}{look}>{html.escape(text)}</{kind}>"

    lines = [("td", row) for row in rows]
    lines = [("th", head), *lines] if any(head) else lines
    body = "".join(
        "<tr>" + "".join(cell(kind, k, text) for k, text in enumerate(row)) + "</tr>" for kind, row in lines
    )
    return f"<table>{body}</table>"


def figure(value: float) -> str:
    """A number for people."""
    if math.isnan(value):
        return "unknown"
    return f"{value:.3g}"


def _as_it_is(q: np.ndarray) -> np.ndarray:
    return q


def _vector(values: np.ndarray) -> str:
    return ", ".join("none" if math.isinf(x) else f"{x:.4g}" for x in values)


def _class(value: Any) -> str:
    if not isinstance(value, Mapping):
        return str(value)
    parts = [p["class"] for p in value.values() if isinstance(p, Mapping) and "class" in p]
    parts = [part for part in parts if part not in ("Gains", "Regressors", "Robot")]
    return f"{value.get('class', 'unknown')}: {', '.join(parts)}" if parts else value.get("class", "unknown")


def _plant(plant: Mapping[str, Any]) -> str:
    said = [
        f"{name} {_said(value)}"
        for name, value in plant.items()
        if name not in ("class", "plant", "seed") and value is not None
    ]
    text = f"{plant['class']} ({'; '.join(said)})"
    return f"{text} around {_plant(plant['plant'])}" if "plant" in plant else text


def _said(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(
            f"{name} {part}" for name, part in value.items() if name != "class" and part is not None
        )
    return str(value)


def _seeds(plant: Mapping[str, Any]) -> str:
    own = [f"{plant['seed']} (noise of {plant['class']})"] if "seed" in plant else []
    return ", ".join([*own, *([_seeds(plant["plant"])] if "plant" in plant else [])])


def _leaves(value: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, part in value.items():
            if name not in ("class", "regressors", "robot"):  # the arm's own, not the controller's
                yield from _leaves(part, f"{path}.{name}" if path else name)
    elif value is not None:
        yield path, value
