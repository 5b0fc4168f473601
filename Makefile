# Everything happens in .venv; a fresh machine needs Python 3.11 or later and make.
PYTHON ?= python3
BIN := .venv/bin
# The matrices are small: more BLAS threads than one only cost.
export OPENBLAS_NUM_THREADS = 1
export OMP_NUM_THREADS = 1

.PHONY: demo test nightly check docs package clean

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

docs: .venv/docs  ## the site, strictly, into site/; runs the code of every page
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

package: .venv/package  ## wheel and sdist into dist/, and the wheel tried in an environment of its own
	rm -rf dist
	$(BIN)/python -m build --quiet
	$(BIN)/twine check --strict dist/*
	$(BIN)/python .ci/try_wheel.py dist/*.whl

clean:
	rm -rf .venv out site dist

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "eladapt needs Python 3.11 or later; say which with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	touch $@

.venv/docs: .venv/installed
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	touch $@

.venv/package: .venv/installed
	$(BIN)/python -m pip install --quiet --editable ".[package]"
	touch $@
