"""Threads may share a robot, its regressors and a shaped controller: each reads what it computed."""

import functools
import inspect
import sys
import threading
import time
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
import pytest
from shared import load, regressors

import eladapt as ea
from eladapt.regressors.joint_terms import JOINT_TERMS
from eladapt.urdf.editing import Edits

PACKAGE = str(Path(ea.__file__).parent)
ROUNDS = 5  # one was enough to show working memory that two threads shared


@functools.cache
def served(kind):
    return load("panda") if kind is ea.Robot else regressors("panda", joint_terms=JOINT_TERMS)


def public(kind):
    """Every property and method of its own that an object of this kind has."""
    names = [name for name in vars(kind) if not name.startswith("_")]
    return [name for name in names if not isinstance(vars(kind)[name], classmethod)]


def arguments(method, robot, share):
    """For the parameters without a default, by their names."""
    q, v = robot.configuration(share * robot.target), np.full(robot.nv, 3 * share)
    known = {
        **dict.fromkeys(("q", "q0"), q), "q1": robot.configuration(robot.home), "x": robot.target,
        **dict.fromkeys(("v", "dq", "tau", "vr"), v), **dict.fromkeys(("a", "ar"), share * np.cos(v)),
        "goal": ea.Reference(q, v, v), "measurement": ea.Measurement(share, q, v, v),
        "count": 3, "edits": Edits({}, {robot.joint_names[0]: {"damping": share}}),
        "model": robot.model, "name": "viscous", "theta": share * served(ea.Regressors).theta,
    }  # fmt: skip
    needed = [p for p in inspect.signature(method).parameters.values() if p.default is p.empty]
    return {p.name: np.random.default_rng(7) if p.name == "rng" else known[p.name] for p in needed}


def asked(kind, name, share):
    """What the object of this kind says, as something to compare."""
    value = getattr(served(kind), name)
    return plain(value(**arguments(value, load("panda"), share)) if inspect.ismethod(value) else value)


def plain(value):
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, Element):
        return ElementTree.tostring(value)
    if isinstance(value, ea.Robot):
        return value.source
    if isinstance(value, pin.GeometryModel):
        return [(item.name, item.placement.homogeneous.tobytes()) for item in value.geometryObjects]
    return value


def handing_over(frame, event, _argument):
    """A trace that lets the other thread run after every instruction of the library."""
    if not frame.f_code.co_filename.startswith(PACKAGE):
        return None
    frame.f_trace_opcodes = True
    if event == "opcode":
        time.sleep(0)
    return handing_over


def side_by_side(*calls, trace=handing_over):
    """What each call returns, `ROUNDS` times in a thread of its own, all at once."""
    found, gate = [[] for _ in calls], threading.Barrier(len(calls))

    def work(call, kept):
        gate.wait()
        sys.settrace(trace)
        try:
            kept.extend(call() for _ in range(ROUNDS))
        finally:
            sys.settrace(None)

    threads = [threading.Thread(target=work, args=pair) for pair in zip(calls, found, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in (ea.Robot, ea.Regressors) for name in public(kind)]
)
def test_two_threads_read_their_own_numbers(kind, name):
    """Every public method and property: bit for bit what it gives in one thread alone."""
    calls = [functools.partial(asked, kind, name, share) for share in (0.3, 0.9)]
    expected = [call() for call in calls]
    trace = (
        None if name in ("source", "document", "visual_model", "edited") else handing_over
    )  # these read files, for minutes
    for found, one in zip(side_by_side(*calls, trace=trace), expected, strict=True):
        assert len(found) == ROUNDS
        assert all(other == one for other in found)


def test_the_threads_of_these_tests_do_hand_over():
    """Working memory that is shared is found out: else the tests above say nothing."""
    shared = pin.Model(load("panda").model).createData()
    reg = ea.Regressors(load("panda"))
    reg._standard._scratch = type("Shared", (), {"own": shared})()
    robot = load("panda")
    states = [(robot.configuration(share * robot.target), np.full(7, share)) for share in (0.3, 0.9)]
    calls = [functools.partial(reg.kinetic_gradient, *state) for state in states]
    expected = [call() for call in calls]
    found = side_by_side(*calls)
    wrong = [
        not np.array_equal(other, one)
        for others, one in zip(found, expected, strict=True)
        for other in others
    ]
    assert any(wrong)


def test_two_threads_plan_with_one_shaped_controller():
    """The planner's memory too: ten references of a way, each thread on one of its own."""
    robot = load("panda")
    shaped = ea.Shaped(ea.CompositeController.for_robot(robot))
    still = np.zeros(robot.nv)

    def way(share):
        reference = ea.Reference(robot.configuration(robot.home), still, still)
        goal = ea.Reference(robot.configuration(share * robot.target), still, still)
        for _ in range(10):
            reference = shaped.follow(reference, goal, 1e-3)
        return plain(reference)

    calls = [functools.partial(way, share) for share in (0.3, 0.9)]
    expected = [call() for call in calls]
    for found, one in zip(side_by_side(*calls), expected, strict=True):
        assert all(other == one for other in found)


def test_a_thread_finds_the_same_memory_again():
    """It is made once in each thread."""
    scratch = load("panda")._scratch
    assert scratch.own is scratch.own
    seen = []
    thread = threading.Thread(target=lambda: seen.append(scratch.own))
    thread.start()
    thread.join()
    assert seen[0] is not scratch.own
