#!/usr/bin/env bash
# The tests with every dependency at its lower bound, in an environment of its own under .venv-lowest.
set -euo pipefail
cd "$(dirname "$0")/.."
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
python3 -m venv .venv-lowest
.venv-lowest/bin/python .ci/lowest.py > .venv-lowest/constraints.txt
.venv-lowest/bin/python -m pip install --quiet -c .venv-lowest/constraints.txt -e ".[identify,motion,mujoco,report,ros]" \
    "hypothesis>=6.100" "pillow>=10.0" "playwright>=1.48" "psutil>=5.9" "pytest>=8.0" "pytest-xdist>=3.6"
.venv-lowest/bin/python -m pytest -q -n auto -m "not slow"
