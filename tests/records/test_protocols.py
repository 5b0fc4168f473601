"""Every controller says what a record keeps of it; one that says nothing is recorded all the same."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD, adaptive_pd, indirect
from eladapt.errors import ArgumentError, EladaptError, UnknownNameError
from eladapt.records.recorder import REVIEWED, SAMPLED
from eladapt.robot.protocols import Recorded, Unrecorded, truth_of
from eladapt.signals import Reference
from eladapt.simulation.instruments import Delay, Encoders

CONTROLLERS = {
    "composite": ea.CompositeController.for_robot,
    "adaptive PD": lambda robot: adaptive_pd(ea.CompositeController.for_robot(robot)),
    "indirect": lambda robot: indirect(ea.CompositeController.for_robot(robot)),
    "Slotine-Li": ea.SlotineLi.for_robot,
    "terminal sliding": ea.TerminalSliding.for_robot,
    "known gravity": lambda robot: KnownGravityPD(robot, ea.FiniteTimePD(20.0, 10.0, 1.0)),
    "gated": lambda robot: ea.GatedController.for_robot(ea.CompositeController.for_robot(robot)),
    "gated, of no parameters": lambda robot: ea.GatedController.for_robot(Silent(robot)),
    **{f"paper {name}": lambda _, name=name: ea.paper.controller(name) for name in ea.paper.NAMES},
    **{
        f"paper {name}, typeset": lambda _, name=name: ea.paper.controller(name, typeset=True)
        for name in ea.paper.NAMES
    },
}


class Silent:
    """A user's controller: three members, and no word about records."""

    def __init__(self, robot):
        self.robot = robot

    def init(self, measurement):
        return None

    def step(self, state, measurement, goal, dt):
        assert isinstance(goal, np.ndarray), "a goal at rest is q_d alone"
        return state, self.robot.gravity(measurement.q)


class Chatty(Silent, Unrecorded):
    """Another, which keeps something that no record holds."""

    def recorded(self, state):
        return {"thteta": np.zeros(2)}


DT = 5e-4  # [s] at twice that, the paper's explicit Euler diverges


def run(controller, plant=None, duration=0.01, goal=None, **options):
    robot = controller.robot
    plant = plant or ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target) if goal is None else goal
    return ea.simulate(controller, plant, goal, duration, DT, progress=False, **options)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_of_the_library_says_what_is_recorded(name):
    """It has all of the protocol, by known names, with shapes that agree with its labels."""
    controller = CONTROLLERS[name](load("two_link"))
    assert isinstance(controller, Recorded)
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    state = controller.init(plant.reset())
    kept, reviewed = controller.recorded(state), controller.reviewed(state, None)
    assert set(kept) <= set(SAMPLED)
    assert set(reviewed) <= set(REVIEWED)
    size = len(controller.labels)
    true = controller.true_parameters(robot.model)
    assert np.shape(kept.get("parameters", ())) == (size,)
    assert (0 if true is None else len(true)) == size
    theta = kept.get("theta", np.zeros(0))
    assert np.array_equal(theta, kept.get("parameters", theta)[size - len(theta) :]), "its last block"
    record = run(controller)
    assert record.parameter_labels == tuple(controller.labels)
    assert record.parameters.shape == (21, size)
    assert record.theta.shape == (21, len(theta))


def test_a_controller_of_ones_own_is_simulated_and_recorded():
    """Without a word about records, the motion is kept; through a gate too."""
    record = run(Silent(load("ur5")))
    assert record.parameters.shape == (21, 0)
    assert record.parameters_true is None
    assert record.excitation is None
    assert len(record) == 21


def test_what_no_record_holds_is_refused_by_name():
    with pytest.raises(
        UnknownNameError,
        match=r"entry of recorded 'thteta' \(did you mean 'theta'\?\); legal names: par",
    ):
        run(Chatty(load("two_link")))


def test_what_is_true_is_told_by_the_plant_inside():
    """Encoders and buses change nothing of it; a plant with another's parameters knows none."""
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=0.2)
    wrapped = Delay(Encoders(plant), 0.002)
    assert truth_of(wrapped) == truth_of(plant) == (True, plant.payload, plant.friction)
    assert truth_of(None) == (False, None, None)
    plant.knows_parameters = False
    controller = ea.CompositeController.for_robot(robot)
    record = run(controller, wrapped)
    assert record.parameters_true is None
    assert record.parameters_true_course is None
    assert record.carried.shape[1] == 6, "the load is known all the same"


def test_a_load_that_was_only_noticed_is_kept_from_then_on():
    """With no load told, nothing is said of one before the controller has noticed a change."""
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)

    class Discreet(ea.PinocchioPlant):
        """Its load is its own business."""

        def step(self, tau, dt):
            self.payload, mine = self.secret, self.payload
            try:
                return super().step(tau, dt)
            finally:
                self.payload = mine

    plant = Discreet(robot, robot.configuration(robot.home), payload=ea.Payload(0.3, attach=0.4))
    plant.secret, plant.payload = plant.payload, None
    record = run(controller, plant, 0.8)
    noticed = record.final_state.change.t
    assert 0.4 < noticed < 0.5
    assert noticed <= record.carried[0, 0] <= noticed + 1 / 30
    assert record.carried.shape[1] == 6
    assert run(controller, duration=0.1).carried is None
    assert record.excitation[0, 0] == 0
    assert np.diff(record.excitation[:, 0]).max() < 1 / 30 + DT


@pytest.mark.parametrize("name", ["composite", "Slotine-Li", "terminal sliding"])
def test_parameters_start_where_they_are_told(name):
    """The URDF's, zero, all of them, or gravity's alone."""
    controller = CONTROLLERS[name](load("two_link"))
    reg = controller.regressors
    j, gravity = reg.n_potential, reg.theta_potential
    assert np.array_equal(run(controller, theta0="urdf").theta[0], gravity)
    assert not run(controller, theta0="zero").theta[0].any()
    assert np.array_equal(run(controller, theta0=2 * reg.theta).theta[0], 2 * gravity)
    assert np.array_equal(run(controller, theta0=np.arange(j)).theta[0], np.arange(j))
    for wrong in ("urfd", np.zeros(len(reg) + 1)):
        with pytest.raises(EladaptError, match="theta0"):
            run(controller, theta0=wrong)


def swing(robot, rate=2.0, size=0.2):
    """A sine of every joint about home, with its velocity and acceleration."""
    home, one = robot.configuration(robot.home), np.ones(robot.nv)

    def goal(t):
        q = robot.integrate(home, size * np.sin(rate * t) * one)
        v, a = size * rate * np.cos(rate * t), -size * rate**2 * np.sin(rate * t)
        return Reference(q, v * one, a * one)

    return goal


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_takes_a_reference(name):
    """A goal that moves is recorded with its velocity; the error is the distance from it at each sample."""
    controller = CONTROLLERS[name](load("two_link"))
    if name == "gated, of no parameters":
        pytest.skip("it takes set-points alone")
    robot, goal = controller.robot, swing(controller.robot)
    record = run(controller, goal=goal)
    for k in (0, 7, 20):
        q, v, a = goal(record.t[k])
        assert np.array_equal(record.goal[k], q)
        assert np.array_equal(record.goal_velocity[k], v)
        assert np.array_equal(record.goal_acceleration[k], a)
        assert np.array_equal(record.error[k], robot.difference(q, record.q[k]))


def test_slotine_and_li_follow_a_sine():
    """With v_d and a_d in s and W_r, and the right parameters, the error stays where it began."""
    controller = ea.SlotineLi.for_robot(load("panda"))
    robot = controller.robot
    goal = swing(robot, 2.0, 0.1)
    plant = ea.PinocchioPlant(robot, goal(0).q, goal(0).v)
    record = run(controller, plant, 1.0, goal, theta0="urdf")
    # Explicit Euler holds the torque for a step of 1 ms, in which a_d changes by 4e-4 rad/s^2.
    assert np.abs(record.error).max() < 1e-4


def test_a_reference_goes_through_file_plot_and_report(tmp_path):
    """Velocity and acceleration of the goal come back as they were, and a picture is made of them."""
    robot = load("kinova")
    record = run(ea.CompositeController.for_robot(robot), goal=swing(robot))
    again = ea.Record.load(record.save(tmp_path / "run.npz"))
    for name in ("goal", "goal_velocity", "goal_acceleration", "error", "excitation", "velocity_limit"):
        assert np.array_equal(getattr(again, name), getattr(record, name)), name
    ea.plot(again, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 10_000
    ea.report(again, tmp_path / "run.html", animation=False)
    assert "moving" in (tmp_path / "run.html").read_text()


def test_a_goal_at_rest_has_no_velocity():
    """A set-point, and a reference that stands still, are the same run."""
    robot = load("two_link")
    q = robot.configuration(robot.target)
    controller = ea.CompositeController.for_robot(robot)
    one = run(controller, goal=q)
    other = run(controller, goal=Reference(q, np.zeros(2), np.zeros(2)))
    assert one.goal_velocity is None
    assert other.goal_velocity is None
    assert np.array_equal(one.tau, other.tau)


@pytest.mark.parametrize("gated", [False, True])
def test_a_bad_reference_is_named(gated):
    """Without a gate the run ends and says why; a gate latches the fault and holds the arm."""
    robot = load("two_link")
    controller = CONTROLLERS["gated" if gated else "composite"](robot)
    good = swing(robot)
    bad = good(0)._replace(v=np.array([np.nan, 0.0]))
    if not gated:
        with pytest.raises(ArgumentError, match=r"goal\.v: expected finite"):
            run(controller, goal=bad)
        return
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state = controller.init(measurement)
    state, _ = controller.step(state, measurement, good(0), 1e-3)
    state, tau = controller.step(state, plant.step(np.zeros(2), 1e-3), bad, 1e-3)
    assert state.fault.name == "goal"
    assert "goal.v" in state.fault.message
    assert np.array_equal(state.gate.goal.q, good(0).q), "the last valid one stays"
    assert np.isfinite(tau).all()


def test_what_is_long_is_said_in_a_line():
    """No array is printed for a record or a gated controller."""
    controller = CONTROLLERS["gated"](load("panda"))
    assert repr(controller).startswith("GatedController(CompositeController of panda")
    record = run(controller)
    assert repr(record).startswith("Record('panda': 7 joints, 21 samples of 0.0005 s")
    assert max(len(repr(controller)), len(repr(record))) < 110
