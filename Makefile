# Everything a fresh machine needs is Python 3.11 or newer and make.
PYTHON ?= python3
BIN := .venv/bin
SCENARIO := ur5e_hexagon_arm
DEMO_DIR := runs/demo

export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# what Python compiles is kept: otherwise each process that a test starts compiles all that it imports
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-long kernels check docs site format lint types packages benchmark clean

help:
	@echo "make demo       install into .venv and run the reference scenario"
	@echo "make test       install into .venv with the development tools and check everything"
	@echo "make test-long  the tests that take longest, which make test leaves out"
	@echo "make kernels    compile all kernels, once; make test and make site do it first"
	@echo "make check      format, lint and types only"
	@echo "make docs       the documentation, from build/docs/index.html; what it shows is run"
	@echo "make site       the same without running its snippets; make test makes it as well"
	@echo "make format     format the code"
	@echo "make lint       ruff, and the order of the rooms"
	@echo "make types      mypy"
	@echo "make packages   wheel and sources in dist/, checked, and the wheel tried in an environment of its own"
	@echo "make benchmark  measure speed and accuracy (benchmarks/)"
	@echo "make clean      remove .venv, caches and runs"

demo: .venv/installed
	$(BIN)/cosim run $(SCENARIO) --out $(DEMO_DIR)
	@echo
	@echo "The recording is $(DEMO_DIR)/recording.rrd, its figures are in $(DEMO_DIR)/summary.json."
	@echo "Open it with:  $(BIN)/cosim view $(DEMO_DIR)"

test: check kernels
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal

# what takes longest: every week, before a release, and after a change of numbers
test-long: kernels
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal -m long

docs: kernels
	$(BIN)/python -m pytest --quiet tests/docs
	@echo "The documentation is build/docs/index.html."

# once, before the tests and the notebooks would each compile them
kernels: .venv/installed-dev
	$(BIN)/python -c 'from cosim.base.compilation import compile_modules; from tests.compiled import all_modules; compile_modules(all_modules())'

site: kernels
	$(BIN)/python -m pytest --quiet tests/docs/test_site.py
	@echo "The documentation is build/docs/index.html."

check: lint types
	$(BIN)/ruff format --check .

format: .venv/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-cache

types: .venv/installed-dev
	$(BIN)/mypy

# the wheel stands alone: it runs the reference scenario where nothing else of these sources is
packages:
	rm -rf dist build/packages
	$(PYTHON) -m venv build/packages/tools
	build/packages/tools/bin/python -m pip install --quiet build twine
	build/packages/tools/bin/python -m build --outdir dist .
	build/packages/tools/bin/python -m twine check --strict dist/*
	$(PYTHON) -m venv build/packages/empty
	build/packages/empty/bin/python -m pip install --quiet dist/*.whl
	cd build/packages && empty/bin/cosim run $(SCENARIO) --out run

benchmark: .venv/installed-dev
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

clean:
	rm -rf .venv runs build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	    || { echo "cosim needs Python 3.11 or newer; choose one: make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv .venv
	@touch $@

# --no-compile: Python compiles what is imported, which is a part of it, and keeps that
.venv/installed: .venv/created pyproject.toml
	@echo "Installing cosim into .venv; this takes a minute or two ..."
	$(BIN)/python -m pip install --quiet --no-compile --editable .
	@touch $@

.venv/installed-dev: .venv/created pyproject.toml
	@echo "Installing cosim, the development tools and Sphinx into .venv; this takes a minute or two ..."
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[dev,docs]"
	@touch $@ .venv/installed
