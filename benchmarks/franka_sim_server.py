"""franka-sim's server on loopback, with all limits enforced, and a load that its firmware does not know.

It runs in an environment of its own, which has franka-sim and, for its model of the arm, franky-sim
(installed without what that asks for): see `franka.py` beside it.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import mujoco


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--load", type=float, default=0.0, help="[kg]")
    parser.add_argument(
        "--centre", type=float, nargs=3, default=(0.0, 0.0, 0.15), help="in the last link's frame [m]"
    )
    options = parser.parse_args()
    found = importlib.util.find_spec("franky_sim")
    assert found is not None
    assert found.submodule_search_locations is not None
    assets = Path(found.submodule_search_locations[0]) / "assets"
    with tempfile.TemporaryDirectory() as folder:
        arm = Path(folder) / "fr3.xml"
        arm.write_text(
            re.sub(r'meshdir="[^"]*"', f'meshdir="{assets}/meshes"', (assets / "fr3.xml").read_text())
        )
        os.environ["FR3_MJCF"] = str(arm)
        import franka_sim.mujoco_franka_sim as simulator
        from franka_sim import FrankaSimServer

        simulator.build_model = loaded(simulator.build_model, options.load, options.centre)
        server = FrankaSimServer(
            host="127.0.0.1", enable_gripper=False, enforce_comm_constraints=True, enforce_motion_limits=True
        )
        print("ready", flush=True)
        server.start()


def loaded(build: Any, load: float, centre: tuple[float, float, float]) -> Any:
    """The same model with a load that gravity compensation leaves out."""

    def with_load(*arguments: Any, **options: Any) -> Any:
        if not load:
            return build(*arguments, **options)
        compile_spec = mujoco.MjSpec.compile

        def compiled(spec: Any) -> Any:
            last = next(body for body in spec.bodies if body.name.endswith("link7"))
            added = last.add_body()
            added.name, added.pos, added.mass, added.explicitinertial = "load", list(centre), load, 1
            added.inertia = [1e-3 * load] * 3
            return compile_spec(spec)

        mujoco.MjSpec.compile = compiled
        try:
            model, prefix = build(*arguments, **options)
        finally:
            mujoco.MjSpec.compile = compile_spec
        model.body_gravcomp[model.body("load").id] = 0.0
        return model, prefix

    return with_load


if __name__ == "__main__":
    main()
