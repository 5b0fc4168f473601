"""The maker's client and a simulated Franka: each of the robot's checks ends the loop, with all there was.

Needs franka-sim in an environment of its own, see benchmarks/franka_client.py, and two cores for itself.
"""

import os
import time

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import HardwareError, LoopError

franka = pytest.importorskip(
    "eladapt.hardware.franka", reason="pylibfranka is not installed", exc_type=HardwareError
)
PYTHON = os.environ.get("ELADAPT_FRANKA_SIM_PYTHON")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(PYTHON is None, reason="ELADAPT_FRANKA_SIM_PYTHON does not say where franka-sim is"),
]
DT, HARM = 1e-3, 1.5  # [s] after which harm is done


class Harmful(franka.FrankaRobot):
    """Sends something else from HARM on."""

    def __init__(self, harm, *arguments, **options):
        super().__init__(*arguments, **options)
        self.harm, self.cycle = harm, 0

    def _send(self, wanted):
        self.cycle += 1
        since = self.cycle - round(HARM / DT)
        if since < 0:
            super()._send(wanted)
        else:
            self.harm(self, wanted, since)

    def raw(self, torques):
        self._moving(lambda: self._control.writeOnce(franka.pylibfranka.Torques(list(torques))))


def torque_step(arm, wanted, since):
    arm.raw(wanted + 50.0 * np.eye(7)[0])


def too_fast(arm, wanted, since):
    franka.FrankaRobot._send(arm, wanted + 12.0 * np.eye(7)[6])  # as far as its rate allows


def silence(arm, wanted, since):
    time.sleep(0.03)


def not_a_number(arm, wanted, since):
    arm.raw(wanted * np.nan)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (torque_step, "controller_torque_discontinuity"),
        (too_fast, "velocity"),
        (silence, "communication_constraints_violation"),
        (not_a_number, "nan|NaN|finite|infinite"),
    ],
)
def test_each_check_ends_the_loop_with_its_name_and_all_there_was(harm, said):
    import franka_client as client

    robot, gravity = load("panda"), client.firmware_gravity(PYTHON)
    with client.server(PYTHON, 0.0):
        arm = Harmful(harm, client.ADDRESS, robot, gravity=gravity, recover=True)
        start = arm.posture()
        controller = ea.CompositeController.for_robot(robot, DT, **client.TOLD[client.ALL])
        with pytest.raises(LoopError, match=said) as ended:
            ea.run_loop(controller, arm, robot.configuration(start), 4.0, DT)
        record = ended.value.record
        assert record.t[-1] - record.t[0] > 0.9 * HARM
        assert np.isfinite(record.q).all()
