"""Faults of sensors, buses and motors in closed loop: the arm recovers or stops, and nothing is lost."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.simulation.faults import BlockedJoints, FrozenSensor, Jitter, LostNumbers, Packets, WeakMotors
from eladapt.simulation.instruments import Delay

DT, BEGINS, ENDS = 1e-3, 0.25, 0.35

RECOVERS = {
    "nan for 10 ms": lambda plant: LostNumbers(plant, BEGINS, BEGINS + 0.01),
    "5 % lost, 5 % twice": lambda plant: Packets(plant, dropped=0.05, duplicated=0.05, seed=1),
    "jitter": lambda plant: Jitter(plant, 5e-4, 1.5e-3),
    "half the torque": lambda plant: WeakMotors(plant, 0.5),
}
STOPS = {
    "nan for 100 ms": (lambda plant: LostNumbers(plant, BEGINS, ENDS), "measurement"),
    "frozen for 100 ms": (lambda plant: FrozenSensor(plant, BEGINS, ENDS), "frozen"),
    "nothing but repeats": (lambda plant: Packets(plant, duplicated=1.0, start=BEGINS, end=ENDS), "watchdog"),
    "a joint blocked": (
        lambda plant: BlockedJoints(plant, ["elbow_joint"], start=BEGINS, end=ENDS),
        "unresponsive",
    ),
}


def run(fault, duration):
    robot = load("ur5")
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, fault(plant), goal, duration, DT, progress=False)
    assert len(record) == round(duration / DT) + 1
    for array in (record.t, record.q, record.v, record.tau, record.theta):
        assert np.isfinite(array).all()
    assert np.all(np.abs(record.tau) <= robot.effort_limit)
    assert np.all(np.abs(record.v) <= robot.velocity_limit)
    return controller, plant, record


@pytest.mark.parametrize("name", RECOVERS)
def test_a_passing_fault_is_got_over(name):
    """No fault is latched, and the set-point is reached as if nothing had been."""
    _, _, record = run(RECOVERS[name], 2.5)
    assert record.final_state.fault is None
    assert np.abs(record.error[-1]).max() < 2e-3


@pytest.mark.parametrize("late", [3e-3, 5e-3])
def test_a_loop_that_a_delay_makes_unstable_is_stopped(late):
    """Torque that acts late, which no gain knows of, is named when it shows; the arm comes to rest."""
    robot = load("panda")
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT)
    plant = Delay(ea.PinocchioPlant(robot, robot.configuration(robot.home)), late)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 3.0, DT, progress=False)
    assert record.final_state.fault.name in ("energy growth", "oscillation", "reversed", "velocity")
    assert np.abs(record.v[record.t > 2.9]).max() < 1e-2
    assert np.all(np.abs(record.tau) <= robot.effort_limit)


@pytest.mark.parametrize("name", STOPS)
def test_a_lasting_fault_stops_the_arm(name, tmp_path):
    """Named within 25 ms, brakes wanted, at rest in the end; the record holds it all; a reset goes on."""
    fault, expected = STOPS[name]
    controller, plant, record = run(fault, 1.8)
    found = record.final_state.fault
    assert found.name == expected
    assert record.final_state.brake
    assert BEGINS < found.t <= BEGINS + 0.025
    assert np.abs(record.v[record.t > 1.75]).max() < 1e-2
    kept = ea.Record.load(record.save(tmp_path / "run.npz"))
    assert np.array_equal(kept.tau, record.tau)
    assert np.array_equal(kept.q, record.q)
    learned = record.theta[record.t > found.t]
    assert np.array_equal(learned, np.broadcast_to(learned[0], learned.shape)), "it went on learning"
    goal = controller.robot.configuration(controller.robot.target)
    plant.release()
    measurement = plant.step(record.tau[-1], DT)
    state = controller.reset(record.final_state, measurement)
    for _ in range(1800):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
    assert state.fault is None
    assert np.abs(controller.robot.difference(goal, plant.q)).max() < 2e-3
