"""Records survive saving, loading and failing, and their metrics mean what they say."""

import dataclasses
import json

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, RecordError
from eladapt.records.metrics import chatter
from eladapt.records.recorder import Recorder
from eladapt.signals import Reference
from eladapt.simulation.faults import LostNumbers
from eladapt.urdf.checks import MAX_BYTES


@pytest.fixture(scope="module")
def record() -> ea.Record:
    robot = load("kinova")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, plant, goal, 0.05, progress=False, title="a short move")


def test_shapes(record):
    n, nv, nq = 51, 6, 9
    assert len(record) == n
    for name, shape in (("q", nq), ("goal", nq), ("v", nv), ("tau", nv), ("error", nv)):
        assert getattr(record, name).shape == (n, shape)
    assert record.t[-1] == pytest.approx(0.05)
    assert record.theta.shape[1] == len(record.theta_labels) == len(record.theta_true)


def test_round_trip_is_exact(record, tmp_path):
    path = record.save(tmp_path / "new" / "run.npz")
    again = ea.Record.load(path)
    assert again.final_state is None, "what only the run's own controller understands is not saved"
    for field in dataclasses.fields(record):
        if field.name == "final_state":
            continue
        one, other = getattr(record, field.name), getattr(again, field.name)
        assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other
    assert ea.Robot.from_source(again.robot_source).joint_names == record.joint_names
    assert again.configuration["controller"]["control"]["class"] == "FiniteTimePD"


@pytest.mark.parametrize("letter", ["\xd0", '"'], ids=["not ASCII", "quotes"])
def test_the_largest_robot_file_that_is_read_goes_into_a_record(record, letter, tmp_path):
    """Also of letters that JSON may write as six."""
    largest = {"urdf": "arm.urdf", "text": letter * MAX_BYTES}
    path = dataclasses.replace(record, robot_source=largest).save(tmp_path / "run.npz")
    assert ea.Record.load(path).robot_source["text"] == largest["text"]


def test_a_failed_write_damages_nothing(record, tmp_path, monkeypatch):
    """What stood there before is still there, and no temporary file is left."""
    path = record.save(tmp_path / "run.npz")
    before = path.read_bytes()

    def full_disk(*_args, **_arrays):
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(OSError, match="no space"):
        record.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_not_a_record_is_refused(record, tmp_path):
    path = tmp_path / "run.npz"
    with pytest.raises(RecordError, match="no such record"):
        ea.Record.load(path)
    path.write_bytes(b"not a zip")
    with pytest.raises(RecordError, match="not a record"):
        ea.Record.load(path)
    path.write_bytes(record.save(tmp_path / "good.npz").read_bytes()[:2000])
    with pytest.raises(RecordError, match="damaged"):
        ea.Record.load(path)
    header = {"format": 1, "configuration": {"versions": {"eladapt": "0.0.7"}}}
    np.savez_compressed(path, header=np.array(json.dumps(header)))
    old = r"run\.npz: a record in format 1, written by eladapt 0\.0\.7; this one reads format 2\. Run the"
    with pytest.raises(RecordError, match=old):
        ea.Record.load(path)
    np.savez_compressed(path, header=np.array('{"format": 2}'))
    with pytest.raises(RecordError, match="lacks"):
        ea.Record.load(path)
    with pytest.raises(ArgumentError, match=r"\.npz"):
        record.save(tmp_path / "run.csv")


def test_metrics_of_a_known_signal(record):
    """Settling is the last entry into the band, not the first."""
    t = np.linspace(0, 4, 4001)
    error = np.where((t < 1) | ((t > 2) & (t < 2.5)), 1.0, 1e-5)[:, None]
    tau = (0.2 * np.sin(2 * np.pi * 50 * t) + t)[:, None]
    theta = np.where(t < 1.5, 0.0, 1.005)[:, None]
    made = dataclasses.replace(
        record,
        t=t,
        error=error,
        tau=tau,
        parameters=theta,
        parameters_true=np.ones(1),
        n_potential=1,
        dt=1e-3,
    )
    metrics = made.metrics()
    assert metrics.settling_time == pytest.approx(2.5)
    assert metrics.steady_error == pytest.approx(1e-5)
    assert metrics.parameter_settling == pytest.approx(1.5)
    assert metrics.chatter == pytest.approx(0.4, rel=0.03)  # the trend of a cut sine
    assert made.settling_time(threshold=1e-6) == np.inf
    assert metrics.control_energy == pytest.approx(np.sum(tau**2) * 1e-3)


def test_a_parameter_that_should_be_zero_counts_by_the_torque_that_its_error_makes(record):
    """Two parameters, of which one is 0: settled when the whole error is within 1 % of the whole torque, and
    not before, and never where it is not."""
    t = np.linspace(0, 2, 2001)
    error = np.where(t < 1, 0.02, 0.005)
    made = dataclasses.replace(
        record, t=t, parameters=np.column_stack([1 + 0 * t, error]), parameters_true=np.array([1.0, 0.0]),
        n_potential=2, dt=1e-3,
    )  # fmt: skip
    assert made.parameter_settling() == pytest.approx(1.0)
    assert made.parameter_settling(0.004) == np.inf
    nothing = dataclasses.replace(made, parameters_true=np.zeros(2))
    assert nothing.parameter_settling() == np.inf, "where there is no torque, any error is too much"


def test_what_is_said_of_rest_is_of_rest(record):
    """A run that ends half a second after it settled: the motion before is neither error nor ripple."""
    t = np.linspace(0, 2, 2001)
    left = np.clip(1.5 - t, 0, 1)[:, None]
    made = dataclasses.replace(record, t=t, error=left + 1e-6, tau=30 * left + 0.0, dt=1e-3)
    metrics = made.metrics()
    assert metrics.arrived
    assert metrics.steady_error < 1e-3
    assert metrics.chatter < 0.03  # N m, 30 N m/rad on the last millirad
    moving = dataclasses.replace(made, error=left + 0.1).metrics()
    assert not moving.arrived
    assert moving.steady_error == pytest.approx(0.6, abs=1e-3)


def test_the_fastest_joint_is_named_with_its_share_and_its_time(record):
    """The share counts, not the speed; joints without a limit do not, nor what no sensor could read."""
    v = np.zeros_like(record.v)
    v[10:14, 1], v[12, 1] = -1.5, -3.0
    v[20:40, 2], v[5, 0], v[7, 3] = 2.0, 50.0, np.nan
    limit = np.array([np.inf, 2.0, 4.0, 1.0, 1.0, 1.0])
    speed = dataclasses.replace(record, v=v, velocity_limit=limit).metrics().speed
    assert speed == (1.5, record.joint_names[1], pytest.approx(0.012), pytest.approx(0.001))
    limit[1] = 4.0
    made = dataclasses.replace(record, v=v, velocity_limit=limit).metrics()
    assert made.speed == (0.75, record.joint_names[1], pytest.approx(0.012), 0.0)
    assert made.speed_said == f"75% of the limit, {record.joint_names[1]} at 0.012 s"
    limit[1] = 1.0
    fast = dataclasses.replace(record, v=v, velocity_limit=limit).metrics()
    assert fast.speed_said == f"300% of the limit, {record.joint_names[1]} at 0.012 s, above it for 0.004 s"
    unlimited = dataclasses.replace(record, v=v, velocity_limit=np.full(6, np.inf)).metrics()
    assert np.isnan(unlimited.speed.value)
    assert unlimited.speed_said == "no joint has a limit"


def test_a_joint_that_left_its_range_is_named(record):
    """By how much, when and for how long, below and above; a continuous joint has no range to leave."""
    robot = load("kinova")
    assert np.isinf(robot.upper[[0, 3, 5]]).all(), "continuous joints, which take two numbers of q each"
    made = record.metrics()
    assert made.beyond.value < 0
    assert made.range_said == "kept by every joint"
    x = np.tile(robot.home, (len(record), 1))
    x[:, 0] = np.linspace(0, 20, len(record))
    x[30:40, 1] = robot.upper[1] + 0.02
    x[8, 2] = robot.lower[2] - 0.03
    left = dataclasses.replace(record, q=np.array([robot.configuration(row) for row in x])).metrics()
    # 1e-12: of differences of angles of some radians
    assert left.beyond == (pytest.approx(0.03, abs=1e-12), robot.joint_names[2], 0.008, pytest.approx(0.001))
    said = f"left by {robot.joint_names[2]}, 0.03 beyond it at 0.008 s, outside for 0.001 s"
    assert left.range_said == said
    x[8, 2] = robot.lower[2] - 0.01
    left = dataclasses.replace(record, q=np.array([robot.configuration(row) for row in x])).metrics()
    assert left.beyond[1:] == (robot.joint_names[1], pytest.approx(0.03), pytest.approx(0.01))
    x[:, [1, 2]] = robot.home[[1, 2]]
    x[:, 1] = robot.upper[1] + 1e-9
    at_the_end = dataclasses.replace(record, q=np.array([robot.configuration(row) for row in x])).metrics()
    assert at_the_end.range_said == "kept by every joint", "by less than a sensor sees"


class Failing:
    """Raises in its eleventh step, once."""

    def __init__(self, robot):
        self.robot = robot

    def init(self, measurement):
        return 0

    def step(self, state, measurement, goal, dt):
        if state == 10:
            raise RuntimeError("no idea")
        return state + 1, self.robot.gravity(measurement.q)


@pytest.mark.parametrize("shaped", [False, True])
def test_the_gates_fault_is_recorded_and_survives_saving(shaped, tmp_path):
    """Its kind, its time and its message, once, however long it lasts."""
    robot = load("two_link")
    gated = ea.GatedController.for_robot(Failing(robot))
    q = robot.configuration(robot.home)
    record = ea.simulate(
        ea.Shaped(gated) if shaped else gated, ea.PinocchioPlant(robot, q), q, 0.05, progress=False
    )
    fault = ea.Fault("controller", pytest.approx(0.010), "RuntimeError: no idea")
    assert record.faults == (fault,) == (record.final_state.fault,)
    again = ea.Record.load(record.save(tmp_path / "run.npz"))
    assert again.faults == record.faults
    assert again.metrics().faults == record.faults
    assert again.metrics().faults_said == "controller at t = 0.0100 s: RuntimeError: no idea"


def test_every_fault_of_a_run_is_kept():
    """After a reset the gate may latch another one; two that follow each other are told apart."""
    robot = load("two_link")
    controller = ea.GatedController.for_robot(Failing(robot))
    q, still = robot.configuration(robot.home), robot.still
    goal = Reference(q, still, still)
    state = controller.init(ea.Measurement(0.0, q, still, still))
    recorder = Recorder(robot, controller, 1e-3, 40, "")
    for k in range(1, 31):
        if k == 15:
            state = controller.reset(state)._replace(inner=0)
        state, tau = controller.step(state, ea.Measurement(1e-3 * k, q, still, still), q, 1e-3)
        recorder.add(1e-3 * k, q, still, tau, goal, state)
    assert [fault.t for fault in recorder.record().faults] == pytest.approx([0.011, 0.025])


@pytest.mark.parametrize("shaped", [False, True])
def test_when_brakes_were_asked_for_and_why_is_recorded(shaped, tmp_path):
    """Sensors that fail for good: once, with the fallback's reason, also after saving."""
    robot = load("two_link")
    q = robot.configuration(robot.home)
    controller = ea.GatedController.for_robot(ea.CompositeController.for_robot(robot))
    record = ea.simulate(
        ea.Shaped(controller) if shaped else controller, LostNumbers(ea.PinocchioPlant(robot, q), 0.05), q,
        0.2, progress=False,
    )  # fmt: skip
    (braking,) = record.brakes
    assert braking == (pytest.approx(0.05 + controller.gate.max_age, abs=2e-3), braking.reason)
    assert "no trusted measurement for" in braking.reason
    metrics = ea.Record.load(record.save(tmp_path / "run.npz")).metrics()
    assert metrics.brakes == record.brakes
    assert f"; brakes asked for at t = {braking.t:.4f} s" in metrics.faults_said
    assert metrics.faults_said.count(braking.reason) == 1, "a reason is said once"


def test_brakes_that_are_not_brakes_are_refused(record, tmp_path):
    path = dataclasses.replace(record, brakes=(ea.Braking(0.1, "why"),)).save(tmp_path / "run.npz")
    with np.load(path) as file:
        header, arrays = json.loads(str(file["header"])), {n: file[n] for n in file.files if n != "header"}
    for given in ([["soon", "why"]], [[0.1, 2]], [[0.1]]):
        np.savez_compressed(path, header=np.array(json.dumps({**header, "brakes": given})), **arrays)
        with pytest.raises(RecordError):
            ea.Record.load(path)


def test_without_a_gate_and_in_older_records_no_fault_is_recorded(record, tmp_path):
    """Nor are the ranges in older ones; all else is there."""
    assert record.faults is None
    assert record.metrics().faults_said == "not recorded"
    gated = ea.GatedController.for_robot(ea.CompositeController.for_robot(load("kinova")))
    plant = ea.PinocchioPlant(load("kinova"), record.q[0])
    watched = ea.simulate(gated, plant, record.goal[0], 0.01, progress=False)
    assert watched.faults == ()
    assert watched.metrics().faults_said == "none"
    path = watched.save(tmp_path / "run.npz")
    with np.load(path) as file:
        header, arrays = json.loads(str(file["header"])), {n: file[n] for n in file.files if n != "header"}
    del header["faults"], header["brakes"], arrays["lower"], arrays["upper"], arrays["q_index"]
    np.savez_compressed(path, header=np.array(json.dumps(header)), **arrays)
    old = ea.Record.load(path)
    assert old.metrics()[:-3] == watched.metrics()[:-3]
    assert old.metrics().range_said == "not recorded"
    assert old.metrics().faults_said == "not recorded"


def test_chatter_ignores_a_trend():
    t = np.linspace(0, 1, 100)
    assert chatter(t, np.column_stack([3 * t, 5 - t])) < 1e-12


@pytest.mark.parametrize("name", ["panda", "talos_left_arm", "two_link"])
@pytest.mark.parametrize("slotine_li", [False, True])
def test_the_true_parameters_follow_the_load(name, slotine_li):
    """Each sample's true theta makes the torque of the arm as it then is; at the end, the loaded one's."""
    robot = load(name)
    kind = ea.SlotineLi if slotine_li else ea.CompositeController
    controller = kind.for_robot(robot)
    payload = ea.Payload(0.5, (0.0, 0.0, -0.02), attach=0.01)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=payload)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 0.02, progress=False)
    reg, heavy = controller.regressors, dataclasses.replace(robot, model=payload.loaded(robot))
    size = record.parameters.shape[1]
    assert record.parameters_true_course.shape == (21, size)
    np.testing.assert_array_equal(
        record.theta_true_course, record.parameters_true_course[:, -reg.n_potential :]
    )
    for k in (0, 9, 10, 20):
        arm = heavy if payload.held(record.t[k]) else robot
        true = record.parameters_true_course[k]
        if slotine_li:
            rng = np.random.default_rng(k)
            v, a = rng.normal(size=(2, robot.nv))
            torque, made = arm.inverse_dynamics(record.q[k], v, a), reg.torque(record.q[k], v, a) @ true
        else:
            torque = arm.gravity(record.q[k])
            made = reg.gravity(record.q[k]) @ true[-reg.n_potential :]
        # Rounding of the base's projection, as for the bare arm's identities (1e-9 asked, 3e-12 measured).
        np.testing.assert_allclose(made, torque, atol=1e-9 * np.abs(torque).max())
    np.testing.assert_array_equal(record.parameters_true, record.parameters_true_course[-1])
    np.testing.assert_array_equal(record.parameter_error, record.parameters - record.parameters_true_course)


def test_a_loaded_record_survives_saving(tmp_path):
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=0.3)
    controller = ea.CompositeController.for_robot(robot)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 0.01, progress=False)
    again = ea.Record.load(record.save(tmp_path / "run.npz"))
    np.testing.assert_array_equal(again.theta_true_course, record.theta_true_course)


def test_parameters_of_another_arm_are_refused():
    with pytest.raises(ArgumentError, match="model: expected the joints"):
        ea.Regressors(load("two_link")).theta_of(load("panda").model)


def test_the_true_friction_is_the_plants():
    """TALOS' URDF has joint friction: Pinocchio's plant does not apply it, MuJoCo's does and adds the
    caller's."""
    robot = load("talos_left_arm")
    assert robot.friction.any()
    q0 = robot.configuration(robot.home)
    rub = ea.Friction(viscous=0.3, coulomb=0.2)
    reg = ea.CompositeController.for_robot(robot).regressors
    for plant, viscous, coulomb in (
        (ea.PinocchioPlant(robot, q0, friction=rub), 0.3, 0.2),
        (ea.MujocoPlant(robot, q0, friction=rub), robot.damping + 0.3, robot.friction + 0.2),
    ):
        controller = ea.CompositeController.for_robot(robot)
        record = ea.simulate(controller, plant, q0, 0.01, progress=False)
        for name, value in (("viscous", viscous), ("coulomb", coulomb)):
            block = reg.block(name)
            true = record.parameters_true[block] / reg.scale[block]
            np.testing.assert_allclose(true, np.broadcast_to(value, robot.nv), rtol=1e-12)
