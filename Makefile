# kickbench: `make demo` and `make test` are all a newcomer needs.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
RUNTIME := $(VENV)/.runtime

.DEFAULT_GOAL := help
.PHONY: help install demo test test-all faults lint format schemas clean

help:  ## list the targets
	@awk -F ':.*## *' '/^[a-z-]+:.*##/ { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

install: $(INSTALLED)  ## make .venv with the pinned dependencies, those of the tests too

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(RUNTIME)

$(RUNTIME): pyproject.toml constraints.txt
	@echo "installing kickbench into $(VENV) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[report,view]'
	@touch $@

demo: $(RUNTIME)  ## train three methods on the mini home-field task; table, page and film
	@$(BIN)/kickbench demo

test: $(INSTALLED)  ## the tests, on all cores; without those that train or measure again
	$(BIN)/pytest -m 'not slow' -n auto --dist loadfile

test-all: test  ## these, the seeded faults, and then the trainings, recorded policies, mujoco_warp
	$(BIN)/python tests/faults/run.py --tested
	$(BIN)/pytest -m 'slow and not ray_all' -n auto --dist loadfile

faults: $(INSTALLED)  ## put each bug of tests/faults into a copy: the tests must catch it
	$(BIN)/python tests/faults/run.py

lint: $(INSTALLED)  ## ruff and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(INSTALLED)  ## let ruff format and fix what it can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

schemas: $(INSTALLED)  ## write the JSON Schemas with which editors complete and check YAML
	mkdir -p kickbench/config/schemas
	for kind in task method robot representations reported; do \
	  $(BIN)/kickbench schema $$kind > kickbench/config/schemas/$$kind.schema.json || exit 1; \
	done

clean:  ## remove .venv and caches; results of runs stay
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build dist
	find kickbench tests -name __pycache__ -type d -prune -exec rm -rf {} +
