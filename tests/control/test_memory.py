"""A controller that runs for weeks keeps nothing of its steps."""

import gc
import tracemalloc

import numpy as np
import pytest
from shared import load

import eladapt as ea

WINDOWS, STEPS = 4, 250


@pytest.mark.slow
def test_steps_leave_nothing_behind():
    """In a noisy loop whose set-point changes there are 250 steps over which memory grows by less than 8
    bytes a step: one float kept of each would be 24, always. A change that is noticed keeps arrays, once."""
    robot = load("panda")
    controller = ea.CompositeController.for_robot(robot, velocity_noise=1e-3)
    plant = ea.PinocchioPlant(
        robot, robot.configuration(robot.home), noise=ea.Noise(1e-5, 1e-3), payload=ea.Payload(2, attach=0.3)
    )
    goals = [robot.configuration(robot.target), robot.configuration(robot.home)]
    measurement = plant.reset()
    state = controller.init(measurement)

    def run(steps: int) -> None:
        nonlocal state, measurement
        for k in range(steps):
            state, tau = controller.step(state, measurement, goals[k // 300 % 2], 1e-3)
            measurement = plant.step(tau, 1e-3)

    run(500)  # caches are filled, and the load that came has been noticed, which keeps what was known before
    assert state.change.noticed >= 1
    sizes = []
    tracemalloc.start()
    try:
        run(10)
        for _ in range(WINDOWS):
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
            run(STEPS)
    finally:
        tracemalloc.stop()
    assert min(np.diff(sizes)) < 8 * STEPS
    assert sizes[-1] - sizes[0] < 100_000, "three triangles of information"
