# Everything sets itself up in .venv; `make PYTHON=/path/to/python3 ...` chooses the interpreter.
.DEFAULT_GOAL := help
SHELL := /bin/bash

PYTHON ?=
VENV := .venv
export VENV
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT := out
JOBS ?= 2
PYTEST ?=
# A Python that runs from elsewhere must not shadow the environment.
unexport PYTHONPATH PYTHONHOME

.PHONY: help setup demo test test-all lint format docs wheel blender release bench clean

help:
	@echo 'make demo    decompose the sample that ships with the package: out/'
	@echo 'make test    run the tests              (PYTEST="-k rigid" passes options on)'
	@echo 'make test-all  all of them: pages, browser, Blender, benchmarks, the highest effort, too'
	@echo 'make lint    ruff, its format, mypy'
	@echo 'make docs    check the links and run the snippets of README and docs, build out/docs'
	@echo 'make wheel   build dist/ and try ssdr in a new environment without a compiler'
	@echo 'make release the same, and garmentnet beside it (PYTHONS="python3.12 ..." tries more of them)'
	@echo 'make blender build the Blender extension with the tool of Blender itself: dist/'
	@echo 'make bench   40 minutes of two idle cores: tables and charts of the benchmarks (ANEW=1 starts over;'
	@echo '             SOLVER=mine.py ONLY=samba-20 has a solver of your own race, into out/bench/)'
	@echo 'make clean   remove what the others made'

setup: $(READY)

$(READY): pyproject.toml garmentnet/pyproject.toml .ci/constraints.txt .ci/setup.sh
	@PYTHON="$(PYTHON)" .ci/setup.sh

demo: $(READY)
	@OUT="$(OUT)" .ci/demo.sh

# Compiles the kernels, which each process of the tests would otherwise do for itself.
KERNELS := $(BIN)/python -c 'import numpy, ssdr; ssdr.decompose(numpy.eye(9).reshape(3, 9, 3), bones=2, effort="fast")'

test: $(READY)
	@$(KERNELS)
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -q -m 'not slow' $(PYTEST)

# SSDR_EXACT_DOCS= allows the figures of the pages to differ, as on another processor.
test-all: $(READY)
	@$(KERNELS)
	SSDR_EXACT_DOCS="$${SSDR_EXACT_DOCS-1}" $(BIN)/python -m pytest -n $(JOBS) --dist worksteal -q $(PYTEST)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.docs
	SSDR_EXACT_DOCS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal -q tests/ssdr/test_docs.py
	rm -rf $(OUT)/docs
	$(BIN)/python -m sphinx -q -E -W --keep-going -b html -c docs -d $(OUT)/docs-cache . $(OUT)/docs
	@echo 'The site: $(OUT)/docs/index.html'

$(VENV)/.docs: $(READY)
	@$(BIN)/python -m pip install -q --disable-pip-version-check -c .ci/constraints.txt -e ".[docs]"
	@touch $@

wheel: $(READY)
	@GARMENTNET=0 .ci/release.sh

blender: $(READY)
	@$(BIN)/python .ci/extension.py dist

release: $(READY)
	@.ci/release.sh

# Goes on where it was stopped.
bench: $(VENV)/.bench
	$(BIN)/python benchmarks/bench.py $(if $(ANEW),--anew) $(if $(ONLY),--only $(ONLY)) $(if $(SOLVER),--solver $(SOLVER))

$(VENV)/.bench: $(READY)
	@$(BIN)/python -m pip install -q --disable-pip-version-check -c .ci/constraints.txt -e ".[bench]"
	@touch $@

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info garmentnet/build garmentnet/*.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find ssdr tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
