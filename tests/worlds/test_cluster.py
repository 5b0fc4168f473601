"""dask.distributed: a real scheduler and two worker processes on loopback, one of them killed."""

import os
import signal

import numpy as np
import pytest
from shared import load
from test_stress import NO_BAR, AtOnce, rows
from worlds_to_fail import slow

import eladapt as ea
from eladapt.cli import main

distributed = pytest.importorskip("distributed")


@pytest.fixture
def cluster(monkeypatch):
    """A scheduler and two workers in processes of their own, which find this folder's modules."""
    folders = [os.path.dirname(__file__), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(folders))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        yield cluster


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(cluster):
    """The rows are those of one process, bit for bit."""
    robot, options = load("two_link"), {**NO_BAR, "controller": slow, "worlds": 12}
    with distributed.Client(cluster) as client:
        pids = list(client.run(os.getpid).values())

        class Killing(type(client.get_executor())):
            sent = 0

            def submit(self, *arguments, **named):
                self.sent += 1
                if self.sent == 7:
                    os.kill(pids[0], signal.SIGKILL)
                return super().submit(*arguments, **named)

        result = ea.stress(robot, executor=Killing(client), window=4, **options)
        assert pids[0] not in client.run(os.getpid).values()
    alone = ea.stress(robot, executor=AtOnce(), **options)
    assert rows(result) == rows(alone)


@pytest.mark.slow
def test_the_command_takes_a_cluster(cluster, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["stress", "two_link", "--worlds", "2", "--out", str(out), "--batch", "2"]
    assert main([*command, "--cluster", cluster.scheduler_address]) in (0, 3)
    assert "of 2 good" in capsys.readouterr().out
    assert np.load(out / "worlds.npy")["seed"].tolist() == [0, 1]
    assert main([*command, "--jobs", "1"]) in (0, 3)  # the folder is the same: nothing is left to do


def test_a_cluster_that_is_not_there_is_told(tmp_path, capsys):
    arguments = ["stress", "two_link", "--out", str(tmp_path / "out"), "--cluster", "tcp://127.0.0.1:1"]
    assert main(arguments) == 1
    assert "--cluster: no scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
