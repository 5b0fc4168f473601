"""Parameters from real arms' logs: `identify` beside FIGAROH, plain least squares, and published friction.

A Panda's log: the first part is learned from, torques of the last are predicted, and compared below 10 Hz.
Which base parameters FIGAROH and `Regressors` find, on random motion. A Staubli TX40's log with its coupled
wrist, which comes with FIGAROH's examples: is its friction the published one?

It needs a folder ../shared beside the repository's root, with logs/panda_exciting.npz, or --log; for FIGAROH
a Python that has it (pip install figaroh, in an environment of its own); for the TX40 a folder with
curr_data.csv, pos_read_data.csv and tx40_mdh_modified.urdf, of examples/staubli_TX40 in
github.com/thanhndv212/figaroh-examples. What is not there is left out, and the table says so.
"""

from __future__ import annotations

import argparse
import inspect
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import scipy.linalg
from table import write
from tx40 import tx40_table

import eladapt as ea
from eladapt.errors import EladaptError
from eladapt.identification.prediction import CUTOFF, torques_of
from eladapt.identification.rows import Column
from eladapt.regressors.joint_terms import JOINT_TERMS
from eladapt.regressors.standard import pseudo_inertia

SHARED = Path(__file__).resolve().parents[2] / "shared"  # beside the repository
LOG = SHARED / "logs" / "panda_exciting.npz"
HELD_OUT = 0.3
TURNING = 0.02  # [rad/s] over which Coulomb friction turns round in plain least squares
SAMPLES, FASTEST, SLOWEST, ACCELERATION = 300, 2.0, 0.1, 5.0  # of random motion; [rad/s], [rad/s^2]
SAME_SPAN = 1e-6  # [rad]
REPEATS = 3  # of a run, the fastest counts
SOUND = -1e-8  # of a pseudo-inertia's least eigenvalue: FIGAROH's tolerance, for everyone
NOTES = f"""
A Panda's log of 21 s: torques of the last {HELD_OUT:.0%}, from which nothing is learned, below {CUTOFF:g} Hz.
Errors [%] by joint and of all as each way predicts: with eladapt, Coulomb friction turns round as the filter
of the torques makes it; with plain least squares over {TURNING:g} rad/s; with FIGAROH at once. Then of all
joints with eladapt's shape for everyone. eladapt's default window was chosen with this log and the TX40's at
hand; FIGAROH's filter was not chosen by its error here. Bodies: how many have a
pseudo-inertia with no eigenvalue below {SOUND:g}, FIGAROH's tolerance; then the least eigenvalue of all, and
the heaviest one's mass [kg].
Time: without imports, the fastest of {REPEATS}; both of eladapt's rows come from one run, with reading and
judging. Lines: what a user writes, with FIGAROH its configuration too; plain least squares takes its filter
from this library. Least squares of eladapt has base parameters only; the bodies of FIGAROH's are its
reconstruction from them.
"""


class Motion(NamedTuple):
    """Instants of a part of the log, below 10 Hz: (n, nv) each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    turned: np.ndarray  # the sign of v, below 10 Hz


class Row(NamedTuple):
    """One way to find parameters, and how well it did on what it has not seen."""

    name: str
    predicted: np.ndarray  # (n, nv) as it predicts
    alike: np.ndarray  # (n, nv) with Coulomb friction that turns round alike for everyone
    bodies: np.ndarray | None  # (nv, 10) standard parameters, where there are any
    seconds: float
    lines: int


def motion(log: ea.Log, regressors: ea.Regressors) -> Motion:
    """As `torques_of` sees it: columns of its regressor can be the motion itself."""
    columns: dict[str, Column] = {"q": lambda q, v, a: q, "v": lambda q, v, a: v, "a": lambda q, v, a: a}
    found = torques_of(log, regressors, columns)
    q, v, a = np.moveaxis(found.regressor[:, :, -3:], 2, 0)
    block = regressors.block("coulomb")
    turned = np.einsum("nii->ni", found.regressor[:, :, block]) * regressors.scale[block]
    return Motion(q, v, a, found.tau, turned)


def regressors_of(robot: ea.Robot) -> ea.Regressors:
    return ea.Regressors(robot, joint_terms=JOINT_TERMS)


def fastest(run: Callable[[], Any]) -> tuple[Any, float]:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        found = run()
        times.append(time.perf_counter() - start)
    return found, min(times)


def identified(path: Path) -> ea.Identified:
    robot = ea.Robot.load("panda")
    log = ea.Log.read(path)
    return ea.identify(robot, log, held_out=HELD_OUT, progress=False)


def lines(*functions: Callable[..., Any]) -> int:
    """Of their bodies."""
    return sum(len(inspect.getsource(function).splitlines()) - 1 for function in functions)


def ours(path: Path, last: ea.Log) -> list[Row]:
    found, seconds = fastest(lambda: identified(path))
    regressor = torques_of(last, found.regressors, {}).regressor
    bodies = found.parameters[: 10 * found.original.nv].reshape(-1, 10)
    return [
        Row(name, regressor @ theta, regressor @ theta, some, seconds, lines(identified))
        for name, theta, some in (
            ("eladapt, least squares", found.theta, None),
            ("eladapt, physical", found.physical, bodies),
        )
    ]


def urdf_row(robot: ea.Robot, last: ea.Log) -> Row:
    regressors = regressors_of(robot)
    torque = torques_of(last, regressors, {}).regressor @ regressors.theta
    bodies = np.array([body.toDynamicParameters() for body in robot.model.inertias[1:]])
    return Row("URDF", torque, torque, bodies, 0.0, 0)


def standard_columns(robot: ea.Robot, moved: Motion, turned: np.ndarray) -> np.ndarray:
    data, offset = robot.model.createData(), np.eye(robot.nv)
    return np.array([
        np.hstack([
            pin.computeJointTorqueRegressor(robot.model, data, q, v, a),
            np.diag(a), np.diag(v), np.diag(direction), offset,
        ])
        for q, v, a, direction in zip(moved.q, moved.v, moved.a, turned, strict=True)
    ])  # fmt: skip


def plain(robot: ea.Robot, first: ea.Log) -> np.ndarray:
    moved = motion(first, regressors_of(robot))
    weight = 1 / robot.effort_limit
    rows = standard_columns(robot, moved, np.tanh(moved.v / TURNING)) * weight[:, None]
    return np.linalg.lstsq(rows.reshape(-1, rows.shape[2]), (moved.tau * weight).ravel(), rcond=1e-9)[0]


def plain_row(robot: ea.Robot, first: ea.Log, judged: Motion) -> Row:
    found, seconds = fastest(lambda: plain(robot, first))
    shapes = (np.tanh(judged.v / TURNING), judged.turned)
    own, alike = (standard_columns(robot, judged, turned) @ found for turned in shapes)
    bodies = found[: 10 * robot.nv].reshape(-1, 10)
    written = lines(motion, standard_columns, plain)
    return Row("plain least squares, differenced velocities", own, alike, bodies, seconds, written)


def bare(robot: ea.Robot) -> bytes:
    """The robot's URDF with locked joints fixed and without meshes, for who looks for these elsewhere."""
    document = robot.document()
    for link in document.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in document.iter("joint"):
        if joint.get("name") not in robot.joint_names:
            joint.set("type", "fixed")
    return ElementTree.tostring(document)


def random_motion(robot: ea.Robot) -> Motion:
    """Every joint faster than Coulomb friction takes to turn round."""
    rng, shape = np.random.default_rng(0), (SAMPLES, robot.nv)
    v = rng.choice([-1, 1], shape) * rng.uniform(SLOWEST, FASTEST, shape)
    a = rng.uniform(-ACCELERATION, ACCELERATION, shape)
    return Motion(rng.uniform(-np.pi, np.pi, shape), v, a, np.zeros(shape), np.sign(v))


def figaroh(python: str, robot: ea.Robot, first: ea.Log, judged: Motion, cutoff: float) -> dict[str, Any]:
    """What `figaroh_peer` found."""
    random = random_motion(robot)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = folder / "arm.urdf"
        urdf.write_bytes(bare(robot))
        np.savez(
            folder / "job.npz", t=first.t, q=first.q, v=first.velocity, tau=first.tau, urdf=str(urdf),
            joints=np.array(robot.joint_names), rate=1 / first.dt, cutoff=cutoff,
            **{f"judged_{k}": getattr(judged, k) for k in "qva"},
            **{f"random_{k}": getattr(random, k) for k in "qva"},
        )  # fmt: skip
        done = subprocess.run(
            [python, str(Path(__file__).with_name("figaroh_peer.py")), name],
            capture_output=True, text=True, env={**os.environ, "PYTHONPATH": "", "MPLBACKEND": "Agg"},
        )  # fmt: skip
        if done.returncode:
            raise EladaptError(f"FIGAROH, under {python}, failed:\n{done.stderr[-2000:]}")
        return dict(np.load(folder / "found.npz"))


def figaroh_rows(found: Mapping[str, Any], judged: Motion) -> list[Row]:
    named = {"reconstruction": "weighted least squares", "physical_fit": "physical fit"}
    turn = judged.turned - np.sign(judged.v)
    rows = []
    for stage, name in named.items():
        if (torque := found.get(f"{stage}_torque")) is None:
            continue  # it found none, and the notes have what it said
        alike = torque + found[f"{stage}_coulomb"] * turn
        seconds, written = float(found[f"{stage}_time"]), int(found["lines"])
        full = f"FIGAROH {found['version']}, {name}"
        rows.append(Row(full, torque, alike, found[f"{stage}_bodies"], seconds, written))
    return rows


def span_angle(robot: ea.Robot, base: np.ndarray) -> float:
    """[rad] the largest principal angle between the spans of W's columns and of these (nv n, b)."""
    random, regressors = random_motion(robot), regressors_of(robot)
    rows = [regressors.torque(q, v, a) for q, v, a, *_ in zip(*random, strict=True)]
    columns = np.concatenate(np.swapaxes(rows, 0, 1))
    sized = [array / np.linalg.norm(array, axis=0) for array in (columns, base)]
    return float(scipy.linalg.subspace_angles(*sized).max())


def relative(predicted: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """(nv + 1,) by joint, then of all."""
    wrong = predicted - tau
    joints = np.linalg.norm(wrong, axis=0) / np.linalg.norm(tau, axis=0)
    return np.append(joints, np.linalg.norm(wrong) / np.linalg.norm(tau))


def cells(row: Row, tau: np.ndarray) -> list[str]:
    errors = [f"{100 * error:.2f}" for error in relative(row.predicted, tau)]
    shapes = [f"{100 * relative(row.alike, tau)[-1]:.2f}"]
    said = ["-", "-", "-"]
    if row.bodies is not None:
        least = np.array([np.linalg.eigvalsh(pseudo_inertia(body)).min() for body in row.bodies])
        said = [
            f"{np.sum(least > SOUND)} of {len(least)}",
            f"{least.min():.0e}",
            f"{row.bodies[:, 0].max():.1f}",
        ]
    return [row.name, *errors, *shapes, *said, f"{row.seconds:.1f}", str(row.lines)]


def figaroh_notes(robot: ea.Robot, found: Mapping[str, Any], cutoff: float) -> str:
    angle = span_angle(robot, found["base"])
    return f"""
FIGAROH's filter is at {cutoff:g} Hz; samples within 0.2 s of a gap are masked; its rank tolerance is 1e-4 of
the largest pivot. Reconstruction: {found["reconstruction_said"]}. Physical fit: {found["physical_fit_said"]}.

Base parameters: FIGAROH finds {found["base"].shape[1]} on {SAMPLES} random states, `Regressors` has
{len(regressors_of(robot))}; the largest principal angle between the spans of their columns is {angle:.1e} rad
(asked: {SAME_SPAN:g}). Which of the standard parameters FIGAROH takes depends on the motion that it is given;
here its rank tolerance is 1e-10 of the largest pivot.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--figaroh", default=os.environ.get("ELADAPT_FIGAROH_PYTHON"), metavar="PYTHON",
        help="that has FIGAROH (default: $ELADAPT_FIGAROH_PYTHON)",
    )  # fmt: skip
    parser.add_argument("--log", type=Path, default=LOG, help="the Panda's (default: in ../shared/logs)")
    parser.add_argument("--tx40", type=Path, default=SHARED / "logs" / "tx40", help="its folder")
    parser.add_argument("--cutoff", type=float, default=CUTOFF, help="[Hz] of FIGAROH's filter (default: 10)")
    parser.add_argument(
        "--output", default="identification_peers", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    if not options.log.exists():
        raise SystemExit(
            "skipped: there is no ../shared/logs/panda_exciting.npz beside the repository, nor --log"
        )
    robot = ea.Robot.load("panda")
    first, last = ea.Log.read(options.log).of(robot).parts(HELD_OUT)
    assert last is not None
    judged = motion(last, regressors_of(robot))
    rows = [urdf_row(robot, last), *ours(options.log, last), plain_row(robot, first, judged)]
    notes = NOTES
    if options.figaroh:
        found = figaroh(options.figaroh, robot, first, judged, options.cutoff)
        rows += figaroh_rows(found, judged)
        notes += figaroh_notes(robot, found, options.cutoff)
    else:
        notes += "\nFIGAROH: left out, no Python that has it was named (--figaroh).\n"
    if (options.tx40 / "pos_read_data.csv").exists():
        notes += tx40_table(options.tx40)
    else:
        notes += "\nTX40: left out, its data are not there (--tx40).\n"
    joints = [f"joint {k + 1}" for k in range(robot.nv)]
    head = [
        "parameters",
        *joints,
        "all",
        "all, alike",
        "bodies",
        "least",
        "heaviest",
        "time [s]",
        "lines",
    ]
    table = [cells(row, judged.tau) for row in rows]
    write(options.output, "Parameters from real logs, beside other ways", head, table, notes)


if __name__ == "__main__":
    main()
