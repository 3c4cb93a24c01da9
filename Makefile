# Two commands on a fresh Debian with Python 3.11 and make:  make demo   and   make test
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo
FUZZ_MINUTES ?= 5
# Python keeps the bytecode of what it imports. To compile all that is installed takes pip as long as
# to install it.
export PYTHONDONTWRITEBYTECODE :=
INSTALL := install --quiet --disable-pip-version-check --no-compile

.DEFAULT_GOAL := help
.PHONY: help demo test lint record pictures results site bench fuzz wheel sbom audit lock clean

help: ## Show what can be made
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/.installed ## Calibrate a simulated RAVEN-II from homing to report, in $(DEMO)/
	$(BIN)/truejoint demo --out $(DEMO) --force

# A process for each core, and one thread in each: more would wait for each other.
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
# tests/conftest.py orders the files.
test: $(VENV)/.installed-dev ## Run the test suite
	$(ONE_THREAD) $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.installed-dev ## Check style, types and which package imports which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.installed-bench ## Measure accuracy and speed (hours); tables go to bench/
	$(BIN)/python -m benchmarks

fuzz: $(VENV)/.installed-dev ## Look for what breaks for FUZZ_MINUTES (5): commands, files, exported C
	$(BIN)/python -m tests.fuzz --minutes $(FUZZ_MINUTES)
	$(BIN)/python -m tests.fuzz.frames --count $$((20000 * $(FUZZ_MINUTES)))
	$(BIN)/python -m tests.fuzz.loop --count $$((100000 * $(FUZZ_MINUTES)))
	FUZZ_MINUTES=$(FUZZ_MINUTES) $(BIN)/python -m pytest -n auto tests/export/test_sanitizers.py

results: $(VENV)/.installed ## Write the page of results anew, with what studies/ and bench/ hold
	$(BIN)/python docs/results.py $(wildcard studies/*/*.json) $(wildcard bench/*.md)

record: ## Keep the overview in studies/ as the manual's record of the reproduction
	sed -E 's#<a href="([a-z-]+)/\1\.html">([^<]*)</a>#\2#' studies/index.html > docs/static/reproduction.html

pictures: demo $(VENV)/.installed-dev ## Draw the pictures of README and manual anew (Chromium, minutes)
	$(ONE_THREAD) $(BIN)/python docs/pictures/overview.py
	$(ONE_THREAD) $(BIN)/python docs/pictures/manual.py
	$(ONE_THREAD) $(BIN)/python docs/pictures/screens.py

VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
site: $(VENV)/.installed-site ## Build the manual, the gallery and the API into site/VERSION/, offline
	$(ONE_THREAD) $(BIN)/sphinx-build -W --keep-going -q -b html -d site/.doctrees docs site/$(VERSION)
	$(BIN)/python docs/versions.py site
	@echo "Open site/index.html in a browser."

FRESH := dist/venv
wheel: $(VENV)/.installed ## Build wheel and sdist, and run the first hours of the manual on the wheel alone
	rm -rf dist/*.whl dist/*.tar.gz $(FRESH)
	$(BIN)/python -m hatchling build -d dist
	$(PYTHON) -m venv $(FRESH)
	$(FRESH)/bin/pip $(INSTALL) -r requirements-dev.txt
	$(FRESH)/bin/pip $(INSTALL) --no-deps dist/*.whl
	cd $(FRESH) && bin/python -c "import truejoint as t; assert 'site-packages' in t.__file__, t.__file__"
	$(ONE_THREAD) $(FRESH)/bin/python -m pytest tests/test_first_hours.py

sbom: $(VENV)/.installed-audit ## Write the bill of materials, CycloneDX, to dist/truejoint.cdx.json
	@mkdir -p dist
	$(BIN)/cyclonedx-py requirements requirements.txt --pyproject pyproject.toml \
		--output-reproducible -o dist/truejoint.cdx.json

audit: $(VENV)/.installed-audit ## Look the pinned packages up among known vulnerabilities (online)
	$(BIN)/pip-audit --strict --disable-pip --require-hashes -r requirements.txt

COMPILE := uv pip compile --quiet --generate-hashes --no-header --no-annotate --python-version 3.11
# All extras but torch, whose builds differ from machine to machine, and xarray; tests skip without.
EXTRAS := $(foreach extra,cluster monitor onnx plots ros ros2 serial urdf,--extra $(extra))
LOCK := $(COMPILE) pyproject.toml --group build
lock: ## Pin the versions of pyproject.toml anew (needs uv; a pin that still fits stays)
	$(LOCK) --extra plots -o requirements.txt
	$(LOCK) $(EXTRAS) --group dev -o requirements-dev.txt
	$(LOCK) $(EXTRAS) --group dev --group bench -o requirements-bench.txt
	$(COMPILE) --group site -c requirements-dev.txt -o requirements-site.txt
	$(COMPILE) --group audit -c requirements-dev.txt -o requirements-audit.txt

clean: ## Remove the virtual environment and everything made
	rm -rf $(VENV) $(DEMO) bench dist site docs/api docs/gallery .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "truejoint needs Python 3.11 or newer; choose one with make PYTHON=..."; exit 2; }
	@echo "Making the virtual environment in $(VENV) ..."
	@$(PYTHON) -m venv $(VENV) \
		|| { echo "python3 cannot make environments here: install Debian's python3-venv"; exit 2; }

$(VENV)/.installed: requirements.txt pyproject.toml | $(VENV)/bin/pip
	@echo "Installing the pinned packages (about a minute) ..."
	@$(BIN)/pip $(INSTALL) -r requirements.txt
	@$(BIN)/pip $(INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.installed-dev: requirements-dev.txt $(VENV)/.installed
	@echo "Installing the pinned development packages ..."
	@$(BIN)/pip $(INSTALL) -r requirements-dev.txt
	@touch $@

$(VENV)/.installed-bench: requirements-bench.txt $(VENV)/.installed-dev
	@echo "Installing the pinned peers to compare with ..."
	@$(BIN)/pip $(INSTALL) -r requirements-bench.txt
	@touch $@

$(VENV)/.installed-site: requirements-site.txt $(VENV)/.installed-dev
	@echo "Installing the pinned site builder ..."
	@$(BIN)/pip $(INSTALL) -r requirements-site.txt
	@touch $@

$(VENV)/.installed-audit: requirements-audit.txt $(VENV)/.installed-dev
	@echo "Installing what looks at the packages ..."
	@$(BIN)/pip $(INSTALL) -r requirements-audit.txt
	@touch $@
