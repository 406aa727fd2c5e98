# `make study` runs the main study, `make paper` the paper's figures, `make test` the tests, `make docs` the site; all set
# up what they need in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: study paper test test-full lint docs clean
study: $(VENV)/.installed
	$(BIN)/fastcoil run studies/robustness.toml -o results/robustness

paper: $(VENV)/.installed
	$(BIN)/fastcoil paper -o results/paper

# on all cores, but one at a time the tests that measure time or signal processes
test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal

# also what takes minutes
test-full: export FASTCOIL_FULL = 1
test-full: test

lint: $(VENV)/.installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# the site, build/docs/site/index.html, always from the beginning: its examples show what the program does now.  Every
# warning is an error, and so is a link that leads nowhere
DOCS := build/docs
docs: $(VENV)/.installed-docs
	rm -rf $(DOCS) && mkdir -p $(DOCS)/pages
	$(BIN)/python -m sphinx -W --keep-going -q -c docs -d $(DOCS)/doctrees $(DOCS)/pages $(DOCS)/site
	$(BIN)/python docs/builder/links.py $(DOCS)/site
	@echo "Open $(DOCS)/site/index.html"

# RESULTS.md of this machine; JAX joins if it is in .venv, C if there is a gcc
BENCH = $(BIN)/python -m pytest benchmarks -q -p no:cacheprovider -o python_files='bench_*.py'
.PHONY: bench bench-quick
bench: $(VENV)/.installed-test
	$(BENCH) --benchmark-json=benchmarks/results.json
	$(BIN)/python benchmarks/report.py benchmarks/results.json > benchmarks/RESULTS.md.new
	mv benchmarks/RESULTS.md.new benchmarks/RESULTS.md

# everything once on tiny sizes, so that it cannot rot; writes nothing here
bench-quick: export FASTCOIL_BENCH = quick
bench-quick: $(VENV)/.installed-test
	out=$$(mktemp -d) && trap 'rm -rf "$$out"' EXIT && \
	$(BENCH) --benchmark-columns=median --benchmark-json="$$out/results.json" && \
	$(BIN)/python benchmarks/report.py "$$out/results.json"

# the same numbers as another checkout, and no slower?  make against OTHER=../before
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

$(VENV)/.installed-lint: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group lint
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

# the oldest versions pyproject.toml allows, in an environment of their own
.PHONY: test-floors
test-floors:
	$(PYTHON) -m venv .venv-floors
	.venv-floors/bin/python -m pip install --quiet uv
	.venv-floors/bin/uv pip install --quiet --python .venv-floors --resolution lowest-direct --editable . --group test
	.venv-floors/bin/python -m pytest
