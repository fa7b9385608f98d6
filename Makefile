# make demo    replays, a first training run and their figures, under runs/demo/
# make test    the test suite (without the slow ones)
# Both set up .venv first where that has not been done. make ray-demo and make ray-test are the same for training on
# Ray, in .venv-ray. `make help` lists the rest.

PYTHON ?= python3
PYTEST_ARGS ?=
# processes that share the tests of a run, one for each core: half of them each, and who is done takes from the other
WORKERS ?= auto
PARALLEL := -n $(WORKERS) --dist worksteal

SHELL := /bin/bash
VENV  := .venv
PY    := $(VENV)/bin/python
READY := $(VENV)/.ready
READY_BENCH := $(VENV)/.ready-bench
READY_FMI := $(VENV)/.ready-fmi
READY_MUJOCO := $(VENV)/.ready-mujoco
READY_DOCS := $(VENV)/.ready-docs
# Ray has an environment of its own: RLlib takes one version of Gymnasium, which need not be the newest
VENV_RAY  := .venv-ray
PY_RAY    := $(VENV_RAY)/bin/python
READY_RAY := $(VENV_RAY)/.ready
PIP_INSTALL := $(PY) -m pip install --disable-pip-version-check --quiet -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help setup setup-bench setup-fmi setup-mujoco setup-ray demo ray-demo ray-test test test-slow test-browser test-notebooks test-fmi test-versions release-check lint format types bits bits-record architecture docs build clean distclean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 15

# ------------------------------------------------------------------ set-up
# $(call MADE,FOLDER): the virtual environment in FOLDER is there, with pip
define MADE
@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
  echo "flexarm_env needs Python 3.11 or newer; '$(PYTHON)' is: $$($(PYTHON) --version 2>&1)." \
       "Say which to use: make $(or $(MAKECMDGOALS),setup) PYTHON=python3.12" >&2; exit 1; }
@if [ ! -x $(1)/bin/python ] || ! $(1)/bin/python -m pip --version >/dev/null 2>&1; then \
  echo "Setting up $(1) (a few minutes, once)"; \
  $(PYTHON) -m venv --clear $(1) || { \
    echo "Could not make $(1): the venv module of '$(PYTHON)' is missing or incomplete" \
         "(on Debian and Ubuntu: the package python3-venv)." >&2; exit 1; }; \
fi
endef

setup: $(READY) ## .venv with the package (editable) and all it needs to train, render, test and build its documents

$(READY): pyproject.toml constraints.txt
	$(call MADE,$(VENV))
	$(PIP_INSTALL) -e ".[train,render,plot,docs,data,export,dev]"
	@touch $@

# the site needs neither PyTorch nor Stable-Baselines3; where .venv has all, it is built there
$(READY_DOCS): pyproject.toml constraints.txt
	$(call MADE,$(VENV))
	$(PIP_INSTALL) -e ".[docs]"
	@touch $@

setup-mujoco: $(READY_MUJOCO) ## in addition, MuJoCo, which reads URDF and MJCF; without it its tests are skipped

$(READY_MUJOCO): $(READY)
	$(PIP_INSTALL) -e ".[mujoco]"
	@touch $@

setup-fmi: $(READY_FMI) ## in addition, FMPy, which validates functional mock-up units

$(READY_FMI): $(READY)
	$(PIP_INSTALL) -e ".[fmi]"
	@touch $@

setup-bench: $(READY_BENCH) ## in addition, the programs that the benchmarks compare with

$(READY_BENCH): $(READY)
	$(PIP_INSTALL) -e ".[bench]"
	@touch $@

setup-ray: $(READY_RAY) ## .venv-ray with the package (editable) and Ray

$(READY_RAY): pyproject.toml constraints-ray.txt
	$(call MADE,$(VENV_RAY))
	$(PY_RAY) -m pip install --disable-pip-version-check --quiet -c constraints-ray.txt -e ".[ray]" pytest hypothesis
	@touch $@

# --------------------------------------------------------------------- use
demo: $(READY) ## replay two scenes, train a first controller; results in runs/demo/
	$(PY) -m agents.demo

ray-demo: $(READY_RAY) ## the same on Ray: train on two runners, judge; results in runs/ray-demo/
	$(PY_RAY) -m agents.ray_demo

# ------------------------------------------------------------------ checks
# pytest ends with 5 where what is asked for has no test, which is no failure here
tests_of = $(PY) -m pytest -m $(1) $(PARALLEL) $(PYTEST_ARGS) $(if $(PYTEST_ARGS),|| [ $$? -eq 5 ])

test: $(READY) ## the test suite without the slow tests; PYTEST_ARGS="-k name" narrows it
	$(call tests_of,"not slow")

test-slow: $(READY) ## the slow tests alone
	$(call tests_of,slow)

ray-test: $(READY_RAY) ## the tests of training on Ray, in .venv-ray
	$(PY_RAY) -m pytest tests/ray $(PYTEST_ARGS)

test-browser: $(READY) ## the player in a headless Chromium of the system (Debian: apt install chromium); pictures in runs/browser
	$(PY) -m pytest tests/browser $(PYTEST_ARGS)

test-notebooks: $(READY) ## the notebooks of docs/notebooks, from start to end
	$(PY) -m pytest tests/notebooks $(PYTEST_ARGS)

test-fmi: $(READY_FMI) ## functional mock-up units, validated and simulated by FMPy
	$(PY) -m pytest tests/fmi $(PYTEST_ARGS)

test-versions: $(READY) ## the oldest and newest releases that pyproject.toml allows, in .venv-versions: smoke and bits
	$(PY) -m tests.versions

release-check: $(READY) ## wheel and source distribution, looked at, installed alone, used: the table of what was tried
	$(PY) -m tests.release

lint: $(READY) ## ruff: rules and format of imports
	$(PY) -m ruff check .

format: $(READY) ## let ruff mend what it can
	$(PY) -m ruff check --fix .

types: $(READY) ## mypy, strict
	$(PY) -m mypy

bits: $(READY) ## some cases of benchmarks.bits, to the last bit, against their record (other machines: the commit before)
	$(PY) -m benchmarks.bits_gate

bits-record: $(READY) ## the record anew, for a commit that changes numbers on purpose
	$(PY) -m benchmarks.bits_gate --write

architecture: $(READY) ## which room may import which
	$(PY) -m pytest tests/test_architecture.py

docs: $(or $(wildcard $(READY)),$(READY_DOCS)) ## the documentation site, in docs/_build/html; a warning is an error
	$(PY) -m sphinx -W --keep-going -b html docs docs/_build/html

build: $(READY) ## wheel and source distribution, in dist/
	$(PY) -m build --no-isolation

# ---------------------------------------------------------------- clean up
clean: ## remove caches and builds; leave the environments and runs/
	rm -rf build dist docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -path ./$(VENV) -prune -o -path ./$(VENV_RAY) -prune -o -path ./.venv-versions -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## remove .venv, .venv-ray, .venv-versions and runs/ too
	rm -rf $(VENV) $(VENV_RAY) .venv-versions runs
