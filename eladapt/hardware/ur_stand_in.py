"""A UR arm that is not there: the classes of ur-rtde that `URRobot` calls, around a simulated arm at 500 Hz.

Time stands still while the caller thinks: asking for a time stamp that was seen already is what lets the next
period pass. So a loop behaves the same on every computer, and faster than the arm would.

The period and positions within a turn both ways are the maker's. By how much a torque may change, for how
long none may come, and what share of a speed limit stops the arm, are assumed. Friction is not compensated,
whatever the scales.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eladapt.gains.extremes import effort, extremes
from eladapt.hardware.makers import require_joints
from eladapt.hardware.ur import FREQUENCY, JOINTS, MODES, RUNNING, loaded_gravity, periods
from eladapt.robot.protocols import Plant

PERIOD = 1 / FREQUENCY  # [s]
STEP = 0.2  # of the effort limit, by which a torque may change from period to period
FAST = 1.05  # of the speed limit
TURN = 2 * np.pi  # [rad] from zero, either way
SILENCE = 0.02  # [s] without a torque
STILL = 1e-6  # [rad/s]


class URStandIn:
    """``URRobot("stand-in", robot, library=URStandIn(plant))`` drives it.

    plant: what moves, with its friction, noise and load; its robot has the limits. gravity: what the firmware
    adds, q (6,) -> (6,) [N m], beside that of a load that it is told; None: that of the plant's robot. delay:
    [periods] until a torque acts. mode: of `MODES`, by its number.

    A protective stop closes the brakes and refuses torques until it is unlocked; ``tripped`` says what caused
    it. Raises ArgumentError for an arm of another number of joints, or a delay that is no whole number.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        gravity: Callable[[np.ndarray], np.ndarray] | None = None,
        delay: int = 1,
        mode: int = RUNNING,
    ):
        self.plant, self.delay, self.mode = plant, periods(delay), mode
        robot = plant.robot
        require_joints(robot, JOINTS, "UR")
        self.gravity = gravity or robot.gravity
        self.effort = effort(robot, extremes(robot))
        self.measurement = plant.reset()
        self.tripped = ""  # the check, and what it saw
        self.emergency = self.following = False  # following: torques, else the arm is held
        self.load: tuple[float, Sequence[float]] = (0.0, (0.0, 0.0, 0.0))
        self._loaded: Callable[[np.ndarray], np.ndarray] = robot.gravity  # with that load
        self._held = 0.0  # [s] for which the plant's clock stood still
        self.sent = np.zeros(JOINTS)
        self._told = [self.sent] * self.delay
        self._asked, self._resting, self._silent = False, False, 0

    def __repr__(self) -> str:
        return f"URStandIn({self.plant!r}, {self.tripped or MODES.get(self.mode, str(self.mode))!r})"

    def RTDEReceiveInterface(self, hostname: str, frequency: float = -1.0) -> Receive:
        """As the class of that name of ur-rtde's makes one."""
        return Receive(self)

    def RTDEControlInterface(self, hostname: str, frequency: float = -1.0) -> Control:
        """The same."""
        return Control(self)

    def DashboardClient(self, hostname: str) -> Dashboard:
        """The same."""
        return Dashboard(self)

    def added(self, q: np.ndarray) -> np.ndarray:
        """(6,) [N m] what the firmware adds."""
        return self.gravity(q) + self._loaded(q) - self.plant.robot.gravity(q)

    def carry(self, mass: float, centre: Sequence[float]) -> None:
        """Be told a load [kg] and its centre (3,) [m]."""
        self.load = (mass, tuple(centre))
        self._loaded = loaded_gravity(self.plant.robot, self.load)

    def take(self, torque: np.ndarray) -> bool:
        """Follow a torque (6,) [N m] from the next period on; whether it was accepted."""
        if self.tripped or self.emergency or self.mode != RUNNING:
            return False
        step = np.abs(torque - self.sent)
        if not np.isfinite(torque).all():
            self._trip(f"torque: {torque}, which is no number")
        elif (np.abs(torque) > self.effort).any():
            self._trip(f"torque: {torque} N m, limits {self.effort}")
        elif self.following and (step > STEP * self.effort).any():
            self._trip(f"torque step: {step} N m, limits {STEP * self.effort}")
        if self.tripped:
            return False
        if not self.following:
            self.following, self._told = True, [torque] * self.delay
            self.plant.release()
        self.sent, self._silent = torque, 0
        return True

    def timestamp(self) -> float:
        """[s] of the newest sample; once it was seen, a period passes."""
        if self._asked:
            self.pass_period()
        self._asked = True
        return self.measurement.t

    def pass_period(self) -> None:
        """Move by a period, and check what a robot's safety system does."""
        if self.following and not self.tripped and not self._resting:
            self._silent += 1
            if self._silent * PERIOD > SILENCE:
                self._trip(f"silence: no torque for {self._silent * PERIOD:.3g} s, limit {SILENCE:g} s")
        if self.following:
            self._told.append(self.sent)
            acts = self._told.pop(0) + self.added(self.plant.q)
            moved = self.plant.step(np.clip(acts, -self.effort, self.effort), PERIOD)
            self.measurement = moved._replace(t=moved.t + self._held)
        else:  # the firmware's own position control holds the arm
            self._held += PERIOD
            self.measurement = self.measurement._replace(t=self.measurement.t + PERIOD)
        robot, v = self.plant.robot, self.measurement.v
        q, fastest = robot.coordinates(self.measurement.q), FAST * robot.velocity_limit
        if (np.abs(v) > fastest).any():
            self._trip(f"speed: {v} rad/s, limits {fastest}")
        if (np.abs(q) > TURN).any():
            self._trip(f"position: {q} rad, limits {TURN:.4g}")

    def rest(self) -> None:
        """Brake until the arm rests, and hold it."""
        self._brake()
        self._resting = True
        while self.following and np.abs(self.plant.v).max() > STILL:
            self.pass_period()
        self.following = self._resting = False

    def unlock(self) -> None:
        """End a protective stop, as at the pendant."""
        self.tripped, self.following = "", False

    def _trip(self, cause: str) -> None:
        if not self.tripped:
            self.tripped = cause
            self._brake()

    def _brake(self) -> None:
        self.sent = np.zeros(JOINTS)
        self._told = [self.sent] * self.delay
        self.plant.brake()


class Receive:
    """What `URRobot` calls of RTDEReceiveInterface."""

    def __init__(self, arm: URStandIn):
        self.arm = arm

    def getTimestamp(self) -> float:
        """[s] of the newest sample."""
        return self.arm.timestamp()

    def getActualQ(self) -> list[float]:
        """[rad]"""
        return self.arm.plant.robot.coordinates(self.arm.measurement.q).tolist()

    def getActualQd(self) -> list[float]:
        """[rad/s]"""
        return self.arm.measurement.v.tolist()

    def getRobotMode(self) -> int:
        """One of `MODES`."""
        return self.arm.mode

    def isEmergencyStopped(self) -> bool:
        """Whether the red button is down."""
        return self.arm.emergency

    def isProtectiveStopped(self) -> bool:
        """Whether a check stopped the arm."""
        return bool(self.arm.tripped)


class Control:
    """What `URRobot` calls of RTDEControlInterface."""

    def __init__(self, arm: URStandIn):
        self.arm = arm

    def setPayload(self, mass: float, cog: Sequence[float]) -> bool:
        """The load [kg] that the firmware is told, and its centre [m] in the tool's frame."""
        self.arm.carry(mass, cog)
        return True

    def directTorque(
        self, torque: Sequence[float], viscous_scale: Sequence[float], coulomb_scale: Sequence[float]
    ) -> bool:
        """Follow torque (6,) [N m], beside gravity; False where the arm is stopped."""
        return self.arm.take(np.array(torque, dtype=float))

    def stopJ(self, a: float = 2.0) -> None:
        """Come to rest."""
        self.arm.rest()

    def stopScript(self) -> None:
        """Hold the arm."""
        self.arm.rest()


class Dashboard:
    """What `URRobot` calls of DashboardClient."""

    def __init__(self, arm: URStandIn):
        self.arm = arm

    def connect(self) -> None:
        """Nothing to be done."""

    def closeSafetyPopup(self) -> None:
        """The same."""

    def unlockProtectiveStop(self) -> None:
        """End a protective stop."""
        self.arm.unlock()

    def disconnect(self) -> None:
        """Nothing to be done."""
