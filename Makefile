# make demo: set all up and run the demo.   make test: set all up and run every test.
# make live: set all up and open the page on a recorded flight.   make docs: set all up and build the documentation.
# All make a virtual environment in .venv; PYTHON=python3.12 chooses another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Every extra, so that no test is skipped for want of one.
EXTRAS := ct,viewer,dask,ndi,gamepad,ros,docs
GL_PACKAGES := libegl1 libgl1-mesa-dri
DEV_PACKAGES := chromium dicom3tools
export PYOPENGL_PLATFORM ?= egl

.PHONY: demo live test docs check sbom setup setup-dev system system-dev clean

demo: setup
	$(BIN)/python -m ursnav_torch.demo out=ursnav_demo overwrite=true

live: setup
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[viewer]'
	$(BIN)/python -m ursnav_torch.demo live out=ursnav_demo

# Two processes, a file of tests to each in turn, those with slow tests first (tests/conftest.py). WORKERS=0 runs them in
# one, to look into a failure.
WORKERS ?= 2
# The browser draws the kidney without a graphics card and wants both cores for itself.
BROWSED := $(wildcard tests/page/test_*_browser.py)
test: check
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(addprefix --ignore=,$(BROWSED))
	$(BIN)/python -m pytest $(BROWSED)

# A site in ursnav_site/; every warning is an error.
docs: setup-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir ursnav_site
	@echo "open ursnav_site/index.html"

check: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/hadolint Containerfile
	@$(BIN)/pip-audit --skip-editable --progress-spinner off \
	  || echo "pip-audit: known holes above, or the registry was not reached; look before a release"

# What the program is made of, as CycloneDX; nothing is asked of any registry.
sbom: setup-dev
	$(BIN)/cyclonedx-py environment $(BIN)/python --output-file sbom.json

setup: system $(VENV)/.installed

setup-dev: system system-dev $(VENV)/.installed-dev

# OpenGL libraries for pyrender (rendering=pyrender): installed where that is possible, named where it is not.
system:
	@if command -v dpkg >/dev/null && ! dpkg -s $(GL_PACKAGES) >/dev/null 2>&1; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(GL_PACKAGES); \
	  else \
	    echo "rendering=pyrender needs the system packages $(GL_PACKAGES): sudo apt-get install $(GL_PACKAGES)"; \
	  fi; \
	fi

# A browser for the tests of the page, and a judge of DICOM objects (dciodvfy); without them those tests are skipped.
system-dev:
	@if command -v dpkg >/dev/null && ! { command -v chromium && command -v dciodvfy; } >/dev/null; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(DEV_PACKAGES); \
	  else \
	    echo "some tests need a browser and dciodvfy: sudo apt-get install $(DEV_PACKAGES)"; \
	  fi; \
	fi

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/.installed-dev: Makefile pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev,$(EXTRAS)]'
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) ursnav_demo ursnav_site
