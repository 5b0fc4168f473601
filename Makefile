# Everything happens in .venv; a fresh machine needs Python 3.11 or later and make.
PYTHON ?= python3
BIN := .venv/bin
# The matrices are small: more BLAS threads than one only cost.
export OPENBLAS_NUM_THREADS = 1
export OMP_NUM_THREADS = 1

.PHONY: demo test nightly check clean

demo: .venv/installed  ## the paper's arm: table, plot and animation under out/
	$(BIN)/python examples/two_link.py

test: .venv/installed  ## all tests but the slow ones, on all cores
	$(BIN)/python -m pytest -q -n auto -m "not slow"

nightly: .venv/installed  ## 100,000 random inputs to a controller, and 20,000 ways to break an arm
	$(BIN)/python -m pytest -q -n auto --hypothesis-profile=nightly tests/test_any_input.py \
		tests/safety/test_fallback.py

check: .venv/installed  ## lint, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf .venv out

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "eladapt needs Python 3.11 or later; say which with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	touch $@
