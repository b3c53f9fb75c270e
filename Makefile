# Everything works on a fresh clone with Python 3.11+ and make; the tools land in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q

.PHONY: help fly test lint bench wheel-check install clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

fly: $(VENV)/.sim  ## fly the default flight in the simulator; logs/ holds what it leaves
	@$(BIN)/sim-bridge fly

# Three workers on two cores: some tests wait for real time.
test: $(VENV)/.test lint  ## lint, types, layers and all tests
	@$(BIN)/python -m pytest -n 3 --dist worksteal $(PYTEST_ARGS)

lint: $(VENV)/.test
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/basedpyright --warnings
	@$(BIN)/lint-imports --no-cache

bench: $(VENV)/.test  ## speed and size of a flight; more: sim-bridge research bench --help
	@$(BIN)/sim-bridge research bench flight

wheel-check:  ## build the wheel and run it outside the checkout, on every Python that is here
	@deploy/check-wheel

install: $(VENV)/.sim

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: $(PYTHON) is $$($(PYTHON) -V 2>&1); Leeway needs 3.11 or later: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.sim: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing leeway-uas[sim,ground] into $(VENV) ..."
	@$(PIP) install -c constraints.txt -e '.[sim,ground]'
	@touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing leeway-uas[sim,ground,test] into $(VENV) ..."
	@$(PIP) install -c constraints.txt -e '.[sim,ground,test]'
	@touch $@ $(VENV)/.sim

clean:  ## remove the virtual environment and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis
