"""A Universal Robots arm over RTDE, by ur-rtde (extra ``ur``), with direct torque at 500 Hz.

The firmware adds gravity for the load that it was told, and can compensate friction, which is left to the
controller here. It needs PolyScope 5.23 or 10.10. Tried against `URStandIn`, not yet against a real arm.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import operator
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, HardwareError, needing, require_number, require_vector
from eladapt.hardware.makers import in_time, require_joints
from eladapt.robot.model import Robot
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Payload

JOINTS = 6
FREQUENCY = 500.0  # [Hz]
NO_FRICTION = [0.0] * JOINTS  # compensated by the firmware: it is learned
DECELERATION = 2.0  # [rad/s^2] with which the arm stops
LONGEST_WAIT = 0.1  # [s] for a new sample
LONGEST_UNLOCK = 4.5  # [s] until a protective stop has ended
NAP = 1e-4  # [s] between two looks whether there is one
RUNNING = 7  # robot mode
MODES = {
    -1: "no controller", 0: "disconnected", 1: "confirm safety", 2: "booting", 3: "power off", 4: "power on",
    5: "idle", 6: "backdrive", 7: "running", 8: "updating firmware",
}  # fmt: skip


class URRobot:
    """A UR3e to UR30 as a `RobotInterface`; ``dt`` of the loop is 0.002 s.

    address: of the robot. robot: what the controller knows of it; its joints are the arm's six. load: that
    the firmware is told, (mass [kg], centre (3,) [m] in the robot's tool frame), None to leave it as it is.
    gravity: what the firmware adds, q (6,) -> (6,) [N m]; None takes the robot's own model and that load.
    Where that is not what the firmware adds, the controller learns the difference as gravity. delay:
    [periods] from a command to the torque that it makes, one by assumption: what acts is told accordingly, so
    that `commission` finds it; the controller has to be told it, too. recover: whether a protective stop from
    before is unlocked at the start. library: who has the classes RTDEReceiveInterface, RTDEControlInterface
    and DashboardClient, as a `URStandIn`; None: ur-rtde.

    Stops and modes of the robot are HardwareErrors that name them. Raises ArgumentError for another number of
    joints.
    """

    keeps_clock = True
    adds_gravity = True

    def __init__(
        self,
        address: str,
        robot: Robot,
        *,
        load: tuple[float, Sequence[float]] | None = None,
        gravity: Callable[[np.ndarray], np.ndarray] | None = None,
        delay: int = 1,
        recover: bool = False,
        library: Any = None,
    ):
        require_joints(robot, JOINTS, "UR")
        self.address, self.robot, self.recover, self.library = address, robot, recover, library
        self.load: tuple[float, list[float]] | None = None
        if load is not None:
            mass = require_number("load: mass", load[0], 0, np.inf, closed=True)
            self.load = (mass, require_vector("load: centre", load[1], 3).tolist())
        self._gravity = gravity or loaded_gravity(robot, self.load)
        self._control: Any = None
        self._receive: Any = None
        self.delay = periods(delay)
        self._t = -np.inf
        self._added = np.zeros(JOINTS)
        self._sent: deque[tuple[float, np.ndarray]] = deque()  # with the time of the sample that was answered

    def __repr__(self) -> str:
        return f"URRobot({self.address!r}, {self.robot.name!r})"

    def connect(self) -> None:
        """Reach the robot and tell it the load; `start` does it too."""
        if self._control is not None:
            return
        library = self.library or ur_rtde()
        said = f"{self.address} does not answer; is that the robot, and is it in remote control?"
        self._receive = in_time(
            lambda: library.RTDEReceiveInterface(self.address, FREQUENCY), said, (RuntimeError,)
        )
        if self.recover and self._receive.isProtectiveStopped():
            self._unlock(library.DashboardClient(self.address))
        self._require_ready()
        control = in_time(
            lambda: library.RTDEControlInterface(self.address, FREQUENCY), said, (RuntimeError,)
        )
        if self.load is not None and not control.setPayload(*self.load):
            raise HardwareError(f"{self.address}: the robot refused the load {self.load}")
        self._control = control

    def posture(self) -> np.ndarray:
        """(6,) [rad] where the arm is, before it starts."""
        self.connect()
        return np.array(self._receive.getActualQ())

    def start(self) -> None:
        """Begin to follow torques: what holds the arm, first."""
        self.connect()
        self._require_ready()
        self._t = -np.inf
        self._sent.clear()
        self._torque(np.zeros(JOINTS))

    def read(self) -> Measurement:
        """Wait for the next sample."""
        if self._control is None:
            raise HardwareError(f"{self.address}: not started, or stopped")
        until = time.monotonic() + LONGEST_WAIT
        while (t := self._receive.getTimestamp()) <= self._t:
            if time.monotonic() > until:
                raise HardwareError(
                    f"{self.address}: no new sample for {LONGEST_WAIT:g} s; the connection is lost"
                )
            time.sleep(NAP)
        self._t = t
        self._require_ready()
        q, v = np.array(self._receive.getActualQ()), np.array(self._receive.getActualQd())
        self._added = np.asarray(self._gravity(q), dtype=float)
        return Measurement(t, self.robot.configuration(q), v, self._acting() + self._added)

    def write(self, tau: np.ndarray) -> None:
        """Command tau (6,) [N m], less what the firmware adds."""
        self._torque(tau - self._added)

    def stop(self) -> None:
        """End direct torque: the arm brakes along its joints, and holds."""
        control, self._control = self._control, None
        if control is None:
            return
        with contextlib.suppress(RuntimeError):
            control.stopJ(DECELERATION)
        with contextlib.suppress(RuntimeError):
            control.stopScript()

    def _torque(self, sent: np.ndarray) -> None:
        if self._control is None:
            raise HardwareError(f"{self.address}: not started, or stopped")
        if not self._control.directTorque(sent.tolist(), NO_FRICTION, NO_FRICTION):
            self._require_ready()
            raise HardwareError(
                f"{self.address}: the robot refused a torque; it needs PolyScope 5.23 or 10.10, and to be in "
                "remote control"
            )
        self._sent.append((self._t, sent))

    def _acting(self) -> np.ndarray:
        """(6,) [N m] of what was sent, the newest that is old enough to have acted over the last period."""
        old = self._t - (self.delay + 0.5) / FREQUENCY
        while len(self._sent) > 1 and self._sent[1][0] < old:
            self._sent.popleft()
        return self._sent[0][1]

    def _unlock(self, dashboard: Any) -> None:
        """End a protective stop, as at the pendant; the robot refuses that for some seconds after it."""
        stays = f"{self.address}: the protective stop stays"

        def ask() -> None:
            dashboard.connect()
            dashboard.closeSafetyPopup()
            dashboard.unlockProtectiveStop()
            dashboard.disconnect()

        in_time(ask, stays, (RuntimeError,))
        until = time.monotonic() + LONGEST_UNLOCK
        while self._receive.isProtectiveStopped():  # until the next sample says so
            if time.monotonic() > until:
                raise HardwareError(f"{stays}; see the pendant why, and unlock it there")
            time.sleep(NAP)

    def _require_ready(self) -> None:
        """Raises HardwareError for a robot that has stopped, and what to do."""
        if self._receive.isEmergencyStopped():
            raise HardwareError(f"{self.address}: emergency stop; release it and power the arm on")
        if self._receive.isProtectiveStopped():
            raise HardwareError(f"{self.address}: protective stop; see the pendant why, and unlock it there")
        if (mode := self._receive.getRobotMode()) != RUNNING:
            named = MODES.get(mode, str(mode))
            raise HardwareError(f"{self.address}: in mode {named!r}; power the arm on and release its brakes")


def periods(delay: Any) -> int:
    """A delay as a number of periods. Raises ArgumentError for what is none."""
    try:
        count = operator.index(delay)
    except TypeError:
        count = -1
    if count < 0:
        raise ArgumentError(f"delay: expected a whole number of periods, 0 or more, got {delay!r}")
    return count


def loaded_gravity(
    robot: Robot, load: tuple[float, Sequence[float]] | None
) -> Callable[[np.ndarray], np.ndarray]:
    """q (6,) -> (6,) [N m], the gravity of the robot's own model with a load (mass [kg], centre (3,) [m]) at
    its tool."""
    if load is None or not load[0]:
        return robot.gravity
    mass, (x, y, z) = load
    return dataclasses.replace(robot, model=Payload(mass, (x, y, z)).loaded(robot)).gravity


def ur_rtde() -> Any:
    """The classes of ur-rtde. Raises HardwareError where it is not installed."""
    with needing("a UR robot needs ur-rtde", "ur", HardwareError):
        receive, control, dashboard = map(
            importlib.import_module, ("rtde_receive", "rtde_control", "dashboard_client")
        )
    return SimpleNamespace(
        RTDEReceiveInterface=receive.RTDEReceiveInterface, RTDEControlInterface=control.RTDEControlInterface,
        DashboardClient=dashboard.DashboardClient,
    )  # fmt: skip
