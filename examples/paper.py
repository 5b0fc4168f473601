"""The paper, whole: four controllers, two cases, every claim checked, every figure drawn.

Runs the eight simulations to the letter (explicit Euler at 5e-4 s, 10 s each) for two ways in which
the arm may carry its masses, which the paper leaves open. Prints one table
(claim of the paper | figure obtained | holds) and the conditions of the proofs, and writes the
table and the four figures.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from tqdm import tqdm

import eladapt as ea
from eladapt.files import atomic_write
from eladapt.paper.claims import claims, table
from eladapt.paper.figures import estimation_figure, motion_figure
from eladapt.paper.proofs import proof_claims

ARMS = {"uniform rods": ea.paper.UNIFORM_RODS, "points at the ends": ea.paper.POINTS_AT_THE_ENDS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    parser.add_argument("--jobs", type=int, default=2, help="simulations at a time (default: 2)")
    options = parser.parse_args()

    with ProcessPoolExecutor(options.jobs) as pool:
        pending = pool.submit(proof_claims)
        jobs = {
            pool.submit(ea.paper.run, name, case, arm=ea.paper.robot(mass), progress=False): (arm, name, case)
            for arm, mass in ARMS.items()
            for case in (1, 2)
            for name in ea.paper.NAMES
        }
        done = tqdm(as_completed(jobs), total=len(jobs), desc="simulations", unit="run")
        runs = {jobs[job]: job.result() for job in done}
        proofs = pending.result()

    found = {arm: claims({key[1:]: run for key, run in runs.items() if key[0] == arm}) for arm in ARMS}
    text = f"{table(found)}\n\n{table({'': proofs})}"
    print(f"\n{text}\n")
    with atomic_write(options.out / "paper.md") as temporary:
        temporary.write_text(text + "\n")
    first = ea.paper.controller("C1", typeset=True)
    print("The conditions of the proofs, for C1 with the paper's gains:")
    print(ea.certify(first, dt=ea.paper.STEP), end="\n\n")
    regressors = first.regressors
    for case in (1, 2):
        records = {name: runs["uniform rods", name, case] for name in ea.paper.NAMES}
        figures = {"motion": motion_figure(records), "estimation": estimation_figure(records, regressors)}
        for kind, figure in figures.items():
            path = options.out / f"paper_case{case}_{kind}.png"
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=150)
            print(f"wrote {path}")


if __name__ == "__main__":
    main()
