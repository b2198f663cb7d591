# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
#
#   make venv          .venv with pinned versions and ROS 2 Jazzy, kernels compiled
#   make demo          simulate, run the node, play the bag into it, report: see demo/
#   make test          the tests of what works by day on board: five minutes, more on slow cores
#   make studies       those of the laboratory and of lamps, and what renders or damages much: as long
#   make fuzz          an hour of damaged files and messages, absurd arguments, signals
#   make lint          ruff, mypy, import-linter
#   make quick         lint, and the tests that start no nodes and render little: two minutes
#   make soak          the node for half an hour on good and bad pairs: see soak.json
#   make bench         speed against OpenCV's StereoSGBM: see bench.json
#   make rates         how many frames of SIZE=640x480 the node answers here: four minutes
#   make figures       measure accuracy and speed anew for docs/reference/figures.md: two to ten minutes
#   make test-oldest   the tests with the versions of Ubuntu 24.04 (needs Python 3.12)
#   make browser       pages in a headless browser, with axe-core (needs npm, and Chromium)
#   make docs          the site: docs/_build/html/index.html; warnings are errors
#   make links         ask other sites whether what the site links to is there
#   make package       dist/: source distribution and wheel, installed without ROS and run
#   make parameters    write config/uw_visibility.yaml anew from the schema
#   make clean         remove everything that these made
#
# PYTHON=... chooses the interpreter; without it the first of 3.12 and 3.11 that runs.
# PYTEST=... hands words to pytest; MINUTES=... is how long make soak runs, and make fuzz
# (an hour without it).

SHELL := /bin/bash
PYTHON ?=
PYTEST ?=
MINUTES ?=
VENV := .venv
VENV_OLDEST := .venv-oldest
VENV_DOCS := .venv-docs
EXTRAS := ros,report,recordings,distributed,stores,netcdf,parquet,completion,onnx,test
INTERPRETERS = $(or $(PYTHON),python3.12 python3.11 python3 python)
SOURCES := setup.py setup.cfg lab/pyproject.toml tools/make_venv

# The environment brings a ROS 2 of its own. One that is sourced in this shell
# must not be mixed into it.
unexport PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

.DEFAULT_GOAL := help
.PHONY: help venv demo test studies quick soak fuzz lint bench rates figures test-oldest docs links browser package parameters clean

help:
	@sed -n 's/^#   //p' Makefile

venv: $(VENV)/.installed

$(VENV)/.installed: constraints/constraints-newest.txt $(SOURCES)
	@tools/make_venv $(VENV) constraints/constraints-newest.txt $(EXTRAS) $(INTERPRETERS)
	$(VENV)/bin/uw_visibility warmup
	@touch $@

$(VENV_OLDEST)/.installed: constraints/constraints-ubuntu-24.04.txt $(SOURCES)
	@tools/make_venv $(VENV_OLDEST) constraints/constraints-ubuntu-24.04.txt $(EXTRAS) $(or $(PYTHON),python3.12)
	@touch $@

$(VENV_DOCS)/.installed: constraints/constraints-newest.txt constraints/constraints-docs.txt $(SOURCES)
	@tools/make_venv $(VENV_DOCS) constraints/constraints-docs.txt replay,docs $(INTERPRETERS)
	@touch $@

demo: venv
	$(VENV)/bin/uw_visibility demo -o demo --force

# Several tests at once would each compile the kernels of lamps.
$(VENV)/.lamps: $(VENV)/.installed test/lamps.yaml
	$(VENV)/bin/uw_visibility warmup --params-file test/lamps.yaml
	@touch $@

test: venv
	$(VENV)/bin/python -m pytest -m "not long and not browser" $(PYTEST)

studies: $(VENV)/.lamps
	$(VENV)/bin/python -m pytest -m long $(PYTEST)

quick: lint
	$(VENV)/bin/python -m pytest -m "not node and not long and not browser" $(PYTEST)

test-oldest: $(VENV_OLDEST)/.installed
	$(VENV_OLDEST)/bin/python -m pytest -m "not browser" $(PYTEST)

soak: venv
	$(VENV)/bin/python test/faults/soak.py --minutes $(or $(MINUTES),30) -o soak.json

# Compiled code looks whether an index is one: what would read beyond an array ends a case.
fuzz: export NUMBA_BOUNDSCHECK := 1
fuzz: venv
	$(VENV)/bin/uw_visibility warmup
	$(VENV)/bin/python test/faults/fuzz.py --minutes $(or $(MINUTES),60) --first $$RANDOM$$RANDOM

lint: venv
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

bench: venv
	$(VENV)/bin/python -m benchmarks

rates: venv
	@$(VENV)/bin/python -m benchmarks.node --table --seconds 30 --size $(or $(SIZE),640x480)

# Random views, the paper's experiments, speed; what they print goes into build/figures.
figures: MEASURED := build/figures
figures: SCENES := $(wildcard $(addprefix ../shared/data/middlebury/,art dolls moebius))
figures: venv
	mkdir -p $(MEASURED)
	git log -1 --format='commit %h of %cs' > $(MEASURED)/version
	test -d $(MEASURED)/pool || $(VENV)/bin/python -m uw_visibility_lab.worlds pool --count 60 --seed 7 -o $(MEASURED)/pool
	rm -f $(MEASURED)/judged.csv $(MEASURED)/each.csv
	$(VENV)/bin/uw_visibility judge --scenes $(MEASURED)/pool --estimator free plain sea-thru --csv $(MEASURED)/judged.csv > $(MEASURED)/judge.txt
	$(VENV)/bin/uw_visibility judge --scenes $(MEASURED)/pool --each --csv $(MEASURED)/each.csv
	$(VENV)/bin/uw_visibility evaluate --quick --force -o $(MEASURED)/experiments $(SCENES)
	$(VENV)/bin/python -m benchmarks --small --json $(MEASURED)/bench.json
	$(VENV)/bin/python tools/draw_pages figures $(MEASURED)

docs: $(VENV_DOCS)/.installed
	@echo "building the site, whose tutorials are run: some five minutes of one processor"
	$(VENV_DOCS)/bin/sphinx-build -W --keep-going -b html -d docs/_build/doctrees docs docs/_build/html
	$(VENV_DOCS)/bin/python tools/check_site docs/_build/html

# Of other sites, whose word it is whether they answer: not part of what has to pass.
links: $(VENV_DOCS)/.installed
	$(VENV_DOCS)/bin/sphinx-build -q -b linkcheck -d docs/_build/doctrees docs docs/_build/links

# axe-core is no package of Python, and a browser is not everywhere: make test does without.
browser: venv
	npm install --silent --no-save --no-package-lock axe-core
	SITE=docs/_build/html $(VENV)/bin/python -m pytest -q test/replay/report/test_browser.py test/test_site.py

package: venv
	tools/check_package $(VENV)/bin/python

parameters: venv
	$(VENV)/bin/python tools/write_parameters config/uw_visibility.yaml

clean:
	rm -rf $(VENV) $(VENV_OLDEST) $(VENV_DOCS) build install log dist demo bench.json soak.json *.egg-info node_modules
	rm -rf .pytest_cache .hypothesis .mypy_cache .ruff_cache .import_linter_cache .benchmarks
	find uw_visibility lab test benchmarks -name __pycache__ -prune -exec rm -rf {} +
