"""A simulated arm behind the four methods of a robot, and what a loop with it takes."""

import numpy as np
from shared import load

import eladapt as ea

DT = 5e-3  # slow enough for a busy machine


class Simulated:
    """A plant behind the four methods; every call is noted, and one of them can be made to fail."""

    def __init__(self, plant, fails="", at=0, dt=DT):
        self.plant, self.fails, self.at, self.dt = plant, fails, at, dt
        self.calls, self.measurement = [], None

    def _note(self, name):
        self.calls.append(name)
        if name == self.fails and self.calls.count(name) > self.at:
            raise OSError(f"{name} failed")

    def start(self):
        self.measurement = self.plant.reset()
        self._note("start")

    def read(self):
        self._note("read")
        return self.measurement

    def write(self, tau):
        self._note("write")
        self.measurement = self.plant.step(tau, self.dt)

    def stop(self):
        self._note("stop")
        self.plant.brake()
        while np.abs(self.plant.v).max() > 1e-9:
            self.measurement = self.plant.step(self.measurement.tau, self.dt)


def made(name="two_link", **limits):
    robot = load(name)
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT, **limits)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return robot, controller, plant, robot.configuration(robot.target)
