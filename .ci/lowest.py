"""Prints each dependency of pyproject.toml at its lower bound, one a line, as pip takes constraints.

    python .ci/lowest.py > lowest.txt && pip install -c lowest.txt -e ".[identify,motion,mujoco,report,ros]"

What only the tests, the site and single robots need is left to pip.
"""

import re
import tomllib
from pathlib import Path

EXTRAS = ("identify", "motion", "mujoco", "report", "ros")


def main() -> None:
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = [*project["dependencies"], *(d for e in EXTRAS for d in project["optional-dependencies"][e])]
    print("\n".join(re.sub(r">=", "==", requirement) for requirement in wanted))


if __name__ == "__main__":
    main()
