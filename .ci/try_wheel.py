"""Tries a wheel as a user would: in a fresh environment, outside of the checkout.

    python .ci/try_wheel.py dist/eladapt-*.whl

The robots are found, the command runs, a move arrives, and mypy --strict sees the types in a user's script.
"""

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

SCRIPT = """\
import numpy as np

import eladapt as ea

robot: ea.Robot = ea.Robot.load("panda")
controller = ea.CompositeController.for_robot(robot)
plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
record: ea.Record = ea.simulate(controller, plant, robot.configuration(robot.target), duration=2.0)
left: float = float(np.abs(record.error[-1]).max())
print(f"{left:.1e} rad left")
assert left < 1e-3, left
"""
WRONG = 'import eladapt as ea\n\nea.Robot.load(7)\nea.Robot.load("panda").mass_matrix()\nea.plott\n'


def main() -> None:
    wheel = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        venv.create(folder / "env", with_pip=True)
        binaries = folder / "env" / "bin"
        python = binaries / "python"

        def run(*command: str | Path, fails: bool = False) -> str:
            print(
                "$",
                " ".join(Path(part).name if isinstance(part, Path) else part for part in command),
                flush=True,
            )
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            print((done.stdout + done.stderr).strip(), flush=True)
            if bool(done.returncode) != fails:
                sys.exit(f"error: ended with {done.returncode}")
            return done.stdout

        run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel, "mypy>=1.13")
        assert str(folder) in run(python, "-c", "import eladapt; print(eladapt.__file__)")
        assert "panda" in run(binaries / "eladapt", "robots")
        run(binaries / "eladapt", "check", "two_link")
        (folder / "script.py").write_text(SCRIPT)
        run(python, "script.py")
        run(python, "-m", "mypy", "--strict", "script.py")
        (folder / "wrong.py").write_text(WRONG)
        said = run(python, "-m", "mypy", "--strict", "wrong.py", fails=True)
        assert said.count("error:") == 3, "mypy should see three mistakes: the types are not there"


if __name__ == "__main__":
    main()
