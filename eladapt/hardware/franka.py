"""A Franka robot over its network interface, by the maker's library (extra ``franka``).

The firmware adds gravity, with its own model and the load that it was told, and compensates the friction of
its motors. So what is sent is the torque wanted less that gravity, and what acts is the torque sent plus it.
The robot keeps the clock: a read waits for its next cycle, and its limit of torque rate is one of cycles.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from eladapt.errors import HardwareError, needing, require_number, require_vector
from eladapt.hardware.makers import in_time, require_joints
from eladapt.robot.model import Robot
from eladapt.signals import Measurement

with needing("a Franka robot needs pylibfranka", "franka", HardwareError):
    import pylibfranka

JOINTS = 7
MOST_PER_CYCLE = 0.99  # [N m] of the 1 N m by which the robot lets a torque change from cycle to cycle
CONTACT_TORQUE, COLLISION_TORQUE = 40.0, 80.0  # [N m] from outside, reported and stopped at
CONTACT_FORCE, COLLISION_FORCE = 60.0, 120.0  # [N, N m] at the tool
RAISED = tuple(
    kind
    for kind in vars(pylibfranka).values()
    if isinstance(kind, type) and issubclass(kind, Exception)  # they have no base of their own
)
ERRORS = tuple(name for name in dir(pylibfranka.Errors) if not name.startswith("_"))


class FrankaRobot:
    """A Panda or FR3 as a `RobotInterface`.

    address: of the robot's control. robot: what the controller knows of it; its joints are the arm's seven.
    load: what the firmware is told to hang on the flange: (mass [kg], centre (3,) [m], inertia (9,) [kg m^2],
    column by column), None to leave it as it is. It is part of the gravity that the firmware adds, and so of
    what acts; nothing is counted twice. collision: torque [N m] from outside at which the robot stops by
    itself; half of it is reported as contact. recover: whether errors from before are cleared at the start.
    realtime: whether the maker's library insists on a real-time kernel. gravity: of the firmware, q (7,) ->
    (7,) [N m]; None asks the maker's model. prompt: whether each cycle is answered at once, by the torque of
    the cycle before, so that the controller has all of a cycle to think; the robot drops what comes later. It
    is a delay of one cycle: tell the controller, ``delay=1e-3``, or let `commission` find it.

    Each error of the robot is a HardwareError that names its reflexes. Raises HardwareError within 5 s for a
    robot that does not answer, ArgumentError for another number of joints.
    """

    keeps_clock = True
    adds_gravity = True

    def __init__(
        self,
        address: str,
        robot: Robot,
        *,
        load: tuple[float, Sequence[float], Sequence[float]] | None = None,
        collision: float = COLLISION_TORQUE,
        recover: bool = False,
        realtime: bool = False,
        gravity: Callable[[np.ndarray], np.ndarray] | None = None,
        prompt: bool = True,
    ):
        require_joints(robot, JOINTS, "Franka")
        self.address, self.robot, self.recover, self.prompt = address, robot, recover, prompt
        self.load = None if load is None else _load(*load)
        self.collision = require_number("collision", collision, 0)
        self._realtime = (
            pylibfranka.RealtimeConfig.kEnforce if realtime else pylibfranka.RealtimeConfig.kIgnore
        )
        self._gravity = gravity
        self._franka: Any = None
        self._control: Any = None
        self._model: Any = None
        self._t, self._added = 0.0, np.zeros(JOINTS)
        self._sent, self._wanted = np.zeros(JOINTS), np.zeros(JOINTS)

    def __repr__(self) -> str:
        return f"FrankaRobot({self.address!r}, {self.robot.name!r})"

    def connect(self) -> None:
        """Reach the robot, clear errors where wanted, and set thresholds and load; `start` does it too."""
        if self._franka is not None:
            return
        found = in_time(
            lambda: pylibfranka.Robot(self.address, self._realtime),
            f"{self.address} does not answer; is that the robot, and is FCI activated in Desk?", RAISED,
        )  # fmt: skip
        with _named("the robot refused its set-up"):
            self._require_ready(found)
            half = 0.5 * self.collision
            found.set_collision_behavior(
                [half] * JOINTS, [self.collision] * JOINTS, [CONTACT_FORCE] * 6, [COLLISION_FORCE] * 6
            )
            if self.load is not None:
                found.set_load(*self.load)
            if self._gravity is None:
                self._model = found.load_model()
        self._franka = found  # not before: a robot that refused its set-up is asked again

    def posture(self) -> np.ndarray:
        """(7,) [rad] where the arm is, before it starts."""
        self.connect()
        with _named("the robot does not say where it is"):
            return np.array(self._franka.read_once().q)

    def start(self) -> None:
        """Begin to follow torques."""
        self.connect()
        with _named("torque control does not start"):
            self._control = self._franka.start_torque_control()
        self._t, self._sent, self._wanted = 0.0, np.zeros(JOINTS), np.zeros(JOINTS)

    def read(self) -> Measurement:
        """Wait for the next cycle."""
        if self._control is None:
            raise HardwareError(f"{self.address}: not started, or stopped")
        state, elapsed = self._moving(lambda: self._control.readOnce())
        self._t += elapsed.to_sec()
        q = np.array(state.q)
        self._sent = np.array(state.tau_J_d)  # what arrived: a command that was lost did not
        if self.prompt:
            self._send(self._wanted)
        self._added = self._firmware_gravity(state, q)
        return Measurement(self._t, self.robot.configuration(q), np.array(state.dq), self._sent + self._added)

    def write(self, tau: np.ndarray) -> None:
        """Command tau (7,) [N m], less what the firmware adds, as near as its rate allows."""
        if self._control is None:
            raise HardwareError(f"{self.address}: not started, or stopped")
        self._wanted = tau - self._added
        if not self.prompt:
            self._send(self._wanted)

    def _send(self, wanted: np.ndarray) -> None:
        change = np.clip(wanted - self._sent, -MOST_PER_CYCLE, MOST_PER_CYCLE)
        limit = self.robot.effort_limit  # of what is sent: the firmware's gravity is beside it
        command = pylibfranka.Torques(np.clip(self._sent + change, -limit, limit).tolist())
        self._moving(lambda: self._control.writeOnce(command))

    def stop(self) -> None:
        """End the motion: the robot brakes by itself, and its brakes close."""
        control, self._control = self._control, None
        if control is None:  # it has ended the motion itself, or none began
            return
        with contextlib.suppress(*RAISED):
            control.readOnce()
            last = pylibfranka.Torques([0.0] * JOINTS)
            last.motion_finished = True
            control.writeOnce(last)

    def _moving(self, call: Callable[[], Any]) -> Any:
        """What a call gives. After an error of the robot there is no motion that could be ended: asked to
        stop one, the maker's library waits for ever."""
        try:
            return call()
        except RAISED as reason:
            self._control = None
            raise HardwareError(f"the robot ended the motion: {reason}") from reason

    def recovered(self) -> None:
        """Clear the errors that stopped the robot, as its user button does. Raises HardwareError."""
        self.connect()
        with _named("the errors stay"):
            self._franka.automatic_error_recovery()

    def _require_ready(self, found: Any) -> None:
        """Raises HardwareError for a robot that will not move, and what to do."""
        state = found.read_once()
        mode = state.robot_mode
        if mode == pylibfranka.RobotMode.Reflex and self.recover:
            found.automatic_error_recovery()
            return
        remedies = {
            pylibfranka.RobotMode.Reflex: "clear the errors: recover=True, or in Desk",
            pylibfranka.RobotMode.UserStopped: "release the user stop",
            pylibfranka.RobotMode.Guiding: "let go of the guiding button",
            pylibfranka.RobotMode.Move: "another program controls it; end that",
        }
        if mode in remedies:
            errors = _said(state.current_errors)
            raise HardwareError(f"{self.address}: in mode {mode.name}{errors}; {remedies[mode]}")

    def _firmware_gravity(self, state: Any, q: np.ndarray) -> np.ndarray:
        """(7,) [N m] what the firmware adds at this state."""
        given = self._model.gravity(state) if self._gravity is None else self._gravity(q)
        return np.asarray(given, dtype=float)


def _load(
    mass: float, centre: Sequence[float], inertia: Sequence[float]
) -> tuple[float, list[float], list[float]]:
    mass = require_number("load: mass", mass, 0, np.inf, closed=True)
    return (
        mass,
        require_vector("load: centre", centre, 3).tolist(),
        require_vector("load: inertia", inertia, 9).tolist(),
    )


@contextlib.contextmanager
def _named(said: str) -> Iterator[None]:
    """What the maker's library raises, as a HardwareError."""
    try:
        yield
    except RAISED as reason:
        raise HardwareError(f"{said}: {reason}") from reason


def _said(errors: Any) -> str:
    named = [name for name in ERRORS if getattr(errors, name, False)]
    return f" ({', '.join(named)})" if named else ""
