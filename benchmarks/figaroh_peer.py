"""FIGAROH's side of `identification_peers`, for a Python of its own: figaroh_peer.py FOLDER.

It reads FOLDER/job.npz and writes FOLDER/found.npz: torques that FIGAROH predicts where it is judged, with
its weighted least squares and with its physically consistent fit, and the columns of its base parameters on
random motion.
"""

from __future__ import annotations

import inspect
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from figaroh.data import TrajectoryData
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.load_robot import load_robot
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

STAGES = ("reconstruction", "physical_fit")  # full parameters of the least squares; bodies that can be
REPEATS = 3  # of each, the fastest counts
BORDER = 0.2  # [s] beside a gap or an end, where its filters do not see a signal as it is
ZERO, RANK = 1e-6, 1e-10  # of the largest column, and pivot: below, a regressor on random motion has none
CONFIG = """
robot:
  name: arm
  properties:
    joints:
      active_joints: {joints}
    coupling:
      has_coupled_wrist: false
tasks:
  identification:
    enabled: true
    select_stage: {stage}
    problem:
      use_joint_torques: true
      model_components:
        friction: true
        joint_offset: true
        actuator_inertia: true
      wls: true
      qr_relative_tolerance: 1.0e-4
    signal_processing:
      sampling_frequency: {rate}
      cutoff_frequency: {cutoff}
      filter_order: 4
      differentiation_method: gradient
"""


class ArmLog(BaseIdentification):
    """What FIGAROH asks a user to write: how samples are read, and which of them hold."""

    job: dict[str, Any]

    def __init__(self, robot: Any, config: str) -> None:
        super().__init__(robot, config)
        joints = [self.model.joints[self.model.getJointId(n)] for n in self.identif_config["active_joints"]]
        self.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        self.identif_config["act_idxv"] = [joint.idx_v for joint in joints]

    def load_trajectory_data(self, data_source: str | None = None) -> TrajectoryData:
        t = self.job["t"]
        gaps = np.flatnonzero(np.diff(t) > 5 * np.median(np.diff(t)))
        borders = t[[0, *gaps, *(gaps + 1), -1]]
        return TrajectoryData(
            t=t,
            joint_names=tuple(self.job["joints"]),
            q=self.job["q"],
            dq=self.job["v"],
            effort=self.job["tau"],
            effort_kind="joint_torque",
            effort_unit="N m",
            mask=np.abs(t[:, None] - borders).min(axis=1) > BORDER,
        )


def fitted(job: dict[str, Any], stage: str, folder: Path) -> ArmLog:
    config = folder / f"{stage}.yaml"
    joints = json.dumps(list(job["joints"]))
    config.write_text(CONFIG.format(joints=joints, stage=stage, rate=job["rate"], cutoff=job["cutoff"]))
    arm = ArmLog(load_robot(str(job["urdf"])), str(config))
    arm.job = job
    arm.initialize()
    arm.solve(plotting=False, wls=True)
    return arm


def lines() -> int:
    """That a user writes, empty ones left out."""
    written = [inspect.getsource(ArmLog), inspect.getsource(fitted), CONFIG]
    return sum(bool(line.strip()) for text in written for line in text.splitlines())


def result(job: dict[str, Any], stage: str, folder: Path) -> dict[str, Any]:
    """The torques (n, nv) at the job's instants, the bodies (nv, 10), and what is said of them."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        arm = fitted(job, stage, folder)
        times.append(time.perf_counter() - start)
    full = build_regressor_basic(arm.robot, *(job[f"judged_{name}"] for name in "qva"), arm.identif_config)
    chosen = arm.selected
    said = f"{chosen.status} ({chosen.reason})"
    if chosen.values is None:
        return {"said": said}
    try:
        arm.export_urdf(str(job["urdf"]), str(folder / "identified.urdf"), merged_bodies="subtract_fixed")
        export = "its URDF is written"
    except ValueError as reason:
        export = f"its URDF is not written ({reason})"
    names = list(job["joints"])
    bodies = chosen.link_p10(names)
    return {
        "coulomb": np.array([chosen.parameter_dict()[f"fs_{name}"] for name in names]),
        "torque": (full @ chosen.values).reshape(len(names), -1).T,
        "bodies": np.array([bodies[name] for name in names]),
        "said": f"{said}; {export}",
        "time": min(times),
    }


def base_columns(job: dict[str, Any], folder: Path) -> np.ndarray:
    """(nv n, b) the columns of FIGAROH's base parameters on random motion, joint by joint."""
    arm = fitted(job, STAGES[0], folder)
    full = build_regressor_basic(arm.robot, *(job[f"random_{name}"] for name in "qva"), arm.identif_config)
    dropped, kept = get_index_eliminate(full, arm.standard_parameter, tol_e=ZERO)
    reduced = build_regressor_reduced(full, dropped)
    decomposer = QRDecomposer(relative_tolerance=RANK)
    decomposer.double_decomposition(np.zeros(len(reduced)), reduced, kept, arm.standard_parameter)
    return reduced[:, decomposer.get_base_indices()]


def main() -> None:
    folder = Path(sys.argv[1])
    job = dict(np.load(folder / "job.npz"))
    found: dict[str, Any] = {
        "version": version("figaroh"),
        "lines": lines(),
        "base": base_columns(job, folder),
    }
    for stage in STAGES:
        found |= {f"{stage}_{name}": value for name, value in result(job, stage, folder).items()}
    np.savez(folder / "found.npz", **found)


if __name__ == "__main__":
    main()
