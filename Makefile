# bayeq: the two commands are `make demo` and `make test`. Everything is installed into $(VENV).
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: demo test lint types tests bench study examples lock clean

demo: $(VENV)/.runtime
	@mkdir -p demo
	$(BIN)/bayeq simulate duffing --seed 1 -o demo/duffing.csv
	$(BIN)/bayeq discover demo/duffing.csv --disp x --vel v --acc a --force u

test: lint types tests

lint: $(VENV)/.dev
	$(BIN)/ruff check src tests perf examples studies
	$(BIN)/ruff format --check src tests perf examples studies

types: $(VENV)/.dev
	$(BIN)/mypy

tests: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto

# Fits against their peers in one run; the table goes to perf/results.
bench: $(VENV)/.dev
	$(BIN)/python -m perf.fit_against_lstsq
	$(BIN)/python -m perf.compare

# The statistical studies behind docs/reproduction.md and the README: hours are not needed, half an hour is.
study: $(VENV)/.dev
	$(BIN)/bayeq study table2 --realisations 1000 --store study.db \
		--algorithms sindy,rvm,gibbs,vb,bma,vb-rvm,vb-greedy,sindy-std
	$(BIN)/bayeq study show study.db --format markdown > docs/tables/table2.md
	$(BIN)/bayeq study show study.db --format csv > docs/tables/table2.csv
	$(BIN)/bayeq study show study.db --table 3 --format markdown > docs/tables/table3.md
	$(BIN)/python -m studies.ablation --realisations 500 > docs/tables/ablation.csv
	$(BIN)/bayeq study table2 --realisations 1000 --smooth auto --store study_smoothed.db --algorithms vb,bma,vb-greedy
	$(BIN)/bayeq study show study_smoothed.db --format markdown > docs/tables/table2_smoothed.md
	$(BIN)/bayeq study show study_smoothed.db --format csv > docs/tables/table2_smoothed.csv
	$(BIN)/python -m studies.channels --records 5 > docs/tables/channels.csv
	$(BIN)/python -m studies.discrepancy > docs/tables/discrepancy.csv
	$(BIN)/python -m studies.coverage --smooth none > docs/tables/coverage.csv
	$(BIN)/python -m studies.coverage --records 200 > docs/tables/coverage_smoothed.csv
	$(BIN)/python -m studies.coverage --clean-states > docs/tables/coverage_clean.csv
	$(BIN)/python -m studies.calibration --folder docs/tables
	$(BIN)/python -m studies.refinement > docs/tables/refinement.csv
	$(BIN)/python -m studies.reliability --figures docs/figures > docs/tables/reliability.csv
	$(BIN)/bayeq study figures docs/figures

# The measured records behind docs/examples.md, from $BAYEQ_DATA or ../shared/data.
examples: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples

# Pin what is installed now, after an upgrade that the tests have passed.
lock: $(VENV)/.dev
	$(BIN)/python -m pip freeze --exclude-editable > constraints.txt

clean:
	rm -rf $(VENV) demo build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "bayeq needs Python 3.11 or later; set PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@ $(VENV)/.runtime
