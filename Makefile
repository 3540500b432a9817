# Everything runs in .venv, which the first target that needs it creates.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: help setup setup-dev demo test lint bench model clean

help:
	@echo "make demo   run one EUMOS test of a palletised load: verdict, report, recording"
	@echo "make test   set up the tools and run every test"
	@echo "make lint   ruff, mypy and the import contract"
	@echo "make bench  error against run time, stability, engine agreement, pictures, campaigns, cost of the parts, into runs/ (two hours)"
	@echo "make model  the campaign paper, a network trained on it, and what that is worth, into classifier/models/compact (two and a half hours)"
	@echo "make clean  remove .venv and caches; runs/ stays"

setup: $(VENV)/.main

# The wheels of ROS 2 Jazzy exist for CPython 3.11 and 3.12 only.
$(VENV)/.main: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v in ((3, 11), (3, 12)) else "Python %d.%d: 3.11 or 3.12 is needed; set PYTHON=python3.11" % v)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

setup-dev: $(VENV)/.dev

$(VENV)/.dev: $(VENV)/.main
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

demo: setup
	$(BIN)/pallet-twin run eur_fields_05g

test: setup-dev
	$(BIN)/python -m pytest -n 2

lint: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

bench: setup-dev
	$(BIN)/pallet-twin accuracy --out runs/accuracy
	$(BIN)/pallet-twin stress --engine both --out runs/stress
	$(BIN)/pallet-twin agreement --out runs/agreement
	$(BIN)/pallet-twin sight --out runs/sight
	$(BIN)/pallet-twin sheet --out runs/sheet.jpg
	$(BIN)/pallet-twin scaling paper
	$(BIN)/pallet-twin parts eur_columns --set sled.level_g=0.2 --out runs/parts

# Goes on from what is in runs/. The model is the one that stands in the package.
model: setup-dev
	$(BIN)/pallet-twin campaign paper --out runs/paper || test $$? -eq 2
	$(BIN)/pallet-twin train runs/paper --out runs/compact
	$(BIN)/pallet-twin train runs/paper --split random --out runs/compact-random
	$(BIN)/pallet-twin evaluate runs/compact runs/paper --random-split runs/compact-random --redrawn 80 --baselines all --out runs/compact-evaluation
	mkdir -p classifier/models/compact
	cp runs/compact/model/* runs/compact-evaluation/metrics.json runs/compact-evaluation/model_card.md classifier/models/compact/

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache *.egg-info
