"""Logs of motions that are known to the last digit, with torques by Pinocchio."""

import numpy as np
import pinocchio as pin

import eladapt as ea
from eladapt.urdf.editing import Edits

VISCOUS, COULOMB, OFFSET = 0.4, 0.6, 0.2  # [N m s/rad], [N m], [N m], of every joint
ALL = ("rotor", "viscous", "coulomb", "offset")


def known_log(robot, duration=8.0, dt=2e-3, seed=0, noise=0.0, load=None, model=None, rng=None, sign=1):
    """A log of an excitation of ``robot``.

    noise: standard deviation of the torques [N m]. load: (mass, centre) at the tool. model: the arm that
    moves, where it is another than the robot's. sign: -1 for the torques of the reaction.
    """
    motion = ea.excitation(robot, duration, rounds=0, seed=seed, progress=False)
    t, course = motion.sampled(dt)
    model = (model or robot.model).copy()
    if load is not None:
        frame = model.frames[model.getFrameId(robot.tool)]
        mass, centre = load
        body = pin.Inertia(mass, np.array(centre), 1e-3 * mass * np.eye(3))
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    data = model.createData()
    torques = [pin.rnea(model, data, *moved) for moved in zip(course.q, course.v, course.a, strict=True)]
    tau = np.array(torques) + VISCOUS * course.v + COULOMB * np.sign(course.v) + OFFSET
    tau = sign * tau + noise * (rng or np.random.default_rng(seed)).normal(size=tau.shape)
    x = np.unwrap([robot.coordinates(q) for q in course.q], axis=0)
    return ea.Log(t, x, course.v, tau, robot.joint_names)


def truth(regressors, model=None):
    """theta of a model with the friction of `known_log`."""
    theta = regressors.theta_of(model or regressors.robot.model)
    for name, value in (("viscous", VISCOUS), ("coulomb", COULOMB), ("offset", OFFSET)):
        block = regressors.block(name)
        theta[block] = regressors.scale[block] * value
    return theta


def heavier(robot, factor=1.3):
    """The robot file of somebody who is wrong about every mass."""
    bodies = {}
    for joint in robot.document().findall("joint"):
        if joint.get("name") in robot.joint_names:
            k = robot.model.getJointId(joint.get("name"))
            parameters = factor * robot.model.inertias[k].toDynamicParameters()
            bodies[joint.find("child").get("link")] = [float(x) for x in parameters]
    return robot.edited(Edits(bodies, {}))


def short_run(**options):
    """A record of 50 ms of the two-link arm."""
    robot = ea.Robot.load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    return ea.simulate(ea.CompositeController.for_robot(robot), plant, goal, 0.05, progress=False, **options)
