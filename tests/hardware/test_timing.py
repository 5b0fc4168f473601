"""A fixed rate: what is late is counted, the robot's clock leads, and the process is as before afterwards."""

import gc
import os
import re
import time
from pathlib import Path

import pytest
from looped import DT, Simulated, made

import eladapt as ea
from eladapt.errors import HardwareError
from eladapt.hardware.timing import Pacer, undisturbed


def test_garbage_collection_is_as_before():
    assert gc.isenabled()
    with undisturbed():
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(HardwareError, match="priority: 1000 was refused"), undisturbed(priority=1000):
        pass
    assert gc.isenabled()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads are not bound to processors here")
def test_a_loop_keeps_to_its_processors_and_leaves_them_as_they_were():
    """While it runs, and no longer; processors that are not there are said before anything moves."""
    _, controller, plant, goal = made()
    before = os.sched_getaffinity(0)
    one = max(before)
    seen = set()

    class Seeing(Simulated):
        def write(self, tau):
            seen.update(os.sched_getaffinity(0))
            super().write(tau)

    ea.run_loop(controller, Seeing(plant), goal, 0.1, DT, cpus=[one])
    assert seen == {one}
    assert os.sched_getaffinity(0) == before
    interface = Seeing(plant)
    for cpus, said in (([4096], r"got \[4096\]"), ([], r"got \[\]"), (["a"], "numbers out of .*'a'")):
        with pytest.raises(HardwareError, match=f"cpus: expected .*{said}"):
            ea.run_loop(controller, interface, goal, 0.1, DT, cpus=cpus)
    assert interface.calls == []
    assert os.sched_getaffinity(0) == before


def permitted() -> bool:
    """Whether real-time priority is."""
    try:
        with undisturbed(priority=1):
            return True
    except HardwareError:
        return False


@pytest.mark.skipif(not permitted(), reason="real-time priority is not permitted here")
def test_real_time_priority_lasts_as_long_as_the_loop():
    """And what is in memory stays there meanwhile, where that is permitted."""
    before = locked_memory()
    with undisturbed(priority=3):
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        assert os.sched_getparam(0).sched_priority == 3
        if os.geteuid() == 0:
            assert locked_memory() > before
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert locked_memory() == before


def locked_memory() -> int:
    """[kB] of this process that stay in memory."""
    return int(re.search(r"VmLck:\s+(\d+)", Path("/proc/self/status").read_text())[1])


def test_the_pacer_counts_what_is_late_and_does_not_catch_up():
    """A tick of 3.5 periods is one overrun and two or more ticks missed; the next is not hurried."""
    pacer = Pacer(0.02)
    pacer.restart()
    for k in range(6):
        pacer.began(0.0)
        if k == 2:
            time.sleep(0.07)
        pacer.wait()
    timing = pacer.timing()
    assert timing.ticks == 6
    assert timing.overruns >= 1
    assert timing.missed >= 2
    assert timing.work[3] >= 0.07
    assert "1 overruns (16.67%)" in str(timing) or timing.overruns > 1
    assert sum(timing.work_counts) == sum(timing.late_counts) == timing.ticks
    assert timing.work_counts[-1] >= 1, "above the last edge, 5 ms"
    assert timing.late_counts[-1] < timing.ticks


def test_a_robot_that_keeps_the_clock_is_the_only_one_that_is_waited_for():
    """Its cycles are twice as long as the loop's period: as many ticks as there are cycles, none late."""
    _, controller, plant, goal = made()

    class Slow(Simulated):
        keeps_clock = True

        def read(self):
            time.sleep(2 * DT)
            return super().read()

    result = ea.run_loop(controller, Slow(plant), goal, 50 * DT, DT)
    assert result.timing.ticks == 50
    assert result.timing.missed == 0
    assert result.timing.late == (0, 0, 0, 0)


def test_what_is_missed_of_a_robot_that_keeps_the_clock_its_time_stamps_say():
    """Every tenth cycle goes unread; a controller that is slower than the cycles of a simulated clock misses
    none of them."""
    _, controller, plant, goal = made()

    class Lossy(Simulated):
        keeps_clock = True
        lost = 0

        def write(self, tau):
            super().write(tau)
            time.sleep(2 * DT)
            if self.lost and self.calls.count("write") % self.lost == 0:
                super().write(tau)

    result = ea.run_loop(controller, Lossy(plant), goal, 50 * DT, DT)
    assert (result.timing.ticks, result.timing.missed, result.timing.overruns) == (50, 0, 50)
    lossy = Lossy(plant)
    lossy.lost = 10
    result = ea.run_loop(controller, lossy, goal, 50 * DT, DT)
    assert result.timing.missed in (4, 5)
    assert result.timing.ticks + result.timing.missed == 50
    assert result.record.t[-1] - result.record.t[0] == pytest.approx(49 * DT)
