"""Every example runs headless as a user would run it, and leaves what it says it leaves."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
LEAVES = {
    "panda": ("panda.png", "panda.html", "panda.npz"),
    "two_link": ("two_link.png", "two_link.html", "two_link_C1.npz", "two_link_C2.npz"),
    "paper": ("paper.md", *(f"paper_case{c}_{k}.png" for c in (1, 2) for k in ("motion", "estimation"))),
}


def run(name: str, *arguments: str) -> subprocess.CompletedProcess:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEAVES)
def test_example_leaves_its_files(name, tmp_path):
    done = run(name, "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    for file in LEAVES[name]:
        assert (tmp_path / file).stat().st_size > 1000 or file.endswith(".md")


def test_every_example_is_tested_and_helps():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    assert names == set(LEAVES)
    for name in names:
        done = run(name, "--help")
        assert done.returncode == 0
        assert "usage:" in done.stdout
