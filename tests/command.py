"""The command line in a process of its own, and URDFs to hand it."""

import os
import subprocess
import sys

LINK = """<link name="{0}"><inertial><mass value="2"/><origin xyz="0 0 0.2"/>
<inertia ixx="0.03" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


JOINT = """<joint name="{1}" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50" velocity="3"/></joint>"""


def run(*arguments, folder=None):
    """The command in a process of its own, as from a shell."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "100"}
    command = [sys.executable, "-m", "eladapt", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=folder, env=environment)


def named(folder, name, joint="j1"):
    """The path of an arm with these names."""
    path = folder / "arm.urdf"
    text = f'<robot name="{name}"><link name="base"/>{LINK.format("l1")}{JOINT}</robot>'
    path.write_text(text.replace("{1}", joint), encoding="utf-8")
    return path
