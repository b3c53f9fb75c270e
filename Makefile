# Everything works on a fresh clone with Python 3.11+ and make; the tools land in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP_INSTALL := $(BIN)/python -m pip --disable-pip-version-check -q install -c constraints.txt
# Most of what is installed is never imported: what is, Python compiles then. Halves the time.
PIP_INSTALL += --no-compile
# Some containers forbid Python to keep what it compiles: each command would compile all again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help fly test quick samples test-all night trials lint golden bench map-assets map-shots wheel-check bundle install-check image-check newcomer-check docs docs-reference install clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

fly: $(VENV)/.sim  ## fly the default flight in the simulator; logs/ holds what it leaves
	@$(BIN)/sim-bridge fly

# Side by side, for the type checker takes a minute and a half of one core.
test: $(VENV)/.test  ## lint, types, layers and the tests that take little time
	@$(MAKE) --no-print-directory -j2 lint quick

# Three workers on two cores: some tests wait for real time. Each takes a file at a time, those that
# fly first, so that nobody is left with a long one at the end. A worker that dies ends the run, and
# is named: a new one in its place can wait for ever. DRAW=N draws an earlier sample again.
WORKERS := -n 3 --dist loadfile --no-loadscope-reorder --max-worker-restart 0
DRAW := new
PYTEST := $(BIN)/python -m pytest $(WORKERS)
quick: $(VENV)/.test
	@$(PYTEST) -m "not night and not sample" --draw-seed $(DRAW) $(PYTEST_ARGS)

samples: $(VENV)/.test  ## longer tests, of large families a drawn sample; DRAW=N draws one again
	@$(PYTEST) -m "sample and not night" --draw-seed $(DRAW) $(PYTEST_ARGS)

test-all: $(VENV)/.night  ## all tests, none drawn, with coverage: hours
	@$(PYTEST) --cov --cov-report=term $(PYTEST_ARGS)

# Coverage doubles the tests' CPU time on Python 3.11 (measured: 22 to 25 s, 52 s with it), so it is
# a report of the night. A test that fails keeps no trial from its night.
night: $(VENV)/.night lint  ## test-all, a newcomer's clone, long trials: hours
	@failed=0; \
	$(MAKE) --no-print-directory test-all || failed=1; \
	$(BIN)/python deploy/check-newcomer || failed=1; \
	$(MAKE) --no-print-directory trials || failed=1; \
	exit $$failed
	@echo "longer still, by hand, each with --help: sim-bridge fly --seeds, day, cross;"
	@echo "sim-bridge research: campaign, table1, table2, towns, frontier, promise, avoid; its"
	@echo "bench: flight; bench-fleet, fleet-wind, rates"

# Another seed each day; SEED=N tries an earlier day's again. What broke: logs/trials/cases.
SEED := $(shell date +%Y%j)
TRIAL := $(BIN)/sim-bridge trials
# Whole days keep their store in PostgreSQL, too, where a server is installed.
STORES := $(if $(wildcard /usr/lib/postgresql/*/bin/postgres)$(shell command -v postgres),both,sqlite)
trials: $(VENV)/.sim  ## faults, lies, stalls, damaged logs, half a day of flights, days; SEED=N again
	@failed=0; \
	$(BIN)/sim-bridge faults --seeds $(SEED) --json logs/trials/faults.json || failed=1; \
	$(BIN)/sim-bridge faults --pairs 500 --seeds $(SEED) --json logs/trials/pairs.json || failed=1; \
	$(BIN)/sim-bridge faults --tight --seeds $(SEED) --json logs/trials/tight.json || failed=1; \
	$(TRIAL) fuzz --count 500 --seed $(SEED) --json logs/trials/fuzz.json || failed=1; \
	$(TRIAL) stall --seed $(SEED) --json logs/trials/stall.json || failed=1; \
	$(TRIAL) logs --minutes 60 --seed $(SEED) --json logs/trials/logs.json || failed=1; \
	$(TRIAL) days --vehicle-hours 200 --store $(STORES) --seed $(SEED) --json logs/trials/days.json || failed=1; \
	$(TRIAL) soak --seed $(SEED) --json logs/trials/soak.json || failed=1; \
	exit $$failed

lint: $(VENV)/.test
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/basedpyright --warnings
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/python deploy/check-budget
	@$(BIN)/python deploy/check-wording

golden: $(VENV)/.test  ## run BASE=COMMIT and this tree, and compare their decisions; SET=two|six|full
	@$(BIN)/python -m tests.golden --base $(BASE) --set $(or $(SET),six)

bench: $(VENV)/.test  ## speed and size of a flight; more: sim-bridge research bench --help
	@$(BIN)/sim-bridge research bench flight

map-assets: $(VENV)/.sim  ## fetch what draws base maps and the world's outline (npm registry)
	@$(BIN)/ground-station map --fetch-assets

map-shots: $(VENV)/.test  ## the documents' picture of the map: docs/img/map.png (Chromium)
	@$(BIN)/python -m tests.ground_station.web.map_shots docs/img

wheel-check:  ## build the wheel and run it outside the checkout, on every Python that is here
	@deploy/check-wheel

bundle:  ## the vehicle's install as one .tar, for a Pi without a package index: build/leeway-bundle.tar
	@python3 deploy/bundle

install-check:  ## deploy/install in a clean Debian root (needs root, debootstrap, a package index)
	@deploy/check-install

image-check:  ## build and run deploy/Containerfile on a clean Debian root (root, buildah, debootstrap)
	@deploy/check-containers

newcomer-check: $(VENV)/.test  ## README's commands in a fresh clone, the map looked at, timed
	@$(BIN)/python deploy/check-newcomer

docs: $(VENV)/.docs docs-reference  ## the site, offline, every warning an error: build/site
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

docs-reference: $(VENV)/.sim  ## generate the pages of docs/reference that git ignores
	@$(BIN)/python -m sim_bridge.research.reference

install: $(VENV)/.sim

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: $(PYTHON) is $$($(PYTHON) -V 2>&1); Leeway needs 3.11 or later: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(PIP_INSTALL) --upgrade pip  # Python 3.11's own takes twice as long to choose versions

$(VENV)/.sim: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing leeway-uas[sim,ground] into $(VENV) ..."
	@$(PIP_INSTALL) -e '.[sim,ground]'
	@touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing leeway-uas[sim,ground,test] into $(VENV) ..."
	@$(PIP_INSTALL) -e '.[sim,ground,test]'
	@$(PIP_INSTALL) --no-deps MAVProxy  # its windows' 790 MB are not needed
	@touch $@ $(VENV)/.sim

$(VENV)/.docs: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing leeway-uas[docs] into $(VENV) ..."
	@$(PIP_INSTALL) -e '.[docs]'
	@touch $@

$(VENV)/.night: $(VENV)/.test
	@$(PIP_INSTALL) -e '.[night]'
	@touch $@

clean:  ## remove the virtual environment and caches
	rm -rf $(VENV) build .pytest_cache .ruff_cache .hypothesis
