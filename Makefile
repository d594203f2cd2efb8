# make dock     install, train scenario 3, evaluate, plot
# make test     install, then run every check that a change must pass
# make check    run the same checks in the existing environment; with MARKS= also the thorough tests, as .ci/run
# make results  write the results pages (docs/results.md, docs/results/) from the archived runs (results/)
# make docs     write the documentation as a site that opens from the disk (build/site/index.html)
# make bench    run the benchmarks against other libraries and write the page of their results (some minutes)
# make clean    remove the environment and the tools' caches; keeps runs/

PYTHON   ?= python3
VENV     ?= .venv
SCENARIO ?= scenarios/s3.yaml
MARKS    ?= not thorough

BIN := $(VENV)/bin
BENCHMARKS := $(filter-out %/bench.py %/cores.py %/figures.py %/page.py %/sections.py %/gpu.py %/optimal_control.py %/pilot.py %/planning.py %/prediction.py %/soak.py %/training.py %/update.py,$(wildcard benchmarks/*.py))
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: dock test check types tests docs results bench clean
.DEFAULT_GOAL := dock

dock: $(VENV)/.run
	$(BIN)/dockctl train $(SCENARIO)
	$(BIN)/dockctl evaluate
	$(BIN)/dockctl plot

test: $(VENV)/.dev
	$(MAKE) --no-print-directory check

check:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) --no-print-directory --jobs 2 types tests

types:
	$(BIN)/mypy
	$(BIN)/lint-imports

tests:
	$(BIN)/pytest -n 2 --dist worksteal -m "$(MARKS)"

results: $(VENV)/.run
	$(BIN)/python -m studies.thesis.build

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo build/site/index.html

bench: $(VENV)/.bench
	for script in $(BENCHMARKS); do $(BIN)/python $$script || exit 1; done
	$(BIN)/python benchmarks/page.py

clean:
	rm -rf $(VENV) build dist .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find dockctl studies tests examples -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamp files in the environment: it is rebuilt when the dependencies change.
$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	@echo "installing dockctl into $(VENV) (a few minutes the first time)"
	$(PIP) --editable .
	@$(BIN)/python -m compileall -q dockctl   # pip does not, and every start would where Python writes no bytecode
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	$(PIP) --editable '.[dev]'
	$(BIN)/python -m tests.compiling   # once, so that the tests need not
	@PYTHONDONTWRITEBYTECODE= $(BIN)/pytest --collect-only -q >/dev/null   # caches the bytecode of the tests
	@touch $@

$(VENV)/.docs: $(VENV)/.run
	$(PIP) --editable '.[docs]'
	@touch $@

$(VENV)/.bench: $(VENV)/.run
	$(PIP) --editable '.[bench]'
	@touch $@
