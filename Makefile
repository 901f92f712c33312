# kickbench: `make demo` and `make test` are all a newcomer needs.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

RUNS ?= runs
DEMO_TASK := tasks/mini_home_field.yaml
DEMO_METHODS := baseline augmentation equivariant
DEMO_FOLDER := $(RUNS)/mini_home_field
DEMO_METRICS := $(DEMO_METHODS:%=$(DEMO_FOLDER)/%/seed0/metrics.json)

.DEFAULT_GOAL := help
.PHONY: help install demo test test-fast lint format schemas clean
# One training uses every core already; two at once would only slow each other and spoil the figures.
.NOTPARALLEL:

help:  ## list the targets
	@awk -F ':.*## *' '/^[a-z-]+:.*##/ { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

install: $(INSTALLED)  ## make .venv with the pinned dependencies

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

demo: $(DEMO_METRICS)  ## train and evaluate three methods on the mini home-field task
	@echo
	@$(BIN)/kickbench table $(DEMO_FOLDER)
	@echo
	@echo "Results: $(DEMO_FOLDER)/<method>/seed0/ (metrics.json, episodes.csv, progress.csv, policy.pt)"

# metrics.json is the last file of a run and is written atomically: a finished run is not run again.
$(DEMO_FOLDER)/%/seed0/metrics.json: | $(INSTALLED)
	$(BIN)/kickbench run $(DEMO_TASK) methods/mini/$*.yaml --seed 0 --out $(DEMO_FOLDER)/$*/seed0 --resume

test: $(INSTALLED)  ## every test, the trainings too
	$(BIN)/pytest

test-fast: $(INSTALLED)  ## the tests without the trainings
	$(BIN)/pytest -m 'not slow'

lint: $(INSTALLED)  ## ruff and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(INSTALLED)  ## let ruff format and fix what it can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

schemas: $(INSTALLED)  ## write the JSON Schemas that editors use
	for kind in task method robot representations reported; do \
	  $(BIN)/kickbench schema $$kind > kickbench/spec/schemas/$$kind.schema.json || exit 1; \
	done

clean:  ## remove .venv and caches; results of runs stay
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build dist
	find kickbench tests -name __pycache__ -type d -prune -exec rm -rf {} +
