# bayeq: the two commands are `make demo` and `make test`. Everything is installed into $(VENV).
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# `make matrix`: Pythons that are tried, and tests that need nothing beside the library and pytest.
PYTHONS ?= 3.11 3.12 3.13
QUICK := tests/conformance tests/test_cli_streams.py tests/test_estimators.py tests/test_expressions.py \
	tests/test_forecast.py tests/test_gram.py tests/test_kernels.py tests/test_kinematic.py tests/test_public_api.py \
	tests/test_records_text.py tests/test_startup.py tests/test_vb.py

# What is linted; of docs the programs alone, for ruff would format the Python in pages too.
SOURCES := src tests perf examples studies docs/conf.py docs/_extensions

# Studies that write every finished record to NAME.jsonl, and go on from there when they are started again.
RECORD_STUDIES := states_only known_terms white_force coupled servo circuit adverse verdicts random_truths tracking forces band hidden maps conserved between few_samples sensitivity

.PHONY: demo test lint types kernels tests slow statistics coverage matrix bench study examples gallery site lock arviz notebooks tutorials app-pictures fuzz audit reliability clean

demo: $(VENV)/.runtime
	@mkdir -p demo
	$(BIN)/bayeq simulate duffing --seed 1 -o demo/duffing.csv
	$(BIN)/bayeq discover demo/duffing.csv --disp x --vel v --acc a --force u

# Kernels are compiled while types are checked.
test: lint
	$(MAKE) -j2 types kernels
	$(MAKE) tests

lint: $(VENV)/.dev
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)

types: $(VENV)/.dev
	$(BIN)/mypy

kernels: $(VENV)/.dev
	$(BIN)/python -W ignore -c "import bayeq as bq; record = bq.simulate('duffing', n=300); \
		[bq.discover(record, chains='x:v:a', inputs=['u'], method=name) for name in ('auto', 'gibbs', 'rvm')]"

# Every worker takes a half of the files, and what other workers have left: fixtures of a file are made once.
tests: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal

# What takes long: the page in a browser, clusters, kills and interrupts, all blocks of the documents, further cases of
# what `make tests` tries once; and all draws of hypothesis, of which `make tests` has a share.
slow: $(VENV)/.dev $(VENV)/.notebooks
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --slow -m "slow or hypothesis"

# Rates, coverage and calibration over the full number of records; `make tests` draws fewer.
statistics: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto -m statistical --ignore tests/reliability --full-statistics

# Faults at many random moments: 200 kills, which go on from kills.jsonl after a stop, and the long form of the tests.
reliability: $(VENV)/.dev
	$(BIN)/python -m studies.kills > docs/tables/reliability_kills.csv
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest tests/reliability --full-statistics

# Lines and branches that the tests run, with the page in a browser and PySINDy beside; kernels are compiled, and not counted.
coverage: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --cov --cov-report= --cov-fail-under=0
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --slow tests/test_app_browser.py tests/test_field.py \
		--cov --cov-append --cov-report=term:skip-covered --cov-report=html

# The long form of fuzzing: 1,000,000 inputs for each parser of our own, 100,000 where a library parses; some hours. It goes
# on where it was stopped (.fuzz), is guided by coverage where atheris is installed, and ends with 1 if it found something.
fuzz: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.fuzz
	$(BIN)/python -m tests.fuzz --table > docs/tables/fuzzing.csv

# Known vulnerabilities of the pinned packages; needs the network.
audit: $(VENV)/.dev
	@$(BIN)/python .ci/audit.py $(BIN)/uvx pip-audit

# The tests on other Pythons, where they can be had, and a quick part of them on the oldest dependencies: scikit-learn 1.6
# brings tests for pytest 8, and matplotlib 3.9 warns when it is imported beside pyparsing 3.3.
matrix: $(PYTHONS:%=$(VENV)/matrix/%) $(VENV)/matrix/oldest

$(VENV)/matrix/oldest: $(VENV)/.dev FORCE
	$(BIN)/uv venv --quiet --clear --python 3.11 $@
	echo 'pyparsing<3.3' | $(BIN)/uv pip compile --quiet --resolution lowest-direct --python-version 3.11 \
		--extra parquet --extra plot --extra arviz --constraint - pyproject.toml --output-file $@/constraints.txt
	$(BIN)/uv pip install --quiet --python $@ --constraint $@/constraints.txt \
		--editable '.[parquet,plot,arviz]' 'pytest<9' pytest-xdist hypothesis
	OPENBLAS_NUM_THREADS=1 $@/bin/python -m pytest -n auto $(QUICK) tests/test_arviz.py

$(VENV)/matrix/%: $(VENV)/.dev FORCE
	@if $(BIN)/uv venv --quiet --clear --python $* $@; then \
		$(BIN)/uv pip install --quiet --python $@ --constraint constraints.txt --editable '.[dev]' \
			&& OPENBLAS_NUM_THREADS=1 $@/bin/python -m pytest -n auto; \
	else echo "Python $* cannot be had here: skipped" >&2; fi

# The adapter with the oldest and the newest ArviZ 0.2x and with ArviZ 1, beside the newest of all other packages: 1 needs
# Python 3.12, and 0.20 a part of matplotlib that was removed in 3.11.
ARVIZ := 0.20 0 1
arviz: $(filter-out %/3.11-1,$(foreach python,$(PYTHONS),$(ARVIZ:%=$(VENV)/arviz/$(python)-%)))

$(VENV)/arviz/%: PYTHON_OF = $(firstword $(subst -, ,$*))
$(VENV)/arviz/%: ARVIZ_OF = $(lastword $(subst -, ,$*))
$(VENV)/arviz/%: $(VENV)/.dev FORCE
	@if $(BIN)/uv venv --quiet --clear --python $(PYTHON_OF) $@; then \
		$(BIN)/uv pip install --quiet --python $@ --editable . 'arviz==$(ARVIZ_OF).*' h5netcdf h5py pytest hypothesis \
			$(if $(filter 0.20,$(ARVIZ_OF)),'matplotlib<3.11') \
			&& $(BIN)/uv pip list --python $@ | grep -E '^(arviz|numpy|pandas|xarray) ' \
			&& OPENBLAS_NUM_THREADS=1 $@/bin/python -m pytest -q tests/test_arviz.py; \
	else echo "Python $(PYTHON_OF) cannot be had here: skipped" >&2; fi

FORCE:

# Fits against their peers in one run; the table goes to perf/results.
bench: $(VENV)/.dev
	$(BIN)/python -m perf.fit_against_lstsq
	$(BIN)/python -m perf.compare

# The statistical studies behind docs/reproduction.md and the README: an hour or two on one core.
study: $(VENV)/.dev
	$(BIN)/bayeq study table2 --realisations 1000 --store study.db \
		--algorithms sindy,rvm,gibbs,vb,bma,vb-rvm,vb-greedy,sindy-std
	$(BIN)/bayeq study show study.db --format csv > docs/tables/table2.csv
	$(BIN)/bayeq study show study.db --table 3 --format csv > docs/tables/table3.csv
	$(BIN)/python -m studies.ablation --realisations 500 > docs/tables/ablation.csv
	$(BIN)/python -m studies.channels --records 5 > docs/tables/channels.csv
	$(BIN)/python -m studies.discrepancy > docs/tables/discrepancy.csv
	$(BIN)/python -m studies.coverage --smooth none > docs/tables/coverage.csv
	$(BIN)/python -m studies.coverage --clean-states > docs/tables/coverage_clean.csv
	$(BIN)/python -m studies.calibration --folder docs/tables
	$(BIN)/python -m studies.refinement > docs/tables/refinement.csv
	$(BIN)/python -m studies.planning --records 12 > docs/tables/planning.csv
	$(BIN)/python -m studies.reliability --figures docs/figures > docs/tables/reliability.csv
	$(BIN)/bayeq study figures docs/figures
	$(BIN)/python -m studies.rest > docs/tables/rest.csv
	for name in $(RECORD_STUDIES); do $(BIN)/python -m studies.$$name > docs/tables/$$name.csv || exit 1; done
	$(BIN)/python -m studies.rules

# The measured records behind docs/examples.md, from $BAYEQ_DATA or ../shared/data.
examples: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples

# The pictures of docs/gallery.md, and the page; the picture of the pipeline.
gallery: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples.gallery
	$(BIN)/python -m examples.pipeline

# The documents as a site, build/site/index.html; a warning is an error.
site: $(VENV)/.dev
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs build/site
	@echo "open build/site/index.html"

# The notebooks of docs/notebooks, of the pages of docs/tutorials.
notebooks: $(VENV)/.notebooks
	$(BIN)/python -m examples.notebooks

# The pictures of docs/tutorials, by the code of its pages.
tutorials: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples.tutorials

# The pictures of docs/app.md, with Chromium and chromedriver.
app-pictures: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples.app_pictures

# Pin what is installed now, after an upgrade that the tests have passed.
lock: $(VENV)/.dev $(VENV)/.notebooks
	$(BIN)/python -m pip freeze --exclude-editable > constraints.txt

clean:
	rm -rf $(VENV) demo build dist .coverage* htmlcov .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "bayeq needs Python 3.11 or later; set PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.notebooks: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[notebooks]'
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@ $(VENV)/.runtime
