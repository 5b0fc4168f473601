"""A stress test loses no world, whatever ends it, and says of each how it went."""

import dataclasses
import errno
import functools
import json
import os
import pickle
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest
from shared import load
from worlds_to_fail import deadly, pd, raising

import eladapt as ea
from eladapt.errors import ArgumentError, StressError
from eladapt.worlds.folder import Folder
from eladapt.worlds.rows import ROW, complete, row_of, text
from eladapt.worlds.sending import rows_of
from eladapt.worlds.trials import Trials

SHORT = ea.Distributions(rest=0.2, pace=(1.0, 1.0), loaded=0.5)
NO_BAR = {"progress": False, "distributions": SHORT, "dt": 4e-3}  # a second of rollouts a test


class AtOnce(Executor):
    """Does the work when it is submitted, up to so many worlds; then it is killed."""

    def __init__(self, most: int = 10**9):
        self.left = most

    def submit(self, call, /, *arguments, **named):
        if call is rows_of:
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
        future: Future = Future()
        try:
            future.set_result(call(*arguments, **named))
        except Exception as reason:
            future.set_exception(reason)
        return future


def rows(result: ea.Stress) -> bytes:
    return np.ascontiguousarray(result.rows).tobytes()


def test_the_rows_are_the_same_bit_for_bit_whatever_the_executor(tmp_path):
    """One process after the other, threads, batches and a pool; and in the file, as numpy reads it."""
    robot, options = load("two_link"), {**NO_BAR, "controller": pd, "worlds": 6}
    one = ea.stress(robot, executor=AtOnce(), out=tmp_path / "a", **options)
    with ThreadPoolExecutor(2) as threads:
        two = ea.stress(robot, executor=threads, batch=4, out=tmp_path / "b", **options)
    three = ea.stress(robot, jobs=2, window=1, **options)
    assert rows(one) == rows(two) == rows(three)
    assert (tmp_path / "a" / "worlds.npy").read_bytes() == (tmp_path / "b" / "worlds.npy").read_bytes()
    np.testing.assert_array_equal(np.load(tmp_path / "a" / "worlds.npy")["seed"], np.arange(6))
    assert complete(one.rows).all()


def test_after_a_kill_the_same_call_goes_on_and_more_worlds_are_added(tmp_path):
    robot, out = load("two_link"), tmp_path / "out"
    whole = ea.stress(robot, pd, 5, executor=AtOnce(), **NO_BAR)
    with pytest.raises(KeyboardInterrupt):
        ea.stress(robot, pd, 3, executor=AtOnce(2), window=1, out=out, **NO_BAR)
    with pytest.raises(KeyboardInterrupt):  # 2 are there, so 1 more is done
        ea.stress(robot, pd, 5, executor=AtOnce(1), window=1, out=out, **NO_BAR)
    assert complete(np.load(out / "worlds.npy")).tolist() == [True] * 3 + [False] * 2
    again = ea.stress(robot, pd, 5, executor=AtOnce(2), out=out, **NO_BAR)
    assert rows(again) == rows(whole)
    assert rows(ea.stress(robot, pd, 5, executor=AtOnce(0), out=out, **NO_BAR)) == rows(whole)  # all there


def test_a_row_that_a_kill_cut_short_is_not_there():
    robot = load("two_link")
    row = Trials(robot, pd, SHORT).row(0)
    torn = np.frombuffer(row.tobytes()[:300] + bytes(ROW.itemsize - 300), dtype=ROW)
    assert complete(np.array([row, np.zeros((), ROW), torn[0]])).tolist() == [True, False, False]


def test_worlds_that_raise_or_diverge_are_rows_with_the_cause_by_name():
    """And the rest goes on."""
    result = ea.stress(load("two_link"), raising, 12, executor=AtOnce(), **NO_BAR)
    assert complete(result.rows).all()
    assert result.causes["raised RuntimeError"] >= 1
    assert result.causes["diverged"] >= 1
    failure = next(one for one in result.failures() if one.cause == "raised RuntimeError")
    assert "the first joint is at more than 1 rad" in failure.said
    assert np.isfinite(result.rows["distance"]).all()  # the worlds are described all the same


def test_a_world_that_kills_its_process_takes_no_other_with_it():
    """In a pool of the test's own, which is made anew; told.delay says in which worlds."""
    robot, options = load("two_link"), {**NO_BAR, "worlds": 8, "jobs": 2}
    result = ea.stress(robot, deadly, **options)
    died = np.array([result.world(seed).told.delay > 1.5e-3 for seed in range(8)])
    assert 0 < died.sum() < 8
    assert (result.rows["cause"] == b"process died").tolist() == died.tolist()
    alive = ea.stress(robot, pd, executor=AtOnce(), **NO_BAR, worlds=8)
    assert np.array_equal(result.rows[~died].tobytes(), alive.rows[~died].tobytes())


def test_an_executor_that_does_not_work_is_told_and_blames_no_world(tmp_path):
    """One that was shut down, and one that is by the time that a world is tried alone."""
    robot, out = load("two_link"), tmp_path / "out"
    with ThreadPoolExecutor(1) as closed:
        pass
    with pytest.raises(StressError, match=r"does not simulate worlds.*after shutdown"):
        ea.stress(robot, pd, 2, executor=closed, out=out, **NO_BAR)

    class Lost(AtOnce):
        gone = False

        def submit(self, call, /, *arguments, **named):
            self.gone = self.gone or call is rows_of
            return super().submit(os.strerror if self.gone else call, *arguments, **named)

    with pytest.raises(StressError, match="does not simulate worlds"):
        ea.stress(robot, pd, 2, executor=Lost(), out=out, **NO_BAR)
    assert not complete(np.load(out / "worlds.npy")).any()


def test_a_full_disk_is_told_by_name_and_what_is_there_stays(tmp_path, monkeypatch):
    robot, out = load("two_link"), tmp_path / "out"
    with monkeypatch.context() as patched:
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def refuse(*_):
            raise full

        patched.setattr(os, "posix_fallocate", refuse)
        with pytest.raises(StressError, match="No space left on device"):
            ea.stress(robot, pd, 2, executor=AtOnce(), out=out, **NO_BAR)
        assert not (out / "worlds.npy").exists()
    first = ea.stress(robot, pd, 1, executor=AtOnce(), out=out, **NO_BAR)
    before = rows(first)
    monkeypatch.setattr(os, "pwrite", refuse)
    with pytest.raises(StressError, match="No space left on device; the worlds that are done are kept"):
        ea.stress(robot, pd, 2, executor=AtOnce(), out=out, **NO_BAR)
    assert np.load(out / "worlds.npy")[:1].tobytes() == before


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"seed": 1}, "seed: 0 there, 1 now"),
        ({"controller": raising}, "controller: worlds_to_fail.pd there, worlds_to_fail.raising now"),
        ({"distributions": ea.Distributions(tilt=0.1)}, "distributions.tilt: 0.0175 there, 0.1 now"),
        ({"criteria": ea.Criteria(tracking=1.0)}, "criteria.tracking: 0.1 there, 1 now"),
        ({"dt": 2e-3}, "dt: 0.004 there, 0.002 now"),
        ({"robot": "panda"}, "robot.model.armature"),
    ],
)
def test_a_folder_of_another_configuration_is_refused_and_stays(tmp_path, changed, said):
    given = {
        "robot": "two_link",
        "controller": pd,
        "worlds": 1,
        "executor": AtOnce(),
        "out": tmp_path / "out",
    }
    ea.stress(**{**given, **NO_BAR, "robot": load("two_link")})
    before = (tmp_path / "out" / "worlds.npy").read_bytes()
    with pytest.raises(StressError, match=said):
        ea.stress(**{**given, **NO_BAR, **changed, "robot": load(changed.get("robot", "two_link"))})
    assert (tmp_path / "out" / "worlds.npy").read_bytes() == before


def test_a_folder_of_something_else_or_in_use_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("...")
    with pytest.raises(StressError, match=r"it has thesis\.tex"):
        ea.stress(load("two_link"), pd, 1, executor=AtOnce(), out=tmp_path, **NO_BAR)

    class Meanwhile(AtOnce):
        def submit(self, call, /, *arguments, **named):
            with pytest.raises(StressError, match="another stress test is writing to it"):
                ea.stress(load("two_link"), pd, 1, executor=AtOnce(), out=tmp_path / "out", **NO_BAR)
            return super().submit(call, *arguments, **named)

    ea.stress(load("two_link"), pd, 1, executor=Meanwhile(), out=tmp_path / "out", **NO_BAR)
    with pytest.raises(StressError, match=r"thesis\.tex: is a file; expected a folder"):
        ea.stress(load("two_link"), pd, 1, executor=AtOnce(), out=tmp_path / "thesis.tex", **NO_BAR)


def test_of_two_that_begin_at_once_one_gets_the_folder(tmp_path, monkeypatch):
    """The second comes when the first has looked at the new folder and not yet written to it."""
    settings, other, dumped = {"seed": "0"}, {"seed": "1"}, []
    plain = json.dumps

    def meanwhile(*given, **options):
        monkeypatch.setattr(json, "dumps", plain)
        with pytest.raises(StressError, match="another stress test is writing to it"):
            Folder(tmp_path, other, 1)
        dumped.append(True)
        return plain(*given, **options)

    monkeypatch.setattr(json, "dumps", meanwhile)
    folder = Folder(tmp_path, settings, 1)
    folder.close()
    assert dumped
    assert json.loads((tmp_path / "configuration.json").read_text()) == settings


def test_a_configuration_that_a_kill_left_empty_is_that_of_a_new_folder(tmp_path):
    (tmp_path / "configuration.json").touch()
    Folder(tmp_path, {"seed": "0"}, 1).close()
    assert json.loads((tmp_path / "configuration.json").read_text()) == {"seed": "0"}


def test_a_replay_is_what_its_row_says():
    """The same world, bit for bit: its steady error and its largest speed."""
    result = ea.stress(load("two_link"), pd, 2, executor=AtOnce(), seed=3, **NO_BAR)
    seed = int(result.rows["seed"][1])
    assert seed == 3 * 10**8 + 1
    record = result.replay(seed)
    last = record.t > record.t[-1] - 0.5
    assert np.abs(record.error[last]).max() == result.rows["steady"][1]
    assert np.isnan(result.rows["torque"]).all()  # a part of limits that this arm does not have
    for wrong in (1, seed + 0.5):
        with pytest.raises(ArgumentError, match="seed: expected one of a world, 300000000 to 300000001, got"):
            result.replay(wrong)


INF = float("inf")
ALONE = ea.Criteria(within=INF, tracking=INF, overshoot=INF, speed=INF, beyond=INF)  # but for one demand


@pytest.mark.parametrize(
    ("demand", "cause"), [("within", "not settled"), ("tracking", "not tracking"), ("overshoot", "overshoot")]
)
def test_the_joint_that_fails_is_named(demand, cause):
    """By the record: the last that comes to rest, the furthest off, the furthest past its goal."""
    strict = dataclasses.replace(ALONE, settled=2e-3, **{demand: 0.0})
    trials, named = Trials(load("two_link"), pd, SHORT, strict, dt=4e-3), set()
    for seed in range(8):
        row = trials.row(seed)
        if row["good"]:
            continue
        record, motion = trials.record(seed), trials.world(seed).motion(trials.robot)
        error = np.abs(record.error)
        outside = np.flatnonzero((error > 2e-3).any(axis=1))
        past = (record.q - motion.end) * np.sign(motion.end - motion.q0)
        figures = {
            "within": error[outside[-1]], "tracking": error[record.t <= motion.duration].max(axis=0),
            "overshoot": past[::5].max(axis=0),
        }  # fmt: skip
        joint = int(np.argmax(figures[demand]))
        assert text(row["cause"][()]) == cause
        assert row["joint"] == joint
        assert text(row["said"][()]).endswith(trials.robot.joint_names[joint])
        named.add(joint)
    assert named == {0, 1}


def test_only_so_many_worlds_are_on_their_way_at_once():
    """So that memory does not grow with their number."""
    most = 0

    class Counting(ThreadPoolExecutor):
        def submit(self, *arguments, **named):
            nonlocal most
            future = super().submit(*arguments, **named)
            most = max(most, self._work_queue.qsize())
            return future

    with Counting(1) as executor:
        ea.stress(load("two_link"), pd, 8, executor=executor, window=2, **NO_BAR)
    assert most <= 2


def made(good: np.ndarray, **columns: np.ndarray) -> np.ndarray:
    """Rows with these columns."""
    kinds = {True: {"cause": ""}, False: {"cause": "not settled", "said": "late"}}
    return np.array(
        [
            row_of({"seed": k, "good": one, **kinds[bool(one)], **{n: v[k] for n, v in columns.items()}})
            for k, one in enumerate(good)
        ]
    )


def test_the_factor_that_makes_worlds_fail_is_named_first(tmp_path):
    """Failures are where the load is above a bound; of pure chance nothing is said."""
    rng = np.random.default_rng(0)
    load_there, chance = rng.uniform(0, 2, 400), rng.uniform(0, 1, 400)
    result = ea.Stress(Trials(load("two_link"), pd, SHORT), tmp_path, 0, 400)
    result.__dict__["rows"] = made(load_there < 1.8, load=load_there, coulomb=chance)
    assert [(one.factor, one.larger) for one in result.explanations] == [("load", True)]
    assert result.explanations[0].strength == 1  # it tells every failure
    summary = result.summary()
    bad = int((load_there >= 1.8).sum())
    assert f"{400 - bad} of 400 good" in summary
    assert f"{bad} not settled" in summary
    assert "more load [kg]" in summary
    assert all("load [kg]" in failure.likely for failure in result.failures())


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"worlds": 0}, "worlds: expected a whole number from 1"),
        ({"worlds": 1.5}, "worlds: expected a whole number"),
        ({"seed": -1}, "seed: expected a whole number from 0"),
        ({"controller": lambda robot, told, dt: None}, "must stand at the top of a module"),
        ({"controller": 3}, "controller: expected one with init and step, or a function"),
        ({"controller": functools.partial(pd)}, "controller: expected one with init and step, or a function"),
        ({"distributions": {"tilt": 1}}, "distributions: expected Distributions"),
        ({"robot": "panda"}, "robot: expected a Robot"),
        ({"dt": 0}, "dt: expected a finite number"),
    ],
)
def test_bad_arguments_are_told_before_anything_runs(given, said):
    with pytest.raises(ArgumentError, match=said):
        ea.stress(**{"robot": load("two_link"), "executor": AtOnce(0), **given})


def test_results_can_be_pickled(tmp_path):
    """As a notebook or another process wants them; a world is the same there."""
    result = ea.stress(load("two_link"), pd, 2, executor=AtOnce(), out=tmp_path / "out", **NO_BAR)
    again = pickle.loads(pickle.dumps(result))
    assert rows(again) == rows(result)
    assert again.world(1) == result.world(1)


@pytest.mark.slow
def test_the_careful_controller_is_good_in_its_first_worlds():
    """Panda, default distributions: what the benchmark measures over more."""
    result = ea.stress(load("panda"), worlds=3, executor=AtOnce(), progress=False)
    assert result.good.all(), result.summary()
    assert np.all(result.rows["tracking"] < 0.05)
