"""Every example runs headless as a user would run it, and leaves what it says it leaves."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
LEAVES = {
    "panda": ("panda.png", "panda.html", "panda.npz"),
    "panda_payload": ("panda_payload.png", "panda_payload.html", "panda_payload.npz"),
    "two_link": ("two_link.png", "two_link.html", "two_link_C1.npz", "two_link_C2.npz"),
    "ur5_waypoints": ("ur5_waypoints.png", "ur5_waypoints.html", "ur5_waypoints.npz"),
    "kinova_continuous": ("kinova_continuous.png", "kinova_continuous.html", "kinova_continuous.npz"),
    "talos_armature": ("talos_armature.png", "talos_armature.html", "talos_armature.npz"),
    "own_urdf": ("own_two_link.png", "own_two_link.html", "own_two_link.npz"),
    "own_law": ("own_law.png", "own_law.html", "own_law.npz"),
    "hardware_loop": ("hardware_loop.png", "hardware_loop.npz", "hardware_loop_panda_state.npz"),
    "identify_panda": (
        "identify_panda.urdf",
        "identify_panda.html",
        "identify_panda.npz",
        "identify_panda.png",
    ),
    "identify_log": ("identify_log.urdf", "identify_log.html", "identify_log_motion.png"),
    "franka": ("franka.npz", "franka.html"),
    "ur": ("ur.png", "ur.npz", "ur.html"),
    "paper": ("paper.md", *(f"paper_case{c}_{k}.png" for c in (1, 2) for k in ("motion", "estimation"))),
}

TWO_LINK = str(EXAMPLES.parent / "robots" / "two_link.urdf")
ARGUMENTS = {"own_urdf": (TWO_LINK,), "identify_panda": ("--duration", "5")}
REAL_LOG = EXAMPLES.parents[1] / "shared" / "logs" / "panda_exciting.npz"


def run(name: str, *arguments: str) -> subprocess.CompletedProcess:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEAVES)
def test_example_leaves_its_files(name, tmp_path):
    done = run(name, *ARGUMENTS.get(name, ()), "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    if name == "identify_log" and not REAL_LOG.is_file():
        assert done.stdout.startswith("skipped: the log of a real Panda is not in ../shared/logs")
        return
    if name == "franka" and "ELADAPT_FRANKA_SIM_PYTHON" not in os.environ:
        assert done.stdout.startswith("skipped: give the address of a robot")
        return
    if name == "ur":
        weighed = re.search(r"the load: ([\d.]+) \+- ", done.stdout)
        assert float(weighed[1]) == pytest.approx(1.5, rel=0.03), "the load that was hung on"
        left = re.findall(r"^(?:set-points|slow move).*; (\S+) rad left$", done.stdout, re.M)
        assert len(left) == 3
        assert max(map(float, left)) < 1e-3
    for file in LEAVES[name]:
        assert (tmp_path / file).stat().st_size > 1000 or file.endswith(".md")


def test_every_example_is_tested_and_helps():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    assert names == set(LEAVES)
    for name in names:
        done = run(name, "--help")
        assert done.returncode == 0
        assert "usage:" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("no_such_arm.urdf",), "does not exist"),
        ((TWO_LINK, "--lock", "wrist"), "unknown joint 'wrist'; legal names: shoulder, elbow"),
        ((TWO_LINK, "--goal", "45", "-30"), "--goal: beyond their limits: shoulder at 45"),
        ((TWO_LINK, "--goal", "1"), "--goal: expected shape (2,), got (1,)"),
    ],
)
def test_own_urdf_says_what_is_wrong_without_a_traceback(arguments, said, tmp_path):
    done = run("own_urdf", *arguments, "--out", str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_every_example_has_a_thumbnail_of_less_than_60_kb():
    listed = (EXAMPLES / "README.md").read_text("utf-8")
    for name in LEAVES:
        picture = EXAMPLES.parent / "docs" / "thumbnails" / f"{name}.png"
        assert picture.stat().st_size < 60_000
        assert f"../docs/thumbnails/{name}.png" in listed
