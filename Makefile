# feel321: every command of the house. `make help` lists them.
# The stamps in .venv are older than pyproject.toml or constraints.txt exactly when something is to be installed.

PYTHON := .venv/bin/python
# Bytecode is made when a module is first imported: of all that is installed it would take as long as the installation.
PIP := $(PYTHON) -m pip install --disable-pip-version-check --no-compile -q -c constraints.txt
PACKAGE := feel321
EXTRAS := dev docs rig ide cluster lsl
comma := ,
space := $(subst ,, )

.DELETE_ON_ERROR:
.PHONY: help demo test coverage realtime computing check lint types floors duplicates guards bench docs screenshots soak constraints advisories clean

help: ## list the commands
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' Makefile | expand -t 20

demo: .venv/.runs ## set up, run the whole chain on the bundled study, say where the report is
	.venv/bin/feel321 demo

test: .venv/.tests ## set up, run every test
ifdef ARGS
	$(PYTHON) -m pytest $(ARGS)
else
	$(MAKE) -j2 realtime computing
endif

coverage: .venv/.tests ## the same with branch coverage, which takes longer
	rm -f .coverage .coverage.*
	$(MAKE) -j2 realtime computing COVER="--cov --cov-report= --cov-fail-under=0"
	.venv/bin/coverage combine -q
	.venv/bin/coverage report

# One process per processor and one thread per process. Bytecode is kept: without it each of them would rewrite every
# assertion anew, which takes as long as hundreds of tests.
test realtime computing: export OPENBLAS_NUM_THREADS = 1
unexport PYTHONDONTWRITEBYTECODE

realtime: # one after the other; what computes beside them is nice, so that keys and sounds come in time; only these folders see the devices' fixtures
	COVERAGE_FILE=.coverage.realtime $(PYTHON) -m pytest -m realtime tests/study/actuator tests/study/lab tests/study/screen $(COVER)

computing:
	COVERAGE_FILE=.coverage.computing nice $(PYTHON) -m pytest -m "not realtime" -n logical --dist loadgroup $(COVER)

check: lint types floors duplicates guards ## every guard rail; `make -k check` goes on after a failure

lint: .venv/.tests
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

types: .venv/.tests
	.venv/bin/mypy

floors: .venv/.tests
	.venv/bin/lint-imports --no-logo

duplicates: .venv/.tests
	.venv/bin/pylint $(PACKAGE)

guards: .venv/.tests # sizes, docstrings, faces, wheel, pins, exclusions
	$(PYTHON) -m pytest tests/house

docs: .venv/.tests ## the documentation site, into build/docs; warnings are errors
	$(PYTHON) -m sphinx -q -W --keep-going -d build/doctrees docs build/docs
	@echo "Open build/docs/index.html"

screenshots: .venv/.tests ## the documentation's pictures of screens and report, by Xvfb and Chromium
	xvfb-run -a -s "-screen 0 1280x1024x24" $(PYTHON) docs/docsite/screenshots.py

bench: export OPENBLAS_NUM_THREADS = 1
bench: .venv/.tests ## speed and memory in one table, against the FFTs
	$(PYTHON) tests/bench/bench.py

soak: .venv/.tests ## the tests that take minutes
	$(PYTHON) -m pytest -m "soak or hypothesis" --hypothesis-profile=soak $(ARGS) || [ $$? -eq 5 ]  # pytest's 5: there is none

constraints: .venv/.tests ## pin what is installed now, after an upgrade
	{ sed -n '/^#/p' constraints.txt; $(PYTHON) -m pip freeze --all --exclude-editable | grep -v '^pip==' | sort -f; } > .venv/pins
	mv .venv/pins constraints.txt

advisories: .venv/.tests ## known flaws of the pinned versions, from the network; fails where they cannot be compared
	$(PYTHON) -m pip_audit --strict --no-deps --disable-pip --progress-spinner off -r constraints.txt

clean: ## remove everything that can be made again
	rm -rf .venv .coverage* .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis dist demo-study

.venv/bin/python:
	.ci/make-venv

.venv/.runs: pyproject.toml constraints.txt | .venv/bin/python
	@echo "Installing into .venv: half a minute, once"
	$(PIP) -e .
	touch $@

.venv/.tests: pyproject.toml constraints.txt .ci/packages.txt | .venv/bin/python
	sed 's/#.*//' .ci/packages.txt | xargs .ci/apt-install
	@echo "Installing into .venv, PsychoPy included: one to three minutes and 2 GB, once"
	$(PIP) -e '.[$(subst $(space),$(comma),$(EXTRAS))]'
	touch $@ .venv/.runs
