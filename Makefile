# Two commands on a fresh Debian with Python 3.11 and make:  make demo   and   make test
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo

.DEFAULT_GOAL := help
.PHONY: help demo test lint bench lock clean

help: ## Show what can be made
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/.installed ## Calibrate a simulated RAVEN-II from homing to report, in $(DEMO)/
	$(BIN)/truejoint demo --out $(DEMO) --force

test: $(VENV)/.installed-dev ## Run the test suite
	$(BIN)/python -m pytest -n auto

lint: $(VENV)/.installed-dev ## Check style, types and which package imports which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.installed-bench ## Measure accuracy and speed (an hour); tables go to bench/
	$(BIN)/python -m benchmarks

LOCK := uv pip compile --quiet --generate-hashes --no-header --no-annotate --python-version 3.11 \
	pyproject.toml --group build
lock: ## Pin the versions of pyproject.toml anew (needs uv; a pin that still fits stays)
	$(LOCK) --extra plots -o requirements.txt
	$(LOCK) --all-extras --group dev -o requirements-dev.txt
	$(LOCK) --all-extras --group dev --group bench -o requirements-bench.txt

clean: ## Remove the virtual environment and everything made
	rm -rf $(VENV) $(DEMO) bench .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "truejoint needs Python 3.11 or newer; choose one with make PYTHON=..."; exit 2; }
	@echo "Making the virtual environment in $(VENV) ..."
	@$(PYTHON) -m venv $(VENV) \
		|| { echo "python3 cannot make environments here: install Debian's python3-venv"; exit 2; }

$(VENV)/.installed: requirements.txt pyproject.toml | $(VENV)/bin/pip
	@echo "Installing the pinned packages (about a minute) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.txt
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.installed-dev: requirements-dev.txt $(VENV)/.installed
	@echo "Installing the pinned development packages ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-dev.txt
	@touch $@

$(VENV)/.installed-bench: requirements-bench.txt $(VENV)/.installed-dev
	@echo "Installing the pinned peers to compare with ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-bench.txt
	@touch $@
