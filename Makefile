# `make study` runs the main study, `make paper` the paper's figures, `make test` the tests, `make docs` the site.  Each
# target installs what it needs into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: study paper test test-full lint docs clean
study: $(VENV)/.installed
	$(BIN)/fastcoil run studies/robustness/robustness.toml -o results/robustness

paper: $(VENV)/.installed
	$(BIN)/python -m studies paper

# in parallel; tests that measure time or send signals take turns
# with the bytecode of an earlier run they are collected in a third of the time
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal

# writes the sentences of refusals and messages anew, after a rewording: review the diff of tests/sentences.tsv
.PHONY: reword
reword: export FASTCOIL_REWORD = 1
reword: test

# includes the tests that take minutes
test-full: export FASTCOIL_FULL = 1
test-full: test

# the formulas of the model without the compiler, so that Python itself checks bounds and types
.PHONY: test-scalar coverage
test-scalar: $(VENV)/.installed-test
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest tests/model -q -p no:cacheprovider

# line coverage of everything but compiled code, in build/coverage/index.html
coverage: $(VENV)/.installed-coverage
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal -q \
	  --cov=fastcoil --cov-report=term:skip-covered --cov-report=html:build/coverage

lint: $(VENV)/.installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/deptry fastcoil

# numbers and tables of the studies into the pages that quote them, parameters and presets into the type stub of Loop
.PHONY: pages
pages: $(VENV)/.installed
	$(BIN)/python docs/builder/numbers.py
	$(BIN)/python docs/builder/stub.py

# the site, build/docs/site/index.html, rebuilt from scratch so that its examples show the current behaviour; warnings
# and dead links are errors
DOCS := build/docs
docs: $(VENV)/.installed-docs
	rm -rf $(DOCS) && mkdir -p $(DOCS)/pages
	$(BIN)/python -m sphinx -W --keep-going -q -c docs -d $(DOCS)/doctrees $(DOCS)/pages $(DOCS)/site
	$(BIN)/python docs/builder/links.py $(DOCS)/site
	@echo "Open $(DOCS)/site/index.html"

# JAX has an environment of its own; where it cannot be installed, the benchmarks leave it out
JAX := .venv-jax
$(JAX)/.installed: pyproject.toml | $(BIN)/python
	@mkdir -p build && rm -rf $(JAX) && $(BIN)/python -m venv --without-pip $(JAX)
	@if $(BIN)/python -m pip --python $(JAX) install --quiet --group jax 2>build/jax.log; then touch $@; \
	else echo "JAX could not be installed, see build/jax.log: the benchmarks leave it out"; fi

# writes RESULTS.md for this machine; compares with C if there is a gcc
BENCH = $(BIN)/python -m pytest benchmarks
.PHONY: bench bench-quick
bench: $(VENV)/.installed-test $(JAX)/.installed
	$(BENCH) --benchmark-json=benchmarks/results.json
	$(BIN)/python benchmarks/report.py benchmarks/results.json > benchmarks/RESULTS.md.new
	mv benchmarks/RESULTS.md.new benchmarks/RESULTS.md

# runs every benchmark once on tiny sizes, as a test; writes nothing into the tree
bench-quick: export FASTCOIL_BENCH = quick
bench-quick: $(VENV)/.installed-test
	out=$$(mktemp -d) && trap 'rm -rf "$$out"' EXIT && \
	$(BENCH) --benchmark-columns=median --benchmark-json="$$out/results.json" && \
	$(BIN)/python benchmarks/report.py "$$out/results.json"

# compares numbers (to the last bit) and speed with another checkout: make against OTHER=../before
.PHONY: against
against: $(VENV)/.installed-test
	$(BIN)/python benchmarks/against.py $(OTHER)

clean:
	rm -rf $(VENV) results build

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "fastcoil needs Python 3.11 or newer; choose one with: make PYTHON=/path/to/python3"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group test
	@touch $@

$(VENV)/.installed-coverage: $(VENV)/.installed-test
	$(BIN)/python -m pip install --quiet --group coverage
	@touch $@

$(VENV)/.installed-lint: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group lint
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

# builds sdist and wheel into dist/ and checks what a package index would show and install
.PHONY: wheel-check
wheel-check: $(BIN)/python
	$(BIN)/python -m pip install --quiet --group wheel
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/pyroma --min=8 dist/*.tar.gz  # of 10: the project has no address and no mailbox yet

# the suite with the oldest versions that pyproject.toml allows, in a separate environment
.PHONY: test-floors
test-floors:
	$(PYTHON) -m venv .venv-floors
	.venv-floors/bin/python -m pip install --quiet uv
	.venv-floors/bin/uv pip install --quiet --python .venv-floors --resolution lowest-direct --editable . --group test
	.venv-floors/bin/python -m pytest

# the suite with the newest numpy, numba and xarray, pre-releases included, whatever pyproject.toml allows; may fail
.PHONY: test-newest
test-newest:
	$(PYTHON) -m venv .venv-newest
	.venv-newest/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	.venv-newest/bin/python -m pip install --quiet --editable . --group test
	.venv-newest/bin/python -m pip install --quiet --upgrade --pre numba numpy xarray
	.venv-newest/bin/python -m pip list | grep -iE '^(numba|numpy|xarray) '
	.venv-newest/bin/python -m pytest -n auto --maxprocesses 4 --dist worksteal
