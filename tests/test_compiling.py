"""The kernels are compiled before a loop, once on a computer, and wherever the package may be."""

import os
import subprocess
import sys

import pytest

# Every kind of loop with every kind of controller, once they are made: what is compiled, for which arguments.
LOOPS = """
import numpy as np
import eladapt as ea
from eladapt.compiling import KERNELS
robot = ea.Robot.load("two_link")
q0, goal = robot.configuration(robot.home), robot.configuration(robot.target)
moving = ea.Reference(goal, 0.1 * np.ones(robot.nv), np.zeros(robot.nv))
composite = ea.CompositeController.for_robot(robot, velocity_noise=1e-3)
gated, simulate = ea.GatedController.for_robot(composite), ea.simulate
others = ea.SlotineLi.for_robot(robot), ea.TerminalSliding.for_robot(robot)
controllers = composite, gated, *others, ea.CompositeController.for_robot(robot)
loaded, mujoco = ea.PinocchioPlant(robot, q0, payload=ea.Payload(1.0, attach=0.05)), ea.MujocoPlant(robot, q0)
misses = [sum(k.stats.cache_misses.values()) + sum(k.stats.cache_hits.values()) for k, _ in KERNELS]
for controller in controllers:
    simulate(controller, loaded, goal, 0.2, progress=False)
for controller in (composite, gated):
    simulate(controller, mujoco, moving, 0.2, progress=False)
again = [sum(k.stats.cache_misses.values()) + sum(k.stats.cache_hits.values()) for k, _ in KERNELS]
print(again == misses, all(len(kernel.signatures) == 1 for kernel, _ in KERNELS), len(KERNELS) > 10)
"""
NOWHERE = "from numba.core.caching import CacheImpl; CacheImpl._locator_classes = []\n"


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    everything = os.environ | environment
    return subprocess.run(
        [sys.executable, "-c", code], env=everything, capture_output=True, text=True, check=True, timeout=300
    )


def test_no_loop_compiles():
    assert python(LOOPS).stdout.split() == ["True"] * 3


@pytest.mark.slow
def test_compiling_is_said_once(tmp_path):
    """On stderr, the first time on a computer; then never again."""
    code = "import eladapt as ea; ea.Regressors(ea.Robot.load('two_link')); ea.FiniteTimePD(1.0, 1.0)"
    first = python(code, NUMBA_CACHE_DIR=str(tmp_path)).stderr
    assert first.count("compiling") == 1
    assert "once on this computer" in first
    assert python(code, NUMBA_CACHE_DIR=str(tmp_path)).stderr == ""


@pytest.mark.slow
def test_it_works_where_no_cache_can_be_written():
    done = python(NOWHERE + LOOPS)
    assert done.stdout.split() == ["True"] * 3
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_it_runs_uncompiled():
    """For a debugger: the same source, interpreted."""
    short = LOOPS.replace("0.2", "0.003").replace("attach=0.05", "attach=0.001")
    done = python(short.split("again =")[0] + "print(len(KERNELS))", NUMBA_DISABLE_JIT="1")
    assert done.stdout.split() == ["0"]
